"""One ArduPilot process: its command, parameters and JSON interface on a UDP socket of loopback.

Motor outputs come in, sensor values go out.

Source: ArduPilot, ``libraries/SITL/examples/JSON/readme.md``: the autopilot sends a binary packet
of servo outputs, and advances its time by that of the answer. Here NED and FRD; inside ENU and FLU.
"""

import math
import socket
import struct
from typing import NamedTuple

import numpy as np

from sitl.firmware.processes import Launch, Need, Port, Start, position_parameters
from sitl.physics.dynamics import Array
from sitl.physics.rigid_bodies import MOTORS
from sitl.world import Origin

_PARAMETERS: dict[str, float] = {
    "FRAME_CLASS": 1,  # quadrotor
    "FRAME_TYPE": 1,  # X
    "SIM_RATE_HZ": 400,  # the rate of `sitl.physics.rigid_bodies`
    "SCHED_LOOP_RATE": 200,  # arming requires 1.8 samples of the gyroscopes per loop
    # Tuned for the default vehicle, as every real one must be. A pull at the end of a stiff dropper
    # turns the vehicle into the pull and so drives it away from there: with ArduCopter's default
    # gains (4.5, 0.135, 0.135) nine of them turned over as soon as they lifted the cable.
    "ATC_ANG_RLL_P": 8,
    "ATC_ANG_PIT_P": 8,
    "ATC_RAT_RLL_P": 0.33,
    "ATC_RAT_PIT_P": 0.33,
    "ATC_RAT_RLL_I": 1.0,
    "ATC_RAT_PIT_I": 1.0,
    "ATC_RAT_RLL_D": 0.006,
    "ATC_RAT_PIT_D": 0.006,
    # ArduPilot takes no force as feed-forward: its integrator resists the cable. With the default
    # gains (1, 2, 1, 0.25) a pull that grows by 0.14 N/s moves one vehicle by 0.08 m, and it is
    # 0.09 m off on a circle of 1.5 m at 1 m/s; with these, 0.02 and 0.04 m.
    "PSC_POSXY_P": 2,
    "PSC_VELXY_P": 4,
    "PSC_VELXY_I": 2,
    "PSC_VELXY_D": 0.5,
    "MOT_THST_HOVER": 0.39,  # weight over full thrust of the default vehicle
    "MOT_SPIN_MIN": 0.0,  # the simulated motors have no dead band
    "MOT_SPIN_ARM": 0.0,
    "COMPASS_OFS_X": 5,  # the simulated compass's offsets: it counts as calibrated with them
    "COMPASS_OFS_Y": 13,
    "COMPASS_OFS_Z": -18,
    "COMPASS_OFS2_X": 5,
    "COMPASS_OFS2_Y": 13,
    "COMPASS_OFS2_Z": -18,
    "COMPASS_OFS3_X": 5,
    "COMPASS_OFS3_Y": 13,
    "COMPASS_OFS3_Z": -18,
    "INS_ACCOFFS_X": 0.001,  # not zero: the accelerometers count as calibrated
    "INS_ACCOFFS_Y": 0.001,
    "INS_ACCOFFS_Z": 0.001,
    "INS_ACC2OFFS_X": 0.001,
    "INS_ACC2OFFS_Y": 0.001,
    "INS_ACC2OFFS_Z": 0.001,
    "INS_ACCSCAL_X": 1.001,
    "INS_ACCSCAL_Y": 1.001,
    "INS_ACCSCAL_Z": 1.001,
    "INS_ACC2SCAL_X": 1.001,
    "INS_ACC2SCAL_Y": 1.001,
    "INS_ACC2SCAL_Z": 1.001,
    "BATT_MONITOR": 4,  # voltage and current
    "SIM_BARO_RND": 0,
}
_GROUND = "127.0.0.1:14550"
"""Where ground stations listen."""
_RADIO = 5501
"""UDP port of instance 0's radio; ArduPilot opens it on all interfaces."""
_GRIPPER_PARAMETERS: dict[str, float] = {"GRIP_ENABLE": 1, "GRIP_TYPE": 1, "SERVO9_FUNCTION": 28}
"""A gripper on output 9."""


def command(start: Start, origin: Origin) -> list[str]:
    """Return the command line of one autopilot; its home is the origin of the world.

    ArduPilot listens for more ground stations and for a radio on all interfaces. Here it has one
    serial port, and without ``radio`` its radio has the port of the physics, which is taken.
    """
    radio = _radio(start) if start.radio else physics_port(start)
    home = f"{origin.latitude:.7f},{origin.longitude:.7f},{origin.altitude:.2f},{start.heading:.1f}"
    return [
        str(start.binary), "--model", "JSON:127.0.0.1", f"-I{start.instance}",
        "--sysid", str(start.system), "--home", home, "--speedup", "1",
        "--serial0", f"udpclient:{start.target or _GROUND}", "--serial1", "none:",
        "--serial2", "none:", "--rc-in-port", str(radio),
        "--defaults", "defaults.parm",
    ]  # fmt: skip


def _radio(start: Start) -> int:
    return _RADIO + PORT_STEP * start.instance


def physics_port(start: Start) -> int:
    """Return the UDP port on loopback of the physics."""
    return PORT + PORT_STEP * start.instance


def parameters(start: Start) -> str:
    """Return the text of the file of default parameters."""
    values = _PARAMETERS | position_parameters("ardupilot", start.positioning, start.capture)
    values |= (_GRIPPER_PARAMETERS if start.gripper else {}) | dict(start.parameters)
    if not start.radio:
        values["FS_THR_ENABLE"] = 0  # otherwise it does not arm without a radio
    return "".join(f"{name} {value:g}\n" for name, value in values.items())


def launch(start: Start, origin: Origin) -> Launch:
    """Return the process of one ArduPilot."""
    needs = [Need("UDP", physics_port(start), "127.0.0.1")]
    if start.radio:
        needs.append(Need("UDP", _radio(start)))
    return Launch(command(start, origin), start.folder, {"defaults.parm": parameters(start)}, needs)


PORT, PORT_STEP = 9002, 10
"""UDP port of the first instance's physics, and the distance to the next one's."""

_SIXTEEN, _THIRTY_TWO = struct.Struct("<HHI16H"), struct.Struct("<HHI32H")
_MAGIC = {18458: _SIXTEEN, 29569: _THIRTY_TWO}
_HALF = math.sqrt(0.5)
_FORMAT = (
    '\n{"timestamp":%.6f,"imu":{"gyro":[%.6g,%.6g,%.6g],"accel_body":[%.6g,%.6g,%.6g]},'
    '"position":[%.5f,%.5f,%.5f],"quaternion":[%.8f,%.8f,%.8f,%.8f],'
    '"velocity":[%.5f,%.5f,%.5f],"no_time_sync":1}\n'
)


class Servos(NamedTuple):
    """Servo outputs: frame number since boot, steps per second, pulse widths in microseconds."""

    frame: int
    rate: int
    pulses: tuple[int, ...]


def parse(data: bytes) -> Servos | None:
    """Return the servo outputs in a packet; None if it is not one."""
    if len(data) < _SIXTEEN.size:
        return None
    layout = _MAGIC.get(int.from_bytes(data[:2], "little"))
    if layout is None or len(data) != layout.size:
        return None
    _, rate, frame, *pulses = layout.unpack(data)
    return Servos(frame, rate, tuple(pulses))


def answer(time: float, state: Array, measured: Array, scale: tuple[float, float]) -> bytes:
    """Return the sensor values of one vehicle at ``time`` (seconds since the physics began).

    ``state`` is a row of `sitl.physics.rigid_bodies` (ENU, FLU), ``measured`` (3,) its specific
    force.
    ``scale`` are ArduPilot's metres per true metre, east and north (`Geodesy.scale`): it turns
    positions into degrees with its own metre (``SIM_Aircraft.cpp``), and a receiver measures true
    degrees. Velocities are true, as a receiver's.
    """
    s = state.tolist()
    ahead, left, up = measured.tolist()
    w, x, y, z = s[6:10]
    text = _FORMAT % (
        time, s[10], -s[11], -s[12], ahead, -left, -up,
        scale[1] * s[1], scale[0] * s[0], -s[2],
        _HALF * (w + z), _HALF * (x + y), _HALF * (x - y), _HALF * (w - z),
        s[4], s[3], -s[5],
    )  # fmt: skip
    return text.encode("ascii")


_IDLE, _SPAN = 1000.0, 1000.0
"""Pulse width without thrust, and from there to full thrust, microseconds."""
_CLOSED, _OPEN = 1700, 1300
"""Pulse widths of the gripper's output above which it closes, and below which it opens."""
_GRIPPER = 8
"""Index of the gripper's output: SERVO9."""
_LARGEST = 256


class ArduPilotPort(Port):
    """One ArduPilot's connection and its latest outputs."""

    def __init__(self, row: int, port: int, scale: tuple[float, float]) -> None:
        """Bind the UDP ``port`` of loopback; raises `OSError` if it is taken.

        ``scale``: as of `answer`.
        """
        super().__init__(row)
        self._scale = scale
        self._pulses: tuple[int, ...] = (0,) * 16
        self._peer: tuple[str, int] | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind(("127.0.0.1", port))

    def fileno(self) -> int:
        """Return the descriptor to wait at."""
        return self._socket.fileno()

    def receive(self) -> None:
        """Take one packet of outputs."""
        try:
            data, self._peer = self._socket.recvfrom(_LARGEST)
        except (BlockingIOError, ConnectionError):
            return
        servos = parse(data)
        if servos is None:
            return
        self._pulses = servos.pulses
        self.fresh, self.silent = True, False
        self.command = (np.array(servos.pulses[:MOTORS]) - _IDLE) / _SPAN

    def answer(self, at: float, state: Array, measured: Array) -> None:
        """Answer the latest outputs with the vehicle's state at ``at``, seconds."""
        if self.fresh and self._peer is not None:
            packet = answer(at, state, measured, self._scale)
            self._socket.sendto(packet, self._peer)
            self.fresh = False

    def end(self) -> None:
        """Note that the process has ended: motors stop, and the gripper stays as it is."""
        super().end()
        self._pulses = (0,) * 16

    def grip(self) -> bool | None:
        """Return whether the gripper's output closes it; None between closed and open."""
        pulse = self._pulses[_GRIPPER]
        if pulse > _CLOSED:
            return True
        return False if 0 < pulse < _OPEN else None

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
