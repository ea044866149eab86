"""A plan as others read it: one JSON object, and one table of every grip point's motion."""

from collections.abc import Iterator
from dataclasses import asdict
from math import isfinite
from typing import Any

import numpy as np

from swarm.certification.assessment import Assessment, Contingencies, Tightest
from swarm.certification.clearances import Moment
from swarm.certification.findings import Finding
from swarm.errors import Refused
from swarm.mission import Mission
from swarm.planning import Plan

MOTION_COLUMNS = (
    "time", "vehicle", "x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az", "phase",
)  # fmt: skip
MOTION_STEP = 0.05
"""Seconds between two rows of the same vehicle."""


def plan_object(plan: Plan, assessment: Assessment) -> dict[str, Any]:
    """Return the plan and what the checks say of it as one JSON-ready object.

    Lengths in metres, times in seconds. ``sag.over`` is the deepest sag of the segments that only
    pass over, ``sag.under`` the shallowest of those that pass under.
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
        "duration": {"fold": fold.end - fold.start, "total": plan.duration},
        "clearance": {
            "cable": tightest_object(assessment.cable),
            "vehicle": tightest_object(assessment.vehicle),
            "vehicle_cable": tightest_object(assessment.vehicle_cable),
        },
        "robustness": {
            "tracking": assessment.robustness.tracking,
            "wind": assessment.robustness.wind,
        },
        "tightest": [moment_object(moment) for moment in assessment.tightest],
        "budget": [asdict(row) | {"remaining": row.remaining} for row in assessment.budget],
        "contingencies": contingencies_object(assessment.contingencies)
        if assessment.contingencies
        else None,
        "notes": list(plan.notes),
    }


def moment_object(moment: Moment) -> dict[str, Any]:
    """Return a tight moment as a JSON-ready object; no distance where nothing could be shown."""
    return {
        "check": moment.check,
        "between": list(moment.between),
        "distance": moment.distance if isfinite(moment.distance) else None,
        "required": moment.required,
        "time": moment.time,
        "where": list(moment.where),
    }


def contingencies_object(contingencies: Contingencies) -> dict[str, Any]:
    """Return the contingencies of a plan; a wait is null without a window."""
    windows = {"land": contingencies.land, "release": contingencies.release}
    return {
        **{
            name: {"share": window.share, "wait": window.wait if isfinite(window.wait) else None}
            for name, window in windows.items()
        },
        "longest_stop": {"time": contingencies.stop_time, "distance": contingencies.stop_distance},
    }


def refusal_object(mission: Mission, refusal: Refused) -> dict[str, Any]:
    """Return what is known of a mission for which no motion was found, as a JSON-ready object."""
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
    """Return a finding as a JSON-ready object."""
    return {
        "severity": finding.severity,
        "check": finding.check,
        "message": finding.message,
        "at_time": finding.at_time,
        "where": list(finding.where) if finding.where is not None else None,
    }


def tightest_object(tightest: Tightest) -> dict[str, Any]:
    """Return a tightest moment as a JSON-ready object; no distance where there is no pair."""
    return {
        "distance": tightest.distance if isfinite(tightest.distance) else None,
        "required": tightest.required,
        "time": tightest.time,
        "between": list(tightest.between),
    }


def motion_rows(plan: Plan, step: float = MOTION_STEP) -> Iterator[str]:
    """Yield the CSV lines of every grip point's motion, header first.

    One row per time and vehicle (1…n along the cable): ENU metres, m/s, m/s², and the phase; the
    last row is the end of the motion.
    """
    times = np.append(np.arange(0.0, plan.duration, step), plan.duration)
    states = np.concatenate(plan.motion.at(times), axis=-1)
    yield ",".join(MOTION_COLUMNS)
    for time, team in zip(times, states, strict=True):
        phase = plan.phase_at(float(time)).name
        for vehicle, state in enumerate(team, start=1):
            numbers = ",".join(f"{value:.9f}" for value in state)
            yield f"{time:.6f},{vehicle},{numbers},{phase}"
