"""Batches of catenaries: an inextensible, perfectly flexible cable between two points.

In the plane of ``up`` (against the effective gravity) and ``heading`` (the horizontal direction
from start to end) the strand is ``a·(θ, cosh θ)`` up to a shift, where θ runs over an interval of
length ``2x`` whose middle is ``artanh(rise / length)`` and ``x`` solves
``sinh(x) / x = √(length² − rise²) / span``. ``sinh θ`` is the slope, ``a·cosh θ`` the tension per
weight of a metre, ``a·sinh θ`` the arc length from the lowest point (Routh, *Statics*, § 443).

All figures come from differences that do not cancel, so that nearly taut and deeply slack strands
are as exact as others. A vertical strand is the limit of a vanishing span, computed at a span of
``1e-80`` lengths.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from swarm.errors import SwarmError
from swarm.geometry.catenary_kernel import arc_offset, solve
from swarm.geometry.catenary_points import Arcs, Vectors, offsets_memory, write_points
from swarm.geometry.catenary_shape import (
    SMALLEST_HALF_ANGLE,
    VERTICAL,
    half_angle_for_drop,
    half_angle_for_sag,
    log_sinhc,
    sag_per_span,
)
from swarm.jit import compiled
from swarm.signatures import Floats1, Floats2, contiguous

Floats = NDArray[np.float64]

STANDARD_GRAVITY = 9.80665
"""m/s², the standard acceleration of gravity (3rd CGPM, 1901)."""

MAX_CHORD_RATIO = 0.985
"""Largest chord over length of a segment in the air. Nearer to taut, errors of the ends grow: the
sag changes by 1.7 m per metre of an end at a ratio of 0.97, and by 9.7 m at 0.999."""

_ROUNDING = 1e-12
"""A chord may exceed the length by this share: coordinates of 1 km are rounded by 1e-13 m."""


class OverStretched(SwarmError):  # noqa: N818 - names the state of the cable
    """A chord is longer than its cable, which does not stretch; lists every such segment.

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

    def __reduce__(self) -> tuple[type, tuple[object, ...]]:
        """Keep the arguments when the error crosses processes."""
        return type(self), (self.segments, self.chords, self.lengths)


@dataclass(frozen=True, eq=False)
class Catenaries:
    """A batch of hanging strands, solved by :func:`solve_catenaries`.

    Vectors are (…, 3), scalars (…,), metres. Horizontal and vertical mean across and along
    ``down``, which is vertical only in still air and without acceleration.
    """

    start: Floats
    end: Floats
    length: Floats
    down: Floats
    """Unit vector of the effective gravity."""
    heading: Floats
    """Unit vector, horizontal, from start to end; zero where one is straight above the other."""
    span: Floats
    """Horizontal distance of the ends."""
    rise: Floats
    """Height of the end above the start."""
    half_angle: Floats
    """x = span / 2a: 0 where taut; at 1 the sag is a quarter of the span; large where slack."""
    parameter: Floats
    """a, metres: horizontal tension over the weight of a metre; very large where taut."""
    slope: Floats
    """sinh θ at the start: rise per horizontal metre there (negative: downward)."""

    def points(self, fractions: ArrayLike) -> Floats:
        """Return points (…, k, 3) at given fractions (k,) of the arc length of every strand."""
        fractions = _floats(fractions)
        points = np.empty((self.span.size, fractions.size, 3))
        memory = offsets_memory(fractions.size)
        write_points(_flat(fractions), *self._for_kernels(), memory, points)
        return points.reshape(*self.span.shape, fractions.size, 3)

    def _for_kernels(self) -> "tuple[Arcs, Vectors]":
        return (
            Arcs(_flat(self.length), _flat(self.parameter), _flat(self.slope)),
            Vectors(_flat(self.start, 3), _flat(self._per_angle, 3), _flat(self._per_height, 3)),
        )

    def points_at(self, fraction: ArrayLike) -> Floats:
        """Return one point per strand, at its own fraction (…,) of its arc length: (…, 3)."""
        shape = _common_shape(np.shape(fraction), self.span.shape)
        figures: tuple[Floats, ...]
        figures = (_floats(fraction), self.length, self.parameter, self.slope)
        if any(figure.shape != shape for figure in figures):
            figures = tuple(np.broadcast_to(figure, shape) for figure in figures)
        at, length, parameter, slope = (_flat(figure) for figure in figures)
        angle, height = np.empty((2, len(at)))
        _write_offsets(at, Arcs(length, parameter, slope), angle, height)
        angle, height = angle.reshape(*shape, 1), height.reshape(*shape, 1)
        point: Floats = self.start + angle * self._per_angle + height * self._per_height
        return point

    def at_span(self, fraction: ArrayLike) -> Floats:
        """Return the point of each strand at a fraction (…,) of its horizontal span: (…, 3).

        Heights at a crossing of the plan view are found so. A vertical strand has no unique such
        point; one of its points is returned.
        """
        fraction = _floats(fraction)
        turned = self.half_angle * fraction
        start_angle = np.arcsinh(self.slope)
        up = 2.0 * self.parameter * np.sinh(turned) * np.sinh(start_angle + turned)
        along = self.span * fraction
        return self.start + along[..., None] * self.heading - up[..., None] * self.down

    @cached_property
    def lowest_fraction(self) -> Floats:
        """Fraction (…,) of the arc length at which each strand is lowest."""
        fraction: Floats = np.clip(-self.slope * (self.parameter / self.length), 0.0, 1.0)
        return fraction

    def lowest(self) -> Floats:
        """Return the lowest point (…, 3) of each strand; an end where the strand is monotone."""
        return self.points_at(self.lowest_fraction)

    def sag(self) -> Floats:
        """Return the largest distance (…,) of each strand below its chord, along ``down``."""
        return self._span * sag_per_span(self.half_angle, self.rise / self._span)

    def tension(
        self, mass_per_length: ArrayLike, gravity: ArrayLike = STANDARD_GRAVITY
    ) -> tuple[Floats, Floats, Floats]:
        """Return tensions (…,) in newtons: the horizontal part, at the start, and at the end.

        ``mass_per_length`` in kg/m; ``gravity`` is the size of the effective gravity, m/s².
        Tensions of a strand that is taut to the last digit are very large and finite.
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
        """Return the forces (…, 3) of each strand on the holders of its start and end; newtons.

        Their sum is the weight of the strand. Arguments as for :meth:`tension`.
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
        return np.maximum(self.span, VERTICAL * self.length)


def solve_catenaries(
    start: ArrayLike, end: ArrayLike, length: ArrayLike, *, down: ArrayLike = (0.0, 0.0, -1.0)
) -> Catenaries:
    """Return the catenaries of cables of given lengths between given ends.

    ``start``, ``end`` and ``down`` are (…, 3), ``length`` is (…,), metres; they broadcast. ``down``
    is the direction (of any size) of the effective gravity: tilt it for steady wind drag or for a
    constant acceleration.

    Raises :class:`OverStretched` where a chord is longer than its cable.
    """
    start, end, length, down = _floats(start), _floats(end), _floats(length), _floats(down)
    shape = _common_shape(start.shape[:-1], end.shape[:-1], length.shape, down.shape[:-1])
    if not start.shape[:-1] == end.shape[:-1] == length.shape == shape:
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

    wide = np.maximum(span, VERTICAL * length)
    solved = np.empty((3, span.size))
    _solve_all(_flat(wide), _flat(rise), _flat(length), solved)
    half_angle, parameter, slope = solved.reshape(3, *shape)
    across /= wide[..., None]
    return Catenaries(
        start=start,
        end=end,
        length=length,
        down=down,
        heading=across,
        span=span,
        rise=rise,
        half_angle=half_angle,
        parameter=parameter,
        slope=slope,
    )


def sag_for_length(span: ArrayLike, length: ArrayLike, rise: ArrayLike = 0.0) -> Floats:
    """Return the sag (…,) below the chord of strands of given lengths; metres.

    ``span`` is the horizontal and ``rise`` the vertical distance of its ends. Raises
    :class:`OverStretched`.
    """
    end = np.stack(np.broadcast_arrays(_floats(span), 0.0, _floats(rise)), axis=-1)
    return solve_catenaries(np.zeros(3), end, length).sag()


def length_for_sag(span: ArrayLike, sag: ArrayLike, rise: ArrayLike = 0.0) -> Floats:
    """Return the length (…,) of the strand that sags by ``sag`` below its chord; metres.

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
    """Return the sag (…,) of the strand that is ``drop`` below its chord at a fraction of its span.

    ``fraction`` lies strictly between 0 and 1; ``drop`` is positive; metres. A longer cable is
    lower everywhere, so the strand is unique.
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
def _solve_all(span: Floats1, rise: Floats1, length: Floats1, solved: Floats2) -> None:
    """Write half angles, parameters and start slopes (3, q)."""
    for q in range(len(span)):
        solved[0, q], solved[1, q], solved[2, q] = solve(
            span[q], rise[q], length[q], SMALLEST_HALF_ANGLE
        )


@compiled
def _write_offsets(fraction: Floats1, arcs: Arcs, angle: Floats1, height: Floats1) -> None:
    """Write :func:`arc_offset` of strands (q,) at a fraction (q,) of each."""
    for q in range(len(arcs.length)):
        angle[q], height[q] = arc_offset(
            fraction[q], arcs.length[q], arcs.parameter[q], arcs.slope[q]
        )


def _flat(array: Floats, *last: int) -> Floats:
    """Return the array as a row of numbers or vectors, contiguous and writable for the kernels."""
    return contiguous(array.reshape(-1, *last))


def _common_shape(first: tuple[int, ...], *others: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape to which arrays broadcast; most have the same one, or none."""
    if all(shape in (first, ()) for shape in others):
        return first
    return np.broadcast_shapes(first, *others)


def _floats(value: ArrayLike) -> Floats:
    return np.asarray(value, dtype=np.float64)


def _dot(a: Floats, b: Floats) -> Floats:
    product: Floats = np.einsum("...i,...i->...", a, b)
    return product
