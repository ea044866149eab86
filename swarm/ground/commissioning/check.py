"""``swarm check``: what the vehicles say of themselves before anything is armed."""

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from swarm.certification.certificate import CertifiedPlan
from swarm.certification.findings import Finding, Severity
from swarm.errors import InputError, Problem, Refused, VehicleError
from swarm.flight.listening import LinkQuality, Listening, radio_findings
from swarm.flight.parameters import (
    STREAM_LOSS_TIME,
    Demands,
    Row,
    demands_of,
    demands_of_plan,
    stream_loss_findings,
    stream_loss_model,
)
from swarm.flight.preparation import GATHERING, Prepared
from swarm.ground.commissioning.audit import Auditor, Tell, VehicleAudit, save_parameters
from swarm.ground.commissioning.survey import Survey, attended
from swarm.mission import Vehicles
from swarm.mission.fleet import Fleet
from swarm.planning import Plan

_SETTLE = 2.5
"""Seconds after the first heartbeats until streams run as they were asked for."""
_STEADY = 5.0
"""Seconds that a vehicle which has run for long is given to say that it is ready."""
_HOLD_PATIENCE = 15.0

SUBJECTS = {
    "plan": "plan",
    "fleet": "vehicles on the links",
    "firmware": "firmware",
    "ready": "ready to arm",
    "health": "health and arming",
    "battery": "battery",
    "position": "position quality",
    "parameters": "parameters",
    "placement": "positions against pads",
    "origin": "origins",
    "clock": "clocks and delays",
    "hold": "Hold, tried",
    "link": "links",
    "radio": "what fits the radios",
    "hop": "hover in a hop",
}
"""The go/no-go list: checks of findings, in order, and what they are called."""


@dataclass(frozen=True)
class Item:
    """One line of the go/no-go list; ``words`` say what was found."""

    check: str
    subject: str
    go: bool
    words: str


@dataclass(frozen=True)
class CheckReport:
    """What the check found: per vehicle, per link, and what it changed.

    ``order`` are the system ids in order along the cable; empty without a plan.
    """

    vehicles: tuple[VehicleAudit, ...]
    links: tuple[LinkQuality, ...]
    changed: tuple[str, ...]
    findings: tuple[Finding, ...]
    order: tuple[int, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether nothing is an error."""
        return all(finding.severity != "error" for finding in self.findings)

    def items(self) -> list[Item]:
        """Return the go/no-go list: one line for everything that was looked at."""
        found = []
        for check, subject in SUBJECTS.items():
            said = [finding for finding in self.findings if finding.check == check]
            if said:
                found.append(Item(check, subject, *_verdict(said)))
        return found

    def having(self, *findings: Finding) -> "CheckReport":
        """Return the report with more findings."""
        return replace(self, findings=(*self.findings, *findings))


def _verdict(said: Sequence[Finding]) -> tuple[bool, str]:
    counts = {
        level: sum(finding.severity == level for finding in said) for level in ("error", "warning")
    }
    worst: Severity = "error" if counts["error"] else "warning" if counts["warning"] else "info"
    first = next(finding for finding in said if finding.severity == worst)
    number = counts.get(worst, 0)
    if worst == "info":
        return True, said[0].message if len(said) == 1 else f"{len(said)} looked at, all well"
    more = f" (and {number - 1} more)" if number > 1 else ""
    return worst != "error", ("" if worst == "error" else "warning: ") + first.message + more


Asked = Callable[[Sequence[Row]], bool]


@dataclass(frozen=True)
class Wanted:
    """What a check shall do beside looking.

    ``soak`` measures the links for so many seconds. ``fix`` is shown the rows that are wrong and
    says whether to set them; ``restore`` is a folder of an earlier check or flight whose
    parameters are put back; ``tell`` is told what is being done, from another thread.
    """

    soak: float = 0.0
    fix: Asked | None = None
    restore: Path | None = None
    tell: Tell = lambda *_: None


def check(
    fleet: Fleet,
    folder: Path,
    flight_plan: CertifiedPlan | None = None,
    wanted: Wanted | None = None,
) -> CheckReport:
    """Check a fleet on the ground; parameters are saved in ``folder`` before anything is changed.

    With a plan the vehicles are judged by what it asks and stand against its pads.

    Raises :class:`VehicleError` where links or vehicles are missing, and :class:`Refused` where
    the fleet is too small for the plan or one system id is two vehicles, of which nothing is asked.
    """
    if flight_plan is not None and len(fleet.vehicles) < flight_plan.plan.vehicles:
        raise Refused(
            f"the plan needs {flight_plan.plan.vehicles} vehicles, the fleet {fleet.name} "
            f"has {len(fleet.vehicles)}"
        )
    restore = (wanted or Wanted()).restore
    if restore is not None:
        for system in fleet.systems:
            _saved(restore, system)
    plan = flight_plan.plan if flight_plan else None
    with attended(fleet, folder, plan) as attendance:
        return attendance.run(_Work(attendance, folder, plan, wanted or Wanted()).run)


@dataclass
class _Work:
    """The blocking part, in a thread of its own beside the loop."""

    attendance: Survey
    folder: Path
    plan: Plan | None
    wanted: Wanted

    def run(self) -> CheckReport:
        self._hear()
        names = {
            vehicle.system: vehicle.autopilot.name
            for vehicle in self.listening.heard
            if vehicle.autopilot is not None
        }
        auditor = Auditor(self.attendance.relay, names, self._demands(), self.wanted.tell)
        audits = auditor.audit()
        self.attendance.relay.closed = True
        save_parameters(self.folder, audits)
        changed: list[str] = []
        if self.wanted.restore is not None:
            changed += auditor.set(_saved_otherwise(audits, self.wanted.restore))
            audits = auditor.judged_again(audits)
        wrong = [row for audit in audits for row in audit.wrong if row.value is not None]
        if wrong and self.wanted.fix is not None and self.wanted.fix(wrong):
            changed += auditor.fix(wrong)
            audits = auditor.judged_again(audits)
        standing, order = self._standing()
        hold = self._hold()
        links = self._soak()
        return self._report(audits, links, changed, [*standing, *hold], order)

    @property
    def listening(self) -> Listening:
        """Who is heard, and what of."""
        return self.attendance.listening

    def _demands(self) -> Demands:
        fleet = self.listening.fleet
        return demands_of_plan(self.plan, fleet) if self.plan else demands_of(Vehicles(), fleet)

    def _hear(self) -> None:
        """Wait until all vehicles are heard and their streams run."""
        fleet = self.listening.fleet
        self.wanted.tell(f"listening to {fleet.name}", 0.0)
        missing = self.attendance.hear(self._tell_heard)
        if missing:
            names = ", ".join(f"system {system}" for system in missing)
            raise VehicleError(f"not heard: {names}")
        self.attendance.wait(_SETTLE)
        self._tell_heard()

    def _tell_heard(self) -> None:
        """Tell how many vehicles are heard; refuse to ask more where one id is two vehicles."""
        if self.listening.team.conflicts():
            self.attendance.wait(GATHERING)
            if conflicts := self.listening.team.conflicts():
                raise Refused("\n".join(finding.message for finding in conflicts))
        heard, of = len(self.listening.heard), len(self.listening.fleet.vehicles)
        self.wanted.tell(f"heard {heard} of {of} vehicles", heard / of)

    def _standing(self) -> tuple[list[Finding], tuple[int, ...]]:
        """Wait until vehicles are ready; tell why not, and where they stand.

        A vehicle gets the fleet's ``limits.ready`` from its own start: one that has run for longer
        will not become ready by waiting.
        """
        listening = self.listening
        self.wanted.tell("waiting until all are ready to arm", 0.0)
        ready = listening.fleet.limits.ready
        self.attendance.until(lambda: not listening.not_ready(), _STEADY)
        youngest = min((vehicle.boot_ms / 1000.0 for vehicle in listening.heard), default=ready)
        self.attendance.until(lambda: not listening.not_ready(), ready - youngest)
        findings = [replace(finding, check="ready") for finding in listening.not_ready()]
        if not findings:
            words = f"{len(listening.heard)} vehicles are ready"
            findings.append(Finding("info", "ready", words))
        if self.plan is None:
            return findings, ()
        lift = np.array([0.0, 0.0, self.plan.mission.vehicles.grip_offset])
        stood = listening.stand(self.plan.motion.at(0.0)[0] + lift)
        if isinstance(stood, Prepared):
            return [*findings, *stood.audit.findings], stood.audit.systems
        return [*findings, stood], ()

    def _hold(self) -> list[Finding]:
        """Try Hold on everybody; on ArduPilot that is Brake."""
        listening = self.listening
        self.wanted.tell("trying Hold", 0.0)
        listening.try_hold()
        self.attendance.until(lambda: listening.holds is not None, _HOLD_PATIENCE)
        findings = []
        for vehicle in listening.heard:
            words = (listening.holds or {}).get(vehicle.system, "no answer")
            text = f"system {vehicle.system}: " + (words or "took it and came back")
            if words:
                text += "; a failsafe that should hold would land or descend instead"
            severity: Severity = "info"
            if words:
                severity = "warning" if listening.fleet.frame == "shared" else "error"
            findings.append(Finding(severity, "hold", text))
        return findings

    def _soak(self) -> Sequence[LinkQuality]:
        if self.wanted.soak <= 0.0:
            return ()
        self.wanted.tell(f"measuring the links for {self.wanted.soak:g} s", 0.0)
        self.listening.begin_soak()
        self.attendance.wait(self.wanted.soak)
        return self.listening.soak()

    def _report(
        self,
        audits: Sequence[VehicleAudit],
        links: Sequence[LinkQuality],
        changed: Sequence[str],
        said: Sequence[Finding],
        order: tuple[int, ...],
    ) -> CheckReport:
        fleet, plan = self.listening.fleet, self.plan
        battery = 100.0 * plan.duration / plan.mission.vehicles.endurance if plan else 0.0
        findings = [
            Finding("info", "fleet", f"{len(self.listening.heard)} vehicles of {fleet.name} heard"),
            *self.listening.team.findings(),
            *said,
        ]
        for audit in audits:
            findings.extend(audit.findings(battery))
        if plan is not None and order:
            values = {audit.system: audit.parameters for audit in audits}
            names = {v.system: v.autopilot.name for v in self.listening.heard if v.autopilot}
            flown = [(names[system], values[system]) for system in order if system in values]
            findings.extend(stream_loss_findings(plan, stream_loss_model(flown, fleet.limits))[1])
        findings.extend(self.listening.frames_and_clocks())
        for link in links:
            findings.extend(link.findings(STREAM_LOSS_TIME, fleet.rates.position))
        findings.extend(radio_findings(fleet, plan.vehicles if plan else len(fleet.vehicles)))
        return CheckReport(tuple(audits), tuple(links), tuple(changed), tuple(findings), order)


def _saved_otherwise(audits: Sequence[VehicleAudit], folder: Path) -> dict[int, dict[str, float]]:
    """Return which parameters of which system are other than they were saved, as saved."""
    return {
        audit.system: {
            name: value
            for name, value in _saved(folder, audit.system).items()
            if name in audit.parameters and abs(audit.parameters[name] - value) > 1e-6
        }
        for audit in audits
    }


def _saved(folder: Path, system: int) -> Mapping[str, float]:
    """Return the parameters of a vehicle as an earlier check saved them."""
    path = folder / "parameters" / f"{system}.json"
    with suppress(ValueError, OSError):
        document = json.loads(path.read_text())
        if isinstance(document, dict):
            return {str(name): float(value) for name, value in document.items()}
    raise InputError([Problem(str(path), "expected the parameters that an earlier check saved")])
