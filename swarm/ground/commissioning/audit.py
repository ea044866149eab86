"""Audit of vehicles before arming: parameters by our own protocol, health and firmware by MAVSDK.

The parameters of all vehicles are fetched once, at the same time; a changed parameter counts as set
once it has been read back. The loop keeps the links meanwhile: the audit blocks, so it runs in a
thread of its own.
"""

import json
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from swarm.certification.findings import Finding, Severity
from swarm.errors import VehicleError
from swarm.flight.parameters import ParameterResult, Requirements, evaluate, rules
from swarm.flight.readiness import mission_fence
from swarm.ground.commissioning.mavsdk_client import VehicleReport, vehicle_reports
from swarm.ground.relay import Relay
from swarm.mavlink.fence import FenceItem, same_fence
from swarm.mavlink.frames import AutopilotName
from swarm.mavlink.vehicle import Vehicle
from swarm.mission.fleet import Fleet
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

    ``names`` are the system ids of the vehicles, with their autopilots. All methods block, so they
    must not run in the loop's thread. They raise :class:`VehicleError` with the names of all
    vehicles that do not respond.
    """

    relay: Relay
    names: Mapping[int, AutopilotName]
    demands: Requirements
    progress: ProgressCallback = lambda *_: None
    _reports: dict[int, VehicleReport] = field(default_factory=dict)

    def audit(self) -> list[VehicleAudit]:
        """Fetch all parameters and fences, then the reports of MAVSDK, for all vehicles at once."""
        vehicles = self._vehicles()
        for vehicle in vehicles.values():
            vehicle.parameters.fetch()
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
            health=report.health,
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
    return sum(one.received for one in parameters), sum(one.total for one in parameters)


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
    for audit in (one for one in audits if not one.unread):
        text = json.dumps(dict(sorted(audit.parameters.items())), indent=1)
        (below / f"{audit.system}.json").write_text(text, encoding="utf-8")
    fences = folder / "fences"
    fences.mkdir(exist_ok=True)
    for audit in (audit for audit in audits if audit.fence is not None):
        text = json.dumps([item._asdict() for item in audit.fence or ()], indent=1)
        (fences / f"{audit.system}.json").write_text(text, encoding="utf-8")
