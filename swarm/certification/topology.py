"""The knot of the folded cable: its exact crossing code, and its type from the curve in space."""

import numpy as np
import numpy.typing as npt

from swarm.errors import SwarmError
from swarm.geometry.chain import plan_crossings, polyline
from swarm.knots.curve import curve_gauss
from swarm.knots.gauss import SignedGauss, same_code
from swarm.knots.invariants import Identification, identify_curve
from swarm.planning import KnotLayout, Plan

Floats = npt.NDArray[np.float64]

PIECES_PER_SEGMENT = 64
"""Straight pieces of a segment in a curve: 5 cm of a segment of 3 m."""


def layout_code(layout: KnotLayout) -> SignedGauss:
    """Return the signed Gauss code of the layout's corners and crossings, seen from above.

    Raises :class:`swarm.errors.SwarmError` where the crossings are not those of the corners.
    """
    found = plan_crossings(layout.corners)
    over_of = {frozenset(pair): pair[0] for pair in layout.crossings}
    met = {frozenset(pair) for pair in found.segments.tolist()}
    if met != set(over_of):
        wrong = sorted(sorted(i + 1 for i in pair) for pair in met ^ set(over_of))
        raise SwarmError(f"crossings in plan view and of the layout differ, segments: {wrong}")
    steps = np.diff(layout.corners[:, :2], axis=0)
    passes = []
    for label, (pair, where) in enumerate(
        zip(found.segments.tolist(), found.fractions.tolist(), strict=True), start=1
    ):
        over = over_of[frozenset(pair)]
        under = pair[1] if pair[0] == over else pair[0]
        turn = steps[over, 0] * steps[under, 1] - steps[over, 1] * steps[under, 0]
        sign = 1 if turn > 0 else -1
        passes += [
            ((segment, place), (label, segment == over, sign))
            for segment, place in zip(pair, where, strict=True)
        ]
    return SignedGauss.of((entry for _, entry in sorted(passes)), closed=False)


def cable_curve(grip_points: Floats, lengths: Floats) -> Floats:
    """Return the cable as a curve (k, 3), every segment the catenary of its length."""
    return polyline(grip_points, lengths, PIECES_PER_SEGMENT)


def end_code(plan: Plan) -> SignedGauss:
    """Return the signed Gauss code of the folded cable in plan view.

    Raises :class:`swarm.errors.SwarmError` where strands meet or the cable is over-stretched.
    """
    return curve_gauss(cable_curve(_held(plan), plan.layout.lengths))


def end_knot(plan: Plan) -> Identification:
    """Return the knot type of the folded cable in space, its ends closed upwards."""
    return identify_curve(cable_curve(_held(plan), plan.layout.lengths))


def ties_planned_knot(plan: Plan, found: Identification, code: SignedGauss) -> bool:
    """Return whether a curve, identified and with its crossing ``code``, has the knot of a plan.

    A knot with a name is compared by name and chirality, which tracking errors do not change as
    long as no strand passes another; in plan view they may add crossings that change no knot. Any
    other knot is compared by its exact crossing code.
    """
    if plan.knot.type and found.known:
        return (found.name, found.chirality) == (plan.knot.type, plan.knot.chirality)
    return same_code(code, layout_code(plan.layout))


def end_time(plan: Plan) -> float:
    """Return the mission time of the folded cable: the last one aloft before it unfolds."""
    return max(
        phase.end for phase in plan.phases if phase.cable == "aloft" and phase.name != "unfold"
    )


def _held(plan: Plan) -> Floats:
    return plan.motion.at(end_time(plan))[0]


__all__ = [
    "cable_curve",
    "end_code",
    "end_knot",
    "end_time",
    "layout_code",
    "same_code",
    "ties_planned_knot",
]
