"""Start and end real autopilots together with the world that is their physics."""

import contextlib
import dataclasses
import math
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from sitl.emulator import Emulator
from sitl.firmware import process, px4_process
from sitl.firmware.ardupilot_port import ArduPilotPort
from sitl.firmware.exchange import Exchange, Port
from sitl.firmware.positioning import Positioning
from sitl.firmware.process import Launch, Processes, Start
from sitl.firmware.px4_port import Px4Port, connect_all
from sitl.firmware.selection import Firmware, FirmwareError
from sitl.firmware.sensors import SensorFaults
from sitl.protocol.vehicle import Vehicle

_BOOT_TIMEOUT = 60.0
"""Seconds until each PX4 must have connected; it takes 0.2 s on an idle machine."""


@contextlib.contextmanager
def flying(
    emulator: Emulator,
    firmware: Mapping[int, Firmware],
    target: str | None,
    folder: Path | None,
    positioning: Positioning = "rtk",
) -> Iterator[Exchange | None]:
    """Run the autopilots of the vehicles in ``firmware`` until the context ends.

    They send to the UDP address ``target``, without one as in the autopilots' own simulators.
    ``folder`` keeps their parameters and logs; without it they are deleted. Yields None without any
    firmware. Raises `OSError` for sockets and files, `FirmwareError` if a PX4 does not connect.
    """
    if not firmware or emulator.outside is None:
        yield None
        return
    with contextlib.ExitStack() as stack:
        if folder is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="firmware")))
        ports: list[Port] = []
        launches = []
        flown = [one for one in emulator.vehicles if one.system in firmware]
        for row, vehicle in enumerate(flown):
            kind = firmware[vehicle.system].kind
            # PX4 derives its system id from its instance
            instance = vehicle.system - 1 if kind == "px4" else row
            start = _start(vehicle, firmware[vehicle.system], instance, target, folder)
            start = dataclasses.replace(
                start, positioning=positioning, capture=emulator.world.capture
            )
            port = _port(emulator, vehicle, row, start)
            stack.callback(port.close)
            ports.append(port)
            launches.append(_launch(emulator, vehicle, start))
        processes = Processes(launches)
        stack.callback(processes.stop)
        _connect(ports, flown, processes, folder)
        yield Exchange(emulator, emulator.outside, ports, processes.ended)


def _start(
    vehicle: Vehicle, firmware: Firmware, instance: int, target: str | None, folder: Path
) -> Start:
    return Start(
        binary=firmware.program,
        folder=folder / f"vehicle{vehicle.system}",
        instance=instance,
        system=vehicle.system,
        heading=math.degrees(vehicle.spec.heading) % 360.0,
        gripper=vehicle.gripper.installed,
        parameters=vehicle.spec.parameters,
        target=target,
    )


def _port(emulator: Emulator, vehicle: Vehicle, row: int, start: Start) -> Port:
    """Open the socket of a vehicle's autopilot."""
    if vehicle.spec.autopilot == "ardupilot":
        return ArduPilotPort(row, start.instance)
    rng = np.random.default_rng([emulator.world.seed, vehicle.system])
    receiver = start.positioning != "mocap"
    geodesy, faults = emulator.environment.geodesy, _faults_of(vehicle)
    return Px4Port(row, start.instance, geodesy, rng, faults, receiver=receiver)


def _faults_of(vehicle: Vehicle) -> Callable[[], SensorFaults]:
    """Return a function of what the world's faults have done to a vehicle's sensors."""
    bias = vehicle.bodies.bias[vehicle.index]
    before = bias.copy()

    def faults() -> SensorFaults:
        offset = (bias - before).tolist()
        # a barometer's drift is in both
        offset[2] -= vehicle.barometer
        return SensorFaults(vehicle.global_valid, tuple(offset), vehicle.barometer)

    return faults


def _launch(emulator: Emulator, vehicle: Vehicle, start: Start) -> Launch:
    if vehicle.spec.autopilot == "ardupilot":
        return process.launch(start, emulator.world.origin)
    return px4_process.launch(start, vehicle.spec.radius)


def _connect(ports: list[Port], flown: list[Vehicle], processes: Processes, folder: Path) -> None:
    """Wait for the connections of all PX4; raise `FirmwareError` if one does not come."""
    waiting = [port for port in ports if isinstance(port, Px4Port)]
    missing = connect_all(waiting, _BOOT_TIMEOUT, lambda: not processes.ended())
    if missing:
        system = flown[missing[0].row].system
        raise FirmwareError(
            f"PX4 of vehicle {system} did not connect to its simulator; its output is in "
            f"{folder / f'vehicle{system}' / 'log.txt'}"
        )
