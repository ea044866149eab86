"""A small diagram of the knot of a curve in space."""

import numpy as np

from swarm.knots.curve import Points, checked, curve_gauss
from swarm.knots.diagram import Diagram
from swarm.knots.gauss import KnotError, SignedGauss

_DIRECTIONS = 8


def curve_diagram(points: Points, *, closed: bool = False) -> Diagram:
    """A diagram of a curve's knot; an open curve is closed straight up, above itself.

    Raises KnotError where the curve meets itself.
    """
    curve = checked(points, closed=closed)
    if len(curve) < 3:
        return Diagram(SignedGauss((), closed=True))
    if not closed:
        curve = closed_upward(curve)
    rng = np.random.default_rng(2)
    for _ in range(_DIRECTIONS):
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        turn *= np.sign(np.linalg.det(turn))
        try:
            return Diagram(curve_gauss(curve @ turn, closed=True))
        except KnotError as error:
            reason = error
    raise reason


def closed_upward(curve: Points) -> Points:
    """An open curve with both ends taken straight up and joined far above it."""
    top = float(np.max(curve[:, 2]) + np.max(np.ptp(curve, axis=0)) + 1.0)
    up = np.array([[0.0, 0.0, 1.0]])
    ends = curve[[-1, 0]] + up * (top - curve[[-1, 0], 2:])
    return np.concatenate([curve, ends])
