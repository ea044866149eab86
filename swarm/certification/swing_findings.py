"""Findings on the swing of the cable: as planned, and after changes of the clock's rate."""

import numpy as np
import numpy.typing as npt

from swarm.certification.clearances import segment_name
from swarm.certification.findings import Finding, Severity
from swarm.certification.swing_tube import SwingTube, beyond_ordinary
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]


def swing_findings(plan: Plan, tube: SwingTube | None) -> list[Finding]:
    """Return the largest swing of fold and hold, and the tube; an error beyond ``fold.swing``.

    A warning without that limit where it exceeds the tracking errors that are certified. An error
    too where clearances are certified in the tube, and other stops and resumes come out of it. None
    without a tube.
    """
    if tube is None:
        return []
    phases = {phase.name: phase for phase in plan.phases}
    planned = tube.planned[tube.times < phases.get("hold", phases["fold"]).end]
    if not planned.size:  # a motion shorter than a sample
        return []
    moment, segment = np.unravel_index(np.argmax(planned), planned.shape)
    largest, time = float(planned.max()), float(tube.times[moment])
    tracking, limit = plan.mission.vehicles.tracking, plan.mission.fold.swing
    share = float((planned.max(axis=1) > max(tracking, 0.1)).mean())
    changes = ", ".join(f"{name} {stray:.2f} m" for name, stray in tube.changed.items())
    message = (
        f"a cable with inertia swings up to {largest:.2f} m away from its catenary "
        f"({segment_name(int(segment))}) in the planned motion, in {share:.0%} of the time more "
        f"than {max(tracking, 0.1):g} m; after a change of the clock's rate, at any moment: "
        f"{changes}; with the errors of the model at most {tube.all_changes.largest:.2f} m"
    )
    beyond = beyond_ordinary(plan, tube.ordinary) if plan.mission.fold.certifies_swing else 0.0
    if beyond > 0.0:
        words = f"; others, with twice the links, come {beyond:.3f} m out of their tube"
        return [Finding("error", "swing", message + words, time)]
    if limit != "auto" and largest > limit:
        return [Finding("error", "swing", f"{message}; fold.swing allows {limit:g} m", time)]
    severity: Severity = "info" if largest <= max(tracking, 0.1) else "warning"
    return [Finding(severity, "swing", message, time)]
