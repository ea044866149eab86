"""Findings on operation: loads, failures, downwash, endurance, contingencies and the budget."""

from collections.abc import Iterable

import numpy as np

from swarm.certification.air import deepest_sinking
from swarm.certification.assessment import Contingencies, Window
from swarm.certification.budget import Budget
from swarm.certification.clearances import vehicle_name
from swarm.certification.contingency_windows import contingency_windows, longest_stop
from swarm.certification.findings import Finding, Severity
from swarm.certification.loads import (
    Loads,
    failed_vehicle_load,
    loads,
    payload_limit,
    stuck_gripper_load,
)
from swarm.geometry.catenary import STANDARD_GRAVITY
from swarm.planning import Plan

FAR_WINDOW = 20.0
"""Seconds to the nearest window from which a finding is a warning: a third of the default hold
timeout."""

LONG_FLIGHT = 0.8
"""Share of the endurance from which a finding is a warning: batteries count as low at 20 %."""

_SAME = 1e-6
"""Seconds by which equal times may differ by rounding."""


def load_findings(plan: Plan) -> list[Finding]:
    """Return findings on the loads of the cable, as planned and after a failure."""
    found = loads(plan)
    if not len(found.time):
        return []
    findings = []
    limit = payload_limit(plan)
    for check, values, allowed, subject in (
        ("payload", found.force, limit, "of cable force on vehicle"),
        ("tension", found.tension, plan.mission.cable.breaking_load, "of tension in segment"),
    ):
        instant, index = np.unravel_index(np.argmax(values), values.shape)
        worst = float(values[instant, index])
        message = f"{worst:.2f} N {subject} {index + 1}; {allowed:.2f} N allowed"
        severity: Severity = "error" if worst > allowed else "info"
        findings.append(Finding(severity, check, message, float(found.time[instant])))
    return [*findings, *_breakaway_findings(plan, found), *_failure_findings(plan, limit)]


def _breakaway_findings(plan: Plan, found: Loads) -> list[Finding]:
    """A tied cable must stay on in normal flight, and break away from a falling vehicle."""
    breakaway = plan.mission.vehicles.breakaway
    if breakaway is None:
        return []
    instant, index = np.unravel_index(np.argmax(found.force), found.force.shape)
    worst = float(found.force[instant, index])
    weight = plan.mission.vehicles.mass * STANDARD_GRAVITY
    message = (
        f"{worst:.2f} N of cable force on {vehicle_name(int(index))}; the tied cable breaks away "
        f"at {breakaway:g} N"
    )
    severity: Severity = "error" if worst >= breakaway else "info"
    findings = [Finding(severity, "breakaway", message, float(found.time[instant]))]
    if breakaway >= weight:
        message = (
            f"{breakaway:g} N of breakaway force are more than the weight of a vehicle, "
            f"{weight:.1f} N: a failed vehicle would hang on its neighbours"
        )
        findings.append(Finding("warning", "breakaway", message))
    return findings


def _failure_findings(plan: Plan, limit: float) -> list[Finding]:
    """Loads after a failure; above the payload a warning, since no failure is planned."""
    findings = []
    failed = failed_vehicle_load(plan)
    if failed is not None:
        message = (
            f"{failed.force:.1f} N on {vehicle_name(failed.vehicle)} if "
            f"{vehicle_name(failed.failed)} fails in the air (payload {limit:.1f} N): release it "
            "at once"
        )
        severity: Severity = "warning" if failed.force > limit else "info"
        findings.append(Finding(severity, "failed vehicle", message, failed.time))
    stuck = stuck_gripper_load(plan)
    if stuck is not None:
        message = (
            f"{stuck.force:.1f} N of cable on {vehicle_name(stuck.vehicle)} if its gripper stays "
            f"closed at the release (payload {limit:.1f} N)"
        )
        severity = "warning" if stuck.force > limit else "info"
        findings.append(Finding(severity, "stuck gripper", message, stuck.time))
    return findings


def endurance_findings(plan: Plan, delay: float = 0.0) -> list[Finding]:
    """Return findings on the flight time; rate limits of the clock add ``delay`` seconds."""
    endurance = plan.mission.vehicles.endurance
    duration = plan.flight_duration + delay
    limited = " with the rate limits of the clock" if delay else ""
    message = (
        f"{duration:.0f} s of flight{limited}, with waits at gates: "
        f"{duration / endurance:.0%} of the vehicles' endurance of {endurance:g} s"
    )
    severity: Severity = (
        "error"
        if duration > endurance
        else "warning"
        if duration > LONG_FLIGHT * endurance
        else "info"
    )
    return [Finding(severity, "endurance", message)]


def contingencies_of(plan: Plan) -> tuple[Contingencies | None, list[Finding]]:
    """Return the contingencies of a plan and findings on them; None without cable aloft.

    Cable that is released as planned must not fall on a vehicle.
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
    message = f"{stop.time:.1f} s and {stop.distance:.2f} m for the longest stop along the path"
    findings = [
        _window_finding(land, "land together"),
        _window_finding(release, "release"),
        Finding("info", "windows", message, stop.at_time),
    ]
    findings += [
        Finding(
            "error", "release", "cable would fall on a vehicle at the planned release", gate.time
        )
        for gate in plan.gates
        if gate.condition == "released"
        and gate.time <= end + _SAME
        and not found.can_release(gate.time)
    ]
    return Contingencies(land, release, stop.time, stop.distance), findings


def _window_finding(window: Window, action: str) -> Finding:
    near = f", at most {window.wait:.1f} s away" if 0.0 < window.share < 1.0 else ""
    message = f"{window.share:.0%} of the time aloft, all can {action}{near}"
    return Finding("warning" if window.wait > FAR_WINDOW else "info", "windows", message)


def downwash_findings(plan: Plan) -> list[Finding]:
    """Return findings on the sinking of a vehicle in the downwash of others."""
    found = deepest_sinking(plan)
    if found is None:
        return []
    tracking = plan.mission.vehicles.tracking
    beyond = f", more than the tracking radius of {tracking:g} m" if found.depth > tracking else ""
    message = (
        f"{found.depth:.2f} m of sinking for {vehicle_name(found.vehicle)}, {found.below:.1f} m "
        f"below {vehicle_name(found.above)} in downwash of {found.speed:.1f} m/s "
        f"(default gains){beyond}"
    )
    severity: Severity = "warning" if found.depth > tracking > 0.0 else "info"
    return [Finding(severity, "downwash", message, found.time)]


def tolerance_findings(plan: Plan) -> list[Finding]:
    """Return a finding that the certificate uses the planned lengths of the segments."""
    tolerance = plan.mission.cable.length_tolerance
    if not len(plan.layout.lengths) or tolerance == 0.0:
        return []
    message = (
        f"{tolerance:g} m of cable.length_tolerance are not certified; their effect is in the "
        "budget"
    )
    return [Finding("info", "length tolerance", message)]


def budget_findings(rows: Iterable[Budget], *, accepted: bool) -> list[Finding]:
    """Return the rows of the budget in words.

    A negative one is an error, or a warning where the mission has accepted that.
    """
    short: Severity = "warning" if accepted else "error"
    return [
        Finding("info" if row.remaining >= 0.0 else short, "budget", _in_words(row), row.time)
        for row in rows
    ]


def _in_words(row: Budget) -> str:
    one, other = row.between
    remain = f"{row.remaining:+.2f} m remain between {one} and {other} if all effects come together"
    effects = (
        ("tracking", row.tracking),
        ("sag and tightening", row.amplification),
        ("length tolerance", row.length),
        ("leaning droppers", row.grip),
        ("swing", row.swing),
        ("swing by tracking errors", row.excited),
        ("wind", row.wind),
        ("rotor wash", row.wash),
    )
    less = ", ".join(f"{name} {size:.2f} m" for name, size in effects)
    available = f"{row.available:.2f} m at the setpoints"
    return f"{remain}: {available}, less {less}, required {row.required:g} m"
