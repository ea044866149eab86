"""What an autopilot does alone after a failure: the same failure, real firmware and emulated one.

``python -m tests.recordings.alone KIND ROW,ROW|all OUT.jsonl [--firmware PATH]``

One vehicle with the parameters of the ground station's audit (T = 20 s) hovers at 4 m in offboard or
GUIDED mode; then one failure happens. The ground station goes on as before (setpoints at 25 Hz,
heartbeats at 1 Hz) unless it is the failure, so what is seen is the autopilot's own answer. Times
are the world's. Without ``--firmware`` the emulated autopilot flies.
"""

import argparse
import itertools
import json
import os
import signal
import socket
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from sitl.emulator import Emulator
from sitl.faults import Fault
from sitl.firmware.processes import assign, parse_firmware
from sitl.firmware.team import flying
from sitl.physics.dynamics import STEP
from sitl.world import Kind, default_world
from tests.recordings.silence import parameters, settings

MODE_AT = {"px4": 15.0, "ardupilot": 62.0}
"""World time of the mode change, seconds: the ArduCopter boots for 40 to 60 s."""
BEFORE, AFTER = 22.0, 45.0
"""Seconds from the mode change to the failure, and from there to the end: T is 20 s."""
HEIGHT = 4.0
OFF = 0.5
"""Metres from its place at which a vehicle has left it."""
DEGREE = 1.0 / 111_319.5  # of latitude, per metre
PX4_MODES = {(6, 0): "offboard", (4, 3): "hold", (4, 6): "land", (4, 5): "return", (3, 0): "position",
             (2, 0): "altitude", (1, 0): "manual", (4, 2): "takeoff", (10, 0): "termination"}  # fmt: skip
ARDUPILOT_MODES = {0: "stabilize", 4: "guided", 5: "loiter", 6: "return", 9: "land", 2: "altitude"}


@dataclass
class Flight:
    """One flight: the vehicle's world, the ground station's switches, what was seen."""

    kind: Kind
    emulator: Emulator
    real: bool
    send: Callable[[bytes], None]
    stranger: Callable[[bytes], None]
    processes: Callable[[], list[int]]
    stream: bool = True
    beats: bool = True
    sticks: bool = False
    later: list[tuple[float, Callable[[], None]]] = field(default_factory=list)
    out: Any = field(default_factory=lambda: dialect.MAVLink(None, 255, 190))

    def fault(self, kind: str, **values: Any) -> None:
        """Let the world inject a fault now."""
        self.emulator.inject(Fault(at=self.emulator.time, kind=kind, vehicle=1, **values))

    def set(self, name: str, value: float) -> None:
        """Set a parameter of the simulation (a float in both autopilots)."""
        self.send(self.out.param_set_encode(1, 1, name.encode(), value, 9).pack(self.out))

    def command(self, number: int, *values: float) -> None:
        """Send a command of the ground station."""
        self.send(self._command(self.out, number, values))

    def foreign(self, number: int, *values: float, system: int = 255) -> None:
        """Send a command from another address, with a system id."""
        self.stranger(self._command(dialect.MAVLink(None, system, 190), number, values))

    @staticmethod
    def _command(mav: Any, number: int, values: tuple[float, ...]) -> bytes:
        padded = (*values, *[0.0] * (7 - len(values)))
        return mav.command_long_encode(1, 1, number, 0, *padded).pack(mav)

    def after(self, seconds: float, action: Callable[[], None]) -> None:
        """Do something later, seconds of the world from now."""
        self.later.append((self.emulator.time + seconds, action))


def _motor(one: Flight) -> None:
    one.fault("motor_loss")


def _weak(one: Flight) -> None:
    one.fault("weak_thrust", fraction=0.7)


def _battery(one: Flight) -> None:
    """Drain to 24 % in 11 s, then 1 % a second; an ArduCopter's voltage falls below BATT_LOW_VOLT."""
    if not one.real:
        for k in range(25):
            charge = 0.24 - 0.01 * k
            one.after(11.0 + k, lambda charge=charge: one.fault("battery", charge=max(charge, 0.0)))
    elif one.kind == "px4":
        one.set("SIM_BAT_MIN_PCT", 0.0)
        one.set("SIM_BAT_DRAIN", 15.0)
        one.after(11.0, lambda: one.set("SIM_BAT_DRAIN", 100.0))
    else:
        one.set("SIM_BATT_VOLTAGE", 10.2)


def _receiver(one: Flight) -> None:
    if one.real and one.kind == "ardupilot":
        one.set("SIM_GPS_DISABLE", 1.0)
    else:
        one.fault("gps_loss")


def _jump(one: Flight) -> None:
    if one.real and one.kind == "ardupilot":
        one.set("SIM_GPS_GLITCH_X", 5.0 * DEGREE)
    else:
        one.fault("gps_jump", offset=(0.0, 5.0, 0.0))


def _barometer(one: Flight) -> None:
    if one.real and one.kind == "ardupilot":
        one.set("SIM_BARO_DRIFT", 0.1)
    else:
        one.fault("barometer_drift", rate=0.1)


def _radio(one: Flight) -> None:
    """Without a radio: an ArduCopter's simulated one ends, a PX4's is a joystick over MAVLink."""
    if not one.real:
        one.fault("rc_loss")
    elif one.kind == "px4":
        one.sticks = False
    else:
        one.set("SIM_RC_FAIL", 1.0)


def _stream(one: Flight) -> None:
    one.stream = False


def _ground_station(one: Flight) -> None:
    one.stream = one.beats = False


def _frozen(one: Flight) -> None:
    if not one.real:
        one.fault("freeze", duration=3.0)
        return
    (process,) = one.processes()
    os.kill(process, signal.SIGSTOP)
    one.after(3.0, lambda: os.kill(process, signal.SIGCONT))


def _killed(one: Flight) -> None:
    if not one.real:
        one.fault("reboot")
        return
    (process,) = one.processes()
    os.kill(process, signal.SIGKILL)


def _disarm(one: Flight) -> None:
    one.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0)


def _reboot(one: Flight) -> None:
    one.command(dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)


def _stranger(one: Flight) -> None:
    """Send a command with the ground station's id; an ArduCopter's UDP client hears one address."""
    one.foreign(dialect.MAV_CMD_NAV_LAND)


def _other(one: Flight) -> None:
    one.foreign(dialect.MAV_CMD_NAV_LAND, system=77)


def _origin(one: Flight) -> None:
    place = one.emulator.world.origin
    latitude = round(1e7 * (place.latitude + 5.0 * DEGREE))
    longitude = round(1e7 * place.longitude)
    height = round(1e3 * place.altitude)
    message = one.out.set_gps_global_origin_encode(1, latitude, longitude, height)
    one.send(message.pack(one.out))


ROWS: dict[str, Callable[[Flight], None]] = {
    "motor": _motor,
    "weak thrust": _weak,
    "battery": _battery,
    "receiver": _receiver,
    "jump": _jump,
    "barometer": _barometer,
    "radio": _radio,
    "stream": _stream,
    "ground station": _ground_station,
    "frozen": _frozen,
    "killed": _killed,
    "disarm": _disarm,
    "reboot": _reboot,
    "stranger": _stranger,
    "other id": _other,
    "origin": _origin,
}


def fly(kind: Kind, row: str, program: Path | None) -> dict[str, Any]:
    """Fly one vehicle until `AFTER` the failure; return what was seen."""
    with one_vehicle(kind, program, radio=row == "radio") as (one, step):
        one.sticks = row == "radio" and one.real and kind == "px4"
        seen, failure = Watch(one), MODE_AT[kind] + BEFORE
        failed = False
        for now in flown(one, step, seen):
            if now >= failure + AFTER:
                break
            if not failed and now >= failure:
                failed = True
                seen.begin(now)
                ROWS[row](one)
            for due in [due for due in one.later if due[0] <= now]:
                one.later.remove(due)
                due[1]()
            if failed:
                seen.watch(now)
        return {"row": row, "kind": kind, "real": one.real, **seen.result()}


def flown(one: Flight, step: Callable[[], list[bytes]], seen: "Watch") -> Iterator[float]:
    """Step the flight without end, and yield the world's time after each step."""
    configured = [] if one.real else list(settings(one.kind))
    for count in itertools.count(1):
        for data in step():
            seen.take(data)
        if count % 5 == 0 and configured:
            one.send(configured.pop(0).pack(one.out))
        ground_station(one, count, one.emulator.time - MODE_AT[one.kind])
        yield one.emulator.time


def ground_station(one: Flight, count: int, since: float) -> None:
    """Send what the ground station sends at a step, ``since`` seconds after the mode change."""
    out = one.out
    if one.beats and count % 50 == 0:
        one.send(out.heartbeat_encode(6, 8, 0, 0, 4).pack(out))
    if one.sticks and count % 5 == 0:
        one.send(out.manual_control_encode(1, 0, 0, 500, 0, 0).pack(out))
    lifted = one.kind == "px4" or since > 9.0
    if one.stream and since > -2.0 and lifted and count % 2 == 0:
        axes = (0, 0, -HEIGHT, 0, 0, 0, 0, 0, 0, 0, 0)
        one.send(out.set_position_target_local_ned_encode(0, 1, 1, 1, 2552, *axes).pack(out))
    if count % 50 == 25:
        if 0.0 <= since < 1.0:
            one.command(dialect.MAV_CMD_DO_SET_MODE, 1, 6 if one.kind == "px4" else 4)
        elif 1.0 <= since < 2.0:
            one.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        elif 3.0 <= since < 4.0 and one.kind == "ardupilot":
            one.command(dialect.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, HEIGHT)
        elif -8.0 <= since < -7.0 and one.kind == "ardupilot":
            for number in (32, 33, 245):  # position, global position, landed state
                one.command(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, number, 100_000)


class Watch:
    """What the vehicle said and did after the failure."""

    def __init__(self, one: Flight) -> None:
        self.one = one
        self.parser = dialect.MAVLink(None)
        self.parser.robust_parsing = True
        self.at = float("inf")
        self.state: dict[str, Any] = {}
        self.changes: list[tuple[float, str]] = []
        self.offset: Any = None
        self.place: Any = None
        self.texts = b""
        self.farthest = self.error = self.tilt = 0.0
        self.left = self.down = None
        self.armed_at_failure = False

    def begin(self, now: float) -> None:
        """Note the state at the failure."""
        self.at = now
        self.place = self._true()
        self.armed_at_failure = bool(self.state.get("armed"))

    def take(self, data: bytes) -> None:
        """Take bytes of the vehicle."""
        for message in self.parser.parse_buffer(data) or []:
            if message.get_srcComponent() == 1:
                self._take(message, message.get_type())

    def _take(self, message: Any, name: str) -> None:
        if name == "HEARTBEAT":
            custom = message.custom_mode
            known = PX4_MODES if self.one.kind == "px4" else ARDUPILOT_MODES
            key: Any = (custom >> 16 & 255, custom >> 24) if self.one.kind == "px4" else custom
            self._change("mode", known.get(key, str(key)))
            self._change("armed", message.base_mode >> 7)
            self._change("status", message.system_status)
        elif name == "EXTENDED_SYS_STATE":
            self._change("landed", message.landed_state)
        elif name == "GPS_RAW_INT":
            self._change("fix", message.fix_type)
        elif name == "BATTERY_STATUS":
            self._change("battery", message.charge_state)
        elif name == "STATUSTEXT" and self.one.emulator.time >= self.at:
            self._note(f"text {message.text.strip()}")
        elif name == "COMMAND_ACK" and self.one.emulator.time >= self.at:
            self._note(f"ack {message.command} result {message.result}")
        elif name == "LOCAL_POSITION_NED":
            here = np.array([message.y, message.x, -message.z])
            if self.one.emulator.time < self.at:
                self.offset = here - self._true()
            else:
                self.error = max(
                    self.error, float(np.linalg.norm(here - self.offset - self._true()))
                )

    def _change(self, key: str, value: Any) -> None:
        if key in self.state and self.state[key] != value and self.one.emulator.time >= self.at:
            self._note(f"{key} {value}")
        self.state[key] = value

    def _note(self, what: str) -> None:
        self.changes.append((round(self.one.emulator.time - self.at, 2), what))

    def _true(self) -> Any:
        return self.one.emulator.bodies.position[0].copy()

    def watch(self, now: float) -> None:
        """Follow the true position."""
        truth = self._true()
        level = float(np.linalg.norm(truth[:2] - self.place[:2]))
        self.farthest = max(self.farthest, level)
        if self.left is None and float(np.linalg.norm(truth - self.place)) > OFF:
            self.left = round(now - self.at, 2)
        bodies = self.one.emulator.bodies
        if self.down is None and bodies.landed[0]:
            self.down = round(now - self.at, 2)
        thrust = bodies.thrust[0]
        tilt = float(np.degrees(np.arctan2(np.hypot(thrust[0], thrust[1]), thrust[2])))
        self.tilt = max(self.tilt, tilt)

    def result(self) -> dict[str, Any]:
        """Return all that was seen."""
        return {
            "flying": self.armed_at_failure and bool(self.place[2] > 0.5 * HEIGHT),
            "changes": self.changes,
            "left_place_after": self.left,
            "down_after": self.down,
            "farthest_level": round(self.farthest, 2),
            "largest_error_of_reported_position": round(self.error, 2),
            "largest_tilt": round(self.tilt),
        }


@contextmanager
def one_vehicle(
    kind: Kind, program: Path | None, *, radio: bool, values: dict[str, float] | None = None
) -> Iterator[tuple[Flight, Callable[[], list[bytes]]]]:
    """Run one vehicle with the audit's parameters and ``values``; yield it, and how to step it."""
    world = default_world(1, [kind])
    start = parameters(kind) | (values or {})
    spec = world.vehicles[0].model_copy(update={"parameters": start, "radio": radio})
    world = world.model_copy(update={"vehicles": [spec]})
    if program is None:
        emulator = Emulator(world)

        def deliver(data: bytes) -> None:
            emulator.receive(1, data, emulator.time)

        def advance() -> list[bytes]:
            return [data for _, data in emulator.step(emulator.time + STEP)]

        yield Flight(kind, emulator, False, deliver, deliver, list), advance
        return
    emulator = Emulator(world, outside=[1])
    firmware = assign(parse_firmware(f"{kind}={program}"), world)
    with tempfile.TemporaryDirectory() as folder, _bound() as ground, _bound() as other:
        target = f"127.0.0.1:{ground.getsockname()[1]}"
        peer: list[Any] = []

        def send_real(data: bytes) -> None:
            if peer:
                ground.sendto(data, peer[-1])

        def send_other(data: bytes) -> None:
            if peer:
                (ground if kind == "ardupilot" else other).sendto(data, peer[-1])

        with flying(emulator, firmware, target, Path(folder)) as exchange:
            assert exchange is not None

            def advance_real() -> list[bytes]:
                exchange.advance(emulator.time + STEP)
                found = []
                try:
                    while True:
                        data, address = ground.recvfrom(65535)
                        peer[:] = [address]
                        found.append(data)
                except (BlockingIOError, ConnectionError):
                    return found

            yield Flight(kind, emulator, True, send_real, send_other, _children), advance_real


@contextmanager
def _bound() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        one.setblocking(False)
        yield one


def _children() -> list[int]:
    """Return the ids of this process's children that run: the autopilot's."""
    me = os.getpid()
    children = Path(f"/proc/{me}/task/{me}/children").read_text().split()
    states = {int(one): Path(f"/proc/{one}/stat").read_text() for one in children}
    return [one for one, state in states.items() if state.rpartition(")")[2].split()[0] != "Z"]


def main() -> None:
    """Fly the rows; add a line of JSON for each to the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=["px4", "ardupilot"])
    parser.add_argument("rows")
    parser.add_argument("out", type=Path)
    parser.add_argument("--firmware", type=Path)
    given = parser.parse_args()
    for row in ROWS if given.rows == "all" else given.rows.split(","):
        found = fly(given.kind, row, given.firmware)
        with given.out.open("a") as file:
            file.write(json.dumps(found) + "\n")


if __name__ == "__main__":
    main()
