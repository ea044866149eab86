"""Everything that is checked before a plan may fly, put into findings."""

from collections.abc import Callable, Iterable
from typing import Literal

import numpy as np

from swarm.cable.catenary import STANDARD_GRAVITY
from swarm.cable.chain import crossing_gaps
from swarm.errors import SwarmError
from swarm.knots.gauss import SignedGauss, parse_gauss, same_code
from swarm.plans import Plan
from swarm.preflight.budget import budgets
from swarm.preflight.certificate import (
    Moment,
    limits,
    moments_of,
    segment_name,
    tightest_moments,
    vehicle_name,
)
from swarm.preflight.course import Course
from swarm.preflight.findings import Assessment, Finding, Robustness, Severity, Tightest
from swarm.preflight.limits import TAUT
from swarm.preflight.loads import Loads, dead_vehicle, loads, payload_limit, stuck_gripper
from swarm.preflight.robustness import holds_in_wind, largest_tracking, largest_wind
from swarm.preflight.topology import end_code, end_knot, end_time, layout_code
from swarm.preflight.windows import longest_stop, windows

Progress = Callable[[str, float], None]
Chirality = Literal["left", "right", "none"]

TIGHTEST = 5
LIMIT_TOLERANCE = 0.006
"""m/s and m/s²: what the enclosure of speeds and accelerations may add to a plan at its limit."""

BUDGETS = 3
FAR_WINDOW = 20.0
"""Seconds to the nearest window that deserve a warning."""
SMOOTH = (("position", "m", 1e-6), ("velocity", "m/s", 1e-3), ("acceleration", "m/s²", 0.05))
"""What may jump where pieces of the motion join: rounding."""

_OUTSIDE = {
    "release": "from contract to hold; what the cable does after its release, and with it the "
    "knot, is outside the model",
    "tighten": "from contract to hold; how the cable falls from the inner vehicles and whether the "
    "ends draw the knot tight is outside the model, in which only vehicles are kept apart then",
    "unfold": "from contract to hold and back to the floor; how slack cable lies down there is "
    "outside the model",
    "hold": "from contract to hold; coming straight down together, everything keeps its distances "
    "until it touches the floor, and how the strands then lie on each other is outside the model",
}
"""Where the model ends, for each finish."""

_CLEARANCES = (
    "cable clearance",
    "neighbouring segments",
    "reach on the floor",
    "vehicle clearance",
    "vehicle-cable clearance",
    "rotor disc",
    "floor",
)
"""Checks whose moments are distances to compare, for the five that are always reported."""


def assess(plan: Plan, *, progress: Progress | None = None, robustness: bool = False) -> Assessment:
    """Check a plan and return everything found out about it.

    ``progress`` is called with a stage's name and the share of it that is done. ``robustness`` asks
    for e* and w* too, which takes a dozen certificates more.
    """
    moments = tightest_moments(plan, progress=progress)
    findings = [
        *_meeting(plan, moments),
        *(_clearance_finding(plan, moment) for moment in _failing(moments)),
        *_wind_findings(plan),
        *_smoothness_findings(plan),
        *_limit_findings(plan),
        *_load_findings(plan),
        *_endurance_findings(plan),
    ]
    knot, chirality, gauss, topology = _topology(plan)
    findings += topology
    findings += _window_findings(plan)
    findings += _tightest_findings(moments)
    findings += _budget_findings(plan, moments)
    findings.append(_scope(plan))
    return Assessment(
        findings=tuple(findings),
        cable=_tightest(moments, ("cable clearance", "neighbouring segments"), plan),
        vehicle=_tightest(moments, ("vehicle clearance",), plan),
        vehicle_cable=_tightest(moments, ("vehicle-cable clearance",), plan),
        knot=knot,
        chirality=chirality,
        gauss=gauss,
        robustness=Robustness(largest_tracking(plan), largest_wind(plan))
        if robustness
        else Robustness(),
    )


def _failing(moments: Iterable[Moment]) -> list[Moment]:
    return [moment for moment in moments if moment.margin < 0.0]


def _clearance_finding(plan: Plan, moment: Moment) -> Finding:
    tracking = plan.mission.vehicles.tracking
    one, other = moment.between
    errors = f" when tracking errs by up to {tracking:g} m" if tracking > 0 else ""
    if moment.check == "taut":
        message = f"{one} is {-moment.margin:.3f} m beyond {TAUT:.1%} of its length{errors}"
    elif moment.check == "over-stretched on the floor":
        message = f"{one} is pulled {-moment.margin:.3f} m beyond its length on the floor"
    elif moment.check == "rotor disc":
        message = f"{other} runs into the rotor disc of its own {one}{errors}"
    elif moment.check in {"ceiling", "fence"}:
        message = f"{one} crosses {other} by {-moment.margin:.3f} m{errors}"
    else:
        distance = (
            f"can be certified only {moment.distance:.3f} m from"
            if moment.distance > 0
            else "can touch"
        )
        message = f"{one} {distance} {other}{errors}; {moment.required:g} m are required"
    return _at("error", moment.check, message, moment)


def _at(severity: Severity, check: str, message: str, moment: Moment) -> Finding:
    place = ", ".join(f"{value:.2f}" for value in moment.where)
    return Finding(
        severity,
        check,
        f"{message} (at {moment.time:.2f} s, near ({place}))",
        moment.time,
        moment.where,
    )


def _meeting(plan: Plan, moments: Iterable[Moment]) -> list[Finding]:
    """Strands that meet even where every vehicle is exactly at its setpoint."""
    if all(moment.margin >= 0.0 for moment in moments if moment.check == "cable clearance"):
        return []
    exact = tightest_moments(plan, tracking=0.0, checks=("cable clearance",))
    meeting = [moment for moment in exact if moment.distance <= 0.0]
    return [
        _at(
            "error",
            "strands meet",
            f"{moment.between[0]} and {moment.between[1]} meet even without tracking errors: "
            "the cable would entangle",
            moment,
        )
        for moment in meeting
    ]


def _smoothness_findings(plan: Plan) -> list[Finding]:
    """Jumps of position, velocity or acceleration, which no vehicle can follow."""
    found = []
    jumps = Course(plan.motion).jumps()
    for order, (what, unit, allowed) in enumerate(SMOOTH):
        if not jumps.size or jumps[:, order].max() <= allowed:
            continue
        joint, vehicle = np.unravel_index(np.argmax(jumps[:, order]), jumps[:, order].shape)
        size = jumps[joint, order, vehicle]
        message = f"the {what} of vehicle {vehicle + 1} jumps by {size:.3g} {unit}"
        place = plan.motion.coefficients[joint + 1, 0, vehicle]
        at = float(plan.motion.times[joint + 1])
        where = (float(place[0]), float(place[1]), float(place[2]))
        found.append(Finding("error", "smoothness", message, at, where))
    return found


def _limit_findings(plan: Plan) -> list[Finding]:
    vehicles = plan.mission.vehicles
    usable = vehicles.max_acceleration - vehicles.braking_acceleration
    reserve = f" ({vehicles.max_acceleration:g} less {vehicles.braking_acceleration:g} to brake)"
    findings = []
    for family in limits(plan):
        failing = [m for m in moments_of(family) if m.margin < -LIMIT_TOLERANCE]
        if not failing:
            continue
        worst = failing[0]
        largest, unit, why = (
            (vehicles.max_speed, "m/s", "")
            if family.check == "speed"
            else (usable, "m/s²", reserve)
        )
        more = ", and is not the only one" if len(failing) > 1 else ""
        message = (
            f"{worst.between[0]} is asked for up to {largest - worst.margin:.3f} {unit}{more}; "
            f"{largest:g} {unit} are allowed{why}"
        )
        findings.append(_at("error", family.check, message, worst))
    return findings


def _wind_findings(plan: Plan) -> list[Finding]:
    steady = plan.mission.wind.steady
    if steady == 0.0:
        return []
    if holds_in_wind(plan, steady):
        message = f"every clearance holds in a steady wind of {steady:g} m/s from any direction"
        return [Finding("info", "wind", message)]
    message = f"the clearances do not hold in the mission's steady wind of {steady:g} m/s"
    return [Finding("error", "wind", message)]


def _load_findings(plan: Plan) -> list[Finding]:
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
        findings.append(Finding(severity, "dead vehicle", message, dead.time))
    stuck = stuck_gripper(plan)
    if stuck is not None:
        message = (
            f"if the gripper of {vehicle_name(stuck.bearer)} stayed shut at the release, it would "
            f"bear {stuck.pull:.1f} N of cable ({limit:.1f} N is its payload)"
        )
        severity = "warning" if stuck.pull > limit else "info"
        findings.append(Finding(severity, "stuck gripper", message, stuck.time))
    return findings


def _endurance_findings(plan: Plan) -> list[Finding]:
    endurance = plan.mission.vehicles.endurance
    share = plan.duration / endurance
    message = (
        f"the plan takes {plan.duration:.0f} s without waiting at gates, {share:.0%} of the "
        f"vehicles' endurance of {endurance:g} s"
    )
    severity: Severity = "error" if share > 1.0 else "warning" if share > 0.8 else "info"
    return [Finding(severity, "endurance", message)]


def _wrong_crossings(plan: Plan, at_time: float) -> list[Finding]:
    """Crossings of the layout where the strand that should pass over hangs below the other."""
    layout = plan.layout
    if not layout.crossings:
        return []
    gaps = crossing_gaps(layout.corners, layout.lengths, layout.crossings)
    return [
        Finding(
            "error",
            "crossing condition",
            f"{segment_name(over)} should pass over {segment_name(under)}, "
            f"but hangs {-gap:.3f} m below it where they cross",
            at_time,
        )
        for (over, under), gap in zip(layout.crossings, gaps.tolist(), strict=True)
        if gap <= 0.0
    ]


def _topology(plan: Plan) -> tuple[str, Chirality, str, list[Finding]]:
    if all(phase.cable != "aloft" for phase in plan.phases):
        message = "no cable is carried, so no knot is tied"
        return "0_1", "none", "", [Finding("info", "crossing code", message)]
    at_time = end_time(plan)
    try:
        code = end_code(plan)
        found = end_knot(plan)
    except SwarmError as error:
        message = f"no knot can be read off the end: {error}"
        return "unknown", "none", "", [Finding("error", "crossing code", message, at_time)]
    findings = _wrong_crossings(plan, at_time)
    for what, wanted in _wanted_codes(plan):
        if isinstance(wanted, str):
            findings.append(Finding("error", "crossing code", wanted, at_time))
        elif not same_code(code.as_closed() if wanted.closed else code, wanted):
            message = f"the cable ends in the crossing code {_shown(code)}, {what} {_shown(wanted)}"
            findings.append(Finding("error", "crossing code", message, at_time))
    asked = (plan.knot.type, plan.knot.chirality)
    if plan.knot.type and (found.name, found.chirality) != asked:
        message = f"the cable ends as {found}, but {_knot(*asked)} was asked for"
        severity: Severity = "error" if found.known else "warning"
        findings.append(Finding(severity, "knot type", message, at_time))
    if not findings:
        as_asked = ", as asked" if plan.knot.type else ""
        message = f"the cable ends as {found}, with the crossing code {_shown(code)}{as_asked}"
        findings.append(Finding("info", "crossing code", message, at_time))
    chirality: Chirality = found.chirality  # type: ignore[assignment]
    return found.name, chirality, code.signed_text(), findings


def _wanted_codes(plan: Plan) -> list[tuple[str, SignedGauss | str]]:
    wanted: list[tuple[str, SignedGauss | str]] = []
    try:
        wanted.append(("but the layout's is", layout_code(plan.layout)))
        signed = parse_gauss(plan.knot.gauss).signed() if plan.knot.gauss else None
    except SwarmError as error:
        return [*wanted, ("", str(error))]
    if signed is not None:
        wanted.append(("but the diagram's is", signed))
    return wanted


def _shown(code: SignedGauss) -> str:
    return f"[{code.signed_text()}]"


def _knot(name: str, chirality: str) -> str:
    return name if chirality == "none" else f"{name}, {chirality}-handed,"


def _tightest_findings(moments: Iterable[Moment]) -> list[Finding]:
    """The tightest moments of all, at most two of one kind, so that kinds can be compared."""
    ordered = sorted(
        (moment for moment in moments if moment.check in _CLEARANCES), key=lambda m: m.margin
    )
    return [
        _at(
            "info",
            "tightest",
            f"{number}. {moment.check}: {moment.between[0]} and {moment.between[1]}, "
            f"certified {moment.distance:.3f} m, required {moment.required:g} m, "
            f"margin {moment.margin:+.3f} m",
            moment,
        )
        for number, moment in enumerate(ordered[:TIGHTEST], start=1)
    ]


def _tightest(moments: Iterable[Moment], checks: tuple[str, ...], plan: Plan) -> Tightest:
    chosen = [moment for moment in moments if moment.check in checks]
    if not chosen:
        return Tightest(float("inf"), 0.0, float(plan.motion.times[0]), ("", ""))
    worst = min(chosen, key=lambda moment: moment.margin)
    return Tightest(max(worst.distance, 0.0), worst.required, worst.time, worst.between)


def _budget_findings(plan: Plan, moments: Iterable[Moment]) -> list[Finding]:
    """What may eat the distance of the strands that are tightest."""
    ordered = sorted(moments, key=lambda moment: moment.margin)
    return [
        Finding(
            "info",
            "budget",
            f"{row.between[0]} and {row.between[1]} are {row.distance:.2f} m apart at their "
            f"setpoints; tracking may take {row.tracking:.2f} m, what sags and tautens of it "
            f"{row.amplification:.2f} m, length tolerance {row.length:.2f} m, leaning droppers "
            f"{row.grip:.2f} m, sway {row.sway:.2f} m, a stop {row.stop:.2f} m, wind "
            f"{row.wind:.2f} m, rotor wash {row.wash:.2f} m: {row.left:+.2f} m are left if all "
            "come together",
            row.time,
        )
        for row in budgets(plan, ordered)[:BUDGETS]
    ]


def _window_findings(plan: Plan) -> list[Finding]:
    """What if it stops here: where the team can land or let go, and how it stops."""
    found = windows(plan)
    if not len(found.time):
        return []
    findings = []
    start, end = float(found.time[0]), float(found.time[-1])
    for flags, what in ((found.land, "land straight down together"), (found.release, "let go")):
        share = found.share(flags, start, end)
        wait = found.longest_wait(flags, start, end)
        distant = wait > FAR_WINDOW
        near = f"at most {wait:.1f} s away" if share else "never"
        message = f"all can {what} at {share:.0%} of the moments with the cable aloft, {near}"
        findings.append(Finding("warning" if distant else "info", "windows", message))
    stop = longest_stop(plan)
    message = f"the longest stop along the path takes {stop.time:.1f} s and {stop.distance:.2f} m"
    findings.append(Finding("info", "windows", message, stop.at_time))
    for gate in plan.gates:
        aloft = gate.time <= end + 1e-6
        if gate.condition == "released" and aloft and not found.releasable(gate.time):
            message = "cable would fall on a vehicle at the planned release"
            findings.append(Finding("error", "release", message, gate.time))
    return findings


def _scope(plan: Plan) -> Finding:
    tracking = plan.mission.vehicles.tracking
    ball = (
        f"for every tracking error of up to {tracking:g} m"
        if tracking > 0
        else "for exact tracking only (vehicles.tracking is 0: geometry only)"
    )
    return Finding(
        "info",
        "scope",
        f"certified in the quasi-static cable model, {ball}, {_OUTSIDE[plan.mission.finish]}",
    )
