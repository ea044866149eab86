"""The emulator against recordings of the real autopilots, field by field.

An emulated vehicle is told what the real one was told, at the same times, after having been
prepared as that one was: connected to, its streams asked for, parameters set, left alone for over
a minute. What differs in what they say is listed, and is either mended or explained below.
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
from sitl.autopilots.ardupilot import tables as ardupilot_tables
from sitl.autopilots.px4 import tables as px4_tables
from tests.recordings import ARDUCOPTER, PX4, recorded
from tests.sitl.client import world
from tests.sitl.conformance import (
    Packets,
    Said,
    decoded,
    delays,
    differences,
    emulated,
    facts,
    table,
    to_vehicle,
)

RECORDINGS = Path(__file__).parent.parent / "recordings"
BEFORE = 100.2
"""Seconds for which the emulated vehicle lives before the recording begins; the fraction lets its
ArduPilot look for its ground station as long after the first heartbeat as the recorded one did."""
CUT = 0.05
"""Seconds at the end that are left out: the recordings end before the last answers."""

PLACE = "the recorded vehicles stand elsewhere on earth, at other headings"
RECEIVER = "the emulated receiver is as good as its world file says, SIH's is poor, SITL's has RTK"
NOISE = "ideal sensors, and a ground without slope: nothing reads them"
BATTERY = "SIH's and SITL's batteries do not run down"
BUILD = "commits, machine and serial number of a build"

KNOWN: Mapping[str, Mapping[str, str]] = {
    PX4: {
        "GPS_RAW_INT.*": RECEIVER,
        "HOME_POSITION.*": PLACE + "; home moves with the estimate, which strays more on SIH",
        "GLOBAL_POSITION_INT.*": PLACE,
        "ALTITUDE.*": NOISE,
        "ATTITUDE*": NOISE,
        "ESTIMATOR_STATUS.*": NOISE + "; SIH's terrain estimate comes and goes",
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
        "message OPEN_DRONE_ID_*": "remote identification: nothing reads it",
        "message POSITION_TARGET_GLOBAL_INT": "the goal of AUTO modes: nothing reads it",
        "message EVENT": "events, for which MAVLink has texts, too",
        "message COMMAND_LONG": "PX4's commands to gimbals: the vehicles have none",
        "rate of CURRENT_EVENT_SEQUENCE *": "it comes with EVENT, too",
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
        "STATUSTEXT": "SITL says how hard it hits the ground, and the number of its board",
        "parameters: sorted": "the order of ArduPilot's list is that of its classes",
    },
}  # fmt: skip
ELSEWHERE: Mapping[str, tuple[Any, Any]] = {
    PX4: (),
    ARDUCOPTER: ("SIM Hit ground", "3d1219c7c4c5404aaa1f6d2a48adfda4", "emulated 001"),
}  # fmt: skip
"""Texts that only one side says."""
LANDS_SOONER = {"landed 4 → landed 1"}
"""What depends on how high it was, and on an estimate that drifts while SIH's vehicle stands."""
TABLES = {"px4": px4_tables.PARAMETERS, "ardupilot": ardupilot_tables.PARAMETERS}
SETTINGS = {"px4": "px4-1.16.0", "ardupilot": "arducopter-4.6.2"}


@dataclass(frozen=True)
class Both:
    """What the real and the emulated vehicle were told and said."""

    told: list[Said]
    real: list[Said]
    emulated: list[Said]


def prepared(autopilot: str, told: Packets, mode: int | None) -> Packets:
    """Packets that bring a new emulated vehicle to where the recorded one began."""
    mav = dialect.MAVLink(None, 255, 190)
    beat = dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    packets = [(float(at), beat.pack(mav)) for at in range(-99, -94)]
    packets += [(-98.0 + 0.004 * k, message.pack(mav))
                for k, message in enumerate(_settings(autopilot))]  # fmt: skip
    if mode is not None:
        change = dialect.MAVLink_command_long_message(1, 1, 176, 0, 1, mode, 0, 0, 0, 0, 0)
        packets.append((-96.0, change.pack(mav)))
    asked = [
        packet for at, packet in told if at < 2.0 and packet[7] == 76 and 511 in _command(packet)
    ]
    packets += [(-95.9 + 0.001 * k, packet) for k, packet in enumerate(asked)]
    return sorted(packets, key=lambda one: one[0])


def _command(packet: bytes) -> tuple[int, ...]:
    return (dialect.MAVLink(None).decode(bytearray(packet)).command,)


def _settings(autopilot: str) -> list[Any]:
    """The recorded vehicle's parameters, as far as the emulated one has them."""
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
def flown(name: str) -> Both:
    autopilot = "px4" if name == PX4 else "ardupilot"
    log = list(recorded(name))
    end = log[-1][0] - CUT
    log = [entry for entry in log if entry[0] < end]
    told = to_vehicle(log, 1)
    before = prepared(autopilot, told, None if name == PX4 else 4)
    emulator = Emulator(world(1, autopilot=autopilot))
    said = emulated(emulator, [*before, *told], 1, BEFORE, end)
    real = [(at, packet) for at, packet in log if packet[5] == 1]
    return Both(decoded(told), decoded(real), decoded(said))


def _without(facts: dict[str, Any], name: str) -> dict[str, Any]:
    """Leave texts out that are known to be said on one side only."""
    texts = facts["STATUSTEXT"]
    kept = tuple(one for one in texts if not one[1].startswith(tuple(ELSEWHERE[name]) or ("\0",)))
    return {**facts, "STATUSTEXT": kept}


def _differences(name: str) -> dict[str, tuple[Any, Any]]:
    both = flown(name)
    real, other = facts(both.real, both.told), facts(both.emulated, both.told)
    known = [key for key in {*real, *other} if key.startswith("parameter ")]
    few = {key for key in known if key not in real or key not in other}
    return differences(real, other, lambda key: key in few)


@pytest.mark.parametrize("name", [PX4, ARDUCOPTER])
def test_the_emulator_says_what_the_real_autopilot_says(name):
    """Messages, rates, flags, answers, modes, texts: whatever differs has its reason above."""
    found = _differences(name)
    unexplained = {
        key: value
        for key, value in found.items()
        if not any(fnmatch(key, pattern) for pattern in KNOWN[name])
    }
    assert not unexplained, "\n" + table(unexplained)
    stale = [pattern for pattern in KNOWN[name] if not any(fnmatch(key, pattern) for key in found)]
    assert not stale, "no longer different"


@pytest.mark.parametrize("name", [PX4, ARDUCOPTER])
def test_the_emulators_texts_are_those_of_the_real_autopilot(name):
    """Severity, wording with its trailing tab, and whether a text has a number."""
    both = flown(name)
    real, other = (
        _without(facts(said, both.told), name)["STATUSTEXT"] for said in (both.real, both.emulated)
    )
    assert real == other


@pytest.mark.parametrize("name", [PX4, ARDUCOPTER])
def test_what_follows_a_command_follows_as_soon(name):
    """Seconds from arming, take-off and landing commands to what they bring."""
    both = flown(name)
    real, other = (delays(said, both.told) for said in (both.real, both.emulated))
    later = {"176 4 → armed 0", "landed 1 → armed 0"}
    assert real.keys() ^ other.keys() <= later
    both_ways = [key for key in real if key in other and key not in LANDS_SOONER]
    assert len(both_ways) >= 3
    apart = {key: (real[key], other[key]) for key in both_ways}
    assert all(abs(one - two) < 1.2 for one, two in apart.values()), apart
