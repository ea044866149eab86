"""Findings on the swing of the cable in the planned motion, by lumped masses."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.clearances import segment_name
from swarm.certification.findings import Finding
from swarm.geometry.lumped_mass import cable_model, stray, swing
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]

_EVERY = 10
"""Steps of the model between compared moments: 0.1 s."""


@dataclass(frozen=True, eq=False)
class PlannedSwing:
    """Distance of the swinging cable from its catenaries in the planned motion.

    ``times`` (k,) are mission times in seconds, ``distance`` (k, n − 1) metres for each segment.
    """

    times: Floats
    distance: Floats

    @property
    def largest(self) -> float:
        """The largest distance of all, metres."""
        return float(self.distance.max())


def planned_swing(plan: Plan) -> PlannedSwing | None:
    """Return the swing of a plan's cable from the beginning of the fold to the end of the hold.

    All vehicles are exactly on their trajectories, the air is still, and the cable is at rest when
    the fold begins, after the gate that waits for it. None for a plan without fold or cable, and
    where a chord exceeds its cable, which the checks of lengths report.
    """
    phases = {phase.name: phase for phase in plan.phases}
    if "fold" not in phases or not len(plan.layout.lengths):
        return None
    fold = phases["fold"]
    if fold.cable != "aloft":
        return None
    cable = plan.mission.cable
    model = cable_model(cable.mass_per_length, cable.diameter)
    times = np.arange(fold.start, phases.get("hold", fold).end, model.step)
    ends = plan.motion.at(times)[0]
    lengths = plan.layout.lengths
    if (np.linalg.norm(np.diff(ends, axis=1), axis=2) > lengths).any():
        return None
    joints = swing(ends, lengths, model, _EVERY)
    return PlannedSwing(times[::_EVERY], stray(joints, ends[::_EVERY], lengths))


def swing_findings(plan: Plan, found: PlannedSwing | None) -> list[Finding]:
    """Return the largest swing as a finding: an error where it exceeds ``fold.swing``.

    A warning without that limit where it exceeds the tracking errors that are certified.
    """
    if found is None:
        return []
    moment, segment = np.unravel_index(np.argmax(found.distance), found.distance.shape)
    tracking, limit = plan.mission.vehicles.tracking, plan.mission.fold.swing
    share = float((found.distance.max(axis=1) > max(tracking, 0.1)).mean())
    message = (
        f"a cable with inertia swings up to {found.largest:.2f} m away from its catenary "
        f"({segment_name(int(segment))}), at {share:.0%} of the moments more than "
        f"{max(tracking, 0.1):g} m; the certificate takes it as quasi-static"
    )
    time = float(found.times[moment])
    if limit is not None and found.largest > limit:
        return [Finding("error", "swing", f"{message}; fold.swing allows {limit:g} m", time)]
    return [Finding("info" if limit is not None else "warning", "swing", message, time)]
