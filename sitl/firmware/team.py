"""Start and end real autopilots together with the world that is their physics."""

import contextlib
import errno
import math
import socket
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from sitl.emulator import Emulator
from sitl.firmware import process, px4_process
from sitl.firmware.ardupilot_port import ArduPilotPort
from sitl.firmware.exchange import Exchange, Port
from sitl.firmware.positioning import Positioning
from sitl.firmware.process import Launch, Need, Processes, Start
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
    firmware. Raises `OSError` for sockets and files, `FirmwareError` if ports are taken or a PX4
    does not connect.
    """
    if not firmware or emulator.outside is None:
        yield None
        return
    with contextlib.ExitStack() as stack:
        if folder is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="firmware")))
        ports: list[Port] = []
        flown = [one for one in emulator.vehicles if one.system in firmware]
        starts = [
            Start(
                binary=firmware[vehicle.system].program,
                folder=folder / f"vehicle{vehicle.system}",
                instance=vehicle.system - 1,  # PX4 derives its system id from it
                system=vehicle.system,
                heading=math.degrees(vehicle.spec.heading) % 360.0,
                gripper=vehicle.gripper.installed,
                parameters=vehicle.spec.parameters,
                target=target,
                radio=vehicle.spec.radio,
                positioning=positioning,
                capture=emulator.world.capture,
            )
            for vehicle in flown
        ]
        launches = [_launch(emulator, *each) for each in zip(flown, starts, strict=True)]
        _require_free(flown, launches)
        for row, (vehicle, start) in enumerate(zip(flown, starts, strict=True)):
            port = _port(emulator, vehicle, row, start)
            stack.callback(port.close)
            ports.append(port)
        processes = Processes(launches)
        stack.callback(processes.stop)
        _connect(ports, flown, processes, folder)
        yield Exchange(emulator, emulator.outside, ports, processes.ended)


def _require_free(flown: Sequence[Vehicle], launches: Sequence[Launch]) -> None:
    """Raise `FirmwareError` with all ports that the processes need and other programs have."""
    taken = [
        f"{need.protocol} {need.port} (vehicle {vehicle.system})"
        for vehicle, launch in zip(flown, launches, strict=True)
        for need in launch.needs
        if _taken(need)
    ]
    if taken:
        raise FirmwareError(f"--firmware: other programs have the ports {', '.join(taken)}")


def _taken(need: Need) -> bool:
    tcp = need.protocol == "TCP"
    with socket.socket(type=socket.SOCK_STREAM if tcp else socket.SOCK_DGRAM) as probe:
        # as our listener has it: the connection of an earlier flight may still be closing
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, tcp)
        try:
            probe.bind((need.host, need.port))
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            return True
    return False


def _port(emulator: Emulator, vehicle: Vehicle, row: int, start: Start) -> Port:
    """Open the socket of a vehicle's autopilot."""
    if vehicle.spec.autopilot == "ardupilot":
        scale = emulator.environment.geodesy.scale(vehicle.spec.autopilot)
        return ArduPilotPort(row, start.physics, scale)
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
