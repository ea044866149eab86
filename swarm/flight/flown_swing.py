"""The swing of the cable as estimated in a flight, beside the planned and the allowed one."""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm.certification.clearances import PlanChecks
from swarm.certification.excitation import allowed_swing
from swarm.certification.swing_tube import SwingTube
from swarm.flight.trace import Trace
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class LargestStray:
    """The largest stray that was estimated in a flight, in metres, of a ``segment`` (from 1)."""

    estimated: float
    segment: int
    mission_time: float


@dataclass(frozen=True)
class FlownSwing(LargestStray):
    """The same beside the plan's: ``planned`` is the largest stray of the planned motion,
    ``allowed`` the largest that tube and budget allow; ``within`` the share of moments at which
    every strand was estimated within what they allow it then."""

    planned: float
    allowed: float
    within: float

    @property
    def words(self) -> str:
        """The estimate, the plan, and the tube, in one line."""
        moments = "all" if self.within == 1.0 else f"{math.floor(100.0 * self.within)} % of the"
        return (
            f"estimated up to {self.estimated:.2f} m (segment {self.segment} at "
            f"{self.mission_time:.1f} s of the plan), {self.planned:.2f} m planned; within what "
            f"the budget allows, up to {self.allowed:.2f} m, at {moments} moments"
        )


@dataclass(frozen=True, eq=False)
class SwingCurves:
    """Strays of the strands (k, n − 1) in metres at k moments of a flight, which are given in
    mission ``time`` (k,): estimated, planned, the radii of the tube of all changes of the clock's
    rate, and what this tube and the budget allow (:mod:`swarm.certification.excitation`)."""

    time: Floats
    estimated: Floats
    planned: Floats
    tube: Floats
    allowed: Floats


def swing_curves(plan: Plan, trace: Trace) -> SwingCurves | None:
    """Return what was estimated in a flight, planned and allowed; None without an estimate."""
    known = np.isfinite(trace.stray).all(axis=1) if trace.stray.shape[1] else np.empty(0, np.bool_)
    tube = PlanChecks.of(plan).tube if known.any() else None
    if tube is None:
        return None
    time = trace.mission_time[known]
    return SwingCurves(
        time, trace.stray[known], _planned(tube, time),
        np.stack([tube.all_changes.strands(moment) for moment in time.tolist()]),
        allowed_swing(plan, tube, time),
    )  # fmt: skip


def largest_stray(trace: Trace) -> LargestStray | None:
    """Return the largest stray of a flight; None where none was estimated."""
    known = np.nan_to_num(trace.stray, nan=-1.0)
    if not known.size or known.max() < 0.0:
        return None
    row, segment = np.unravel_index(int(np.argmax(known)), known.shape)
    return LargestStray(
        float(known[row, segment]), int(segment) + 1, float(trace.mission_time[row])
    )


def flown_swing(plan: Plan, trace: Trace) -> FlownSwing | None:
    """Return the swing of a flight; None where it was not estimated."""
    largest, found = largest_stray(trace), swing_curves(plan, trace)
    if largest is None or found is None:
        return None
    return FlownSwing(
        **asdict(largest),
        planned=float(found.planned.max()),
        allowed=float(found.allowed.max()),
        within=float((found.estimated <= found.allowed).all(axis=1).mean()),
    )


def swing_object(found: LargestStray | None) -> dict[str, Any] | None:
    """Return the swing of a flight as a JSON-ready object."""
    return asdict(found) if found is not None else None


def _planned(tube: SwingTube, time: Floats) -> Floats:
    nearest = np.abs(tube.times[:, None] - time).argmin(axis=0)
    strays: Floats = tube.planned[nearest]
    return strays
