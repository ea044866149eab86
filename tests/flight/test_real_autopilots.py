"""What the ground station makes of real autopilots: their recorded packets, fed to its vehicles."""

from dataclasses import dataclass, field
from functools import cache

import pytest
from pymavlink.dialects.v20 import common

from swarm.flight.preparation import readiness
from swarm.mavlink.packets import Decoder
from swarm.mavlink.signing import Signing
from swarm.mavlink.vehicle import Vehicle
from swarm.mission.fleet import Fleet, emulated_fleet
from tests.recordings import ARDUCOPTER, ARDUCOPTER_ENDS, PX4, recorded

ARM = int(common.MAV_CMD_COMPONENT_ARM_DISARM)
PREARM = int(common.MAV_SYS_STATUS_PREARM_CHECK)


@dataclass
class Told:
    """What a vehicle of a recording came to, and when."""

    vehicle: Vehicle
    ready: list[tuple[float, bool | None]] = field(default_factory=list)
    not_ready: list[tuple[float, str]] = field(default_factory=list)
    events: list[tuple[float, str, str]] = field(default_factory=list)
    accepted: list[float] = field(default_factory=list)
    present: int = 0
    unknown: int = 0
    enabled: int = 0


@cache
def told(name: str, system: int) -> Told:
    """Feed a vehicle with all that it said in a recording."""
    fleet = _fleet(name)
    known, decoder = Told(Vehicle(system)), Decoder()
    vehicle = known.vehicle
    for now, data in recorded(name):
        if data[5] != system:
            continue
        for packet in decoder.feed(data):
            vehicle.receive(packet, now)
            m = packet.message
            if packet.number == common.MAVLINK_MSG_ID_SYS_STATUS:
                known.present |= m.onboard_control_sensors_present
                known.enabled |= m.onboard_control_sensors_enabled
                known.not_ready += _not_ready(vehicle, fleet, now)
            if packet.number == common.MAVLINK_MSG_ID_COMMAND_ACK and m.command == ARM:
                known.accepted += [now] if m.result == common.MAV_RESULT_ACCEPTED else []
        known.events += [(now, event.kind, event.message) for event in vehicle.take_events()]
        if not known.ready or known.ready[-1][1] is not vehicle.ready:
            known.ready.append((now, vehicle.ready))
    known.unknown = decoder.unknown
    return known


def _not_ready(vehicle: Vehicle, fleet: Fleet, now: float) -> list[tuple[float, str]]:
    findings = readiness([vehicle], fleet, now)
    return [(now, finding.message) for finding in findings if finding.check == "ready"]


def _fleet(name: str) -> Fleet:
    return emulated_fleet(1, ("px4" if name.startswith("px4") else "ardupilot",))


@pytest.mark.parametrize("system", [1, 2])
def test_real_px4_becomes_ready_when_its_health_says_so(system):
    """It never lists the pre-arm check among what is present or enabled."""
    known = told(PX4, system)
    assert not (known.present | known.enabled) & PREARM
    (_, first), (heard, second), (ready, third), *later = known.ready
    assert (first, second, third) == (None, False, True)
    assert heard < 1.0 < ready < 2.0
    # it stays so until it is armed, and says nothing else until it has landed and is disarmed
    (armed,) = known.accepted
    landed = [now for now, kind, _ in known.events if kind == "landed"][-1]
    assert all(now > landed > armed > ready for now, _ in later)
    assert [value for _, value in later] == [False]
    while_ready = [words for now, words in known.not_ready if ready <= now < armed]
    assert while_ready == []
    before = {words for now, words in known.not_ready if now < ready}
    assert before
    assert all("ready to arm" in words for words in before)


@pytest.mark.parametrize(
    ("name", "system"), [(ARDUCOPTER, 1), (ARDUCOPTER, 2), (ARDUCOPTER_ENDS, 4)]
)
def test_real_arducopter_lists_the_check_and_is_ready_before_it_is_armed(name, system):
    known = told(name, system)
    assert known.present & known.enabled & PREARM
    ready = next(now for now, value in known.ready if value)
    (armed,) = known.accepted
    assert ready < 3.0 < armed
    assert [value for now, value in known.ready if now > ready] == []


@pytest.mark.parametrize(
    ("name", "system", "kinds"),
    [
        (PX4, 1, ["mode hold", "on the ground", "mode offboard", "armed", "in the air", "mode land",
                  "on the ground", "mode offboard", "mode land", "disarmed"]),
        (ARDUCOPTER, 2, ["mode guided", "on the ground", "armed", "in the air", "mode land",
                         "on the ground", "disarmed"]),
        (ARDUCOPTER_ENDS, 4, ["mode land", "mode guided", "on the ground", "armed", "in the air"]),
    ],
)  # fmt: skip
def test_a_real_flight_is_received_in_its_order(name, system, kinds):
    flown = ("mode", "landed", "airborne", "armed", "disarmed", "origin", "rebooted")
    assert [words for _, kind, words in told(name, system).events if kind in flown] == kinds


@pytest.mark.parametrize(
    ("name", "system"), [(PX4, 1), (PX4, 2), (ARDUCOPTER, 1), (ARDUCOPTER, 2), (ARDUCOPTER_ENDS, 4)]
)
def test_nothing_is_lost_on_loopback(name, system):
    """PX4 sends messages that the library does not know; they are not missing ones."""
    known = told(name, system)
    assert known.vehicle.packets > 4000
    assert known.vehicle.lost_packets == 0
    assert known.unknown == 0


@pytest.mark.parametrize("signed", [False, True])
def test_messages_that_no_library_knows_are_counted_and_not_missed(signed):
    number, key = 59_999, bytes(range(32))
    theirs, ours = Signing(key, 1_000_000), Signing(key, 1_000_000)
    decoder, vehicle = Decoder(include_unknown=True), Vehicle(1)
    for k in range(30):
        unknown = (
            bytes((0xFD, 4, int(signed), 0, k, 1, 1)) + number.to_bytes(3, "little") + b"abcdef"
        )
        packet = theirs.append_signature(unknown) if signed else unknown
        for one in decoder.feed(packet, ours if signed else None):
            vehicle.receive(one, float(k))
    assert (decoder.unknown, vehicle.packets, vehicle.lost_packets) == (30, 30, 0)
    assert vehicle.unhandled == {number: 30}
    forged = bytes((0xFD, 4, 1, 0, 0, 1, 1)) + number.to_bytes(3, "little") + bytes(19)
    assert not decoder.feed(forged, ours)
    assert not Decoder().feed(unknown)
