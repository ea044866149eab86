"""A small diagram of the knot of a curve in space."""

import numpy as np

from swarm.knots.curve import Points, curve_gauss, validated_curve
from swarm.knots.diagram import Diagram
from swarm.knots.gauss import KnotError, SignedGauss

_TILTS = ((0.0137, 0.0071), (-0.0523, 0.0911), (0.313, -0.177), (-1.37, -0.853), (7.1, 3.3))
"""Leans of the directions of view from straight above; none is aligned with a grid."""


def curve_diagram(points: Points, *, closed: bool = False) -> Diagram:
    """Return a diagram of a curve's knot; an open curve is closed far above itself.

    Raises KnotError where the curve meets itself.
    """
    curve = validated_curve(points, closed=closed)
    if len(curve) < 3:
        return Diagram(SignedGauss((), closed=True))
    if not closed:
        curve = close_upward(curve)
    reason: KnotError | None = None
    for tilt in _TILTS:
        try:
            return Diagram(curve_gauss(curve, closed=True, tilt=tilt))
        except KnotError as error:
            reason = error
    how = "" if closed else ", closed straight up from its ends,"
    raise KnotError(f"the curve{how} is degenerate from every side: {reason}")


def close_upward(curve: Points) -> Points:
    """Return an open curve with both ends extended straight up and joined far above it."""
    top = float(np.max(curve[:, 2]) + np.max(np.ptp(curve, axis=0)) + 1.0)
    up = np.array([[0.0, 0.0, 1.0]])
    ends = curve[[-1, 0]] + up * (top - curve[[-1, 0], 2:])
    return np.concatenate([curve, ends])
