"""Batches of catenaries: an inextensible, perfectly flexible cable hung between two points.

In the plane of ``up`` (against the effective gravity) and ``heading`` (the horizontal direction
from start to end) the strand is ``a·(θ, cosh θ)`` up to a shift, where θ runs over an interval of
length ``2x`` whose middle is ``artanh(rise / length)`` and ``x`` solves
``sinh(x) / x = √(length² − rise²) / span``. ``sinh θ`` is the slope, ``a·cosh θ`` the tension per
weight of a metre, ``a·sinh θ`` the arc length from the lowest point (Routh, *Statics*, § 443).

Everything is computed from differences that do not cancel, so that nearly taut and deeply slack
strands are as exact as the rest. A vertical strand is the limit of a vanishing span, taken at a
span of ``1e-80`` lengths.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from swarm.errors import SwarmError
from swarm.geometry.catenary_shape import (
    SMALLEST_HALF_ANGLE,
    half_angle_for_drop,
    half_angle_for_sag,
    half_angle_for_stretch,
    log_sinhc,
    sag_per_span,
)
from swarm.jit import compiled

Floats = NDArray[np.float64]

STANDARD_GRAVITY = 9.80665
"""m/s²; what turns a mass per length into a weight."""

_VERTICAL = 1e-80
"""Smallest span per length: below it a strand is vertical to any accuracy."""

_ROUNDING = 1e-12
"""A chord may exceed the length by this share: it is rounding of the coordinates, not stretch."""


class OverStretched(SwarmError):  # noqa: N818 - reads as what happened to the cable
    """A chord is longer than its cable, which does not stretch; names every such segment.

    ``segments`` are the indices in the batch (one tuple each), ``chords`` and ``lengths`` metres.
    """

    def __init__(self, segments: list[tuple[int, ...]], chords: Floats, lengths: Floats) -> None:
        self.segments, self.chords, self.lengths = segments, chords, lengths
        shown = [
            f"segment {', '.join(map(str, segment)) or '0'}: "
            f"its ends are {chord:.6g} m apart, its cable is {length:.6g} m"
            for segment, chord, length in zip(segments[:10], chords, lengths, strict=False)
        ]
        if len(segments) > 10:
            shown.append(f"and {len(segments) - 10} more")
        super().__init__("over-stretched cable: " + "; ".join(shown))


@dataclass(frozen=True, eq=False)
class Catenaries:
    """A batch of hanging strands, as solved by :func:`solve_catenaries`.

    Vectors are (…, 3), scalars (…,), metres. Horizontal and vertical mean across and along
    ``down``, which is vertical only in still air and without acceleration.
    """

    start: Floats
    end: Floats
    length: Floats
    down: Floats
    """Unit vector of the effective gravity."""
    heading: Floats
    """Unit vector, horizontally from start to end; zero where one is straight above the other."""
    span: Floats
    """Horizontal distance of the ends."""
    rise: Floats
    """How much higher the end is than the start."""
    half_angle: Floats
    """x = span / 2a: from nothing (taut) over 1 (sag of a quarter of the span) upwards (slack)."""
    parameter: Floats
    """a, metres: horizontal tension over the weight of a metre; huge where taut."""
    slope: Floats
    """sinh θ at the start: rise per horizontal metre there (negative: the strand goes down)."""

    def points(self, fractions: ArrayLike) -> Floats:
        """Points at the given fractions (k,) of the arc length of every strand: (…, k, 3)."""
        fractions = _floats(fractions)
        points = np.empty((self.span.size, fractions.size, 3))
        _points(
            _flat(fractions), _flat(self.length), _flat(self.parameter), _flat(self.slope),
            _flat(self.start, 3), _flat(self._per_angle, 3), _flat(self._per_height, 3), points,
        )  # fmt: skip
        return points.reshape(*self.span.shape, fractions.size, 3)

    def points_at(self, fraction: ArrayLike) -> Floats:
        """One point per strand, at its own fraction (…,) of its arc length: (…, 3)."""
        shape = np.broadcast_shapes(np.shape(fraction), self.span.shape)
        figures = (_floats(fraction), self.length, self.parameter, self.slope)
        at, length, parameter, slope = (_flat(np.broadcast_to(v, shape)) for v in figures)
        angle, height = np.empty((2, len(at)))
        _offsets(at, length, parameter, slope, angle, height)
        angle, height = angle.reshape(*shape, 1), height.reshape(*shape, 1)
        point: Floats = self.start + angle * self._per_angle + height * self._per_height
        return point

    def at_span(self, fraction: ArrayLike) -> Floats:
        """The point of each strand above or below a fraction (…,) of its horizontal span: (…, 3).

        This is how heights at a crossing of the plan view are found. A strand between two ends
        that are straight above another has no such point; one of its points is returned.
        """
        fraction = _floats(fraction)
        turned = self.half_angle * fraction
        start_angle = np.arcsinh(self.slope)
        up = 2.0 * self.parameter * np.sinh(turned) * np.sinh(start_angle + turned)
        along = self.span * fraction
        return self.start + along[..., None] * self.heading - up[..., None] * self.down

    @cached_property
    def lowest_fraction(self) -> Floats:
        """Where each strand is lowest, as a fraction (…,) of its arc length."""
        fraction: Floats = np.clip(-self.slope * (self.parameter / self.length), 0.0, 1.0)
        return fraction

    def lowest(self) -> Floats:
        """The lowest point of each strand: (…, 3). It is an end where the strand never turns."""
        return self.points_at(self.lowest_fraction)

    def sag(self) -> Floats:
        """How far each strand hangs below its chord at the deepest, along ``down``: (…,) metres."""
        return self._span * sag_per_span(self.half_angle, self.rise / self._span)

    def tension(
        self, mass_per_length: ArrayLike, gravity: ArrayLike = STANDARD_GRAVITY
    ) -> tuple[Floats, Floats, Floats]:
        """Tension (…,) in newtons: its horizontal part, at the start, and at the end.

        ``mass_per_length`` in kg/m; ``gravity`` is the size of the effective gravity, m/s².
        Where a strand is taut to the last digit the figure is huge and means just that.
        """
        weight = _floats(mass_per_length) * _floats(gravity)
        horizontal = weight * self.parameter
        return (
            horizontal,
            horizontal * np.hypot(1.0, self.slope),
            horizontal * np.hypot(1.0, self._end_slope),
        )

    def end_forces(
        self, mass_per_length: ArrayLike, gravity: ArrayLike = STANDARD_GRAVITY
    ) -> tuple[Floats, Floats]:
        """Force (…, 3) of each strand on what holds its start, and on what holds its end; newtons.

        Together they are the weight of the strand. Arguments as for :meth:`tension`.
        """
        weight = _floats(mass_per_length) * _floats(gravity)
        horizontal = (weight * self.parameter)[..., None]
        at_start = horizontal * (self.heading - self.slope[..., None] * self.down)
        at_end = -horizontal * (self.heading - self._end_slope[..., None] * self.down)
        return at_start, at_end

    @property
    def _end_slope(self) -> Floats:
        return self.slope + self.length / self.parameter

    @property
    def _per_angle(self) -> Floats:
        return self.parameter[..., None] * self.heading

    @property
    def _per_height(self) -> Floats:
        return -self.length[..., None] * self.down

    @property
    def _span(self) -> Floats:
        return np.maximum(self.span, _VERTICAL * self.length)


def solve_catenaries(
    start: ArrayLike, end: ArrayLike, length: ArrayLike, *, down: ArrayLike = (0.0, 0.0, -1.0)
) -> Catenaries:
    """Hang cables of the given lengths between the given ends.

    ``start``, ``end`` and ``down`` are (…, 3), ``length`` is (…,), metres; they broadcast. ``down``
    is the direction (of any size) of the effective gravity: tilt it for steady wind drag or for a
    constant acceleration.

    Raises :class:`OverStretched` where a chord is longer than its cable.
    """
    start, end, length, down = _floats(start), _floats(end), _floats(length), _floats(down)
    shape = np.broadcast_shapes(start.shape[:-1], end.shape[:-1], length.shape, down.shape[:-1])
    start = np.broadcast_to(start, (*shape, 3))
    end = np.broadcast_to(end, (*shape, 3))
    length = np.broadcast_to(length, shape)
    down = np.broadcast_to(down / np.linalg.norm(down, axis=-1, keepdims=True), (*shape, 3))

    across = end - start
    rise = -_dot(across, down)
    for axis in range(3):
        across[..., axis] += rise * down[..., axis]
    span = np.sqrt(_dot(across, across))
    chord = np.sqrt(span * span + rise * rise)
    _require_reach(chord, length)

    wide = np.maximum(span, _VERTICAL * length)
    excess = np.maximum(length - chord, 0.0) * (length + chord)
    half_angle = np.maximum(
        half_angle_for_stretch(0.5 * np.log1p(excess / wide**2)), SMALLEST_HALF_ANGLE
    )
    across /= wide[..., None]
    # sinh and cosh of the middle angle are rise and length over the level length of the same x.
    level = np.sqrt(excess + wide**2)
    sinh = half_angle * (level / wide)
    return Catenaries(
        start=start,
        end=end,
        length=length,
        down=down,
        heading=across,
        span=span,
        rise=rise,
        half_angle=half_angle,
        parameter=wide / (2.0 * half_angle),
        slope=(rise * np.sqrt(1.0 + sinh * sinh) - length * sinh) / level,
    )


def sag_for_length(span: ArrayLike, length: ArrayLike, rise: ArrayLike = 0.0) -> Floats:
    """Deepest vertical distance (…,) of a strand below its chord, for its length; metres.

    ``span`` is the horizontal and ``rise`` the vertical distance of its ends. Raises
    :class:`OverStretched`.
    """
    end = np.stack(np.broadcast_arrays(_floats(span), 0.0, _floats(rise)), axis=-1)
    return solve_catenaries(np.zeros(3), end, length).sag()


def length_for_sag(span: ArrayLike, sag: ArrayLike, rise: ArrayLike = 0.0) -> Floats:
    """Length (…,) of the strand that hangs ``sag`` below its chord; metres.

    At level ends this is ℓ = 2a·sinh(s/a) = 2√((h + a)² − a²) with h/a = cosh(s/a) − 1, s half the
    span and h the sag (paper eq. 2; its printed length √(s² − a²) is a misprint). ``span`` must be
    positive and ``sag`` not negative.
    """
    span, sag, rise = np.broadcast_arrays(_floats(span), _floats(sag), _floats(rise))
    if not (np.all(span > 0.0) and np.all(sag >= 0.0)):
        raise ValueError("a span must be positive, a sag not negative")
    gradient = rise / span
    x = half_angle_for_sag(sag / span, gradient)
    length: Floats = np.hypot(rise, span * np.exp(log_sinhc(x)))
    return length


def sag_for_drop(
    span: ArrayLike, drop: ArrayLike, fraction: ArrayLike, rise: ArrayLike = 0.0
) -> Floats:
    """Sag (…,) of the strand that passes ``drop`` below its chord at a fraction of its span.

    ``fraction`` lies strictly between 0 and 1; ``drop`` is positive; metres. A longer cable hangs
    lower everywhere, so there is just one such strand.
    """
    span, drop, fraction, rise = np.broadcast_arrays(
        _floats(span), _floats(drop), _floats(fraction), _floats(rise)
    )
    if not (np.all(span > 0.0) and np.all(drop > 0.0) and np.all((fraction > 0) & (fraction < 1))):
        raise ValueError("a span and a drop must be positive, a fraction between 0 and 1")
    gradient = rise / span
    return span * sag_per_span(half_angle_for_drop(drop / span, fraction, gradient), gradient)


def _require_reach(chord: Floats, length: Floats) -> None:
    if not (np.all(length > 0.0) and np.all(np.isfinite(length)) and np.all(np.isfinite(chord))):
        raise ValueError("cable lengths must be positive, and the ends finite")
    over = chord > length * (1.0 + _ROUNDING)
    if np.any(over):
        segments = [tuple(int(i) for i in index) for index in np.argwhere(over)]
        raise OverStretched(segments, chord[over], length[over])


@compiled
def _points(
    fractions: Floats,
    length: Floats,
    parameter: Floats,
    slope: Floats,
    start: Floats,
    per_angle: Floats,
    per_height: Floats,
    found: Floats,
) -> None:
    """Write points (q, k, 3) of strands (q,) at fractions (k,) of their arcs."""
    for q in range(len(length)):
        for k in range(len(fractions)):
            angle, height = _offset(fractions[k], length[q], parameter[q], slope[q])
            for axis in range(3):
                moved = angle * per_angle[q, axis] + height * per_height[q, axis]
                found[q, k, axis] = start[q, axis] + moved


@compiled
def _offsets(
    fraction: Floats,
    length: Floats,
    parameter: Floats,
    slope: Floats,
    angle: Floats,
    height: Floats,
) -> None:
    """Write :func:`_offset` of strands (q,) at a fraction (q,) of each."""
    for q in range(len(length)):
        angle[q], height[q] = _offset(fraction[q], length[q], parameter[q], slope[q])


@compiled
def _offset(fraction: float, length: float, parameter: float, first: float) -> tuple[float, float]:
    """Angle turned, and height gained over length, from the start to a fraction of the arc.

    With slopes A at the start and B at the point, and C = √(1 + slope²): the height is
    arc · (A + B)/(C_A + C_B), which does not cancel. The angle is arsinh B − arsinh A, or where it
    is small, from tanh(Δθ/2) = (B − A)/(C_A + C_B).
    """
    turned = fraction * (length / parameter)
    slope = first + turned
    cosh_first, cosh = np.sqrt(1.0 + first * first), np.sqrt(1.0 + slope * slope)
    total = cosh_first + cosh
    if parameter * 1e-3 > length:
        half = turned / total
        angle = half * (2.0 + half * half * (2 / 3 + half * half * (2 / 5)))
    else:
        angle = np.copysign(np.log(abs(slope) + cosh), slope)
        angle -= np.copysign(np.log(abs(first) + cosh_first), first)
    return angle, fraction * ((slope + first) / total)


def _flat(array: Floats, *last: int) -> Floats:
    """The array as a row of numbers or vectors, contiguous and writable as compiled for."""
    return np.require(array.reshape(-1, *last), requirements=["C", "W"])


def _floats(value: ArrayLike) -> Floats:
    return np.asarray(value, dtype=np.float64)


def _dot(a: Floats, b: Floats) -> Floats:
    product: Floats = np.einsum("...i,...i->...", a, b)
    return product
