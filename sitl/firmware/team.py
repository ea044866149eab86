"""Start and end real autopilots together with the world that is their physics, in lockstep."""

import contextlib
import errno
import math
import select
import socket
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from sitl.emulator import Emulator
from sitl.firmware import ardupilot
from sitl.firmware.processes import (
    Firmware,
    FirmwareError,
    Launch,
    Need,
    Port,
    Positioning,
    Processes,
    Start,
)  # fmt: skip
from sitl.firmware.px4 import Px4Port, connect_all, launch_px4
from sitl.firmware.sensors import SensorFaults
from sitl.physics.dynamics import STEP
from sitl.physics.rigid_bodies import MOTORS, SUBSTEPS, RigidBodies
from sitl.protocol.vehicle import Vehicle

_PATIENCE = 1.0
"""Seconds of real time that the world waits for an autopilot; then its outputs stay as they are."""


class Exchange:
    """The connections of all vehicles with real firmware; `advance` takes the world on."""

    def __init__(
        self,
        emulator: Emulator,
        outside: RigidBodies,
        ports: Sequence[Port],
        ended: Callable[[], Sequence[int]] = tuple,
    ) -> None:
        """``ended`` returns the numbers of the ports whose processes have ended."""
        self.emulator, self.outside = emulator, outside
        self.ports = ports
        self._ended = ended
        self._poll = select.poll()
        self._command = np.zeros((len(ports), MOTORS))
        for port in ports:
            self._poll.register(port.fileno(), select.POLLIN)
        self._by_descriptor = {port.fileno(): port for port in ports}

    def advance(self, now: float) -> None:
        """Advance the world and all autopilots to ``now``, seconds of emulated time."""
        emulator = self.emulator
        while emulator.time + STEP <= now + 1e-9:
            for k in range(SUBSTEPS):
                self._collect()
                emulator.advance_outside(self._command, k * STEP / SUBSTEPS)
                at = emulator.time + (k + 1) * STEP / SUBSTEPS
                for port in self.ports:
                    row = port.row
                    port.answer(at, self.outside.state[row], self.outside.measured[row])
            emulator.advance(emulator.time + STEP)
            self._move_grippers()

    def _collect(self) -> None:
        """Wait until every autopilot that runs has sent its outputs."""
        deadline = time.monotonic() + _PATIENCE
        missing = sum(not port.fresh and not port.silent for port in self.ports)
        while True:
            timeout = deadline - time.monotonic()
            ready = self._poll.poll(1000.0 * max(timeout, 0.0) if missing else 0.0)
            for descriptor, _ in ready:
                port = self._by_descriptor[descriptor]
                expected = not port.fresh and not port.silent
                port.receive()
                missing -= expected and (port.fresh or port.silent)
                self._command[port.row] = port.command
                if port.ended:
                    self._poll.unregister(descriptor)
            if missing <= 0:
                return
            if timeout <= 0.0:
                for port in self.ports:
                    port.silent = not port.fresh
                for number in self._ended():
                    self._stop(self.ports[number])
                return

    def _stop(self, port: Port) -> None:
        """Turn off the outputs of an autopilot whose process has ended."""
        port.end()
        self._command[port.row] = port.command

    def _move_grippers(self) -> None:
        """Close and open grippers as the autopilots' outputs say."""
        for port in self.ports:
            gripper = self.emulator.vehicles[int(self.outside.rows[port.row])].gripper
            closed = port.grip() if gripper.installed else None
            if closed is not None and closed != (gripper.gripped or gripper.closed):
                gripper.move(closed)
                # jaws that missed the cable stay closed without it
                gripper.closed = closed and not gripper.gripped

    def close(self) -> None:
        """Close every socket."""
        for port in self.ports:
            port.close()


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
        flown = [vehicle for vehicle in emulator.vehicles if vehicle.system in firmware]
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
        return ardupilot.ArduPilotPort(row, ardupilot.physics_port(start), scale)
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
        return ardupilot.launch(start, emulator.world.origin)
    return launch_px4(start, vehicle.spec.radius)


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
