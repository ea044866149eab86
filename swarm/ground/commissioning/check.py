"""The ground check of a fleet, ``swarm check``: a go/no-go list before arming.

Its audit, parameters by our own protocol and health and firmware by MAVSDK, comes before a flight
too. The parameters of all vehicles are fetched once, at the same time; a changed parameter counts
as set once it has been read back. The audit blocks, so it runs in a thread beside the loop.
"""

import json
import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from swarm.certification.certificate import CertifiedPlan
from swarm.certification.findings import Finding, Severity
from swarm.errors import InputError, Interrupted, Problem, Refused, SwarmError, VehicleError
from swarm.files import parse_json, read_bytes
from swarm.flight.bodies import PoseRow, pose_rows
from swarm.flight.fleet_listener import FleetListener, LinkQuality, radio_findings
from swarm.flight.identification import Identification
from swarm.flight.parameters import (
    STREAM_LOSS_TIME,
    ParameterResult,
    Requirements,
    evaluate,
    fleet_requirements,
    plan_requirements,
    rules,
    stream_loss_findings,
    stream_loss_model,
)
from swarm.flight.preparation import GATHERING, Prepared, mission_fence
from swarm.flight.stages import CheckStep
from swarm.ground.commissioning.identify import guided, moved_words
from swarm.ground.commissioning.mavsdk_client import VehicleReport, vehicle_reports
from swarm.ground.commissioning.screens import CheckScreens
from swarm.ground.commissioning.survey import Survey, open_survey
from swarm.ground.mocap_bridge import Borrowed
from swarm.ground.relay import Relay
from swarm.mavlink.fence import FenceItem, same_fence
from swarm.mavlink.frames import AutopilotName
from swarm.mavlink.vehicle import Vehicle
from swarm.mission import Vehicles
from swarm.mission.fleet import Fleet
from swarm.mission.validation import LARGEST_FILE
from swarm.planning import Plan

BATTERY_RESERVE = 25.0
"""Percent of a battery that must remain when all vehicles have landed."""
_TIMEOUT = 300.0
"""Seconds for fetching or setting parameters, on the slowest link."""
_POLL = 0.05
_FIRMWARE = {"px4": "PX4", "ardupilot": "ArduPilot"}

ProgressCallback = Callable[[str, float], None]
"""Called with the name of the present step, and the completed share of it."""


@dataclass(frozen=True)
class VehicleAudit:
    """The state that one vehicle reports before arming.

    ``deviations`` and ``correct`` are rows of the parameter table; ``parameters`` all parameters,
    or ``unread`` says how many are missing;
    ``health`` whether each subsystem is healthy; ``battery`` in percent, negative or NaN if it is
    unknown; ``problems`` the vehicle's own reasons why it cannot be armed; ``fence`` the items of
    its fence, None if they were not read.
    """

    system: int
    firmware: str
    health: Mapping[str, bool]
    battery: float
    satellites: int
    problems: tuple[str, ...]
    parameters: Mapping[str, float]
    deviations: tuple[ParameterResult, ...]
    correct: tuple[ParameterResult, ...]
    unread: str = ""
    fence: tuple[FenceItem, ...] | None = None

    def findings(self, required_battery: float = 0.0) -> Iterator[Finding]:
        """Yield the findings; ``required_battery`` is the percentage that the flight uses."""
        name = f"system {self.system}"
        yield Finding("info", "firmware", f"{name}: {self.firmware}")
        unhealthy = ", ".join(subsystem for subsystem, fine in self.health.items() if not fine)
        for problem in self.problems:
            yield Finding("warning", "health", f"{name}: {problem}")
        if unhealthy:
            yield Finding("warning", "health", f"{name}: not healthy: {unhealthy}")
        elif not self.problems:
            yield Finding("info", "health", f"{name}: healthy and armable")
        yield self._battery(name, required_battery)
        for row in self.deviations:
            yield Finding(row.severity, "parameters", row.message)
        if self.unread:
            yield Finding("error", "parameters", f"{name}: {self.unread}")
        elif not self.deviations:
            yield Finding("info", "parameters", f"{name}: all {len(self.correct)} correct")

    def fence_finding(self, wanted: Sequence[FenceItem]) -> Finding:
        """Return the finding on the vehicle's fence; ``wanted`` is the mission's, or empty."""
        had = self.fence
        severity: Severity = "warning"
        if had is None:
            words = "its fence was not read"
        elif wanted and not had:
            words = "has no fence; swarm check MISSION --fence uploads the mission's"
        elif had and not wanted:
            words = f"has a fence of {len(had)} items, and the mission none (workspace.fence)"
        elif not same_fence(had, wanted):
            severity = "error"
            words = f"has another fence than the mission's ({len(had)} items): swarm check MISSION "
            words += "--fence replaces it"
        elif had and self.parameters.get("FENCE_ENABLE") == 0.0:
            words = "has the mission's fence, but FENCE_ENABLE is 0: it does nothing"
        else:
            severity = "info"
            words = "has the mission's fence" if had else "no fence, and none in the mission"
        return Finding(severity, "fence", f"system {self.system}: {words}")

    def _battery(self, name: str, required: float) -> Finding:
        if not self.battery >= 0.0:
            return Finding("warning", "battery", f"{name}: does not report its battery")
        text = f"{name}: {self.battery:.0f} %"
        if self.battery < required + BATTERY_RESERVE:
            text += f"; the flight uses {required:.0f} %, and {BATTERY_RESERVE:.0f} % must remain"
            return Finding("error", "battery", text)
        return Finding("info", "battery", text)


@dataclass
class Auditor:
    """Audits a team of vehicles on the ground, through the links of a relay's team.

    ``names`` are the system ids of the vehicles, with their autopilots; where they know their place
    ``on_earth``, their fences are read too. All methods block, so they must not run in the loop's
    thread. They raise :class:`VehicleError` with the names of all
    vehicles that do not respond.
    """

    relay: Relay
    names: Mapping[int, AutopilotName]
    demands: Requirements
    progress: ProgressCallback = lambda *_: None
    on_earth: bool = False
    _reports: dict[int, VehicleReport] = field(default_factory=dict)

    def audit(self) -> list[VehicleAudit]:
        """Fetch all parameters and fences, then the reports of MAVSDK, for all vehicles at once."""
        vehicles = self._vehicles()
        for vehicle in vehicles.values():
            vehicle.parameters.fetch()
            if self.on_earth:
                vehicle.fence.fetch()
        self._wait("parameters", lambda: _fetched(vehicles.values()))
        self._fetch_reports()
        return [self._vehicle_audit(system) for system in vehicles]

    def fix(self, rows: Sequence[ParameterResult]) -> list[str]:
        """Set the parameters of deviating rows; return a line for each change."""
        values: dict[int, dict[str, float]] = {}
        for row in rows:
            if row.value is not None:
                values.setdefault(row.system, {})[row.name] = row.should
        return self.set(values)

    def set(self, values: Mapping[int, Mapping[str, float]]) -> list[str]:
        """Set parameters of each system and read them back; return a line for each change.

        Raises :class:`VehicleError` with the names of parameters that are read back differently.
        """
        vehicles = {system: self.relay.team.vehicles[system] for system in values}
        before = {system: dict(vehicle.parameters.values) for system, vehicle in vehicles.items()}
        for system, vehicle in vehicles.items():
            vehicle.parameters.set(values[system])
        number = sum(len(parameters) for parameters in values.values())
        self._wait("setting parameters", lambda: _set(vehicles.values(), number))
        problems = [
            f"system {system}: {failed.name} was set to {failed.requested:g}, "
            + (
                "but was not read back"
                if failed.reported is None
                else f"but is {failed.reported:g}"
            )
            for system, vehicle in vehicles.items()
            for failed in vehicle.parameters.failed
        ]
        if problems:
            raise VehicleError("\n".join(problems))
        return [
            f"system {system}: {name} {before[system][name]:g} → {value:g}"
            for system, parameters in values.items()
            for name, value in parameters.items()
        ]

    def set_fences(self, fences: Mapping[int, Sequence[FenceItem]]) -> list[str]:
        """Upload the fence of each system, none: clear it; return a line for each change.

        Raises :class:`VehicleError` with the fences that are read back differently.
        """
        vehicles = {system: self.relay.team.vehicles[system] for system in fences}
        for system, vehicle in vehicles.items():
            vehicle.fence.upload(fences[system])
        self._wait("fences", lambda: (0, 0))
        problems = [
            f"system {system}: {vehicle.fence.problem or 'its fence was read back differently'}"
            for system, vehicle in vehicles.items()
            if vehicle.fence.problem or not same_fence(vehicle.fence.items or (), fences[system])
        ]
        if problems:
            raise VehicleError("\n".join(problems))
        return [
            f"system {system}: fence {f'of {len(items)} items uploaded' if items else 'cleared'}"
            for system, items in fences.items()
        ]

    def updated(self, audits: Sequence[VehicleAudit]) -> list[VehicleAudit]:
        """Return audits with the present parameters; nothing is fetched again."""
        new = [self._vehicle_audit(audit.system) for audit in audits]
        return [
            replace(
                audit,
                parameters=now.parameters,
                deviations=now.deviations,
                correct=now.correct,
                fence=now.fence,
            )
            for audit, now in zip(audits, new, strict=True)
        ]

    def _vehicles(self) -> dict[int, Vehicle]:
        return {system: self.relay.team.vehicles[system] for system in sorted(self.names)}

    def _fetch_reports(self) -> None:
        ports = {system: self.relay.ports[system] for system in sorted(self.names)}
        step, received = "health and firmware", [0]
        self.progress(step, 0.0)

        def on_report(_: int) -> None:
            received[0] += 1
            text = f"{step}: {received[0]} of {len(ports)} vehicles"
            self.progress(text, received[0] / len(ports))

        self._reports = vehicle_reports(ports, on_report)

    def _vehicle_audit(self, system: int) -> VehicleAudit:
        report, name = self._reports[system], self.names[system]
        vehicle = self.relay.team.vehicles[system]
        received = vehicle.parameters
        values = dict(received.values)
        deviations, correct = evaluate(system, values, rules(name, self.demands))
        number = report.firmware
        return VehicleAudit(
            system=system,
            firmware=f"{_FIRMWARE[name]} {number}" if number else f"{name}, version unknown",
            health={
                subsystem: fine
                for subsystem, fine in report.health.items()
                if (self.on_earth or subsystem not in _ON_EARTH)
                # MAVSDK calls the compass of an ArduPilot that has none unhealthy
                and (vehicle.compass_present or subsystem != "magnetometer")
            },
            battery=report.battery,
            satellites=report.satellites,
            problems=report.problems,
            parameters=values,
            deviations=tuple(deviations),
            correct=tuple(correct),
            unread=received.problem,
            fence=vehicle.fence.items,
        )

    def _wait(self, step: str, progress: Callable[[], tuple[int, int]]) -> None:
        """Wait until all parameters are fetched or set, and report the progress."""
        pause, deadline = threading.Event(), time.monotonic() + _TIMEOUT
        vehicles = self._vehicles().values()
        while any(vehicle.parameters.busy or vehicle.fence.busy for vehicle in vehicles):
            done, total = progress()
            if total:
                self.progress(f"{step}: {done} of {total}", done / total)
            if time.monotonic() > deadline:
                busy = [v.system for v in vehicles if v.parameters.busy or v.fence.busy]
                names = ", ".join(str(system) for system in busy)
                raise VehicleError(f"{step} of system {names}: not done in {_TIMEOUT:g} s")
            pause.wait(_POLL)


def _fetched(vehicles: Iterable[Vehicle]) -> tuple[int, int]:
    parameters = [vehicle.parameters for vehicle in vehicles]
    return sum(each.received for each in parameters), sum(each.total for each in parameters)


def _set(vehicles: Iterable[Vehicle], number: int) -> tuple[int, int]:
    return number - sum(vehicle.parameters.pending for vehicle in vehicles), number


def wanted_fence(
    plan: Plan, flyers: Sequence[Vehicle], fleet: Fleet
) -> tuple[FenceItem, ...] | None:
    """Return the fence that the vehicles should have; None where it has no place on the earth.

    ``flyers`` are in order along the cable.
    """
    if fleet.frame != "gps":
        return None
    corners = plan.mission.workspace.fence
    return mission_fence(flyers, fleet, plan.motion.at(0.0)[0], corners) if corners else ()


def save_parameters(folder: Path, audits: Sequence[VehicleAudit]) -> None:
    """Save parameters and fences in a folder, a JSON file for each vehicle whose were all read."""
    below = folder / "parameters"
    below.mkdir(parents=True, exist_ok=True)
    for audit in (vehicle for vehicle in audits if not vehicle.unread):
        text = json.dumps(dict(sorted(audit.parameters.items())), indent=1)
        (below / f"{audit.system}.json").write_text(text, encoding="utf-8")
    fences = folder / "fences"
    fences.mkdir(exist_ok=True)
    for audit in (audit for audit in audits if audit.fence is not None):
        text = json.dumps([item._asdict() for item in audit.fence or ()], indent=1)
        (fences / f"{audit.system}.json").write_text(text, encoding="utf-8")


LOST_SETPOINTS = "computing what lost setpoints of these vehicles lead to"
_STREAM_START = 2.5
"""Seconds after the first heartbeats until messages arrive at the requested rates."""
_READY_TIMEOUT = 5.0
"""Seconds within which a vehicle that has run for long must report that it is ready."""
_HOLD_TIMEOUT = 15.0
_ON_EARTH = frozenset({"global position", "home position", "armable"})
"""Health that needs a place on the earth: without one PX4 can arm in offboard mode only, which the
check of ``ready`` knows."""
_POLYGON = 4
"""The bit of FENCE_TYPE for the uploaded polygon (ArduPilot, AC_Fence)."""

SUBJECTS = {
    "plan": "plan",
    "fleet": "vehicles on the links",
    "firmware": "firmware",
    "ready": "ready to arm",
    "health": "health and arming",
    "battery": "battery",
    "position": "position quality",
    "poses": "poses of motion capture",
    "bodies": "bodies of motion capture, moved by hand",
    "corrections": "corrections of positions",
    "parameters": "parameters",
    "fence": "fences",
    "placement": "positions against pads",
    "origin": "origins",
    "clock": "clocks and delays",
    "hold": "Hold mode, tested",
    "stream loss": "lost setpoints",
    "endurance": "duration of the flight",
    "link": "links",
    "radio": "capacity of the radios",
    "hop": "hover errors in a hop",
    "first tests": "first tests",
}
"""The go/no-go list: the checks of findings, in order, with their titles."""


@dataclass(frozen=True)
class ChecklistItem:
    """One line of the go/no-go list."""

    check: str
    subject: str
    go: bool
    message: str


@dataclass(frozen=True)
class CheckReport:
    """The result of a check: vehicles, links, findings, and the parameters that were set.

    ``order`` are the system ids in order along the cable; empty without a plan. ``poses`` has a row
    for each vehicle where a motion capture system is read, here or by a bridge that runs;
    ``sender`` names the process that sends them.
    """

    vehicles: tuple[VehicleAudit, ...]
    links: tuple[LinkQuality, ...]
    parameters_set: tuple[str, ...]
    findings: tuple[Finding, ...]
    order: tuple[int, ...] = ()
    poses: tuple[PoseRow, ...] = ()
    sender: str = ""

    @property
    def passed(self) -> bool:
        """Whether no finding is an error."""
        return all(finding.severity != "error" for finding in self.findings)

    def checklist(self) -> list[ChecklistItem]:
        """Return the go/no-go list: one line for every check with findings."""
        items = []
        for check, subject in SUBJECTS.items():
            findings = [finding for finding in self.findings if finding.check == check]
            if findings:
                items.append(ChecklistItem(check, subject, *_verdict(findings)))
        return items

    def with_findings(self, *findings: Finding) -> "CheckReport":
        """Return the report with these findings added."""
        return replace(self, findings=(*self.findings, *findings))


def _verdict(findings: Sequence[Finding]) -> tuple[bool, str]:
    counts = {
        level: sum(finding.severity == level for finding in findings)
        for level in ("error", "warning")
    }
    worst: Severity = "error" if counts["error"] else "warning" if counts["warning"] else "info"
    first = next(finding for finding in findings if finding.severity == worst)
    number = counts.get(worst, 0)
    if worst == "info":
        return True, findings[0].message if len(
            findings
        ) == 1 else f"{len(findings)} without faults"
    more = f" (and {number - 1} more)" if number > 1 else ""
    return worst != "error", ("" if worst == "error" else "warning: ") + first.message + more


@dataclass(frozen=True)
class CheckOptions:
    """Options of a check.

    - ``soak``: seconds for which the links are measured.
    - ``confirm_fix``: called with the deviating parameters; True sets them.
    - ``restore``: folder of an earlier check or flight whose saved parameters are set again.
    - ``fence``: upload the mission's fence to all vehicles, and enable it.
    - ``rtcm``: address of a source of corrections that are sent to the vehicles' receivers.
    - ``mocap``: URL of a motion capture system whose poses are sent to the vehicles; without it,
      those of a bridge that runs for the fleet are looked at.
    - ``identify``: have a person move one vehicle after the other, and compare it with the bodies
      of motion capture; ``say`` gets what is asked for and what was seen.
    - ``beforehand``: findings that are part of the result, and known before.
    - ``screens``: the screens of the check.
    - ``prepared``: emulated vehicles start with the parameters that are required.
    - ``progress``: called from another thread with the present step.
    """

    soak: float = 0.0
    confirm_fix: Callable[[Sequence[ParameterResult]], bool] | None = None
    restore: Path | None = None
    progress: ProgressCallback = lambda *_: None
    rtcm: str | None = None
    fence: bool = False
    mocap: str | None = None
    prepared: bool = False
    identify: bool = False
    say: Callable[[str], None] = lambda _: None
    beforehand: tuple[Finding, ...] = ()
    screens: CheckScreens = field(default_factory=CheckScreens)


def check(
    fleet: Fleet,
    folder: Path,
    flight_plan: CertifiedPlan | None = None,
    options: CheckOptions | None = None,
) -> CheckReport:
    """Check a fleet on the ground; parameters are saved in ``folder`` before any is changed.

    With a plan, the vehicles are compared with its requirements and their positions with its pads.

    Raises :class:`VehicleError` if links or vehicles are missing, and :class:`Refused` if the fleet
    is too small for the plan or two vehicles share a system id, which are then not checked.
    """
    if flight_plan is not None and len(fleet.vehicles) < flight_plan.plan.vehicles:
        raise Refused(
            f"the plan needs {flight_plan.plan.vehicles} vehicles, the fleet {fleet.name} "
            f"has {len(fleet.vehicles)}"
        )
    options = options or CheckOptions()
    if options.restore is not None:
        for system in fleet.systems:
            _saved(options.restore, system)
    plan = flight_plan.plan if flight_plan else None
    required = _requirements(plan, fleet) if options.prepared else None
    screens = options.screens
    screens.steps = [
        step
        for step in CheckStep
        if (step is not CheckStep.BODIES or options.identify)
        and (step is not CheckStep.LINKS or options.soak > 0.0)
    ]
    with (
        open_survey(fleet, folder, plan, options.rtcm, options.mocap, required) as survey,
        screens.opened(survey.listener, plan),
    ):
        work = _Check(survey, folder, flight_plan, options)
        try:
            report = survey.run(work.run, screens.run).with_findings(*options.beforehand)
        except SwarmError as error:
            word = "interrupted" if isinstance(error, Interrupted) else "failed"
            screens.end(word, str(error), error.exit_code)
            raise
        screens.findings(report.findings)
        words = "GO for flight" if report.passed else "NO-GO: do not arm"
        screens.end(words, "", 0 if report.passed else 1)
        return report


def _requirements(plan: Plan | None, fleet: Fleet) -> Requirements:
    return plan_requirements(plan, fleet) if plan else fleet_requirements(Vehicles(), fleet)


@dataclass
class _Check:
    """The blocking part, in a thread beside the loop."""

    survey: Survey
    folder: Path
    flight_plan: CertifiedPlan | None
    options: CheckOptions
    bodies: tuple[Finding, ...] = ()
    findings: list[Finding] = field(default_factory=list)

    def run(self) -> CheckReport:
        self._wait_for_vehicles()
        names = {
            vehicle.system: vehicle.autopilot.name
            for vehicle in self.listener.received
            if vehicle.autopilot is not None
        }
        if self.options.identify:
            self._identify()
        self._begin(CheckStep.PARAMETERS)
        auditor = Auditor(
            self.survey.relay, names, _requirements(self.plan, self.listener.fleet),
            self._progress,
            on_earth=self.listener.fleet.frame == "gps",
        )  # fmt: skip
        audits = auditor.audit()
        self._add(finding for audit in audits for finding in audit.findings())
        self.survey.relay.closed = True
        save_parameters(self.folder, audits)
        changed: list[str] = []
        if self.options.restore is not None:
            changed += auditor.set(_changed_since(audits, self.options.restore))
            changed += auditor.set_fences(_fences_before(audits, self.options.restore))
            audits = auditor.updated(audits)
        audits = self._fixed(auditor, audits, changed)
        if changed:
            self.findings = list(self.bodies)
            self._add(finding for audit in audits for finding in audit.findings())
        self._begin(CheckStep.PLACES)
        placement, order = self._placement()
        self._add(placement)
        wanted = self._wanted_fence(order)
        if self.options.fence and wanted:
            changed += auditor.set_fences({audit.system: wanted for audit in audits})
            changed += auditor.set(_enabled_fences(audits))
            # what an enabled fence does counts from now on
            audits = self._fixed(auditor, auditor.updated(audits), changed)
        fences = [] if wanted is None else [audit.fence_finding(wanted) for audit in audits]
        if self.options.fence and not wanted:
            fences.append(Finding("error", "fence", f"not uploaded: {self._why_no_fence(wanted)}"))
        self._begin(CheckStep.HOLD)
        hold = self._test_hold()
        self._add(hold)
        links = self._soak()
        observed = [*self.bodies, *placement, *hold, *fences]
        return self._report(audits, links, changed, observed, order)

    def _begin(self, step: CheckStep) -> None:
        self.options.screens.begin(step)

    def _progress(self, words: str, share: float) -> None:
        """Show what is done now, in the terminal and on the screens."""
        self.options.progress(words, share)
        self.options.screens.progress(words, share)

    def _add(self, findings: Iterable[Finding]) -> None:
        """Show findings on the screens, after those before."""
        self.findings += findings
        self.options.screens.findings(self.findings)

    def _identify(self) -> None:
        """Have a person move one vehicle after the other."""
        screens, systems = self.options.screens, self.listener.fleet.systems
        self._begin(CheckStep.BODIES)

        def show(identification: Identification, words: str) -> None:
            self._progress(words, len(identification.results) / len(systems))
            screens.guide(words, moved_words(identification), identification.asked)

        def say(words: str) -> None:
            self.options.say(words)
            screens.say(words)

        say("Propellers off. All vehicles on the ground, and nothing else moved.")
        self.bodies = guided(self.survey, self.folder, say, show).findings()
        self._add(self.bodies)

    @property
    def plan(self) -> Plan | None:
        """The plan that is to be flown, if any."""
        return self.flight_plan.plan if self.flight_plan else None

    @property
    def listener(self) -> FleetListener:
        """The fleet as it is received."""
        return self.survey.listener

    def _fixed(
        self, auditor: Auditor, audits: list[VehicleAudit], changed: list[str]
    ) -> list[VehicleAudit]:
        """Set the parameters that deviate where that is confirmed; return the audits then."""
        rows = [row for audit in audits for row in audit.deviations if row.value is not None]
        confirm_fix = self.options.confirm_fix
        if not rows or confirm_fix is None or not confirm_fix(rows):
            return audits
        changed += auditor.fix(rows)
        return auditor.updated(audits)

    def _wanted_fence(self, order: Sequence[int]) -> tuple[FenceItem, ...] | None:
        """Return the mission's fence; None without a mission, or where it cannot be placed."""
        if self.plan is None or not order:
            return None
        flyers = [self.listener.team.vehicles[system] for system in order]
        return wanted_fence(self.plan, flyers, self.listener.fleet)

    def _why_no_fence(self, wanted: tuple[FenceItem, ...] | None) -> str:
        if self.listener.fleet.frame != "gps":
            return f"in the frame {self.listener.fleet.frame} it has no place on the earth"
        return (
            "where it lies is not known"
            if wanted is None
            else "the mission has none (workspace.fence)"
        )

    def _wait_for_vehicles(self) -> None:
        """Wait until all vehicles are received, at the requested rates."""
        fleet = self.listener.fleet
        self._progress(f"listening to {fleet.name}", 0.0)
        missing = self.survey.wait_for_vehicles(self._report_received)
        if missing:
            names = ", ".join(f"system {system}" for system in missing)
            raise VehicleError(f"not received: {names}")
        self.survey.wait(_STREAM_START)
        self._report_received()

    def _report_received(self) -> None:
        """Report the number of received vehicles; refuse if two of them share a system id."""
        if self.listener.team.conflicts():
            self.survey.wait(GATHERING)
            if conflicts := self.listener.team.conflicts():
                raise Refused("\n".join(finding.message for finding in conflicts))
        number, total = len(self.listener.received), len(self.listener.fleet.vehicles)
        self._progress(f"received {number} of {total} vehicles", number / total)

    def _placement(self) -> tuple[list[Finding], tuple[int, ...]]:
        """Wait until the vehicles are ready; return findings, and the order along the cable.

        ``limits.ready`` counts from the start of each autopilot: one that has run for longer does
        not become ready by waiting. Corrections begin with the check.
        """
        listener, begun = self.listener, time.monotonic()
        self._progress("waiting until all are ready to arm", 0.0)
        ready = listener.fleet.limits.ready
        self.survey.wait_until(listener.at_rest, _READY_TIMEOUT)
        youngest = min((vehicle.boot_ms / 1000.0 for vehicle in listener.received), default=ready)
        self.survey.wait_until(listener.at_rest, ready - youngest)
        if self.survey.corrections is not None and not listener.not_ready():
            self._progress("waiting until all receivers use the corrections", 0.0)
            self.survey.wait_until(listener.at_rest, ready - (time.monotonic() - begun))
        findings = [replace(finding, check="ready") for finding in listener.waits_for()]
        if not findings:
            text = f"{len(listener.received)} vehicles are ready"
            findings.append(Finding("info", "ready", text))
        if self.plan is None:
            return findings, ()
        lift = np.array([0.0, 0.0, self.plan.mission.vehicles.grip_offset])
        placed = listener.placement(self.plan.motion.at(0.0)[0] + lift)
        if isinstance(placed, Prepared):
            return [*findings, *placed.audit.findings], placed.audit.systems
        return [*findings, placed], ()

    def _test_hold(self) -> list[Finding]:
        """Test Hold mode on all vehicles, on ArduPilot Brake; return the findings."""
        listener = self.listener
        self._progress("testing Hold", 0.0)
        listener.try_hold()
        self.survey.wait_until(lambda: listener.hold_results is not None, _HOLD_TIMEOUT)
        findings = []
        for vehicle in listener.received:
            problem = (listener.hold_results or {}).get(vehicle.system, "no acknowledgement")
            text = f"system {vehicle.system}: " + (problem or "entered Hold and returned")
            severity: Severity = "info"
            if problem:
                text += "; a failsafe with Hold would land or descend instead"
                severity = "warning" if listener.fleet.frame == "shared" else "error"
            findings.append(Finding(severity, "hold", text))
        return findings

    def _soak(self) -> Sequence[LinkQuality]:
        if self.options.soak <= 0.0:
            return ()
        self._begin(CheckStep.LINKS)
        self._progress(f"measuring the links for {self.options.soak:g} s", 0.0)
        self.listener.begin_link_measurement()
        self.survey.wait(self.options.soak)
        return self.listener.link_quality()

    def _report(
        self,
        audits: Sequence[VehicleAudit],
        links: Sequence[LinkQuality],
        changed: Sequence[str],
        observed: Sequence[Finding],
        order: tuple[int, ...],
    ) -> CheckReport:
        fleet, plan = self.listener.fleet, self.plan
        findings = [
            Finding(
                "info", "fleet", f"{len(self.listener.received)} vehicles of {fleet.name} received"
            ),
            *self.listener.team.findings(),
            *observed,
        ]
        duration = plan.flight_duration if plan else 0.0
        loss_findings: list[Finding] = []
        if self.flight_plan is not None and order:
            values = {audit.system: audit.parameters for audit in audits}
            names = {v.system: v.autopilot.name for v in self.listener.received if v.autopilot}
            flown = [(names[system], values[system]) for system in order if system in values]
            model = stream_loss_model(flown, fleet.limits)
            loss, loss_findings = stream_loss_findings(
                self.flight_plan, model, partial(self._progress, LOST_SETPOINTS)
            )
            duration += loss.delay
        battery = 100.0 * duration / plan.mission.vehicles.endurance if plan else 0.0
        for audit in audits:
            findings.extend(audit.findings(battery))
        findings.extend(loss_findings)
        tracking = plan.mission.vehicles.tracking if plan else math.inf
        findings.extend(self.listener.frames_and_clocks(tracking))
        if self.survey.corrections is not None:
            findings.append(self.survey.corrections.finding(self.listener.now))
        poses = self._poses()
        findings.extend(row.finding() for row in poses)
        for link in links:
            findings.extend(link.findings(STREAM_LOSS_TIME, fleet.rates.position))
        findings.extend(radio_findings(fleet, plan.vehicles if plan else len(fleet.vehicles)))
        return CheckReport(
            tuple(audits), tuple(links), tuple(changed), tuple(findings), order, poses,
            self._sender(),
        )  # fmt: skip

    def _sender(self) -> str:
        """Return what process sends the poses, in words; "" where none is known."""
        source = self.survey.poses
        if isinstance(source, Borrowed):
            return source.words
        mocap = self.options.mocap
        return f"this check sends the poses ({mocap}): they end with it" if mocap else ""

    def _poses(self) -> tuple[PoseRow, ...]:
        """Return what the vehicles get from motion capture, where it is known."""
        source, listener = self.survey.poses, self.listener
        if source is None:
            return ()
        bodies = source.bodies(listener.now)
        return pose_rows(listener.received, bodies, listener.now, positions=True)


def _enabled_fences(audits: Sequence[VehicleAudit]) -> dict[int, dict[str, float]]:
    """Return the parameters by which each ArduPilot watches the polygon of its fence."""
    return {
        audit.system: {
            "FENCE_ENABLE": 1.0,
            "FENCE_TYPE": float(int(audit.parameters["FENCE_TYPE"]) | _POLYGON),
        }
        for audit in audits
        if "FENCE_TYPE" in audit.parameters
    }


def _fences_before(
    audits: Sequence[VehicleAudit], folder: Path
) -> dict[int, tuple[FenceItem, ...]]:
    """Return the saved fences that differ from the present ones, by system id."""
    before = {}
    for audit in audits:
        path = folder / "fences" / f"{audit.system}.json"
        if path.exists():
            document = parse_json(read_bytes(path, LARGEST_FILE), str(path))
            try:
                items = tuple(
                    FenceItem(**(item | {"parameters": tuple(item["parameters"])}))
                    for item in document
                )
            except (TypeError, KeyError):
                raise InputError(
                    [Problem(str(path), "expected the saved fence of an earlier check")]
                ) from None
            if not same_fence(items, audit.fence or ()):
                before[audit.system] = items
    return before


def _changed_since(audits: Sequence[VehicleAudit], folder: Path) -> dict[int, dict[str, float]]:
    """Return the saved values of the parameters that differ from them, by system id."""
    return {
        audit.system: {
            name: value
            for name, value in _saved(folder, audit.system).items()
            if name in audit.parameters and abs(audit.parameters[name] - value) > 1e-6
        }
        for audit in audits
    }


def _saved(folder: Path, system: int) -> Mapping[str, float]:
    """Return the parameters of a vehicle that an earlier check has saved."""
    path = folder / "parameters" / f"{system}.json"
    with suppress(InputError, TypeError, ValueError, OverflowError):
        document = parse_json(read_bytes(path, LARGEST_FILE), str(path))
        if isinstance(document, dict):
            return {str(name): float(value) for name, value in document.items()}
    raise InputError([Problem(str(path), "expected the saved parameters of an earlier check")])
