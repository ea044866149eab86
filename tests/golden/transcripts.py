"""What goes between ground station and vehicles after a fault, as lines that people can read.

``>>`` is what the ground station hears, ``<<`` what it says. Times are seconds after the fault.
Setpoints are summarised by what they ask for; heartbeats and clock messages are left out.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from pymavlink import mavutil
from pymavlink.dialects.v20 import common

from swarm.flight.snapshot import Event
from tests.golden.wire import CURRENT_MODE, Datagram, Reader, is_setpoint, listed

HEARD = frozenset(
    {
        CURRENT_MODE,
        int(common.MAVLINK_MSG_ID_HEARTBEAT),
        int(common.MAVLINK_MSG_ID_SYS_STATUS),
        int(common.MAVLINK_MSG_ID_COMMAND_ACK),
        int(common.MAVLINK_MSG_ID_STATUSTEXT),
        int(common.MAVLINK_MSG_ID_EXTENDED_SYS_STATE),
        int(common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN),
    }
)
"""Messages of vehicles that are told where they say something new."""
_LEFT_OUT = frozenset({"HEARTBEAT", "TIMESYNC"})
SILENCE = 1.0
"""Seconds without a packet after which a vehicle is called silent."""
STREAM_END = 0.3
"""Seconds without a setpoint after which a stream has ended."""
STEADY = 0.5
"""Seconds for which setpoints must ask for the same kind of motion to be told."""
_STILL, _DESCENDING = 0.05, 0.15
"""m/s below which setpoints stand still, and above which they go down."""
_BATTERY_STEP = 5


class Line(NamedTuple):
    """One thing that one vehicle (0: none) said or was told; events are numbered likewise."""

    time: float
    incoming: bool
    kind: str
    words: str
    system: int = 0


def transcript(wire: Sequence[Datagram], events: Iterable[Event], since: float) -> list[str]:
    """Return the lines of what happened after ``since``, in the order of time.

    ``wire`` may begin earlier: what is known of the vehicles then is not told again.
    """
    lines = _heard([one for one in wire if not one.up])
    lines += _told([one for one in wire if one.up])
    lines += [
        Line(e.time, False, "event", _one_line(f"{e.kind}: {e.message}"), e.vehicle or 0)
        for e in events
        if e.kind != "text"  # the vehicle's own words, which are told where they arrive
    ]
    later = [line for line in lines if line.time >= since]
    later.sort(key=lambda line: (round(line.time, 3), not line.incoming, _ORDER.index(line.kind)))
    return list(_written(later, since))


_ORDER = ("link", "mode", "state", "battery", "health", "origin", "text", "ack",
          "event", "command", "packet", "setpoints")  # fmt: skip


def _written(lines: Sequence[Line], since: float) -> Iterable[str]:
    """One line for what several vehicles said, or were told, at the same time."""
    for (time, _, _), alike in groupby(lines, key=lambda x: (round(x.time, 3), x.incoming, x.kind)):
        ones = list(alike)
        sign = ">>" if ones[0].incoming else "<<"
        for words in dict.fromkeys(one.words for one in ones):
            systems = [one.system for one in ones if one.words == words]
            times = max(Counter(systems).values())
            again = f" ×{times}" if times > 1 else ""
            yield (
                f"{sign} {time - since:7.2f}  {ones[0].kind:<9} {words}{again}"
                f"{_addressed(ones[0], systems)}"
            )


def _addressed(line: Line, systems: list[int]) -> str:
    if 0 in systems:
        return ""
    preposition = "from" if line.incoming else "of" if line.kind == "event" else "to"
    return f" · {preposition} {listed(systems)}"


def fault_line(words: str) -> str:
    """Return the line of the fault itself, at time 0."""
    return f">> {0.0:7.2f}  {'fault':<9} {words}"


@dataclass
class _Said:
    """What a vehicle said last, by kind."""

    heard_at: float | None = None
    silent: bool = False
    known: dict[str, Any] = field(default_factory=dict)

    def new(self, kind: str, value: Any) -> bool:
        """Whether a value differs from the last of its kind; the first one does not count."""
        before = self.known.get(kind, value)
        self.known[kind] = value
        return bool(before != value)


def _heard(wire: Sequence[Datagram]) -> list[Line]:
    """What vehicles said that is new, and where they fell silent."""
    reader = Reader(HEARD)
    said: dict[int, _Said] = {one.system: _Said() for one in wire}
    lines: list[Line] = []

    def tell(time: float, kind: str, words: str, system: int) -> None:
        lines.append(Line(time, True, kind, words, system))

    for time, _, system, data in wire:
        for other, one in said.items():
            quiet = one.heard_at is not None and time - one.heard_at > SILENCE
            if quiet and not one.silent:
                one.silent = True
                tell(one.heard_at + SILENCE, "link", f"silent for {SILENCE:g} s", other)
        one = said[system]
        if one.silent:
            one.silent = False
            tell(time, "link", "heard again", system)
        one.heard_at = time
        for message in reader.messages(data):
            for kind, words in _news(one, message):
                tell(time, kind, words, system)
    return lines


def _news(said: _Said, message: Any) -> Iterable[tuple[str, str]]:
    kind = message.get_type()
    if kind == "HEARTBEAT":
        if said.new("mode", mavutil.mode_string_v10(message)):
            yield "mode", said.known["mode"]
        if said.new("armed", bool(message.base_mode & common.MAV_MODE_FLAG_SAFETY_ARMED)):
            yield "state", "armed" if said.known["armed"] else "disarmed"
    elif kind == "CURRENT_MODE":
        if said.new("mode", mavutil.interpret_px4_mode(0, message.custom_mode)):
            yield "mode", said.known["mode"]
    elif kind == "EXTENDED_SYS_STATE":
        if said.new("landed", message.landed_state):
            yield "state", _name("MAV_LANDED_STATE", message.landed_state)
    elif kind == "SYS_STATUS":
        yield from _status(said, message)
    elif kind == "GPS_GLOBAL_ORIGIN":
        if said.new("origin", (message.latitude, message.longitude, message.altitude)):
            yield "origin", "moved"
    elif kind == "STATUSTEXT":
        yield "text", f'"{message.text.strip()}"'
    elif kind == "COMMAND_ACK":
        words = _name("MAV_RESULT", message.result)
        yield "ack", f"{_name('MAV_CMD', message.command)} {words}"


def _status(said: _Said, message: Any) -> Iterable[tuple[str, str]]:
    charge, before = message.battery_remaining, said.known.get("charge")
    if before is None or abs(charge - before) >= _BATTERY_STEP:
        said.known["charge"] = charge
        if before is not None:
            yield "battery", f"{charge} %"
    health = message.onboard_control_sensors_health & message.onboard_control_sensors_enabled
    was = said.known.get("health", health)
    if said.new("health", health):
        yield "health", ", ".join([*_sensors(was & ~health, "bad"), *_sensors(health & ~was, "ok")])


def _sensors(bits: int, word: str) -> list[str]:
    known = common.enums["MAV_SYS_STATUS_SENSOR"]
    return [
        f"{known[bit].name.removeprefix('MAV_SYS_STATUS_').removeprefix('SENSOR_')} {word}"
        for bit in sorted(known)
        if bit & bits
    ]


def _told(wire: Sequence[Datagram]) -> list[Line]:
    """What vehicles were told: commands, and setpoints by what they ask for."""
    reader = Reader()
    lines: list[Line] = []
    streams: dict[int, list[tuple[float, float, float]]] = {}
    for time, _, system, data in wire:
        if is_setpoint(data):
            (message,) = reader.messages(data)
            level = float(np.hypot(message.vx, message.vy))
            streams.setdefault(system, []).append((time, level, float(message.vz)))
            continue
        for message in reader.messages(data):
            kind = message.get_type()
            if kind in {"COMMAND_LONG", "COMMAND_INT"}:
                lines.append(Line(time, False, "command", _command(message), system))
            elif kind not in _LEFT_OUT:
                lines.append(Line(time, False, "packet", kind, system))
    end = max((one.time for one in wire), default=0.0)
    for system, stream in streams.items():
        lines += _streamed(system, stream, end)
    return lines


def _command(message: Any) -> str:
    parameters = [getattr(message, f"param{k}") for k in range(1, 8)]
    while parameters and parameters[-1] == 0.0:
        parameters.pop()
    again = f" (sent again, {message.confirmation})" if message.confirmation else ""
    words = ", ".join(f"{value:g}" for value in parameters)
    return f"{_name('MAV_CMD', message.command)}({words}){again}"


def _streamed(system: int, stream: Sequence[tuple[float, float, float]], end: float) -> list[Line]:
    """One line for each kind of motion that setpoints ask for, and where they begin and end."""
    lines: list[Line] = []
    spans: list[tuple[str, list[tuple[float, float, float]]]] = []
    last = stream[0][0]
    for one in stream:
        kind = _kind(one[1], one[2])
        if one[0] - last > STREAM_END or not spans or spans[-1][0] != kind:
            spans.append((kind, []))
        spans[-1][1].append(one)
        last = one[0]
    told = ""
    last = stream[0][0]
    for kind, ones in spans:
        if ones[0][0] - last > STREAM_END:
            lines.append(Line(last, False, "setpoints", "end", system))
            told = ""
        last = ones[-1][0]
        if kind != told and last - ones[0][0] >= STEADY:
            lines.append(Line(ones[0][0], False, "setpoints", _motion(kind, ones), system))
            told = kind
    if end - last > STREAM_END:
        lines.append(Line(last, False, "setpoints", "end", system))
    return lines


def _kind(level: float, down: float) -> str:
    if level < _STILL:
        if abs(down) < _STILL:
            return "stand still"
        if down > _DESCENDING:
            return "descend"
    return "move"


def _motion(kind: str, ones: Sequence[tuple[float, float, float]]) -> str:
    if kind == "stand still":
        return kind
    if kind == "descend":
        return f"descend at {max(down for _, _, down in ones):.1f} m/s"
    return "move"


def _name(group: str, number: int) -> str:
    """Return MAVLink's name of a number, without the group's where what it is about is clear."""
    known = common.enums[group].get(number)
    if known is None:
        return f"{group} {number}"
    if group == "MAV_CMD":
        return str(known.name)
    return str(known.name).removeprefix(f"{group}_").replace("_", " ").lower()


def _one_line(words: str) -> str:
    return " / ".join(words.splitlines())
