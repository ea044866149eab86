"""``swarm check``: what the vehicles say of themselves before anything is armed."""

import json
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from swarm.errors import InputError, Problem, SwarmError, VehicleError
from swarm.fleet import Fleet
from swarm.flight.listening import LinkQuality, Listening
from swarm.flight.parameters import STREAM_LOSS_TIME, Row
from swarm.flight.world import bare_world
from swarm.ground.audit import Auditor, VehicleAudit
from swarm.ground.emulator import EmulatorProcess
from swarm.ground.loop import Loop
from swarm.ground.relay import Relay
from swarm.ground.sockets import open_links
from swarm.mission import Vehicles
from swarm.preflight.findings import Finding

_LISTEN = 0.1
_SETTLE = 2.5
"""Seconds after the first heartbeats until streams run as they were asked for."""


@dataclass(frozen=True)
class CheckReport:
    """What the check found: per vehicle, per link, and what it changed."""

    vehicles: tuple[VehicleAudit, ...]
    links: tuple[LinkQuality, ...]
    changed: tuple[str, ...]
    findings: tuple[Finding, ...]

    @property
    def passed(self) -> bool:
        """Whether nothing is an error."""
        return all(finding.severity != "error" for finding in self.findings)


def check(
    fleet: Fleet,
    folder: Path,
    *,
    vehicles: Vehicles | None = None,
    soak: float = 0.0,
    fix: Callable[[Sequence[Row]], bool] | None = None,
    restore: Path | None = None,
) -> CheckReport:
    """Check a fleet on the ground; parameters are saved in ``folder`` before anything is changed.

    ``vehicles`` are the mission's demands (defaults without). ``soak`` measures the links for so
    many seconds. ``fix`` is shown the rows that are wrong and says whether to set them;
    ``restore`` is a folder of an earlier check whose parameters are put back.

    Raises :class:`VehicleError` where links or vehicles are missing.
    """
    links = open_links(fleet.links)
    emulator: EmulatorProcess | None = None
    listening = Listening(fleet)
    relay = Relay(listening.team)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if fleet.emulated is not None:
            port = links.port(next(iter(fleet.links)))
            emulator = EmulatorProcess(bare_world(fleet), folder, port, 1.0)
        loop = Loop(listening, links, None, 1.0, lambda _: None, relay)
        work = _Work(listening, relay, folder, vehicles or Vehicles(), soak, fix, restore)
        thread = threading.Thread(target=work.run, name="audit")
        thread.start()
        loop.run()
        thread.join()
        if work.error is not None:
            raise work.error
        if work.report is None:
            raise VehicleError("the check ended without a report")
        return work.report
    except OSError as error:
        raise InputError([Problem(str(folder), str(error.strerror or error))]) from None
    finally:
        listening.over = True
        relay.close()
        if emulator is not None:
            emulator.stop()
        links.close()


class _Work:
    """The blocking part, in a thread of its own beside the loop."""

    def __init__(
        self,
        listening: Listening,
        relay: Relay,
        folder: Path,
        vehicles: Vehicles,
        soak: float,
        fix: Callable[[Sequence[Row]], bool] | None,
        restore: Path | None,
    ) -> None:
        self._listening, self._relay, self._folder = listening, relay, folder
        self._vehicles, self._soak, self._fix, self._restore = vehicles, soak, fix, restore
        self._pause = threading.Event()
        self.report: CheckReport | None = None
        self.error: Exception | None = None

    def run(self) -> None:
        try:
            self.report = self._run()
        except (SwarmError, OSError) as error:
            self.error = error
        finally:
            self._listening.over = True

    def _run(self) -> CheckReport:
        self._hear()
        names = {
            system: vehicle.autopilot.name
            for system, vehicle in self._listening.team.vehicles.items()
            if vehicle.autopilot is not None
        }
        links: Sequence[LinkQuality] = ()
        if self._soak > 0.0:
            self._pause.wait(_SETTLE)
            self._listening.begin_soak()
            self._pause.wait(self._soak)
            links = self._listening.soak()
        with Auditor(self._relay.ports, names, self._vehicles).connected() as auditor:
            audits = auditor.audit()
            self._save(audits)
            changed: list[str] = []
            if self._restore is not None:
                changed += self._put_back(auditor, audits)
            wrong = [row for audit in audits for row in audit.wrong if row.value is not None]
            if wrong and self._fix is not None and self._fix(wrong):
                changed += auditor.fix(wrong)
            if changed:
                audits = auditor.audit()
        return self._report(audits, links, changed)

    def _hear(self) -> None:
        waited = 0.0
        limit = self._listening.fleet.limits.ready
        while self._listening.missing:
            if waited > limit:
                missing = ", ".join(f"system {s}" for s in self._listening.missing)
                raise VehicleError(f"not heard: {missing}")
            self._pause.wait(_LISTEN)
            waited += _LISTEN

    def _save(self, audits: Sequence[VehicleAudit]) -> None:
        folder = self._folder / "parameters"
        folder.mkdir(exist_ok=True)
        for audit in audits:
            path = folder / f"{audit.system}.json"
            path.write_text(json.dumps(dict(sorted(audit.parameters.items())), indent=1))

    def _put_back(self, auditor: Auditor, audits: Sequence[VehicleAudit]) -> list[str]:
        changed = []
        for audit in audits:
            saved = _saved(self._restore or self._folder, audit.system)
            different = {
                name: value
                for name, value in saved.items()
                if name in audit.parameters and abs(audit.parameters[name] - value) > 1e-6
            }
            auditor.restore(audit.system, different)
            changed += [
                f"system {audit.system}: {name} {audit.parameters[name]:g} → {value:g}"
                for name, value in different.items()
            ]
        return changed

    def _report(
        self,
        audits: Sequence[VehicleAudit],
        links: Sequence[LinkQuality],
        changed: Sequence[str],
    ) -> CheckReport:
        findings = [finding for audit in audits for finding in audit.findings()]
        for link in links:
            findings.extend(link.findings(STREAM_LOSS_TIME))
        findings.extend(
            Finding("warning", "fleet", f"system {system} is heard and not in the fleet file")
            for system in self._listening.team.strangers
        )
        return CheckReport(tuple(audits), tuple(links), tuple(changed), tuple(findings))


def _saved(folder: Path, system: int) -> Mapping[str, float]:
    """Return the parameters of a vehicle as an earlier check saved them."""
    path = folder / "parameters" / f"{system}.json"
    with suppress(ValueError, OSError):
        document = json.loads(path.read_text())
        if isinstance(document, dict):
            return {str(name): float(value) for name, value in document.items()}
    raise InputError([Problem(str(path), "expected the parameters that an earlier check saved")])
