"""The emulator against recordings of the real autopilots, field by field.

An emulated vehicle receives the packets of the recorded one, at the same times, after the same
preparation: connection, requests of streams, parameters, more than a minute of waiting. Every
difference between the two vehicles' messages is explained below.
"""

import gzip
import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as dialect

from sitl import Emulator
from sitl.autopilots import ardupilot, px4
from tests.recordings import ARDUCOPTER, ARDUCOPTER_CABLE, PX4, recorded
from tests.sitl.client import world
from tests.sitl.conformance import (
    Decoded,
    Packets,
    decoded,
    delays,
    differences,
    facts,
    replay,
    table,
    to_vehicle,
)

RECORDINGS = Path(__file__).parent.parent / "recordings"
BEFORE = 100.2
"""Seconds of the emulated vehicle before the recording starts; the fraction gives its ArduPilot the
same time between the first heartbeat and its check of the ground station as in the recording."""
CUT = 0.05
"""Seconds omitted at the end: the recordings end before the last answers."""

PLACE = "the recorded vehicles have other positions and headings"
RECEIVER = "the emulated receiver follows the world file, SIH's is poor, SITL's has RTK"
NOISE = "ideal sensors and level ground, which no client evaluates"
BATTERY = "SIH's and SITL's batteries do not discharge"
BUILD = "commits, machine and serial number of a build"

EXPLAINED: Mapping[str, Mapping[str, str]] = {
    PX4: {
        "GPS_RAW_INT.*": RECEIVER,
        "HOME_POSITION.*": PLACE + "; home moves with the estimate, which drifts more on SIH",
        "GLOBAL_POSITION_INT.*": PLACE,
        "ALTITUDE.*": NOISE,
        "ATTITUDE*": NOISE,
        "ESTIMATOR_STATUS.*": NOISE + "; SIH's terrain estimate is intermittent",
        "HIGHRES_IMU.*": NOISE,
        "ODOMETRY.*": NOISE,
        "POSITION_TARGET_LOCAL_NED.yaw": NOISE,
        "SCALED_PRESSURE.temperature": NOISE,
        "VFR_HUD.*": NOISE,
        "VIBRATION.*": NOISE,
        "DISTANCE_SENSOR.current_distance": "the emulated vehicle stands on its dropper",
        "BATTERY_STATUS.*": BATTERY,
        "SYS_STATUS.current_battery": BATTERY,
        "SYS_STATUS.load": "a constant load",
        "AUTOPILOT_VERSION.*": BUILD,
        "HEARTBEAT.*_mode": "it lands sooner: a heartbeat falls between disarming and the next command",
        "message OPEN_DRONE_ID_*": "remote identification, which no client evaluates",
        "message POSITION_TARGET_GLOBAL_INT": "the goal of AUTO modes, which no client evaluates",
        "message EVENT": "events, which STATUSTEXT reports too",
        "message COMMAND_LONG": "PX4's commands to gimbals: the vehicles have none",
        "rate of CURRENT_EVENT_SEQUENCE *": "EVENT triggers it too",
    },
    ARDUCOPTER: {
        "GPS_RAW_INT.*": RECEIVER,
        "HOME_POSITION.*": PLACE,
        "GPS_GLOBAL_ORIGIN.*": PLACE,
        "GLOBAL_POSITION_INT.*": PLACE,
        "ATTITUDE.*": NOISE,
        "SYS_STATUS.voltage_battery": BATTERY,
        "SYS_STATUS.load": "a constant load",
        "AUTOPILOT_VERSION.uid2": BUILD,
        "STATUSTEXT": "SITL reports the speed of ground contact, and its board number",
        "parameters: sorted": "the order of ArduPilot's list is that of its classes",
    },
}  # fmt: skip
ONE_SIDE_ONLY: Mapping[str, tuple[Any, Any]] = {
    PX4: (),
    ARDUCOPTER: ("SIM Hit ground", "3d1219c7c4c5404aaa1f6d2a48adfda4", "emulated 001"),
}  # fmt: skip
"""Start of texts that only one side sends."""
LANDS_SOONER = {"landed 4 → landed 1"}
"""Delays that depend on the height and on the drift of SIH's estimate on the ground."""
TABLES = {"px4": px4.PARAMETERS, "ardupilot": ardupilot.PARAMETERS}
SETTINGS = {"px4": "px4-1.16.0", "ardupilot": "arducopter-4.6.2"}


@dataclass(frozen=True)
class Flown:
    """Messages to both vehicles, and from the real and the emulated one."""

    uplink: list[Decoded]
    real: list[Decoded]
    emulated: list[Decoded]


def prepared(autopilot: str, uplink: Packets, mode: int | None) -> Packets:
    """Return packets that bring a new emulated vehicle to the initial state of the recording."""
    mav = dialect.MAVLink(None, 255, 190)
    beat = dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    packets = [(float(at), beat.pack(mav)) for at in range(-99, -94)]
    packets += [(-98.0 + 0.004 * k, message.pack(mav))
                for k, message in enumerate(_settings(autopilot))]  # fmt: skip
    if mode is not None:
        change = dialect.MAVLink_command_long_message(1, 1, 176, 0, 1, mode, 0, 0, 0, 0, 0)
        packets.append((-96.0, change.pack(mav)))
    requested = [
        packet for at, packet in uplink if at < 2.0 and packet[7] == 76 and 511 in _command(packet)
    ]
    packets += [(-95.9 + 0.001 * k, packet) for k, packet in enumerate(requested)]
    return sorted(packets, key=lambda one: one[0])


def _command(packet: bytes) -> tuple[int, ...]:
    return (dialect.MAVLink(None).decode(bytearray(packet)).command,)


def _settings(autopilot: str) -> list[Any]:
    """Return PARAM_SET of the recorded parameters that the emulated vehicle has."""
    path = RECORDINGS / f"{SETTINGS[autopilot]}-parameters.json.gz"
    messages = []
    for name, value in json.loads(gzip.decompress(path.read_bytes())).items():
        known = TABLES[autopilot].get(name)
        if known is None or name in {"MAV_SYS_ID", "SYSID_THISMAV"}:
            continue
        whole = isinstance(known, int)
        sent = value
        if whole and autopilot == "px4":
            (sent,) = struct.unpack("<f", struct.pack("<i", int(value)))
        kind = 6 if whole else 9
        messages.append(dialect.MAVLink_param_set_message(1, 1, name.encode(), sent, kind))
    return messages


@cache
def flown(name: str) -> Flown:
    autopilot = "px4" if name == PX4 else "ardupilot"
    log = list(recorded(name))
    end = log[-1][0] - CUT
    log = [entry for entry in log if entry[0] < end]
    uplink = to_vehicle(log, 1)
    before = prepared(autopilot, uplink, None if name == PX4 else 4)
    emulator = Emulator(world(1, autopilot=autopilot))
    downlink = replay(emulator, [*before, *uplink], 1, BEFORE, end)
    real = [(at, packet) for at, packet in log if packet[5] == 1]
    return Flown(decoded(uplink), decoded(real), decoded(downlink))


def _without(facts: dict[str, Any], name: str) -> dict[str, Any]:
    """Return facts without texts that only one side sends."""
    texts = facts["STATUSTEXT"]
    kept = tuple(
        one for one in texts if not one[1].startswith(tuple(ONE_SIDE_ONLY[name]) or ("\0",))
    )
    return {**facts, "STATUSTEXT": kept}


def _differences(name: str) -> dict[str, tuple[Any, Any]]:
    both = flown(name)
    real, other = facts(both.real, both.uplink), facts(both.emulated, both.uplink)
    known = [key for key in {*real, *other} if key.startswith("parameter ")]
    few = {key for key in known if key not in real or key not in other}
    return differences(real, other, lambda key: key in few)


@pytest.mark.parametrize("name", [PX4, ARDUCOPTER])
def test_messages_match_the_real_autopilot(name):
    """Messages, rates, flags, answers, modes, texts: every difference is explained above."""
    found = _differences(name)
    unexplained = {
        key: value
        for key, value in found.items()
        if not any(fnmatch(key, pattern) for pattern in EXPLAINED[name])
    }
    assert not unexplained, "\n" + table(unexplained)
    stale = [
        pattern for pattern in EXPLAINED[name] if not any(fnmatch(key, pattern) for key in found)
    ]
    assert not stale, "no longer different"


@pytest.mark.parametrize("name", [PX4, ARDUCOPTER])
def test_texts_match_the_real_autopilot(name):
    """Severity, text with its trailing tab, and whether it has an id."""
    both = flown(name)
    real, other = (
        _without(facts(downlink, both.uplink), name)["STATUSTEXT"]
        for downlink in (both.real, both.emulated)
    )
    assert real == other


@pytest.mark.parametrize("name", [PX4, ARDUCOPTER])
def test_delays_after_commands_match_the_real_autopilot(name):
    """Seconds from arming, take-off and landing commands to their effects."""
    both = flown(name)
    real, other = (delays(downlink, both.uplink) for downlink in (both.real, both.emulated))
    later = {"176 4 → armed 0", "landed 1 → armed 0"}
    assert real.keys() ^ other.keys() <= later
    both_ways = [key for key in real if key in other and key not in LANDS_SOONER]
    assert len(both_ways) >= 3
    apart = {key: (real[key], other[key]) for key in both_ways}
    assert all(abs(one - two) < 1.2 for one, two in apart.values()), apart


def test_a_real_arducopter_acknowledges_its_gripper_before_that_has_moved():
    """A servo has no feedback: a grip that misses the cable is acknowledged, too.

    The emulated gripper has a switch at its jaws, and answers when they have moved.
    """
    log = list(recorded(ARDUCOPTER_CABLE))
    told = [one for one in decoded(to_vehicle(log, 1)) if _is(one, "COMMAND_LONG", 211)]
    heard = decoded([(at, packet) for at, packet in log if packet[5] == 1])
    answers = [one for one in heard if _is(one, "COMMAND_ACK", 211)]
    texts = [one for one in heard if one.name == "STATUSTEXT"]
    assert [one.fields["param2"] for one in told] == [1.0, 0.0]
    assert [one.fields["result"] for one in answers] == [0, 0]
    for asked, answered, word in zip(told, answers, ("grabb", "releas"), strict=True):
        said = (one.at for one in texts if one.fields["text"].startswith(f"Gripper load {word}"))
        begins, ends = said
        assert 0.0 < answered.at - asked.at < 0.1
        assert 0.4 < ends - begins < 0.7


def _is(one: Decoded, name: str, command: int) -> bool:
    return one.name == name and one.fields["command"] == command
