"""How far a hanging strand moves when its ends do, and how far it is from a polygon: upper bounds.

**Response of the shape.** Let T be the tension, n the unit normal of the curve in its plane, s the
arc length. The cable does not stretch, so a point moves by ∫ω n ds with some turning rate ω; in
equilibrium T·tangent changes by a constant force, so ω = n·δF / T. With

    K(s) = ∫₀ˢ n nᵀ / T,    J(s) = K(s) K(ℓ)⁻¹

a material point moves in the plane by (1 − J) a + J b when the ends move by a and b. Across the
plane the same holds with the point's share of the span in place of J, which never amplifies; that
covers a plane that swings about by any angle while the ends are nearly in plumb. K is elementary:
per weight of a metre, and between angles θ₀ and θ₁ (see :mod:`swarm.cable.catenary`),

    K₂₂ = [tanh θ],    K₁₁ = θ₁ − θ₀ − [tanh θ],    K₁₂ = [sech θ].

**Distances** only feel motion across the strand. A point's motion along the tangent carries the
curve into itself, apart from its ends, which move by a and b. So the set of points of the strand
moves no faster than the normal part of J, and

    |½(a + b)| + ½·S·|b − a|,    S = the largest of |(2J − 1)ᵀ n| and 1.

**The worst shape.** κ, the condition of K(ℓ), gives a proof for every shape: K(s) lies between 0
and K(ℓ), hence S ≤ √κ. Far sharper, and attained, is the level strand of the same chord and length
at its middle, where a change of chord moves the sag by half of

    k(x) = (1 − sech x) / (x − tanh x),    sinh(x) / x = length / chord.

Over all inclinations and places, and for chord / length from 1e-4 to 1 − 1e-6, S came out as
max(1, k), and the joint response to both ends anywhere in a ball as √(1 + k²) of its radius: to
1e-8 on dense meshes, and no search found a shape beyond. That the level middle is worst is thus
found out, not proved; bounds here are raised by one per cent for it. k grows with chord / length,
so over an interval of time the greatest chord gives the bound.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from swarm.cable.shape import half_angle_for_stretch

Floats = NDArray[np.float64]

_MARGIN = 1.01
_ACROSS = 1.13
"""Greatest response to a motion of the ends across their chord (1 up to chord / length of 0.99)."""
_BALL_STEPS = 8


def shape_sensitivity(chord: ArrayLike, length: ArrayLike) -> Floats:
    """Upper bound (…,) of what a strand of any inclination makes of a change of its chord.

    Half of it is the greatest motion across the strand per metre by which the ends part. It grows
    with chord / length, from 0 (deeply slack) over 1 (at 0.72), 3.5 (at 0.97) and 19.4 (at 0.999)
    to infinity where chord ≥ length.
    """
    chord, length = np.broadcast_arrays(_floats(chord), _floats(length))
    taut = chord >= length
    ratio = np.where(taut, 0.5, np.maximum(chord / length, 1e-12))
    x = half_angle_for_stretch(-np.log(ratio))
    return np.where(taut, np.inf, _MARGIN * _level_middle(x))


def motion_bound(
    mean: ArrayLike, relative: ArrayLike, chord: ArrayLike, length: ArrayLike
) -> Floats:
    """Upper bound (…,) of how far (or how fast) any point of a strand moves across the strand.

    ``mean`` bounds |a + b| / 2 and ``relative`` |b − a|, where a and b are the displacements (or
    velocities) of the ends; ``chord`` is the greatest distance of the ends on the way. Every point
    of the new strand is at most this far from the old strand, and the reverse.
    """
    stretching = np.maximum(1.0, shape_sensitivity(chord, length))
    return _floats(mean) + 0.5 * _times(stretching, _floats(relative))


def turning_bound(
    mean: ArrayLike,
    along: ArrayLike,
    across: ArrayLike,
    chord: ArrayLike,
    length: ArrayLike,
) -> Floats:
    """Sharper :func:`motion_bound` (…,) where the ends move relative to another mostly sideways.

    ``along`` bounds the change of the chord's length, ``across`` what is left of b − a at right
    angles to the chord, at every moment on the way. Turning a nearly taut strand does not whip it.
    """
    along, across, chord, length = (_floats(v) for v in (along, across, chord, length))
    stretching = np.maximum(1.0, shape_sensitivity(chord, length))
    sideways = np.where(chord <= 0.99 * length, _MARGIN, _MARGIN * _ACROSS)
    apart = _times(stretching, along) + sideways * across
    return _floats(mean) + 0.5 * np.minimum(apart, _times(stretching, np.hypot(along, across)))


def ball_bound(radius: ArrayLike, chord: ArrayLike, length: ArrayLike) -> Floats:
    """Upper bound (…,) of how far a strand is off when each end is off by up to ``radius``.

    ``chord`` is the distance between the ends' nominal places; it may grow by 2·radius on the way,
    and the response with it, which is summed up in steps from above. Infinite where the strand
    could be pulled taut.
    """
    radius, chord, length = _floats(radius), _floats(chord), _floats(length)
    share = np.arange(1, _BALL_STEPS + 1) / _BALL_STEPS
    reached = chord[..., None] + 2.0 * radius[..., None] * share
    response = np.hypot(_MARGIN, shape_sensitivity(reached, length[..., None]))
    return _times(response.mean(axis=-1), radius)


def tilt_bound(angle: ArrayLike, chord: ArrayLike, length: ArrayLike) -> Floats:
    """Upper bound (…,) of how far a strand moves when its gravity turns by ``angle``, radians.

    Turning gravity is turning the ends back about the middle of the chord, which moves them across
    the chord by ½·angle·chord each, and then everything forth, which moves points by up to
    ½·angle·length.
    """
    return 0.5 * _floats(angle) * (_MARGIN * _ACROSS * _floats(chord) + _floats(length))


def chord_polygon_error(points: ArrayLike, length: ArrayLike) -> Floats:
    """Upper bound (…,) of the distance of a strand from its inscribed polygon, metres.

    ``points`` (…, k + 1, 3) cut the strand of ``length`` (…,) into k equal arcs. A point on an arc
    of length h between ends at distance c lies within the ellipse with these foci, that is at most
    ½√(h² − c²) from their line's piece (for a shallow arc 1.15 times its true sagitta).
    """
    points, length = _floats(points), _floats(length)
    arc = length / (points.shape[-2] - 1)
    step = np.diff(points, axis=-2)
    shortest = np.einsum("...i,...i->...", step, step).min(axis=-1)
    error: Floats = 0.5 * np.sqrt(np.maximum(arc * arc * (1.0 + 1e-12) - shortest, 0.0))
    return error


def _level_middle(x: Floats) -> Floats:
    """(1 − sech x) / (x − tanh x), without cancellation; it falls as x grows."""
    x = np.minimum(x, 300.0)
    u = np.minimum(x * x, 1.0)
    term = np.ones_like(u)
    for j in (8, 7, 6, 5, 4, 3, 2, 1):
        term = 1.0 + u / (2 * j * (2 * j + 3)) * term
    wide = np.maximum(x, 1.0)
    below = np.where(x < 1.0, x**3 / 3.0 * term, wide * np.cosh(wide) - np.sinh(wide))
    return 2.0 * np.sinh(0.5 * x) ** 2 / below


def _times(response: Floats, size: Floats) -> Floats:
    """Product that is 0 where nothing moves, even if the response is infinite."""
    return np.where(size > 0.0, np.where(size > 0.0, response, 0.0) * size, 0.0)


def _floats(value: ArrayLike) -> Floats:
    return np.asarray(value, dtype=np.float64)
