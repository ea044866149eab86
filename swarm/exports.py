"""Plans and check results as JSON-ready objects, and the motion of a plan as CSV."""

from collections.abc import Iterator
from dataclasses import asdict
from math import isfinite
from typing import Any

import numpy as np

from swarm.certification.assessment import Assessment, Contingencies
from swarm.certification.clearances import Moment
from swarm.certification.distances import Tightest
from swarm.certification.findings import Finding
from swarm.errors import Refused
from swarm.mission import Mission
from swarm.planning import Plan

MOTION_COLUMNS = (
    "time", "vehicle", "x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az", "phase",
)  # fmt: skip
MOTION_STEP = 0.05
"""Seconds between two rows of a vehicle."""


def plan_object(plan: Plan, assessment: Assessment) -> dict[str, Any]:
    """Return a plan and the results of its checks; lengths in metres, times in seconds.

    ``sag.over`` is the largest sag of the segments that only pass over others, ``sag.under`` the
    smallest sag of the segments that pass under others.
    """
    layout = plan.layout
    fold = plan.phase("fold")
    return {
        "mission": plan.mission.name,
        "cleared": assessment.cleared,
        "findings": [finding_object(finding) for finding in assessment.findings],
        "knot": {
            "type": plan.knot.type,
            "chirality": plan.knot.chirality,
            "gauss": plan.knot.gauss,
        },
        "grid": {
            "size": len(plan.knot.grid_columns),
            "columns": [list(rows) for rows in plan.knot.grid_columns],
        },
        "vehicles": plan.vehicles,
        "cell": layout.cell,
        "sag": _sags(plan),
        "cable": {
            "segments": [float(length) for length in layout.lengths],
            "total": float(layout.lengths.sum()),
        },
        "duration": {
            "fold": fold.duration,
            "total": plan.duration,
            "gates": plan.expected_waits,
            "slowing": plan.expected_slowing,
            "flight": plan.flight_duration,
        },
        "clearance": clearance_object(assessment),
        "robustness": _robustness_object(assessment),
        "tightest": [moment_object(moment) for moment in assessment.tightest],
        "budget": [asdict(row) | {"remaining": row.remaining} for row in assessment.budget],
        "contingencies": contingencies_object(assessment.contingencies)
        if assessment.contingencies
        else None,
        "notes": list(plan.notes),
    }


def assessment_object(assessment: Assessment) -> dict[str, Any]:
    """Return the results of all checks of an external trajectory."""
    return {
        "cleared": assessment.cleared,
        "findings": [finding_object(finding) for finding in assessment.findings],
        "knot": {
            "type": assessment.knot,
            "chirality": assessment.chirality,
            "gauss": assessment.gauss,
        },
        "clearance": clearance_object(assessment),
        "robustness": _robustness_object(assessment),
    }


def clearance_object(assessment: Assessment) -> dict[str, Any]:
    """Return the tightest distances by their keys."""
    return {name: tightest_object(tightest) for name, tightest in assessment.distances.items()}


def _robustness_object(assessment: Assessment) -> dict[str, Any]:
    robustness = assessment.robustness
    return {"max_tracking_error": robustness.tracking, "max_wind": robustness.wind}


def moment_object(moment: Moment) -> dict[str, Any]:
    """Return a tight moment; its distance is None without a certified bound."""
    return {
        "check": moment.check,
        "between": list(moment.between),
        "distance": moment.distance if isfinite(moment.distance) else None,
        "required": moment.required,
        "time": moment.time,
        "position": list(moment.where),
    }


def contingencies_object(contingencies: Contingencies) -> dict[str, Any]:
    """Return the contingencies of a plan; a wait is None without a window."""
    windows = {"land": contingencies.land, "release": contingencies.release}
    return {
        **{
            name: {"share": window.share, "wait": window.wait if isfinite(window.wait) else None}
            for name, window in windows.items()
        },
        "longest_stop": {"time": contingencies.stop_time, "distance": contingencies.stop_distance},
    }


def refusal_object(mission: Mission, refusal: Refused) -> dict[str, Any]:
    """Return the result for a mission without a plan: the reason as a finding."""
    return {
        "mission": mission.name,
        "cleared": False,
        "findings": [finding_object(Finding("error", "planner", str(refusal)))],
    }


def _sags(plan: Plan) -> dict[str, float | None]:
    sags = plan.layout.sags
    if not len(sags):
        return {"over": None, "under": None}
    over, under = (sorted({pair[k] for pair in plan.layout.crossings}) for k in (0, 1))
    only_over = [segment for segment in over if segment not in under]
    return {
        "over": float(sags[only_over].max() if only_over else sags.min()),
        "under": float(sags[under].min() if under else sags.max()),
    }


def finding_object(finding: Finding) -> dict[str, Any]:
    """Return a finding; time and position are None where they do not apply."""
    return {
        "severity": finding.severity,
        "check": finding.check,
        "message": finding.message,
        "time": finding.at_time,
        "position": list(finding.where) if finding.where is not None else None,
    }


def tightest_object(tightest: Tightest) -> dict[str, Any]:
    """Return the tightest moment of a clearance; its distance is None without such a pair."""
    return {
        "distance": tightest.distance if isfinite(tightest.distance) else None,
        "required": tightest.required,
        "time": tightest.time,
        "between": list(tightest.between),
    }


def motion_rows(plan: Plan, step: float = MOTION_STEP) -> Iterator[str]:
    """Yield the CSV lines of the motion of every grip point, header first.

    One row per time and vehicle (1…n along the cable): ENU metres, m/s, m/s², and the phase. The
    last rows are those of the end of the motion.
    """
    times = np.append(np.arange(0.0, plan.duration, step), plan.duration)
    states = np.concatenate(plan.motion.at(times), axis=-1)
    yield ",".join(MOTION_COLUMNS)
    for time, team in zip(times, states, strict=True):
        phase = plan.phase_at(float(time)).name
        for vehicle, state in enumerate(team, start=1):
            numbers = ",".join(f"{value:.9f}" for value in state)
            yield f"{time:.6f},{vehicle},{numbers},{phase}"
