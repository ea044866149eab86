"""Findings beside the clearances: loads, mishaps, downwash, stops, and what eats the clearances."""

from collections.abc import Iterable

import numpy as np

from swarm.certification.air import deepest_sinking
from swarm.certification.assessment import Contingencies, Window
from swarm.certification.budget import Budget
from swarm.certification.clearances import vehicle_name
from swarm.certification.contingency_windows import contingency_windows, longest_stop
from swarm.certification.findings import Finding, Severity
from swarm.certification.loads import Loads, dead_vehicle, loads, payload_limit, stuck_gripper
from swarm.geometry.catenary import STANDARD_GRAVITY
from swarm.planning import Plan

FAR_WINDOW = 20.0
"""Seconds to the nearest window that deserve a warning."""


def load_findings(plan: Plan) -> list[Finding]:
    """Return what the cable asks of the vehicles, as planned and after a mishap."""
    found = loads(plan)
    if not len(found.time):
        return []
    findings = []
    limit = payload_limit(plan)
    for quantity, values, allowed, name in (
        ("payload", found.pull, limit, "vehicle"),
        ("tension", found.tension, plan.mission.cable.breaking_load, "segment"),
    ):
        instant, index = np.unravel_index(np.argmax(values), values.shape)
        worst = float(values[instant, index])
        message = (
            f"{name} {index + 1} bears up to {worst:.2f} N of cable; {allowed:.2f} N are allowed"
        )
        severity: Severity = "error" if worst > allowed else "info"
        findings.append(Finding(severity, quantity, message, float(found.time[instant])))
    return [*findings, *_breakaway_findings(plan, found), *_mishap_findings(plan, limit)]


def _breakaway_findings(plan: Plan, found: Loads) -> list[Finding]:
    """A cable that is tied on must stay on while all goes well, and let go of one that falls."""
    breakaway = plan.mission.vehicles.breakaway
    if breakaway is None:
        return []
    instant, index = np.unravel_index(np.argmax(found.pull), found.pull.shape)
    worst = float(found.pull[instant, index])
    weight = plan.mission.vehicles.mass * STANDARD_GRAVITY
    message = (
        f"the cable is tied on and breaks away at {breakaway:g} N; "
        f"{vehicle_name(int(index))} bears up to {worst:.2f} N of it"
    )
    severity: Severity = "error" if worst >= breakaway else "info"
    findings = [Finding(severity, "breakaway", message, float(found.time[instant]))]
    if breakaway >= weight:
        message = (
            f"the cable breaks away only at {breakaway:g} N: a dead vehicle, {weight:.1f} N, would "
            "hang on its neighbours"
        )
        findings.append(Finding("warning", "breakaway", message))
    return findings


def _mishap_findings(plan: Plan, limit: float) -> list[Finding]:
    """What a failure would load on others; beyond the payload a warning, for nobody planned it."""
    findings = []
    dead = dead_vehicle(plan)
    if dead is not None:
        message = (
            f"if {vehicle_name(dead.cause)} died in the air, {vehicle_name(dead.bearer)} would "
            f"bear {dead.pull:.1f} N ({limit:.1f} N is its payload): let go of it at once"
        )
        severity: Severity = "warning" if dead.pull > limit else "info"
        findings.append(Finding(severity, "failed vehicle", message, dead.time))
    stuck = stuck_gripper(plan)
    if stuck is not None:
        message = (
            f"if the gripper of {vehicle_name(stuck.bearer)} stayed shut at the release, it would "
            f"bear {stuck.pull:.1f} N of cable ({limit:.1f} N is its payload)"
        )
        severity = "warning" if stuck.pull > limit else "info"
        findings.append(Finding(severity, "stuck gripper", message, stuck.time))
    return findings


def endurance_findings(plan: Plan, slowed: float = 0.0) -> list[Finding]:
    """Return what the plan takes of a battery; caps of the clock make it ``slowed`` s longer."""
    endurance = plan.mission.vehicles.endurance
    takes = plan.duration + slowed
    caps = " with the caps of its clock" if slowed else ""
    message = (
        f"the plan takes {takes:.0f} s{caps}, without waiting at gates: {takes / endurance:.0%} of "
        f"the vehicles' endurance of {endurance:g} s"
    )
    severity: Severity = (
        "error" if takes > endurance else "warning" if takes > 0.8 * endurance else "info"
    )
    return [Finding(severity, "endurance", message)]


def contingencies_of(plan: Plan) -> tuple[Contingencies | None, list[Finding]]:
    """Return what can be done where the plan stops, and findings on it; None without cable aloft.

    The cable that is let go of at the planned release must not fall on a vehicle.
    """
    found = contingency_windows(plan)
    if not len(found.time):
        return None, []
    start, end = float(found.time[0]), float(found.time[-1])
    land, release = (
        Window(found.share(flags, start, end), found.longest_wait(flags, start, end))
        for flags in (found.land, found.release)
    )
    stop = longest_stop(plan)
    findings = [
        _window_finding(land, "land straight down together"),
        _window_finding(release, "let go"),
        Finding(
            "info",
            "windows",
            f"the longest stop along the path takes {stop.time:.1f} s and {stop.distance:.2f} m",
            stop.at_time,
        ),
    ]
    findings += [
        Finding(
            "error", "release", "cable would fall on a vehicle at the planned release", gate.time
        )
        for gate in plan.gates
        if gate.condition == "released"
        and gate.time <= end + 1e-6
        and not found.can_release(gate.time)
    ]
    return Contingencies(land, release, stop.time, stop.distance), findings


def _window_finding(window: Window, what: str) -> Finding:
    near = f", at most {window.wait:.1f} s away" if 0.0 < window.share < 1.0 else ""
    share = f"at {window.share:.0%} of the moments" if window.share else "at no moment"
    message = f"all can {what} {share} with the cable aloft{near}"
    return Finding("warning" if window.wait > FAR_WINDOW else "info", "windows", message)


def downwash_findings(plan: Plan) -> list[Finding]:
    """Return how far a vehicle may sink in the jets of those above it."""
    found = deepest_sinking(plan)
    if found is None:
        return []
    ball = plan.mission.vehicles.tracking
    share = f", more than the tracking ball of {ball:g} m" if found.depth > ball else ""
    message = (
        f"{vehicle_name(found.vehicle)} flies {found.below:.1f} m below "
        f"{vehicle_name(found.above)}, in air that falls at {found.speed:.1f} m/s, and may sink by "
        f"{found.depth:.2f} m of it (usual gains){share}"
    )
    severity: Severity = "warning" if found.depth > ball > 0.0 else "info"
    return [Finding(severity, "downwash", message, found.time)]


def tolerance_findings(plan: Plan) -> list[Finding]:
    """Say that the certificate takes the segments' lengths as they are in the plan."""
    tolerance = plan.mission.cable.length_tolerance
    if not len(plan.layout.lengths) or tolerance == 0.0:
        return []
    message = (
        f"the certificate takes every segment's length as exact; what cable.length_tolerance, "
        f"{tolerance:g} m, may eat is in the budget"
    )
    return [Finding("info", "length tolerance", message)]


def budget_findings(rows: Iterable[Budget]) -> list[Finding]:
    """Return in words what may eat the distance of the strands that are tightest."""
    return [
        Finding(
            "info",
            "budget",
            f"{row.between[0]} and {row.between[1]} are {row.available:.2f} m apart at their "
            f"setpoints; tracking may take {row.tracking:.2f} m, what sags and tautens of it "
            f"{row.amplification:.2f} m, length tolerance {row.length:.2f} m, leaning droppers "
            f"{row.grip:.2f} m, sway {row.sway:.2f} m, a stop {row.stop:.2f} m, wind "
            f"{row.wind:.2f} m, rotor wash {row.wash:.2f} m: {row.remaining:+.2f} m remain if all "
            "come together",
            row.time,
        )
        for row in rows
    ]
