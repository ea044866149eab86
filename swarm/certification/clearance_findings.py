"""Findings on clearances and on the limits of the motion."""

from collections.abc import Iterable

import numpy as np

from swarm.certification.clearances import Moment, limits, moments_of, tightest_moments
from swarm.certification.findings import Finding, Severity
from swarm.certification.floor_limits import LYING
from swarm.certification.motion_bounds import BoundedMotion
from swarm.certification.robustness import failure_in_wind
from swarm.geometry.catenary import MAX_CHORD_RATIO
from swarm.planning import Plan

SMOOTH = (("position", "m", 1e-9), ("velocity", "m/s", 1e-6), ("acceleration", "m/s²", 0.05))
"""Allowed jumps between pieces of the motion: rounding of polynomials through rows 0.1 ms apart.
Movement bounds include the first two, limits of acceleration the second; nothing relies on the
third."""

_CONDITIONS = {
    "lying": f"{{one}} is more than {LYING:g} m above the floor while its cable must lie there",
    "drawn out": "{one} and {other} are more than 60° off a line in plan view while cable can lie "
    "on the floor",
    "beside rotors": "{one} is too steep beside the rotors of its vehicles while cable can lie on "
    "the floor",
    "straight down": "{one} does not descend vertically together with the others: their knot would "
    "change its shape",
}
"""Messages of conditions for cable on the floor."""


def clearance_findings(plan: Plan, moments: Iterable[Moment]) -> list[Finding]:
    """Return an error for every moment with a negative margin, and for strands that meet."""
    failing = [moment for moment in moments if moment.margin < 0.0]
    return [*_meeting(plan, failing), *(_clearance_finding(plan, moment) for moment in failing)]


def _meeting(plan: Plan, failing: Iterable[Moment]) -> list[Finding]:
    """Strands that meet even with every vehicle exactly at its setpoint."""
    if all(moment.check != "cable clearance" for moment in failing):
        return []
    exact = tightest_moments(plan, tracking=0.0, checks=("cable clearance",))
    return [
        at_moment(
            "error",
            "strands meet",
            f"{moment.between[0]} and {moment.between[1]} meet even without tracking errors: "
            "the cable would entangle",
            moment,
        )
        for moment in exact
        if moment.distance <= 0.0
    ]


def _clearance_finding(plan: Plan, moment: Moment) -> Finding:
    tracking = plan.mission.vehicles.tracking
    one, other = moment.between
    short = -moment.margin
    errors = f" for tracking errors up to {tracking:g} m" if tracking > 0 else ""
    if not np.isfinite(moment.distance):
        message = f"no distance between {one} and {other} can be certified"
    elif moment.check == "taut":
        message = (
            f"{short:.3f} m of chord beyond {MAX_CHORD_RATIO:.1%} of the length of {one}{errors}"
        )
    elif moment.check == "over-stretched on the floor":
        message = f"{short:.3f} m of chord beyond the length of {one} on the floor"
    elif moment.check == "rotor disc":
        message = f"{other} enters the rotor disc of its own {one}{errors}"
    elif moment.check in _CONDITIONS:
        message = _CONDITIONS[moment.check].format(one=one, other=other)
    elif moment.check == "ground":
        message = f"{short:.3f} m below the floor: {one}"
    elif moment.check in {"ceiling", "fence"}:
        message = f"{short:.3f} m beyond {other}: {one}{errors}"
    else:
        certified = (
            f"{moment.distance:.3f} m certified between {one} and {other}"
            if moment.distance > 0
            else f"{one} and {other} can touch"
        )
        message = f"{certified}{errors}; {moment.required:g} m required"
    return at_moment("error", moment.check, message, moment)


def at_moment(severity: Severity, check: str, message: str, moment: Moment) -> Finding:
    """Return a finding with the time and the place of a moment."""
    place = ", ".join(f"{value:.2f}" for value in moment.where)
    message = f"{message} (at {moment.time:.2f} s, near ({place}))"
    return Finding(severity, check, message, moment.time, moment.where)


def smoothness_findings(plan: Plan) -> list[Finding]:
    """Return errors for jumps of position, velocity or acceleration."""
    found = []
    jumps = BoundedMotion(plan.motion).jumps
    for order, (quantity, unit, allowed) in enumerate(SMOOTH):
        if not jumps.size or jumps[:, order].max() <= allowed:
            continue
        joint, vehicle = np.unravel_index(np.argmax(jumps[:, order]), jumps[:, order].shape)
        size = jumps[joint, order, vehicle]
        message = f"{size:.3g} {unit} jump in the {quantity} of vehicle {vehicle + 1}"
        place = plan.motion.coefficients[joint + 1, 0, vehicle]
        at = float(plan.motion.times[joint + 1])
        where = (float(place[0]), float(place[1]), float(place[2]))
        found.append(Finding("error", "smoothness", message, at, where))
    return found


def limit_findings(plan: Plan) -> list[Finding]:
    """Return errors for speeds and accelerations above the vehicles' limits."""
    vehicles = plan.mission.vehicles
    usable = vehicles.max_acceleration - vehicles.braking_acceleration
    reserve = f" ({vehicles.max_acceleration:g} less {vehicles.braking_acceleration:g} to brake)"
    findings = []
    for family in limits(plan):
        failing = [m for m in moments_of(family) if m.margin < 0.0]
        if not failing:
            continue
        worst = failing[0]
        largest, unit, why = (
            (vehicles.max_speed, "m/s", "")
            if family.check == "speed"
            else (usable, "m/s²", reserve)
        )
        others = " and others" if len(failing) > 1 else ""
        message = (
            f"{largest - worst.margin:.3f} {unit} for {worst.between[0]}{others}; "
            f"{largest:g} {unit} allowed{why}"
        )
        findings.append(at_moment("error", family.check, message, worst))
    return findings


def wind_findings(plan: Plan) -> list[Finding]:
    """Return a finding on the clearances in the mission's steady wind."""
    steady = plan.mission.wind.steady
    if steady == 0.0:
        return []
    failed = failure_in_wind(plan, steady)
    if failed is None:
        message = (
            f"in every steady wind up to {steady:g} m/s, from any side, freely hanging cable keeps "
            "every clearance, also from floor and fence; all strands lean equally, with the drag "
            "of a strand across the wind"
        )
        return [Finding("info", "wind", message)]
    check, (one, other), time = failed
    message = (
        f"steady wind up to {steady:g} m/s: {check} of {one} and {other} fails (at {time:.2f} s)"
    )
    return [Finding("error", "wind", message, time)]


def tightest_findings(moments: Iterable[Moment]) -> list[Finding]:
    """Return the given moments as numbered remarks."""
    return [
        at_moment(
            "info",
            "tightest",
            f"{number}. {moment.check}: {moment.between[0]} and {moment.between[1]}, "
            f"certified {moment.distance:.3f} m, required {moment.required:g} m, "
            f"margin {moment.margin:+.3f} m",
            moment,
        )
        for number, moment in enumerate(moments, start=1)
    ]
