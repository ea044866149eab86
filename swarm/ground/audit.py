"""The vehicles before arming, asked through MAVSDK: firmware, health in words, parameters.

The library speaks through the relay's loopback endpoints; it has its own threads and wall-clock
timers, and is gone before anything is armed.
"""

import json
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from mavsdk import Configuration, Mavsdk, log_subscribe
from mavsdk.exceptions import MavsdkError
from mavsdk.plugins.events import Events
from mavsdk.plugins.info import Info
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import Telemetry

from swarm.errors import VehicleError
from swarm.flight.parameters import Demands, Row, judge, rules
from swarm.mavlink.frames import Projection
from swarm.mavlink.packets import GROUND_COMPONENT, GROUND_SYSTEM
from swarm.preflight.findings import Finding

DISCOVERY = 10.0
"""Seconds within which every vehicle must be discovered."""
HEALTH = 5.0
BATTERY_RESERVE = 25.0
"""Percent of a battery that must be left when everybody has landed."""
_POLL = 0.05


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
    """Asks a team of vehicles; ``ports`` are loopback UDP ports by system id.

    ``names`` tell each vehicle's autopilot. Used as a context; blocking, so not for the flight's
    thread.
    """

    ports: Mapping[int, int]
    names: Mapping[int, Projection]
    demands: Demands
    _systems: dict[int, Any] = field(default_factory=dict)

    @contextmanager
    def connected(self) -> Iterator["Auditor"]:
        """Discover the vehicles; raises :class:`VehicleError` that names those not found."""
        with discovered(self.ports) as found:
            self._systems = found
            yield self
            self._systems = {}

    def audit(self) -> list[VehicleAudit]:
        """Ask all vehicles, at the same time."""
        with ThreadPoolExecutor(len(self.ports)) as pool:
            return list(pool.map(self._one, sorted(self.ports)))

    def fix(self, rows: Sequence[Row]) -> list[str]:
        """Set the parameters of rows that are wrong; return what was changed, in words."""
        changed = []
        for row in rows:
            if row.value is not None:
                self._set(row.system, {row.name: row.should})
                changed.append(f"system {row.system}: {row.name} {row.value:g} → {row.should:g}")
        return changed

    def restore(self, system: int, values: Mapping[str, float]) -> None:
        """Set parameters back to saved values."""
        self._set(system, values)

    def _set(self, system: int, values: Mapping[str, float]) -> None:
        param = Param(self._systems[system])
        everything = param.get_all_params()
        whole = {one.name for one in everything.int_params}
        for name, value in values.items():
            try:
                if name in whole:
                    param.set_param_int(name, round(value))
                else:
                    param.set_param_float(name, float(value))
            except MavsdkError as error:
                raise VehicleError(f"system {system}: {name} cannot be set: {error}") from None

    def _one(self, system: int) -> VehicleAudit:
        handle = self._systems[system]
        telemetry = Telemetry(handle)
        _wait(telemetry.health_all_ok, HEALTH)
        try:
            everything = Param(handle).get_all_params()
        except MavsdkError as error:
            raise VehicleError(f"system {system}: parameters cannot be read: {error}") from None
        values = {
            one.name: float(one.value) for one in (*everything.int_params, *everything.float_params)
        }
        name = self.names[system]
        wrong, good = judge(system, values, rules(name, self.demands))
        health = telemetry.health()
        return VehicleAudit(
            system=system,
            firmware=_firmware(handle, name),
            health={
                "gyroscope": health.is_gyrometer_calibration_ok,
                "accelerometer": health.is_accelerometer_calibration_ok,
                "magnetometer": health.is_magnetometer_calibration_ok,
                "local position": health.is_local_position_ok,
                "global position": health.is_global_position_ok,
                "home position": health.is_home_position_ok,
                "armable": health.is_armable,
            },
            battery=float(telemetry.battery().remaining_percent),
            satellites=int(telemetry.gps_info().num_satellites),
            problems=_arming_problems(handle),
            parameters=values,
            wrong=tuple(wrong),
            good=tuple(good),
        )


@contextmanager
def discovered(ports: Mapping[int, int]) -> Iterator[dict[int, Any]]:
    """Give the library's handles of the vehicles behind loopback ports, by system id.

    Raises :class:`VehicleError` that names those not found.
    """
    _quiet()
    configuration = Configuration.create_manual(GROUND_SYSTEM, GROUND_COMPONENT, False)
    with Mavsdk(configuration) as mavsdk:
        for port in ports.values():
            mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        found: dict[int, Any] = {}

        def everybody() -> bool:
            found.update({s.get_system_id(): s for s in mavsdk.get_systems()})
            return found.keys() >= ports.keys()

        if not _wait(everybody, DISCOVERY):
            missing = ", ".join(str(s) for s in sorted(ports.keys() - found.keys()))
            raise VehicleError(f"not found by MAVSDK: system {missing}")
        yield found


@cache
def _quiet() -> None:
    """Keep the library's log off the terminal; once, since it frees what it was given before."""
    log_subscribe(lambda *_: True)


def save_parameters(folder: Path, audits: Sequence[VehicleAudit]) -> None:
    """Keep everybody's parameters below a folder, one file per vehicle."""
    below = folder / "parameters"
    below.mkdir(parents=True, exist_ok=True)
    for audit in audits:
        text = json.dumps(dict(sorted(audit.parameters.items())), indent=1)
        (below / f"{audit.system}.json").write_text(text, encoding="utf-8")


def _firmware(handle: Any, name: str) -> str:
    with suppress(MavsdkError):
        version = Info(handle).get_version()
        number = f"{version.flight_sw_major}.{version.flight_sw_minor}.{version.flight_sw_patch}"
        return f"{'ArduPilot' if name == 'ardupilot' else 'PX4'} {number}"
    return f"{name}, version unknown"


def _arming_problems(handle: Any) -> tuple[str, ...]:
    """What PX4's health and arming checks complain of; other firmware has no such report."""
    with suppress(MavsdkError):
        report = Events(handle).get_health_and_arming_checks_report()
        return tuple(
            f"{problem.message}{': ' + problem.description if problem.description else ''}"
            for problem in report.all_problems
        )
    return ()


def _wait(condition: Callable[[], bool], seconds: float) -> bool:
    deadline = time.monotonic() + seconds
    pause = threading.Event()
    while not condition():
        if time.monotonic() >= deadline:
            return False
        pause.wait(_POLL)
    return True
