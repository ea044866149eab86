"""How strands answer when the vehicles that hold them move: the more, the tauter they are.

All functions but :func:`sag_responses` are compiled, and for one strand.
"""

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary_kernel import max_elevation_sine
from swarm.jit import compiled

Floats = npt.NDArray[np.float64]

PIECES = 6
"""A strand is handled as this many chords."""

_RATIOS = np.array([0.0, 0.3, 0.5, 0.7, 0.8, 0.85, 0.9, 0.93, 0.95, 0.97, 1.0])
_LIFTS = np.array([0.1, 0.15, 0.25, 0.5, 0.75, 1.0, 1.55, 2.3, 3.6, 5.0, 8.0])
"""What the middle of a level strand moves vertically per metre of both ends, over one, by ratio."""

_FROM_GRIP = np.array([0.0, 0.1, 0.17, 0.25, 0.5, 0.75, 1.0])
_FAR_LEVEL = np.array([0.0, 0.3, 0.44, 0.55, 0.84, 1.0, 1.02])
_FAR_STEEP = np.array([0.3, 0.6, 0.7, 0.75, 0.95, 1.02, 1.02])

_NOT_STEEP = 0.86
"""Sine of an elevation up to which strands do not count as steep."""


@compiled
def sag_response(ratio: float) -> float:
    """How far the middle of a level strand moves vertically per metre of both its ends."""
    return 1.0 + interpolate(ratio, _RATIOS, _LIFTS)


def sag_responses(ratio: Floats) -> Floats:
    """As :func:`sag_response`, for many strands (…)."""
    moved: Floats = 1.0 + np.interp(ratio, _RATIOS, _LIFTS)
    return moved


@compiled
def interpolate(at: float, places: Floats, values: Floats) -> float:
    """Read a table of values at rising places (k,) between two of these; its ends go on level.

    As ``np.interp``, which makes arrays of its own for one number, too.
    """
    if not at > places[0]:
        return float(values[0])
    for k in range(len(places) - 1):
        if at < places[k + 1]:
            slope = (values[k + 1] - values[k]) / (places[k + 1] - places[k])
            return float(slope * (at - places[k]) + values[k])
    return float(values[-1])


@compiled
def point_movement(lifted: float, fraction: float, upright: float) -> float:
    """Movement of a strand's point per metre of its ends, along a direction this much upright.

    ``lifted`` is the strand's :func:`sag_response`, ``fraction`` where on the strand the point is.
    """
    bulge = 4.0 * fraction * (1.0 - fraction)
    vertical = 1.0 + (lifted - 1.0) * bulge
    level = 1.0 + 0.45 * bulge
    return float(level * np.sqrt(1.0 - upright**2) + vertical * upright)


@compiled
def max_point_movement(lifted: float) -> float:
    """The most that :func:`point_movement` says of any point of a strand."""
    return float(np.sqrt(1.45**2 + max(lifted, 1.0) ** 2))


@compiled
def far_end_movement(
    points: Floats, ratio: float, chord: float, fraction: float, upright: float, tracking: float
) -> float:
    """As :func:`point_movement` where only the far end moves, but twice as far; for one strand.

    ``points`` (k, 3) are the strand's, ``fraction`` is from the grip that rests. Strands between
    ends far above each other swing more.
    """
    rise = points[-1, 2] - points[0, 2]
    sine = max_elevation_sine(rise, np.sqrt(max(chord * chord - rise * rise, 0.0)), 2.0 * tracking)
    level = interpolate(fraction, _FROM_GRIP, _FAR_LEVEL)
    if sine > _NOT_STEEP:
        steep = min(max((np.arcsin(sine) - 1.05) / 0.52, 0.0), 1.0)
        level += steep * (interpolate(fraction, _FROM_GRIP, _FAR_STEEP) - level)
    level *= min(0.4 + 0.75 * ratio, 1.0)
    vertical = min(1.05, level * (0.5 + 1.5 * ratio**2))
    vertical *= max(1.0, 0.5 * (1.0 + interpolate(ratio, _RATIOS, _LIFTS)))
    return float(2.0 * (level * np.sqrt(1.0 - upright**2) + vertical * upright))


@compiled
def max_far_end_movement(ratio: float) -> float:
    """The most that :func:`far_end_movement` says of any point of a strand."""
    vertical = 1.05 * max(1.0, 0.5 * (1.0 + interpolate(ratio, _RATIOS, _LIFTS)))
    return float(2.0 * np.sqrt(1.02**2 + vertical**2))


@compiled
def add_to_ends(
    slopes: Floats, segment: int, share: float, lifted: float, points: Floats, push: Floats
) -> None:
    """Add what grows by ``push`` (3,) with a point of a segment to the slopes (n, 3) of its ends.

    A strand's point follows the strand's ends in proportion to how near it is to each; where they
    move apart, it rises by as much as its :func:`sag_response` says.
    """
    along_x, along_y = points[-1, 0] - points[0, 0], points[-1, 1] - points[0, 1]
    span = max(np.sqrt(along_x**2 + along_y**2), 1e-9)
    rises = 2.0 * share * (1.0 - share) * (lifted - 1.0) * push[2] / span
    for axis in range(3):
        slopes[segment, axis] += (1.0 - share) * push[axis]
        slopes[segment + 1, axis] += share * push[axis]
    slopes[segment, 0] -= rises * along_x
    slopes[segment, 1] -= rises * along_y
    slopes[segment + 1, 0] += rises * along_x
    slopes[segment + 1, 1] += rises * along_y
