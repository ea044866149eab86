"""The vehicles before arming: parameters by our own protocol, the rest in words through MAVSDK.

Each vehicle's parameters are fetched once, all vehicles side by side; what is set counts when it
has been read back. Both happen on the links that the loop keeps; this is the blocking part, for a
thread of its own.
"""

import json
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from swarm.certification.findings import Finding
from swarm.errors import VehicleError
from swarm.flight.parameters import Demands, Row, judge, rules
from swarm.ground.commissioning.mavsdk_client import Report, reports
from swarm.ground.relay import Relay
from swarm.mavlink.frames import AutopilotName
from swarm.mavlink.vehicle import Vehicle

BATTERY_RESERVE = 25.0
"""Percent of a battery that must be left when all vehicles have landed."""
_LONGEST = 300.0
"""Seconds that fetching or setting may take, however slow the link."""
_POLL = 0.05
_FIRMWARE = {"px4": "PX4", "ardupilot": "ArduPilot"}

Tell = Callable[[str, float], None]
"""Is told what is being done, in words, and the share of it that is done."""


@dataclass(frozen=True)
class VehicleAudit:
    """What one vehicle said of itself before arming.

    ``wrong`` and ``good`` are rows of the parameter table; ``parameters`` everything it has;
    ``problems`` what keeps it from arming, in its own words.
    """

    system: int
    firmware: str
    health: Mapping[str, bool]
    battery: float
    satellites: int
    problems: tuple[str, ...]
    parameters: Mapping[str, float]
    wrong: tuple[Row, ...]
    good: tuple[Row, ...]

    def findings(self, battery: float = 0.0) -> Iterator[Finding]:
        """Yield what is to be said of it; ``battery`` is the percentage that the flight takes."""
        name = f"system {self.system}"
        yield Finding("info", "firmware", f"{name}: {self.firmware}")
        bad = ", ".join(what for what, fine in self.health.items() if not fine)
        for problem in self.problems:
            yield Finding("warning", "health", f"{name}: {problem}")
        if bad:
            yield Finding("warning", "health", f"{name}: not healthy: {bad}")
        elif not self.problems:
            yield Finding("info", "health", f"{name}: healthy and armable")
        yield self._battery(name, battery)
        for row in self.wrong:
            yield Finding(row.severity, "parameters", row.message)
        if not self.wrong:
            yield Finding("info", "parameters", f"{name}: all {len(self.good)} as they should be")

    def _battery(self, name: str, needed: float) -> Finding:
        if not self.battery >= 0.0:
            return Finding("warning", "battery", f"{name}: says nothing of its battery")
        words = f"{name}: {self.battery:.0f} %"
        if self.battery < needed + BATTERY_RESERVE:
            words += f"; the flight takes {needed:.0f} % and {BATTERY_RESERVE:.0f} % must be left"
            return Finding("error", "battery", words)
        return Finding("info", "battery", words)


@dataclass
class Auditor:
    """Asks a team of vehicles on the ground, through the links of a relay's team.

    ``names`` tell the autopilot of each vehicle that is asked. Blocking, so not for the loop's
    thread. Raises :class:`VehicleError` that names all vehicles which do not answer.
    """

    relay: Relay
    names: Mapping[int, AutopilotName]
    demands: Demands
    tell: Tell = lambda *_: None
    _reports: dict[int, Report] = field(default_factory=dict)

    def audit(self) -> list[VehicleAudit]:
        """Fetch all parameters, and ask MAVSDK for the rest; all vehicles at the same time."""
        vehicles = self._vehicles()
        for vehicle in vehicles.values():
            vehicle.parameters.fetch()
        self._until_done("parameters", lambda: _fetched(vehicles.values()))
        problems = [
            f"system {system}: {vehicle.parameters.problem}"
            for system, vehicle in vehicles.items()
            if vehicle.parameters.problem
        ]
        if problems:
            raise VehicleError("\n".join(problems))
        self._ask_mavsdk()
        return [self._judged(system) for system in vehicles]

    def fix(self, rows: Sequence[Row]) -> list[str]:
        """Set the parameters of rows that are wrong; return what was changed, in words."""
        wanted: dict[int, dict[str, float]] = {}
        for row in rows:
            if row.value is not None:
                wanted.setdefault(row.system, {})[row.name] = row.should
        return self.set(wanted)

    def set(self, wanted: Mapping[int, Mapping[str, float]]) -> list[str]:
        """Set parameters of each system and read them back; return what was changed, in words.

        Raises :class:`VehicleError` that names those which are not what they were set to.
        """
        vehicles = {system: self.relay.team.vehicles[system] for system in wanted}
        before = {system: dict(vehicle.parameters.values) for system, vehicle in vehicles.items()}
        for system, vehicle in vehicles.items():
            vehicle.parameters.set(wanted[system])
        number = sum(len(values) for values in wanted.values())
        self._until_done("setting parameters", lambda: _set(vehicles.values(), number))
        problems = [
            f"system {system}: {refusal.name} was set to {refusal.requested:g}, "
            + (
                "and nothing came back"
                if refusal.reported is None
                else f"and is {refusal.reported:g}"
            )
            for system, vehicle in vehicles.items()
            for refusal in vehicle.parameters.failed
        ]
        if problems:
            raise VehicleError("\n".join(problems))
        return [
            f"system {system}: {name} {before[system][name]:g} → {value:g}"
            for system, values in wanted.items()
            for name, value in values.items()
        ]

    def judged_again(self, audits: Sequence[VehicleAudit]) -> list[VehicleAudit]:
        """Return audits by what the parameters are now; nothing is asked again."""
        return [
            replace(audit, parameters=again.parameters, wrong=again.wrong, good=again.good)
            for audit, again in ((one, self._judged(one.system)) for one in audits)
        ]

    def _vehicles(self) -> dict[int, Vehicle]:
        return {system: self.relay.team.vehicles[system] for system in sorted(self.names)}

    def _ask_mavsdk(self) -> None:
        """Have MAVSDK say what it knows of every vehicle."""
        ports = {system: self.relay.ports[system] for system in sorted(self.names)}
        what, told = "health and firmware", [0]
        self.tell(what, 0.0)

        def one_more(_: int) -> None:
            told[0] += 1
            self.tell(f"{what}: {told[0]} of {len(ports)} vehicles", told[0] / len(ports))

        self._reports = reports(ports, one_more)

    def _judged(self, system: int) -> VehicleAudit:
        report, name = self._reports[system], self.names[system]
        values = dict(self.relay.team.vehicles[system].parameters.values)
        wrong, good = judge(system, values, rules(name, self.demands))
        number = report.firmware
        return VehicleAudit(
            system=system,
            firmware=f"{_FIRMWARE[name]} {number}" if number else f"{name}, version unknown",
            health=report.health,
            battery=report.battery,
            satellites=report.satellites,
            problems=report.problems,
            parameters=values,
            wrong=tuple(wrong),
            good=tuple(good),
        )

    def _until_done(self, what: str, progress: Callable[[], tuple[int, int]]) -> None:
        """Wait until all that is fetched or set has come, telling how much has."""
        pause, deadline = threading.Event(), time.monotonic() + _LONGEST
        vehicles = self._vehicles().values()
        while any(vehicle.parameters.busy for vehicle in vehicles):
            done, of = progress()
            if of:
                self.tell(f"{what}: {done} of {of}", done / of)
            if time.monotonic() > deadline:
                slow = [v.system for v in vehicles if v.parameters.busy]
                names = ", ".join(str(system) for system in slow)
                raise VehicleError(f"{what} of system {names}: not done in {_LONGEST:g} s")
            pause.wait(_POLL)


def _fetched(vehicles: Iterable[Vehicle]) -> tuple[int, int]:
    known = [vehicle.parameters for vehicle in vehicles]
    return sum(one.received for one in known), sum(one.total for one in known)


def _set(vehicles: Iterable[Vehicle], number: int) -> tuple[int, int]:
    return number - sum(vehicle.parameters.pending for vehicle in vehicles), number


def save_parameters(folder: Path, audits: Sequence[VehicleAudit]) -> None:
    """Keep all vehicles' parameters below a folder, one file per vehicle."""
    below = folder / "parameters"
    below.mkdir(parents=True, exist_ok=True)
    for audit in audits:
        text = json.dumps(dict(sorted(audit.parameters.items())), indent=1)
        (below / f"{audit.system}.json").write_text(text, encoding="utf-8")
