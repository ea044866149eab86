"""Response of strands to movements of their vehicles, as the planner estimates it: by short tables.

The tables approximate :mod:`swarm.geometry.sensitivity`, by which the certificate bounds the same
movement; they are quicker to read and have derivatives. All functions but :func:`sag_responses` are
compiled, and for one strand.
"""

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary_kernel import max_elevation_sine
from swarm.jit import compiled

Floats = npt.NDArray[np.float64]

PIECES = 6
"""Edges of the polygon that stands for a strand."""

_RATIOS = np.array([0.0, 0.3, 0.5, 0.7, 0.8, 0.85, 0.9, 0.93, 0.95, 0.97, 1.0])
_RISES = np.array([0.1, 0.15, 0.25, 0.5, 0.75, 1.0, 1.55, 2.3, 3.6, 5.0, 8.0])
"""Vertical movement of the middle of a level strand per metre of both ends, less 1, by chord ratio.
Within 9 % of the certificate's tables for ratios that grow by 0.05."""

_FROM_GRIP = np.array([0.0, 0.1, 0.17, 0.25, 0.5, 0.75, 1.0])
_FAR_LEVEL = np.array([0.0, 0.3, 0.44, 0.55, 0.84, 1.0, 1.02])
_FAR_STEEP = np.array([0.3, 0.6, 0.7, 0.75, 0.95, 1.02, 1.02])
"""Horizontal movement per metre of the far end, by the share of the strand from the grip that does
not move, of level and of steep chords. Within 0.13 of the certificate's tables for ratios of 0.79
to 0.9, level chords and chords of 70° to 80°; at the grip of steep ones these have 0.12 to 0.34."""

_LEVEL_BULGE = 0.45
"""Horizontal movement of the middle per metre of both ends, less 1; 0.44 in the same tables."""

_NOT_STEEP = 0.86
"""Sine of an elevation of 59°, up to which the table of level chords applies; see _STEEP_FROM."""

_STEEP_FROM, _STEEP_OVER = 1.05, 0.52
"""Radians: the elevation from which the tables blend (60°), and the range until 90°."""

_LARGEST_FAR = 1.05
"""Largest vertical movement of a slack strand per metre of the far end; 1.04 in the same tables."""


@compiled
def sag_response(ratio: float) -> float:
    """Return the vertical movement of the middle of a level strand per metre of both its ends."""
    return 1.0 + interpolate(ratio, _RATIOS, _RISES)


def sag_responses(ratio: Floats) -> Floats:
    """As :func:`sag_response`, for many strands (…)."""
    response: Floats = 1.0 + np.interp(ratio, _RATIOS, _RISES)
    return response


@compiled
def interpolate(at: float, places: Floats, values: Floats) -> float:
    """Return the linear interpolation of values at increasing places (k,), constant outside.

    As ``np.interp``, which creates arrays even for one number.
    """
    if not at > places[0]:
        return float(values[0])
    for k in range(len(places) - 1):
        if at < places[k + 1]:
            slope = (values[k + 1] - values[k]) / (places[k + 1] - places[k])
            return float(slope * (at - places[k]) + values[k])
    return float(values[-1])


@compiled
def point_movement(response: float, fraction: float, upright: float) -> float:
    """Return the movement of a strand's point per metre of its ends, along a direction.

    ``response`` is the strand's :func:`sag_response`, ``fraction`` the place of the point on the
    strand, ``upright`` the vertical part of the unit vector of the direction.
    """
    bulge = 4.0 * fraction * (1.0 - fraction)
    vertical = 1.0 + (response - 1.0) * bulge
    level = 1.0 + _LEVEL_BULGE * bulge
    return float(level * np.sqrt(1.0 - upright**2) + vertical * upright)


@compiled
def max_point_movement(response: float) -> float:
    """Return the largest :func:`point_movement` of any point of a strand, in any direction."""
    return float(np.sqrt((1.0 + _LEVEL_BULGE) ** 2 + max(response, 1.0) ** 2))


@compiled
def far_end_movement(
    points: Floats, ratio: float, chord: float, fraction: float, upright: float, tracking: float
) -> float:
    """As :func:`point_movement`, where only the far end moves, by twice the tracking error.

    ``points`` (k, 3) are the strand's outline, ``fraction`` is from the grip that does not move.
    Points of steep strands move more.
    """
    rise = points[-1, 2] - points[0, 2]
    sine = max_elevation_sine(rise, np.sqrt(max(chord * chord - rise * rise, 0.0)), 2.0 * tracking)
    level = interpolate(fraction, _FROM_GRIP, _FAR_LEVEL)
    if sine > _NOT_STEEP:
        steep = min(max((np.arcsin(sine) - _STEEP_FROM) / _STEEP_OVER, 0.0), 1.0)
        level += steep * (interpolate(fraction, _FROM_GRIP, _FAR_STEEP) - level)
    level *= min(0.4 + 0.75 * ratio, 1.0)
    vertical = min(_LARGEST_FAR, level * (0.5 + 1.5 * ratio**2))
    vertical *= max(1.0, 0.5 * (1.0 + interpolate(ratio, _RATIOS, _RISES)))
    return float(2.0 * (level * np.sqrt(1.0 - upright**2) + vertical * upright))


@compiled
def max_far_end_movement(ratio: float) -> float:
    """Return the largest :func:`far_end_movement` of any point of a strand, in any direction."""
    vertical = _LARGEST_FAR * max(1.0, 0.5 * (1.0 + interpolate(ratio, _RATIOS, _RISES)))
    return float(2.0 * np.sqrt(_FAR_LEVEL[-1] ** 2 + vertical**2))


@compiled
def add_to_ends(
    gradient: Floats, segment: int, share: float, response: float, points: Floats, push: Floats
) -> None:
    """Add to the gradient (n, 3) the derivative ``push`` (3,) by a point of a segment.

    The point follows the two ends in proportion to its nearness to each; where they move apart, it
    rises by ``response``, the strand's :func:`sag_response`.
    """
    along_x, along_y = points[-1, 0] - points[0, 0], points[-1, 1] - points[0, 1]
    span = max(np.sqrt(along_x**2 + along_y**2), 1e-9)
    rises = 2.0 * share * (1.0 - share) * (response - 1.0) * push[2] / span
    for axis in range(3):
        gradient[segment, axis] += (1.0 - share) * push[axis]
        gradient[segment + 1, axis] += share * push[axis]
    gradient[segment, 0] -= rises * along_x
    gradient[segment, 1] -= rises * along_y
    gradient[segment + 1, 0] += rises * along_x
    gradient[segment + 1, 1] += rises * along_y
