"""What real and emulated autopilots do alone after the ground station has ended: the same."""

from functools import cache

import pytest
from pymavlink.dialects.v20 import common as dialect

from sitl import Emulator
from sitl.world import default_world
from tests.recordings import recorded
from tests.recordings.silence import HOLD, parameters, settings
from tests.recordings.trim import GROUND
from tests.sitl.conformance import Decoded, decoded, replay

RECORDINGS = {"px4": "px4-1.16.0-ground-station-ends"}
ARM = dialect.MAV_CMD_COMPONENT_ARM_DISARM
BEFORE = 20.0
"""Seconds of the emulated vehicle before the recording's packets; its parameters are set in it."""
FROM = 25.0
"""Seconds before the silence from which packets are played: the real one boots before."""
SLACK = 2.0
"""Largest difference of times, seconds: heartbeats come once a second, PX4 checks the link to its
ground station every 1.25 s, and its descent begins and ends more softly than the emulated one."""


@cache
def both(kind):
    """Return the messages of the real and of the emulated vehicle, and when they began."""
    log = list(recorded(RECORDINGS[kind]))
    uplink = [(at, packet) for at, packet in log if packet[5] == GROUND]
    silence = uplink[-1][0]
    played = [(at, packet) for at, packet in uplink if at > silence - FROM]
    mav = dialect.MAVLink(None, 255, 190)
    beats = [
        (played[0][0] - BEFORE + k, dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(mav))
        for k in range(1, int(BEFORE))
    ]
    configuration = [
        (played[0][0] - 15.0 + 0.01 * k, message.pack(mav))
        for k, message in enumerate(settings(kind))
    ]
    emulator = Emulator(default_world(1, [kind]))
    delay = BEFORE - played[0][0]
    downlink = replay(emulator, [*sorted(beats + configuration), *played], 1, delay, log[-1][0])
    real = [(at, packet) for at, packet in log if packet[5] == 1 and packet[6] == 1]
    return decoded(real), decoded(downlink), silence


def changes(messages, since) -> list[tuple[float, str]]:
    """Return the changes of mode, arming and landed state, with seconds after ``since``."""
    state: dict[str, int] = {}
    found = []
    for one in messages:
        for key, value in _state(one):
            if key in state and state[key] != value and one.at >= since:
                found.append((one.at - since, f"{key} {value}"))
            state[key] = value
    return found


def _state(one: Decoded):
    if one.name == "HEARTBEAT":
        yield "armed", one.fields["base_mode"] >> 7
        yield "mode", one.fields["custom_mode"]
    elif one.name == "EXTENDED_SYS_STATE":
        yield "landed", one.fields["landed_state"]


@pytest.mark.parametrize("what", ["mode", "armed", "landed"])
@pytest.mark.parametrize("kind", RECORDINGS)
def test_without_a_ground_station_both_do_the_same_at_the_same_times(kind, what):
    real, emulated, silence = both(kind)
    one, two = (
        [(at, change) for at, change in changes(messages, silence) if change.startswith(what)]
        for messages in (real, emulated)
    )
    assert one
    assert [change for _, change in one] == [change for _, change in two]
    for (at, change), (also, _) in zip(one, two, strict=True):
        assert abs(at - also) < SLACK, change


def test_px4_holds_at_once_and_lands_after_t():
    real, _, silence = both("px4")
    modes = [(at, int(what.split()[1])) for at, what in changes(real, silence) if "mode" in what]
    hold, land = 3 << 24 | 4 << 16, 6 << 24 | 4 << 16  # AUTO with its submodes
    assert [mode for _, mode in modes[:2]] == [hold, land]
    assert 0.5 <= modes[0][0] < 0.5 + SLACK
    # COM_DL_LOSS_T is T - 2 s, and the last heartbeat was sent up to a second before
    assert parameters("px4")["COM_DL_LOSS_T"] == HOLD - 2.0
    assert HOLD - 1.8 <= modes[1][0] < HOLD + 1.0


def test_px4_refuses_to_arm_without_a_ground_station_and_says_why():
    real, _, _ = both("px4")
    answers = [one.fields for one in real if one.name == "COMMAND_ACK"]
    assert [one["result"] for one in answers if one["command"] == ARM] == [1, 0]
    texts = "".join(one.fields["text"] for one in real if one.name == "STATUSTEXT")
    assert "Arming denied" in texts
    assert "No connection to the ground control station" in texts
