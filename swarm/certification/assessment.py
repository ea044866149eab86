"""All checks of a plan, with their findings, and their result as a frozen value."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from decimal import ROUND_FLOOR, Decimal
from typing import Literal

import numpy as np
import numpy.typing as npt

from swarm.certification.air import deepest_sinking
from swarm.certification.budget import EFFECTS, Budget, budgets, smallest_budgets
from swarm.certification.cable_spans import MOST_EXEMPT, exempt_length
from swarm.certification.clearances import (
    Moment,
    PlanChecks,
    Robustness,
    failure_in_wind,
    limits,
    moments_of,
    robustness_of,
    tightest_moments,
)
from swarm.certification.contingency_windows import contingency_windows, longest_stop
from swarm.certification.distances import Tightest, segment_name, vehicle_name
from swarm.certification.findings import Finding, Severity
from swarm.certification.kinds import FIGURES, kind_of
from swarm.certification.loads import (
    Loads,
    failed_vehicle_load,
    loads,
    payload_limit,
    stuck_gripper_load,
)
from swarm.certification.stream_loss import StreamLossCertificate
from swarm.certification.swing_tube import SwingTube, beyond_ordinary
from swarm.certification.topology import tied_knot
from swarm.geometry.catenary import STANDARD_GRAVITY
from swarm.planning import Plan
from swarm.planning.phase_motion import usable_acceleration
from swarm.planning.phase_order import finish_of

NO_DISTANCE = Tightest(float("inf"), 0.0, 0.0, ("", ""))
"""The tightest of objects that a plan does not have."""

TIGHTEST = 5
"""Number of tightest moments in every report."""


def rounded_down(value: float, decimals: int) -> float:
    """Return a value up to which something holds as it is shown: never more than it holds for."""
    step = Decimal(1).scaleb(-decimals)
    return float(Decimal(repr(float(value))).quantize(step, ROUND_FLOOR))


@dataclass(frozen=True)
class Window:
    """Availability of a contingency while the cable is aloft.

    ``share`` of the time at which it is open; ``wait`` the largest time in seconds to the nearest
    open moment, forward or backward, infinite without an open moment.
    """

    share: float
    wait: float


@dataclass(frozen=True)
class Contingencies:
    """Windows to land together and to release; the longest stop in seconds and in metres."""

    land: Window
    release: Window
    stop_time: float
    stop_distance: float


@dataclass(frozen=True)
class Assessment:
    """Results of all checks of a plan.

    ``distances`` are the tightest by their keys in files (:data:`.kinds.FIGURES`), ``moments`` the
    tightest of each kind of clearance. ``budget`` lists what reduces the distances of the tightest
    strands. ``contingencies`` is None where the cable is never aloft.
    ``stream_loss`` limits the clock's rate, so that clearances hold after a loss of setpoints.
    ``tube`` bounds the swing of the cable; None without a fold. ``swing_certified`` says whether
    clearances hold in it, for the planned motion and one ordinary stop with the resume that
    follows.
    """

    findings: tuple[Finding, ...]
    distances: Mapping[str, Tightest]
    knot: str
    chirality: Literal["left", "right", "none"]
    gauss: str
    robustness: Robustness = field(default_factory=Robustness)
    moments: tuple[Moment, ...] = ()
    budget: tuple[Budget, ...] = ()
    contingencies: Contingencies | None = None
    stream_loss: StreamLossCertificate | None = None
    tube: SwingTube | None = None
    swing_certified: bool = False

    @property
    def tightest(self) -> tuple[Moment, ...]:
        """The TIGHTEST moments of all clearances, tightest first."""
        distances = [moment for moment in self.moments if kind_of(moment.check).listed]
        return tuple(sorted(distances, key=lambda moment: moment.margin)[:TIGHTEST])

    def certified(self, key: str) -> Tightest:
        """Return the tightest of what has this key in flights (:data:`.kinds.MEASURED`).

        The certificate's own under a key that it has in files; infinite where a plan has none.
        """
        if key in self.distances:
            return self.distances[key]
        moments = [moment for moment in self.moments if moment.flown == key]
        if not moments:
            return NO_DISTANCE
        worst = min(moments, key=lambda moment: moment.margin)
        return Tightest(worst.distance, worst.required, worst.time, worst.between)

    @property
    def cleared(self) -> bool:
        """Whether no finding is an error."""
        return all(finding.severity != "error" for finding in self.findings)


SMOOTH = (("position", "m", 1e-9), ("velocity", "m/s", 1e-6), ("acceleration", "m/s²", 0.05))
"""Allowed jumps between pieces of the motion: rounding of polynomials through rows 0.1 ms apart.
Movement bounds include the first two, limits of acceleration the second; nothing relies on the
third."""


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
    first, second = moment.between
    errors = f" for tracking errors up to {tracking:g} m" if tracking > 0 else ""
    failure = kind_of(moment.check).failure
    if not np.isfinite(moment.distance):
        message = f"no distance between {first} and {second} can be certified"
    elif failure:
        message = failure.format(short=-moment.margin, one=first, other=second, errors=errors)
    else:
        certified = (
            f"{moment.distance:.3f} m certified between {first} and {second}"
            if moment.distance > 0
            else f"{first} and {second} can touch"
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
    findings = []
    jumps = PlanChecks.of(plan).motion.jumps
    for order, (quantity, unit, allowed) in enumerate(SMOOTH):
        if not jumps.size or jumps[:, order].max() <= allowed:
            continue
        joint, vehicle = np.unravel_index(np.argmax(jumps[:, order]), jumps[:, order].shape)
        size = jumps[joint, order, vehicle]
        message = f"{size:.3g} {unit} jump in the {quantity} of vehicle {vehicle + 1}"
        place = plan.motion.coefficients[joint + 1, 0, vehicle]
        at = float(plan.motion.times[joint + 1])
        where = (float(place[0]), float(place[1]), float(place[2]))
        findings.append(Finding("error", "smoothness", message, at, where))
    return findings


def limit_findings(plan: Plan) -> list[Finding]:
    """Return errors for speeds and accelerations above the vehicles' limits."""
    vehicles = plan.mission.vehicles
    usable, findings = usable_acceleration(plan.mission), []
    for family in limits(plan):
        failing = [m for m in moments_of(family) if m.margin < 0.0]
        if not failing:
            continue
        worst = failing[0]
        message = family.kind.failure.format(
            reached=family.kind.limit(plan.mission) - worst.margin,
            one=worst.between[0],
            others=" and others" if len(failing) > 1 else "",
            vehicles=vehicles,
            usable=usable,
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
    check, (first, second), time = failed
    message = (
        f"steady wind up to {steady:g} m/s: {check} of {first} and {second} fails (at {time:.2f} s)"
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


FAR_WINDOW = 20.0
"""Seconds to the nearest window from which a finding is a warning: a third of the default hold
timeout."""

LONG_FLIGHT = 0.8
"""Share of the endurance from which a finding is a warning: batteries count as low at 20 %."""

_SAME = 1e-6
"""Seconds by which equal times may differ by rounding."""


def load_findings(plan: Plan) -> list[Finding]:
    """Return findings on the loads of the cable, as planned and after a failure."""
    load = loads(plan)
    if not len(load.time):
        return []
    findings = []
    limit = payload_limit(plan)
    for check, values, allowed, subject in (
        ("payload", load.force, limit, "of cable force on vehicle"),
        ("tension", load.tension, plan.mission.cable.breaking_load, "of tension in segment"),
    ):
        instant, index = np.unravel_index(np.argmax(values), values.shape)
        worst = float(values[instant, index])
        message = f"{worst:.2f} N {subject} {index + 1}; {allowed:.2f} N allowed"
        severity: Severity = "error" if worst > allowed else "info"
        findings.append(Finding(severity, check, message, float(load.time[instant])))
    return [*findings, *_breakaway_findings(plan, load), *_failure_findings(plan, limit)]


def _breakaway_findings(plan: Plan, load: Loads) -> list[Finding]:
    """A tied cable must stay on in normal flight, and break away from a falling vehicle."""
    breakaway = plan.mission.vehicles.breakaway
    if breakaway is None:
        return []
    instant, index = np.unravel_index(np.argmax(load.force), load.force.shape)
    worst = float(load.force[instant, index])
    weight = plan.mission.vehicles.mass * STANDARD_GRAVITY
    message = (
        f"{worst:.2f} N of cable force on {vehicle_name(int(index))}; the tied cable breaks away "
        f"at {breakaway:g} N"
    )
    severity: Severity = "error" if worst >= breakaway else "info"
    findings = [Finding(severity, "breakaway", message, float(load.time[instant]))]
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
    windows = contingency_windows(plan)
    if not len(windows.time):
        return None, []
    start, end = float(windows.time[0]), float(windows.time[-1])
    land, release = (
        Window(windows.share(flags, start, end), windows.longest_wait(flags, start, end))
        for flags in (windows.land, windows.release)
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
        and not windows.may_fall(gate.time)
    ]
    return Contingencies(land, release, stop.time, stop.distance), findings


def _window_finding(window: Window, action: str) -> Finding:
    near = f", at most {window.wait:.1f} s away" if 0.0 < window.share < 1.0 else ""
    message = f"{window.share:.0%} of the time aloft, all can {action}{near}"
    return Finding("warning" if window.wait > FAR_WINDOW else "info", "windows", message)


def downwash_findings(plan: Plan) -> list[Finding]:
    """Return findings on the sinking of a vehicle in the downwash of others."""
    worst = deepest_sinking(plan)
    if worst is None:
        return []
    tracking = plan.mission.vehicles.tracking
    beyond = f", more than the tracking radius of {tracking:g} m" if worst.depth > tracking else ""
    message = (
        f"{worst.depth:.2f} m of sinking for {vehicle_name(worst.vehicle)}, {worst.below:.1f} m "
        f"below {vehicle_name(worst.above)} in downwash of {worst.speed:.1f} m/s "
        f"(default gains){beyond}"
    )
    severity: Severity = "warning" if worst.depth > tracking > 0.0 else "info"
    return [Finding(severity, "downwash", message, worst.time)]


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
    part, other = row.between
    rest = f"{row.remaining:+.2f} m remain between {part} and {other} if all effects come together"
    less = ", ".join(f"{words} {getattr(row, name):.2f} m" for name, words in EFFECTS.items())
    available = f"{row.available:.2f} m at the setpoints"
    return f"{rest}: {available}, less {less}, required {row.required:g} m"


Progress = Callable[[str, float], None]

BUDGETS = 3
"""Rows of the budget: the pairs of strands with the least that remains."""

_MODEL_END = {
    None: "to the end of the motion",
    "release": "to the release; the cable after it, and with it the knot, is outside the model",
    "tighten": "until the inner vehicles release it; the fall of the cable and the tightening of "
    "the knot are outside the model, in which then only distances of vehicles are certified",
    "unfold": "through the hold and back to the floor; the shape of slack cable on the floor is "
    "outside the model",
    "hold": "through the hold and the common vertical descent until the cable touches the floor; "
    "the contact of strands there is outside the model",
}
"""The end of the cable model, for each finish."""


def assess(
    plan: Plan,
    *,
    progress: Progress | None = None,
    robustness: bool = False,
) -> Assessment:
    """Return the results of all checks of a plan.

    ``progress`` is called with the name of a stage and the share of it that is done. With
    ``robustness``, e* and w* are computed too (:func:`with_robustness`).
    """
    checks = PlanChecks.of(plan)
    moments = checks.moments(progress)
    tube = checks.tube
    findings = [
        *(Finding("error", "phases", *problem) for problem in checks.spans.problems),
        *clearance_findings(plan, moments),
        *wind_findings(plan),
        *smoothness_findings(plan),
        *limit_findings(plan),
        *load_findings(plan),
        *downwash_findings(plan),
        *swing_findings(plan, tube),
    ]
    knot = tied_knot(plan)
    contingencies, new_findings = contingencies_of(plan)
    findings += [*knot.findings, *new_findings]
    # A refused plan is not flown, so it needs no certificate of stream losses.
    refused = any(finding.severity == "error" for finding in (*findings, *endurance_findings(plan)))
    stream_loss = None if refused else checks.stream_loss()
    findings += stream_loss.findings() if stream_loss else []
    findings += endurance_findings(plan, stream_loss.delay if stream_loss else 0.0)
    rows = smallest_budgets(plan, tube.pairs) if tube else budgets(plan, moments)
    budget = tuple(sorted(rows, key=lambda row: row.remaining))[:BUDGETS]
    assessment = Assessment(
        findings=(),
        distances={figure: _tightest(moments, figure, plan) for figure in FIGURES},
        knot=knot.type,
        chirality=knot.chirality,
        gauss=knot.gauss,
        moments=moments,
        budget=budget,
        contingencies=contingencies,
        stream_loss=stream_loss,
        tube=tube,
        swing_certified=checks.certified_tube is not None,
    )
    findings += tightest_findings(assessment.tightest)
    findings += budget_findings(budget, accepted=plan.mission.limits.accept_negative_budget)
    findings += tolerance_findings(plan)
    findings.append(_scope(plan, swing_certified=assessment.swing_certified))
    assessment = replace(assessment, findings=tuple(findings))
    return with_robustness(plan, assessment, progress) if robustness else assessment


def with_robustness(
    plan: Plan, assessment: Assessment, progress: Progress | None = None
) -> Assessment:
    """Return the assessment with e* and w*; as long as a dozen certificates.

    A plan without cable aloft has none.
    """
    if all(phase.cable != "aloft" for phase in plan.phases):
        return assessment
    return replace(assessment, robustness=robustness_of(plan, assessment.moments, progress))


def _tightest(moments: Iterable[Moment], figure: str, plan: Plan) -> Tightest:
    chosen = [moment for moment in moments if kind_of(moment.check).figure == figure]
    if not chosen:
        return Tightest(float("inf"), 0.0, float(plan.motion.times[0]), ("", ""))
    worst = min(chosen, key=lambda moment: moment.margin)
    return Tightest(max(worst.distance, 0.0), worst.required, worst.time, worst.between)


def _scope(plan: Plan, *, swing_certified: bool) -> Finding:
    """State the model, the tracking errors and the times for which a plan is certified."""
    tracking = plan.mission.vehicles.tracking
    errors = (
        f"for every tracking error up to {tracking:g} m"
        if tracking > 0
        else "for exact tracking only (vehicles.tracking is 0: geometry only)"
    )
    spans = PlanChecks.of(plan).spans
    if not spans.ever:
        message = f"distances of vehicles are certified {errors}; no cable is carried"
        return Finding("info", "scope", message)
    exempt = ""
    if plan.vehicles > 2:
        exempt = (
            f"; between two segments that share a vehicle, {exempt_length(plan):.2f} m of cable "
            f"from its grip (at most {MOST_EXEMPT:.0%} of the shorter one) are exempt"
        )
        if spans.low:
            exempt += ", and all of both while cable lies on the floor in a line"
    model = "in the quasi-static cable model"
    if swing_certified:
        model = (
            "in the swinging-cable model for the planned motion and one ordinary stop with the "
            f"resume that follows, at any moment of the fold, {model}"
        )
    return Finding(
        "info",
        "scope",
        f"certified {model} {errors}, from the grip at "
        f"{spans.gripped:.1f} s {_MODEL_END[finish_of([phase.name for phase in plan.phases])]}; "
        f"all vehicles hold the cable until {spans.released:.1f} s{exempt}",
    )
