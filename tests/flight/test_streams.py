"""The packets of a tick, and their order."""

from collections import Counter

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from swarm.flight.router import Team
from swarm.mission.fleet import parse_fleet
from tests.network import Network, small_plan

SETPOINT = common.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED


def number(packet):
    return int.from_bytes(packet[7:10], "little")


def test_whatever_else_is_due_goes_out_behind_the_setpoints():
    flight = Network(small_plan()).in_fold(1.0)
    flight.sent.clear()
    flight.until_time(3.0)
    ticks = {}
    for now, _, data in flight.sent:
        ticks.setdefault(now, []).append(number(data) == SETPOINT)
    assert all(kinds[:3] == [True] * 3 and not any(kinds[3:]) for kinds in ticks.values())
    assert any(len(kinds) > 3 for kinds in ticks.values())


def listened(count, interval=None, seconds=8.0, rate=50.0, answered=False):
    """Which vehicles of a team are asked for their clocks, tick by tick.

    Where one request has been ``answered``, no other is.
    """
    listed = "\n".join(f"  - {{sysid: {k + 1}, links: [a], pad: {k + 1}}}" for k in range(count))
    text = f'schema: 1\nname: many\nlinks: {{a: "udpin://127.0.0.1:0"}}\nvehicles:\n{listed}\n'
    team = Team(parse_fleet(text, "many", [f"rates.setpoint={rate}"]), lambda *_: None)
    for k in range(count):
        beat = common.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3)
        team.receive("a", k, beat.pack(common.MAVLink(None, k + 1, 1)), 0.0)
        if answered:
            answer = common.MAVLink_timesync_message(1, 1)
            team.receive("a", k, answer.pack(common.MAVLink(None, k + 1, 1)), 0.01)
    if interval is not None:
        team.set_timesync_interval(interval)
    asked = []
    for tick in range(1, int(seconds * rate) + 1):
        sent = team.tick(tick / rate)
        asked.append([one.address for one in sent if number(one.data) == 111])
    return asked


@pytest.mark.parametrize("count", [1, 9, 100, 250])
def test_clock_requests_are_spread_over_ticks(count):
    asked = listened(count)
    assert max(len(one) for one in asked) <= max(10, count * 0.02 / 0.2 + 1)
    times = Counter(vehicle for one in asked for vehicle in one)
    assert set(times) == set(range(count))
    assert set(times.values()) <= {39, 40, 41}


def test_a_vehicle_that_does_not_answer_is_asked_at_every_tick():
    asked = listened(3, seconds=2.0, answered=True)
    first = next(k for k, one in enumerate(asked) if one)
    assert [len(one) for one in asked[first + 1 : first + 10]] == [0] * 9
    assert {tuple(sorted(one)) for one in asked[first + 11 :]} == {(0, 1, 2)}


@pytest.mark.parametrize("interval", [0.02, 0.1])
def test_clock_requests_follow_the_interval_of_a_soak(interval):
    asked = listened(100, interval, seconds=4.0)
    times = np.array(list(Counter(vehicle for one in asked for vehicle in one).values()))
    assert len(times) == 100
    assert np.abs(times - 4.0 / interval).max() <= 2
    assert max(len(one) for one in asked) <= 100 * 0.02 / interval + 1
