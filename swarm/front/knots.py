"""Identification of the knot of a curve."""

import numpy as np
import numpy.typing as npt

from swarm.errors import InputError, Problem
from swarm.knots.invariants import identify_curve
from swarm.knots.names import describe_knot


def identify(curve: npt.ArrayLike, *, closed: bool = False) -> str:
    """Return the name of the knot of a curve (n, 3), points in order, in any unit of length.

    The ends of an open curve are extended straight up and joined above it; with ``closed`` the last
    point is joined to the first. The name is KnotInfo's with the chirality, such as
    ``"3_1 right-handed"``, ``"4_1"`` (its own mirror image), ``"0_1"`` (not knotted) or
    ``"3_1#m3_1"`` (a sum). A knot of more than ten crossings is ``"unknown"``, with the knots of
    the table that share its invariants.

    Raises :class:`swarm.InputError` where the curve meets itself, has fewer than 3 different points
    or numbers that are not finite.

    Source: :func:`swarm.knots.invariants.identify_curve` (exact crossings, then Jones and Alexander
    polynomials of a minimised diagram; names and tables are KnotInfo's).
    """
    try:
        points = np.asarray(curve, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError([Problem("curve", "expected an (n, 3) array of numbers")]) from None
    knot = identify_curve(points, closed=closed)
    words = describe_knot(knot.name, knot.chirality)
    if knot.known or not knot.candidates:
        return words
    return f"{words}, perhaps {' or '.join(knot.candidates)}"
