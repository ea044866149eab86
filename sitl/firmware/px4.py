"""One PX4 process: its command, environment, parameters and simulator link on a TCP socket.

Motor outputs come in, sensor values go out.

Source: PX4 user guide, "Simulation", and MAVLink's HIL messages. The simulator listens on TCP, PX4
connects; the time of each HIL_SENSOR is PX4's time from then on, and each HIL_ACTUATOR_CONTROLS
carries the time of the sensor values that it answers. Here NED and FRD; inside ENU and FLU.
"""

import math
import os
import socket
import struct
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from fastcrc import crc16

from sitl.firmware import processes, sensors
from sitl.firmware.processes import PX4_PROGRAM, Launch, Need, Start
from sitl.firmware.sensors import Fix, SensorFaults
from sitl.physics.dynamics import STEP, Array
from sitl.physics.geodesy import Geodesy
from sitl.physics.rigid_bodies import MOTORS, SUBSTEPS, in_body
from sitl.protocol import wire

PORT = 4560
"""TCP port of instance 0's simulator; instance i connects to the i-th after it."""

_IMU, _SLOW = 0b111111, 0b1101111000000
"""Bits of HIL_SENSOR's updated fields: accelerometer and gyroscope; magnetometer and barometer."""
_SENSOR = wire.template(
    "HIL_SENSOR",
    "time_usec xacc yacc zacc xgyro ygyro zgyro xmag ymag zmag abs_pressure pressure_alt "
    "temperature fields_updated",
)
_GPS = wire.template(
    "HIL_GPS",
    "time_usec lat lon alt eph epv vel vn ve vd cog fix_type",
    satellites_visible=16,  # as an open sky gives
)
_CONTROLS = wire.LAYOUTS["HIL_ACTUATOR_CONTROLS"]
_HEAD, _CHECKSUM = 10, 2
_ARMED = 128


class Outputs(NamedTuple):
    """Outputs of the autopilot: microseconds of the sensor values they answer, and 16 values.

    Motors are between 0 and 1, other outputs between -1 and 1; all are 0 unless ``armed``.
    """

    time: int
    controls: tuple[float, ...]
    armed: bool


def sensor(
    sender: wire.Sender, microseconds: int, inertial: Array, slow: tuple[float, ...] | None
) -> bytes:
    """Return HIL_SENSOR.

    ``inertial`` (6,) are specific force (m/s²) and rates (rad/s) in FLU. ``slow`` is what has a
    new value less often: the magnetic field (gauss, FLU), pressure (hPa), the altitude (m) and the
    temperature (°C) that belong to it.
    """
    x, y, z, p, q, r = inertial.tolist()
    ahead, left, up, pressure, altitude, temperature = slow or (0.0,) * 6
    body = _SENSOR(
        microseconds, x, -y, -z, p, -q, -r, ahead, -left, -up, pressure, altitude, temperature,
        _IMU if slow is None else _IMU | _SLOW,
    )  # fmt: skip
    return sender.frame(wire.NUMBERS["HIL_SENSOR"], body, wire.LAYOUTS["HIL_SENSOR"].seed)


def receiver(sender: wire.Sender, microseconds: int, fix: Fix) -> bytes:
    """Return HIL_GPS: the fix of a satellite receiver."""
    east, north, up = fix.velocity
    level = math.hypot(east, north)
    course = math.degrees(math.atan2(east, north)) % 360.0
    body = _GPS(
        microseconds, round(fix.latitude * 1e7), round(fix.longitude * 1e7),
        round(fix.altitude * 1e3), round(100.0 * fix.level_error), round(100.0 * fix.height_error),
        round(100.0 * level), round(100.0 * north), round(100.0 * east), round(-100.0 * up),
        round(100.0 * course) % 36000, fix.kind,
    )  # fmt: skip
    return sender.frame(wire.NUMBERS["HIL_GPS"], body, wire.LAYOUTS["HIL_GPS"].seed)


class Stream:
    """The bytes of PX4's end of the link, which come in pieces of any size."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> Outputs | None:
        """Return the latest outputs that ``data`` completes; None without any."""
        buffer = self._buffer + data
        latest = None
        start = 0
        while True:
            start = buffer.find(wire.MAGIC, start)
            if start < 0:
                self._buffer = b""
                return latest
            if len(buffer) < start + _HEAD:
                break
            end = start + _HEAD + buffer[start + 1] + _CHECKSUM
            if len(buffer) < end:
                break
            if int.from_bytes(buffer[start + 7 : start + 10], "little") != _CONTROLS.number:
                start = end
                continue
            outputs = _outputs(buffer[start:end])
            latest = outputs or latest
            start = end if outputs else start + 1
        self._buffer = buffer[start:]
        return latest


def _outputs(frame: bytes) -> Outputs | None:
    """Return the outputs in a frame of HIL_ACTUATOR_CONTROLS; None if its checksum is wrong."""
    if crc16.mcrf4xx(frame[1:-2] + _CONTROLS.seed) != int.from_bytes(frame[-2:], "little"):
        return None
    layout: struct.Struct = _CONTROLS.struct
    time, _, *controls, mode = layout.unpack(
        frame[_HEAD:-2][: layout.size].ljust(layout.size, b"\0")
    )
    return Outputs(time, tuple(controls), bool(mode & _ARMED))


_AIRFRAME = "10016"
"""PX4's quadrotor X whose physics come through the simulator link (``none_iris``)."""
_LOCAL = 14580
"""UDP port of instance 0's link to a ground station; instance i uses the i-th after it."""
_OWN = (18570, _LOCAL, 14280, 13030)
"""UDP ports of instance 0's links by its own startup script."""

_PARAMETERS: dict[str, float] = {
    "IMU_INTEG_RATE": 200,  # the rate of the sensor values
    "THR_MDL_FAC": 0.65,  # the curve of `sitl.physics.rigid_bodies`
    "MPC_THR_HOVER": 0.39,  # weight over full thrust of the default vehicle
    # Tuned for the default vehicle, as every real one must be: see ArduPilot's.
    "MC_ROLL_P": 8,
    "MC_PITCH_P": 8,
    "MC_ROLLRATE_P": 0.33,
    "MC_PITCHRATE_P": 0.33,
    "MC_ROLLRATE_I": 1.0,
    "MC_PITCHRATE_I": 1.0,
    "MC_ROLLRATE_D": 0.006,
    "MC_PITCHRATE_D": 0.006,
    "MC_RR_INT_LIM": 0.5,
    "MC_PR_INT_LIM": 0.5,
    # Stiff enough for a cable: with PX4's defaults (0.95, 1.8, 0.4, 1, 4, 2) nine were up to 0.17 m
    # low as they lifted it, and 0.09 m behind on a circle of 1 m at 0.5 m/s (0.05 m with these).
    "MPC_XY_P": 1.5,
    "MPC_XY_VEL_P_ACC": 3.5,
    "MPC_XY_VEL_I_ACC": 1.5,
    "MPC_Z_P": 1.5,
    "MPC_Z_VEL_P_ACC": 8,
    "MPC_Z_VEL_I_ACC": 3,
    "SIM_BAT_DRAIN": 900,  # seconds, as the emulated vehicles
    "SDLOG_MODE": -1,  # no log: in SITL it has the whole estimator at 100 Hz, 20 MB a minute
}
_GRIPPER_PARAMETERS: dict[str, float] = {
    "PD_GRIPPER_TYPE": 0,
    "PD_GRIPPER_TO": 1,
    "PWM_MAIN_FUNC5": 430,
}
"""A gripper on output 5, which has moved after a second."""


def launch_px4(start: Start, radius: float) -> Launch:
    """Return the process of one PX4; ``radius`` is that of the vehicle's disc in metres.

    PX4's instance is the system id less one. Variables ``PX4_PARAM_…`` set parameters before its
    startup script sets its own defaults; the file ``px4-rc.mavlink``, which PX4 finds by its path
    as the user's own choice of links, sets those of the flight after that: a value that was equal
    to the first default would follow the second (COM_LOW_BAT_ACT: 0, then 3).
    """
    build, instance = start.binary, start.instance
    values = (
        _PARAMETERS
        | processes.position_parameters("px4", start.positioning, start.capture)
        | _rotors(radius)
        | (_GRIPPER_PARAMETERS if start.gripper else {})
    )
    return Launch(
        [str(build / PX4_PROGRAM), "-d", "-i", str(instance), str(build / "etc")],
        start.folder,
        {"px4-rc.mavlink": _links(start)},
        [
            Need("TCP", PORT + instance, "127.0.0.1"),
            *(Need("UDP", at + instance) for at in (_OWN if start.target is None else [_LOCAL])),
        ],
        {
            "PX4_SIM_MODEL": "none_iris",
            "PX4_SYS_AUTOSTART": _AIRFRAME,
            "PATH": f"{start.folder.absolute()}:{os.environ.get('PATH', os.defpath)}",
            **{f"PX4_PARAM_{name}": f"{value:g}" for name, value in values.items()},
        },
    )


def _links(start: Start) -> str:
    """Return the script that sets the flight's parameters and starts the MAVLink links."""
    lines = [f"param set {name} {value:g}" for name, value in start.parameters.items()]
    if start.target is None:
        lines.append(". etc/init.d-posix/px4-rc.mavlink")
    else:
        host, _, port = start.target.rpartition(":")
        local = _LOCAL + start.instance
        lines.append(f"mavlink start -x -u {local} -r 4000000 -f -m onboard -o {port} -t {host}")
    return "\n".join(lines) + "\n"


def _rotors(radius: float) -> dict[str, float]:
    """Return the places of the motors of `sitl.physics.rigid_bodies`, metres forward and right."""
    arm = 0.7 * radius * math.sqrt(0.5)
    places = ((arm, arm), (-arm, -arm), (arm, -arm), (-arm, arm))
    return {
        f"CA_ROTOR{i}_P{axis}": value
        for i, place in enumerate(places)
        for axis, value in zip("XY", place, strict=True)
    }


INTERVAL = 2 * STEP / SUBSTEPS
"""Seconds between sensor values: 200 Hz. PX4's own simulators have 250 Hz; at 400 Hz nine need
twice the processor time, and hover no better."""
_SLOW_EVERY = 4
"""Magnetometer and barometer have a new value with every fourth message: 50 Hz."""
_START = 1_000_000
"""PX4's time at the world's time zero, microseconds; zero is no time for it."""
_GRIPPER, _HALF = 4, 0.5
"""Index of the gripper's output (PWM_MAIN_FUNC5), and the value beyond which it is an end."""
_LARGEST = 65536


class Px4Port(processes.Port):
    """One PX4's connection and its latest outputs.

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
        super().__init__(row)
        self._faults = faults
        self._outputs = Outputs(0, (0.0,) * 16, armed=False)
        self._geodesy, self._rng = geodesy, rng
        self._field = sensors.magnetic_field(geodesy.latitude, geodesy.longitude, geodesy.altitude)
        self._sender, self._stream = wire.Sender(instance + 1), Stream()
        self._sent = self._count = 0
        self._next_fix = 0.0 if receiver else math.inf
        self._due = 0.0
        self._listener = socket.create_server(("127.0.0.1", PORT + instance))
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
        slow = self._slow(state) if self._count % _SLOW_EVERY == 0 else None
        self._count += 1
        data = sensor(self._sender, self._sent, inertial, slow)
        if at >= self._next_fix:
            self._next_fix = at + sensors.RTK.interval - 1e-9
            noise = self._rng.standard_normal(6)
            faults = self._faults()
            place = state[0:3] + faults.offset
            fix = sensors.fix(sensors.RTK, self._geodesy, place, state[3:6], noise)
            if not faults.receiver:
                fix = fix._replace(kind=sensors.NO_FIX)
            data = receiver(self._sender, self._sent, fix) + data
        self.fresh = False
        try:
            self._socket.send(data)
        except OSError:
            self.silent = True

    def _slow(self, state: Array) -> tuple[float, ...]:
        """Return magnetic field, pressure, altitude and temperature with noise."""
        field = in_body(state[6:10], self._field)
        noise = self._rng.standard_normal(4)
        field += sensors.MAGNETIC_NOISE * noise[:3]
        pressure, temperature = sensors.air(
            self._geodesy.altitude + float(state[2]) + self._faults().barometer
        )
        pressure += sensors.PRESSURE_NOISE * float(noise[3])
        return *field.tolist(), pressure, sensors.pressure_altitude(pressure), temperature

    def end(self) -> None:
        """Note that the process has ended: motors stop, and the gripper stays as it is."""
        super().end()
        self._outputs = Outputs(0, (0.0,) * 16, armed=False)

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
