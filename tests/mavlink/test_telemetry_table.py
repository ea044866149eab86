"""Reading for the whole team at once equals reading packet by packet."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from swarm.flight.router import Team
from swarm.mavlink.telemetry_table import TelemetryTable
from swarm.mission.fleet import emulated_fleet

SYSTEMS = (1, 2, 3)
number = st.floats(-100.0, 100.0, width=32)
boot = st.integers(0, 20_000)


@st.composite
def packets(draw):
    """A packet of a vehicle or of a camera on board, intact or damaged by a bad link."""
    sender = common.MAVLink(
        None, draw(st.sampled_from(SYSTEMS)), draw(st.sampled_from([1, 1, 100]))
    )
    sender.seq = draw(st.integers(0, 255))
    x, y, z = draw(st.tuples(number, number, number))
    time = draw(boot)
    message = draw(
        st.sampled_from(
            [
                common.MAVLink_local_position_ned_message(time, x, y, z, y, z, x),
                common.MAVLink_attitude_message(time, x, y, z, 0.0, 0.0, 0.0),
                common.MAVLink_attitude_message(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
                common.MAVLink_global_position_int_message(time, 0, 0, 0, 0, 0, 0, 0, 0),
                common.MAVLink_gps_raw_int_message(time, 3, 0, 0, 500, 0, 0, 0, 0, 9),
                common.MAVLink_gps_global_origin_message(0, 0, 0),
                common.MAVLink_heartbeat_message(2, common.MAV_AUTOPILOT_PX4, 128, 6 << 16, 4, 3),
                common.MAVLink_statustext_message(3, b"words"),
                common.MAVLink_vfr_hud_message(1.0, 1.0, 0, 0, 0.0, 0.0),
            ]
        )
    )
    data = bytes(message.pack(sender))
    match draw(st.integers(0, 12)):
        case 0:
            return data[: draw(st.integers(0, len(data)))]
        case 1:
            place = draw(st.integers(0, len(data) - 1))
            return (
                data[:place] + bytes([data[place] ^ draw(st.integers(1, 255))]) + data[place + 1 :]
            )
        case 2:
            return draw(st.binary(max_size=30)) + data
    return data


def team():
    """A team whose vehicles have all been discovered, and the list of its reports."""
    reports = []
    new = Team(emulated_fleet(len(SYSTEMS)), lambda *report: reports.append(report))
    for system in SYSTEMS:
        vehicle = common.MAVLink(None, system, 1)
        beat = common.MAVLink_heartbeat_message(2, common.MAV_AUTOPILOT_PX4, 0, 4 << 16, 4, 3)
        new.receive("loopback", system, bytes(beat.pack(vehicle)), 0.0)
    return new, reports


def state(team):
    """The state of a team's vehicles, and their events."""
    return [
        (
            v.take_events(), v.received_at, v.position_at, v.position, v.velocity, v.attitude, v.boot_ms,
            v.packets, v.lost_packets, v.component, v.custom_mode, v.height_difference, v.origin_mismatches,
            v.texts, v.unhandled,
        )
        for v in team.vehicles.values()
    ]  # fmt: skip


@pytest.mark.slow
@settings(max_examples=120, deadline=None)
@given(
    st.lists(
        st.lists(
            st.tuples(st.sampled_from([*SYSTEMS, 9]), st.lists(packets(), min_size=1, max_size=5)),
            max_size=4,
        ),
        max_size=6,
    )
)
def test_reading_the_whole_team_equals_reading_one_by_one(ticks):
    """From the vehicle's own address or another, whole or damaged, in order or not."""
    (one_by_one, singly), (at_once, together) = team(), team()
    for tick, datagrams in enumerate(ticks, 1):
        arrived = [(address, b"".join(parts)) for address, parts in datagrams]
        for address, data in arrived:
            one_by_one.receive("loopback", address, data, 0.05 * tick)
        at_once.receive_all("loopback", arrived, 0.05 * tick)
        assert repr(state(at_once)) == repr(state(one_by_one))
    assert (together, at_once.rejected) == (singly, one_by_one.rejected)


def test_undiscovered_vehicles_have_no_state():
    table = TelemetryTable(2)
    known, _ = team()
    fresh = Team(emulated_fleet(2), lambda *_: None).vehicles[1]
    assert (fresh.received_at, fresh.position_at) == (-math.inf, -math.inf)
    assert np.isnan([*fresh.position, *fresh.velocity, *fresh.attitude]).all()
    assert (fresh.boot_ms, fresh.packets, fresh.lost_packets, fresh.component) == (-1, 0, 0, 1)
    assert table.values.shape == (2, 29)
    assert known.vehicles[1].packets == 1


def test_a_copy_of_a_vehicle_does_not_change():
    from copy import copy

    known, _ = team()
    vehicle = known.vehicles[2]
    vehicle.position = (1.0, 2.0, 3.0)
    twin = copy(vehicle)
    vehicle.position = (4.0, 5.0, 6.0)
    assert twin.position == pytest.approx((1.0, 2.0, 3.0))
    assert known.vehicles[1].position != vehicle.position
