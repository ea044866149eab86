"""Lockstep with real autopilots over sockets on loopback: time advances for all together."""

import select
import time
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sitl.emulator import Emulator
from sitl.physics.dynamics import STEP
from sitl.physics.rigid import MOTORS
from sitl.physics.rigid_bodies import SUBSTEPS, RigidBodies

Array = NDArray[np.float64]

_PATIENCE = 1.0
"""Seconds of real time that the world waits for an autopilot; then its outputs stay as they are."""


class Port(Protocol):
    """One autopilot's connection and its latest outputs.

    ``row`` is that of its rigid body; ``command`` (4,) are its motors between 0 and 1; ``fresh``:
    they answer the latest sensor values; ``silent``: none came in time, because it has not booted
    or its process has ended, so the world does not wait for it; ``ended``: none will come.
    """

    row: int
    fresh: bool
    silent: bool
    ended: bool
    command: Array

    def fileno(self) -> int:
        """Return the descriptor to wait at."""

    def receive(self) -> None:
        """Take what has come."""

    def answer(self, at: float, state: Array, measured: Array) -> None:
        """Send what the vehicle measures at ``at`` seconds, if it is expected."""

    def end(self) -> None:
        """Note that the process has ended: its outputs are off."""

    def grip(self) -> bool | None:
        """Return whether the gripper shall close (True) or open (False); None: stay."""

    def close(self) -> None:
        """Close the sockets."""


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
            left = deadline - time.monotonic()
            ready = self._poll.poll(1000.0 * max(left, 0.0) if missing else 0.0)
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
            if left <= 0.0:
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
