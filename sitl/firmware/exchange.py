"""Lockstep with real ArduPilot processes over UDP on loopback: time advances for all together."""

import select
import socket
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.emulator import Emulator
from sitl.firmware import ardupilot_json
from sitl.physics.dynamics import STEP
from sitl.physics.rigid import MOTORS
from sitl.physics.rigid_bodies import SUBSTEPS, RigidBodies

Array = NDArray[np.float64]

_IDLE, _SPAN = 1000.0, 1000.0
"""Pulse width without thrust, and from there to full thrust, microseconds."""
_CLOSED, _OPEN = 1700, 1300
"""Pulse widths of the gripper's output above which it closes, and below which it opens."""
_GRIPPER = 8
"""Index of the gripper's output: SERVO9."""
_PATIENCE = 1.0
"""Seconds of real time that the world waits for an autopilot; then its outputs stay as they are."""
_LARGEST = 256


@dataclass
class Port:
    """One autopilot's connection: its latest outputs, and whether they are not answered yet."""

    socket: socket.socket
    row: int
    peer: tuple[str, int] | None = None
    frame: int = -1
    waiting: bool = False
    pulses: tuple[int, ...] = (0,) * 16
    silent: bool = True
    """No packet within `_PATIENCE`: before it has booted, or after its process has ended."""


class Exchange:
    """The sockets of all vehicles with ArduPilot firmware; `advance` takes a world one step on."""

    def __init__(self, emulator: Emulator, outside: RigidBodies, instances: Sequence[int]) -> None:
        self.emulator, self.outside = emulator, outside
        self.ports: list[Port] = []
        self._poll = select.poll()
        self._command = np.zeros((len(instances), MOTORS))
        for row, instance in enumerate(instances):
            sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            sock.setblocking(False)
            sock.bind(("127.0.0.1", ardupilot_json.PORT + ardupilot_json.PORT_STEP * instance))
            self.ports.append(Port(sock, row))
            self._poll.register(sock, select.POLLIN)
        self._by_descriptor = {port.socket.fileno(): port for port in self.ports}

    def advance(self, now: float) -> None:
        """Advance the world and all autopilots to ``now``, seconds of emulated time."""
        emulator = self.emulator
        while emulator.time + STEP <= now + 1e-9:
            for k in range(SUBSTEPS):
                self._collect()
                emulator.advance_outside(self._command, k * STEP / SUBSTEPS)
                self._answer(emulator.time + (k + 1) * STEP / SUBSTEPS)
            emulator.advance(emulator.time + STEP)
            self._move_grippers()

    def _collect(self) -> None:
        """Wait until every autopilot that runs has sent its outputs."""
        deadline = time.monotonic() + _PATIENCE
        missing = sum(not port.waiting and not port.silent for port in self.ports)
        while True:
            left = deadline - time.monotonic()
            ready = self._poll.poll(1000.0 * max(left, 0.0) if missing else 0.0)
            for descriptor, _ in ready:
                port = self._by_descriptor[descriptor]
                expected = not port.waiting and not port.silent
                if self._receive(port):
                    missing -= expected
            if missing <= 0:
                return
            if left <= 0.0:
                for port in self.ports:
                    port.silent = not port.waiting
                return

    def _receive(self, port: Port) -> bool:
        """Take one packet of an autopilot; return whether it has new outputs."""
        try:
            data, port.peer = port.socket.recvfrom(_LARGEST)
        except (BlockingIOError, ConnectionError):
            return False
        servos = ardupilot_json.parse(data)
        if servos is None:
            return False
        port.frame, port.pulses = servos.frame, servos.pulses
        port.waiting, port.silent = True, False
        self._command[port.row] = (np.array(servos.pulses[:MOTORS]) - _IDLE) / _SPAN
        return True

    def _answer(self, at: float) -> None:
        for port in self.ports:
            if port.waiting and port.peer is not None:
                row = port.row
                data = ardupilot_json.answer(
                    at, self.outside.state[row], self.outside.measured[row]
                )
                port.socket.sendto(data, port.peer)
                port.waiting = False

    def _move_grippers(self) -> None:
        """Close and open grippers as the autopilots' outputs say."""
        for port in self.ports:
            gripper = self.emulator.vehicles[int(self.outside.rows[port.row])].gripper
            pulse = port.pulses[_GRIPPER]
            if gripper.installed and pulse:
                if pulse > _CLOSED and not gripper.gripped:
                    gripper.move(True)
                elif pulse < _OPEN and gripper.gripped:
                    gripper.move(False)

    def close(self) -> None:
        """Close every socket."""
        for port in self.ports:
            port.socket.close()
