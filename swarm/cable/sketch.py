"""Points of hanging strands for looking at them many times a second: within a micrometre, quickly.

The same catenaries as :func:`swarm.cable.catenary.hang`, for vertical gravity, with the half angle
from a table instead of Halley's method, and boxes that no strand leaves, without any catenary.
"""

import numpy as np
from numpy.typing import NDArray

from swarm.cable.shape import half_angle_for_stretch

Floats = NDArray[np.float64]

_VERTICAL = 1e-6
"""Span over length below which a strand counts as hanging straight down and up again."""
_TAUTEST = 1e-6
"""Smallest half angle: its strand sags by a quarter of a millionth of its span."""
_ROOTS = np.linspace(0.0, 2.0, 8001)
"""Square roots of the stretch, of which the half angle is nearly a straight line."""
_HALF_ANGLES = half_angle_for_stretch(_ROOTS**2)


def sketch(start: Floats, end: Floats, length: Floats, pieces: int) -> Floats:
    """Return the ends of ``pieces`` equally long pieces of each strand: (…, pieces + 1, 3).

    ``start`` and ``end`` (…, 3) and ``length`` (…,) broadcast; metres. No chord may be longer than
    its strand.
    """
    across = end - start
    rise = across[..., 2]
    span = np.hypot(across[..., 0], across[..., 1])
    wide = np.maximum(span, _VERTICAL * length)
    excess = np.maximum(length * length - span * span - rise * rise, 0.0)
    half_angle = np.maximum(_half_angle(0.5 * np.log1p(excess / (wide * wide))), _TAUTEST)
    level = np.sqrt(excess + wide * wide)
    sinh = half_angle * (level / wide)
    slope = ((rise * np.sqrt(1.0 + sinh * sinh) - length * sinh) / level)[..., None]
    parameter = (wide / (2.0 * half_angle))[..., None]
    slopes = slope + (length[..., None] / parameter) * np.linspace(0.0, 1.0, pieces + 1)
    along = (parameter / wide[..., None]) * (np.arcsinh(slopes) - np.arcsinh(slope))
    points: Floats = start[..., None, :] + along[..., None] * across[..., None, :]
    raised = parameter * (np.sqrt(1.0 + slopes * slopes) - np.sqrt(1.0 + slope * slope))
    points[..., 2] = start[..., 2, None] + raised
    return points


def boxes(start: Floats, end: Floats, length: Floats) -> tuple[Floats, Floats]:
    """Return lowest and highest corners (…, 3) of upright boxes that contain the strands.

    A strand that comes down by d below its lower end is at least as long as two straight lines down
    to there: length² ≥ span² + (2d + rise)².
    """
    low, high = np.minimum(start, end), np.maximum(start, end)
    size = high - low
    level = length * length - size[..., 0] ** 2 - size[..., 1] ** 2
    dip = 0.5 * (np.sqrt(np.maximum(level, 0.0)) - size[..., 2])
    low[..., 2] -= np.maximum(dip, 0.0)
    return low, high


def _half_angle(stretch: Floats) -> Floats:
    root = np.sqrt(stretch)
    if root.max(initial=0.0) > _ROOTS[-1]:
        return half_angle_for_stretch(stretch)
    found: Floats = np.interp(root, _ROOTS, _HALF_ANGLES)
    return found
