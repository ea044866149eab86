"""The connection to one PX4 process: its simulator link on a TCP socket of loopback."""

import math
import socket
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sitl.firmware import px4_hil, sensors
from sitl.firmware.sensors import SensorFaults
from sitl.physics.dynamics import STEP
from sitl.physics.geodesy import Geodesy
from sitl.physics.rigid import MOTORS
from sitl.physics.rigid_bodies import SUBSTEPS
from sitl.protocol import wire

Array = NDArray[np.float64]

INTERVAL = 2 * STEP / SUBSTEPS
"""Seconds between sensor values: 200 Hz. PX4's own simulators have 250 Hz; at 400 Hz nine need
twice the processor time, and hover no better."""
_SLOW = 4
"""Magnetometer and barometer have a new value with every fourth message: 50 Hz."""
_START = 1_000_000
"""PX4's time at the world's time zero, microseconds; zero is no time for it."""
_GRIPPER, _HALF = 4, 0.5
"""Index of the gripper's output (PWM_MAIN_FUNC5), and the value beyond which it is an end."""
_LARGEST = 65536


class Px4Port:
    """One autopilot's connection and its latest outputs; a `sitl.firmware.exchange.Port`.

    ``silent``: PX4 has not answered in time, or has not started its outputs yet. It gets sensor
    values all the same, because its time stands still without them.
    """

    def __init__(
        self,
        row: int,
        instance: int,
        geodesy: Geodesy,
        rng: np.random.Generator,
        faults: Callable[[], SensorFaults] = SensorFaults,
        *,
        receiver: bool = True,
    ) -> None:
        """Listen for the ``instance``; raises `OSError` if its port is taken.

        ``faults`` returns what is wrong with the vehicle's sensors now; without ``receiver`` it has
        none for satellites.
        """
        self.row = row
        self._faults = faults
        self.fresh, self.silent, self.ended = False, True, False
        self.command = np.zeros(MOTORS)
        self._outputs = px4_hil.Outputs(0, (0.0,) * 16, armed=False)
        self._geodesy, self._rng = geodesy, rng
        self._field = sensors.magnetic_field(geodesy.latitude, geodesy.longitude, geodesy.altitude)
        self._sender, self._stream = wire.Sender(instance + 1), px4_hil.Stream()
        self._sent = self._count = 0
        self._next_fix = 0.0 if receiver else math.inf
        self._due = 0.0
        self._listener = socket.create_server(("127.0.0.1", px4_hil.PORT + instance))
        self._socket: socket.socket | None = None

    def connect(self, timeout: float) -> bool:
        """Wait ``timeout`` seconds for PX4's connection; return whether it is there."""
        self._listener.settimeout(timeout)
        try:
            self._socket, _ = self._listener.accept()
        except TimeoutError:
            return False
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(False)
        return True

    def fileno(self) -> int:
        """Return the descriptor to wait at."""
        return (self._socket or self._listener).fileno()

    def receive(self) -> None:
        """Take what has come; it is fresh if it answers the latest sensor values."""
        if self._socket is None:
            return
        try:
            data = self._socket.recv(_LARGEST)
        except BlockingIOError:
            return
        except ConnectionError:
            data = b""
        if not data:
            self.end()
            return
        outputs = self._stream.feed(data)
        if outputs is None:
            return
        self._outputs = outputs
        self.command = np.array(outputs.controls[:MOTORS])
        self.fresh = outputs.time >= self._sent
        if self.fresh:
            self.silent = False

    def answer(self, at: float, state: Array, measured: Array) -> None:
        """Send the sensor values at ``at`` seconds, if it is time for them."""
        if (
            self._socket is None
            or self.ended
            or at < self._due - 1e-9
            or not (self.fresh or self.silent)
        ):
            return
        self._due = at + INTERVAL
        self._sent = _START + round(1e6 * at)
        inertial = np.concatenate([measured, state[10:13]])
        inertial += sensors.INERTIAL_NOISE * self._rng.standard_normal(6)
        slow = self._slow(state) if self._count % _SLOW == 0 else None
        self._count += 1
        data = px4_hil.sensor(self._sender, self._sent, inertial, slow)
        if at >= self._next_fix:
            self._next_fix = at + sensors.RTK.interval - 1e-9
            noise = self._rng.standard_normal(6)
            faults = self._faults()
            place = state[0:3] + faults.offset
            fix = sensors.fix(sensors.RTK, self._geodesy, place, state[3:6], noise)
            if not faults.receiver:
                fix = fix._replace(kind=sensors.NO_FIX)
            data = px4_hil.receiver(self._sender, self._sent, fix) + data
        self.fresh = False
        try:
            self._socket.send(data)
        except OSError:
            self.silent = True

    def _slow(self, state: Array) -> tuple[float, ...]:
        """Return magnetic field, pressure, altitude and temperature with noise."""
        field = sensors.in_body(state[6:10], self._field)
        noise = self._rng.standard_normal(4)
        field += sensors.MAGNETIC_NOISE * noise[:3]
        pressure, temperature = sensors.air(
            self._geodesy.altitude + float(state[2]) + self._faults().barometer
        )
        pressure += sensors.PRESSURE_NOISE * float(noise[3])
        return *field.tolist(), pressure, sensors.pressure_altitude(pressure), temperature

    def end(self) -> None:
        """Note that the process has ended: motors stop, and the gripper stays as it is."""
        self.ended = self.silent = True
        self.command = np.zeros(MOTORS)
        self._outputs = px4_hil.Outputs(0, (0.0,) * 16, armed=False)

    def grip(self) -> bool | None:
        """Return whether the gripper's output closes it; None between closed and open.

        Outputs are 0 until PX4 is armed.
        """
        value = self._outputs.controls[_GRIPPER]
        return value > 0.0 if abs(value) > _HALF else None

    def close(self) -> None:
        """Close the sockets."""
        self._listener.close()
        if self._socket is not None:
            self._socket.close()


def connect_all(ports: list[Px4Port], timeout: float, alive: Callable[[], bool]) -> list[Px4Port]:
    """Wait until every PX4 has connected; return the ports of those that have not."""
    missing = list(ports)
    waited, interval = 0.0, 0.1
    while missing and waited < timeout and alive():
        if missing[0].connect(interval):
            missing.pop(0)
        else:
            waited += interval
    return missing
