"""Read a flight's .tlog: positions, setpoints, the mission clock, commands, losses; and where an
interrupted flight broke off.

A .tlog is a sequence of packets, each after its time (eight bytes, microseconds since 1970,
big-endian). A log that is cut off, or has a gap where a disk was full, is read as far as possible.
After their ground station has ended, vehicles hold where they stopped, until the fleet's T has
passed since they last received one; then they land by themselves, together.
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view
from pymavlink.dialects.v20 import common

from swarm.errors import InputError, Refused
from swarm.flight.preparation import STANDING_TIME, prepared_team
from swarm.flight.trace import Trace
from swarm.mavlink.autopilots import AUTOPILOTS, Autopilot
from swarm.mavlink.frames import Frames
from swarm.mavlink.packets import (
    GROUND_SYSTEM,
    Decoder,
    Encoder,
    Packet,
    enum_words,
    packet_length,
)
from swarm.mavlink.vehicle import HANDLED_MESSAGES, Vehicle
from swarm.mission.fleet import Fleet
from swarm.planning import Plan
from swarm.planning.archive import READ_ERRORS
from swarm.planning.assembly import begins_aloft
from swarm.tables import stamp_unit

Floats = npt.NDArray[np.float64]

CLOCK_COMPONENT = int(common.MAV_COMP_ID_USER1)
"""The component of the mission clock's packets, which are in the record only."""
STEP = 0.1
"""Seconds between samples of a flight that is read from its packets, as those of a record."""
_NEIGHBOURS = 100
"""Reports before and after one, of which the quickest shows the difference of the clocks: 7 to 20 s
together, longer than a link stalls in a flight, and clocks part by 1 ms in them (50 ppm each)."""
_FRESH = 1.0
"""Seconds after which a position counts as unknown, as in a record."""
_STAMP = 8
"""Bytes of the time stamp before each packet: microseconds, big-endian (MAVLink .tlog)."""
_LONGEST = 43_200.0
"""Longest record in seconds, three times the longest plan: damaged stamps must not fill memory."""
_HOUR = 3_600_000_000
"""Microseconds; a larger difference of two stamps is no stamp but damage."""
_SETPOINT = int(common.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED)
_POSITION = int(common.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
_VALUE = int(common.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT)
_COMMAND = int(common.MAVLINK_MSG_ID_COMMAND_LONG)
_ANSWER = int(common.MAVLINK_MSG_ID_COMMAND_ACK)
_WANTED = HANDLED_MESSAGES | {_SETPOINT, _VALUE, _COMMAND}
_COMMANDS = enum_words("MAV_CMD", "MAV_CMD_")


@dataclass(frozen=True)
class CommandLatency:
    """A command's counts of packets and answers, and the seconds to the first answer."""

    name: str
    sent: int
    answered: int
    repeated: int
    median: float
    largest: float


@dataclass(frozen=True, eq=False)
class KnownFrames:
    """Frames and yaw (n,) in radians of vehicles ``systems``, in order along the cable."""

    systems: tuple[int, ...]
    frames: Frames
    yaw: Floats


@dataclass(frozen=True, eq=False)
class Replayed:
    """The content of a .tlog; losses by system id.

    ``known`` are the vehicles, with their frames on their pads. ``started`` is time 0 of the trace,
    the first packet, in seconds since 1970; ``event_time`` is the same moment on the clock of the
    record's events.
    """

    trace: Trace
    started: float
    event_time: float
    known: KnownFrames
    commands: tuple[CommandLatency, ...]
    received: Mapping[int, int]
    lost: Mapping[int, int]
    damaged: int
    notes: tuple[str, ...] = ()


class ClockEncoder:
    """Encodes the mission clock and phase as packets for a record."""

    def __init__(self, plan: Plan) -> None:
        self._encoder = Encoder(GROUND_SYSTEM, CLOCK_COMPONENT)
        self._phases = {phase.name: number for number, phase in enumerate(plan.phases)}

    def encode(self, now: float, mission_time: float, phase: str) -> bytes:
        """Return the packets for a moment; ``phase`` is "" outside the plan."""
        number = next((k for name, k in self._phases.items() if name == phase), -1)
        boot = int(now * 1000.0) & 0xFFFFFFFF
        message = common.MAVLink_named_value_float_message
        return self._encoder.encode(message(boot, b"mission", mission_time)) + self._encoder.encode(
            message(boot, b"phase", float(number))
        )


def packets(data: bytes) -> Iterator[tuple[float, bytes | None]]:
    """Yield seconds since 1970 and the packet; None for bytes that are no packet."""
    start, last, end = 0, 0, len(data)
    while start + _STAMP + 3 <= end:
        stamp = int.from_bytes(data[start : start + _STAMP], "big")
        length = packet_length(data, start + _STAMP)
        likely = last == 0 or abs(stamp - last) < _HOUR
        if length <= 0 or not likely or start + _STAMP + length > end:
            if length > 0 and likely:
                return  # the last packet, cut off
            yield last * 1e-6, None
            start = _next(data, start + 1, last)
            continue
        last = stamp
        yield stamp * 1e-6, data[start + _STAMP : start + _STAMP + length]
        start += _STAMP + length


def _next(data: bytes, start: int, last: int) -> int:
    """Return where the next stamp and packet may begin."""
    at = start
    while True:
        starts = (data.find(magic, at + _STAMP) for magic in (b"\xfd", b"\xfe"))
        starts_at = [place for place in starts if place >= 0]
        if not starts_at:
            return len(data)
        at = min(starts_at) - _STAMP
        if abs(int.from_bytes(data[at : at + _STAMP], "big") - last) < _HOUR:
            return at
        at += 1


@dataclass
class _Content:
    """The values that are collected while reading."""

    fleet: Fleet
    vehicles: dict[int, Vehicle]
    times: dict[int, list[float]] = field(default_factory=dict)
    boots: dict[int, list[float]] = field(default_factory=dict)
    places: dict[int, list[tuple[float, float, float]]] = field(default_factory=dict)
    setpoint_times: dict[int, list[float]] = field(default_factory=dict)
    setpoints: dict[int, list[tuple[float, float, float]]] = field(default_factory=dict)
    clock: list[tuple[float, float]] = field(default_factory=list)
    phase: list[tuple[float, float]] = field(default_factory=list)
    sent: dict[tuple[int, int], float] = field(default_factory=dict)
    latencies: dict[int, list[float]] = field(default_factory=dict)
    counts: dict[int, Counter[str]] = field(default_factory=dict)
    standing: dict[int, Vehicle] = field(default_factory=dict)
    event_time: float = 0.0

    def take(self, now: float, packet: Packet) -> None:
        message = packet.message
        if packet.system == GROUND_SYSTEM:
            if message is not None:
                self._read_own(now, packet)
            return
        vehicle = self.vehicles.get(packet.system)
        if vehicle is None:
            return
        vehicle.receive(packet, now)
        vehicle.take_events()
        if packet.component != vehicle.component:
            return
        if packet.number == _POSITION and message is not None:
            if message.time_boot_ms != vehicle.boot_ms:
                return
            self.times.setdefault(packet.system, []).append(now)
            self.boots.setdefault(packet.system, []).append(1e-3 * vehicle.boot_ms)
            self.places.setdefault(packet.system, []).append(vehicle.position)
        elif packet.number == _ANSWER and message is not None:
            self._answered(now, packet.system, message.command)

    def _read_own(self, now: float, packet: Packet) -> None:
        m = packet.message
        assert m is not None  # noqa: S101 - checked by the caller
        if packet.number == _SETPOINT:
            self.setpoint_times.setdefault(m.target_system, []).append(now)
            self.setpoints.setdefault(m.target_system, []).append((m.x, m.y, m.z))
        elif packet.number == _VALUE and packet.component == CLOCK_COMPONENT:
            name = m.name.rstrip(b"\0") if isinstance(m.name, bytes) else m.name
            (self.clock if name == b"mission" else self.phase).append((now, m.value))
            if not self.standing:
                self.event_time = m.time_boot_ms * 1e-3 - now
                self.standing = {s: copy(vehicle) for s, vehicle in self.vehicles.items()}
        elif packet.number == _COMMAND:
            count = self.counts.setdefault(m.command, Counter())
            if m.confirmation:
                count["repeated"] += 1
            else:
                count["sent"] += 1
                self.sent[m.target_system, m.command] = now

    def _answered(self, now: float, system: int, command: int) -> None:
        since = self.sent.pop((system, command), None)
        if since is not None:
            self.counts[command]["answered"] += 1
            self.latencies.setdefault(command, []).append(now - since)


def frames_document(known: KnownFrames) -> dict[str, Any]:
    """Return frames as plain data for JSON: a resumed flight's log does not determine them."""
    return {
        "schema": 1,
        "systems": list(known.systems),
        "rotation": known.frames.rotation.tolist(),
        "translation": known.frames.translation.tolist(),
        "yaw": known.yaw.tolist(),
    }


def read_frames(document: Mapping[str, Any], plan: Plan) -> KnownFrames:
    """Return the content of a :func:`frames_document`; raises :class:`InputError`."""
    n = plan.vehicles
    try:
        systems = tuple(int(system) for system in document["systems"])
        rotation = np.array(document["rotation"], dtype=np.float64)
        translation = np.array(document["translation"], dtype=np.float64)
        yaw = np.array(document["yaw"], dtype=np.float64)
        if (len(systems), rotation.shape, translation.shape, yaw.shape) != (
            n, (n, 3, 3), (n, 3), (n,),
        ):  # fmt: skip
            raise ValueError(f"not of {n} vehicles")
        if not all(np.isfinite(array).all() for array in (rotation, translation, yaw)):
            raise ValueError("numbers that are not finite")
        return KnownFrames(systems, Frames(rotation, translation), yaw)
    except READ_ERRORS as error:
        raise InputError(f"the record's frames cannot be read: {error}") from None


def replay(data: bytes, plan: Plan, fleet: Fleet, known: KnownFrames | None = None) -> Replayed:
    """Return the flight in the bytes of a .tlog, for its plan and fleet.

    Frames and places along the cable follow from the vehicles' positions before they were armed, as
    before the flight. The log of a resumed flight does not have them: they must be ``known``.
    Raises :class:`InputError` where they cannot be determined.
    """
    content = _Content(fleet, _vehicles(fleet))
    decoder = Decoder(unpacked=_WANTED, include_unknown=True)
    first = last = math.nan
    holes = 0
    for now, packet in packets(data):
        if packet is None:
            holes += 1
            continue
        if math.isnan(first):
            first = now
            _require_microseconds(now)
        last = now
        if last - first > _LONGEST:
            raise InputError(f"the record's flight.tlog is longer than {_LONGEST / 3600.0:g} hours")
        for message in decoder.feed(packet):
            content.take(now - first, message)
    if math.isnan(first) or not content.clock:
        raise InputError("the record's flight.tlog contains no flight")
    known = known or _frames(content, plan)
    notes = [f"the .tlog has {holes} damaged places"] if holes else []
    return Replayed(
        trace=_trace(content, plan, known.frames, list(known.systems), last - first),
        started=first,
        event_time=content.event_time,
        known=known,
        commands=tuple(_commands(content)),
        received={v.system: v.packets for v in content.vehicles.values()},
        lost={v.system: v.lost_packets for v in content.vehicles.values()},
        damaged=holes + decoder.damaged,
        notes=tuple(notes),
    )


def _require_microseconds(first: float) -> None:
    unit = stamp_unit(first * 1e6)
    if unit not in {None, "microseconds"}:
        message = "the record's flight.tlog: expected stamps in microseconds since 1970, got "
        raise InputError(message + f"{unit}")


def _vehicles(fleet: Fleet) -> dict[int, Vehicle]:
    named: dict[str, Autopilot] = {kind.name: kind for kind in AUTOPILOTS.values()}
    return {
        listed.sysid: Vehicle(listed.sysid, autopilot=named.get(listed.autopilot))
        for listed in fleet.vehicles
    }


def _frames(content: _Content, plan: Plan) -> KnownFrames:
    """Return the frames, from the vehicles' positions when all were ready."""
    flown = [system for system in content.vehicles if system in content.places]
    streamed = [system for system in flown if system in content.setpoints]
    flown = streamed if len(streamed) >= plan.vehicles else flown
    if len(flown) < plan.vehicles:
        raise InputError(f"the .tlog has {len(flown)} vehicles, the plan of {plan.vehicles}")
    ready = content.clock[0][0]
    measured = []
    for system in flown:
        times, places = np.array(content.times[system]), np.array(content.places[system])
        before = (times <= ready) & (times > ready - STANDING_TIME)
        measured.append(places[before].mean(axis=0) if before.any() else places[0])
    lift = np.array([0.0, 0.0, plan.mission.vehicles.grip_offset])
    standing = plan.motion.at(0.0)[0] + lift
    try:
        prepared = prepared_team(
            [content.standing[s] for s in flown], content.fleet, standing, np.array(measured)
        )
    except Refused as error:
        raise InputError(f"the .tlog does not determine the vehicles' places: {error}") from None
    return KnownFrames(
        tuple(vehicle.system for vehicle in prepared.flyers), prepared.frames, prepared.yaw
    )


def _trace(
    content: _Content, plan: Plan, frames: Frames, systems: list[int], duration: float
) -> Trace:
    clock, phase = np.array(content.clock), np.array(content.phase)
    time = np.arange(clock[0, 0], max(duration, clock[0, 0] + STEP), STEP)
    lift = np.array([0.0, 0.0, plan.mission.vehicles.grip_offset])
    position = np.full((len(time), len(systems), 3), np.nan)
    setpoint = np.full_like(position, np.nan)
    # a setpoint stands until the next one comes: it was aimed at the middle of its time
    lead = 0.5 / content.fleet.rates.setpoint
    for k, system in enumerate(systems):
        if system in content.times:
            measured_at = measurement_times(content.times[system], content.boots[system])
            position[:, k] = _sampled(measured_at, content.places[system], time)
        if system in content.setpoint_times:
            aimed_at = np.array(content.setpoint_times[system]) + lead
            setpoint[:, k] = _sampled(aimed_at, content.setpoints[system], time)
    for places in (position, setpoint):
        for moment in places:
            moment[:] = frames.points_to_mission(moment) - lift
    number = phase[np.clip(np.searchsorted(phase[:, 0], time, "right") - 1, 0, len(phase) - 1), 1]
    names = [*(part.name for part in plan.phases), ""]
    return Trace(
        time=time,
        mission_time=np.interp(time, clock[:, 0], clock[:, 1]),
        position=position,
        setpoint=setpoint,
        phase=tuple(names[int(n)] for n in number),
    )


def measurement_times(read: Sequence[float], boot: Sequence[float]) -> Floats:
    """Return when reports (k,) were measured, in seconds of the clock by which they were ``read``.

    ``boot`` are the vehicle's own times in the reports. A report that waited, in a stalled program
    or on a busy link, is read late; among its neighbours the quickest one shows the difference of
    the two clocks. Times of reading are returned for a vehicle that counts no time, or booted anew.
    """
    arrived, own = np.array(read), np.array(boot)
    delay = arrived - own
    booted = np.any(np.diff(own) < 0.0)
    if booted or np.ptp(delay) > 0.5 * np.ptp(arrived):
        return arrived
    neighbours = sliding_window_view(np.pad(delay, _NEIGHBOURS, mode="edge"), 2 * _NEIGHBOURS + 1)
    return np.asarray(own + neighbours.min(axis=1))


def _sampled(times: Floats, places: Sequence[tuple[float, float, float]], at: Floats) -> Floats:
    """Return points (k, 3) at moments, interpolated; NaN where no known one is near."""
    order = np.argsort(times, kind="stable")
    known, points = times[order], np.array(places)[order]
    sampled = np.column_stack([np.interp(at, known, points[:, axis]) for axis in range(3)])
    after = np.searchsorted(known, at)
    before = known[np.clip(after - 1, 0, len(known) - 1)]
    sampled[(np.abs(at - before) > _FRESH) | (at < known[0])] = np.nan
    return sampled


def _commands(content: _Content) -> Iterator[CommandLatency]:
    for command, count in content.counts.items():
        latencies = np.array(content.latencies.get(command, [math.nan]))
        yield CommandLatency(
            _COMMANDS.get(command, f"command {command}"),
            count["sent"],
            count["answered"],
            count["repeated"],
            float(np.median(latencies)),
            float(latencies.max()),
        )


Then = Literal["hold", "continue", "rewind", "land", "release"]


@dataclass(frozen=True, eq=False)
class LeftOff:
    """Where a flight broke off.

    ``known`` are the vehicles, with their frames; ``mission_time`` is the last recorded one,
    ``gripped`` says whether the cable was held.
    """

    known: KnownFrames
    mission_time: float
    gate: int
    gripped: bool


def left_off(tlog: bytes, plan: Plan, fleet: Fleet, known: KnownFrames | None = None) -> LeftOff:
    """Return where a flight broke off, from its .tlog; ``known`` are frames from its record.

    Raises :class:`InputError` where the log does not determine it, or the flight had ended or had
    not left the ground.
    """
    flown = replay(tlog, plan, fleet, known)
    time, phase = float(flown.trace.mission_time[-1]), flown.trace.phase[-1]
    if not phase:
        raise InputError("the team was leaving the plan, or had not begun it: nothing to resume")
    if time <= 0.0 and not begins_aloft(plan):
        raise InputError("the team had not left the ground: fly it anew")
    passed = [gate for gate in plan.gates if gate.time < time - 1e-3]
    done = {gate.condition for gate in passed}
    return LeftOff(
        known=flown.known,
        mission_time=time,
        gate=len(passed),
        gripped=(begins_aloft(plan) or "gripped" in done) and "released" not in done,
    )
