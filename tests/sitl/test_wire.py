"""The emulator's fast parsing and packing, against pymavlink."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as dialect

from sitl import Emulator
from sitl.autopilots import telemetry
from sitl.protocol import wire
from tests.sitl.client import Ground, world

numbers = st.floats(width=32, allow_nan=True, allow_infinity=True)
small = st.integers(0, 255)


def same(one: float, other: float) -> bool:
    """Return whether two numbers are equal, NaN included."""
    return one == other or (math.isnan(one) and math.isnan(other))


@settings(max_examples=200, deadline=None)
@given(
    values=st.lists(numbers, min_size=11, max_size=11),
    mask=st.integers(0, 65535),
    addresses=st.tuples(small, small, small, small),
    frame=st.integers(0, 255),
    flipped=st.none() | st.tuples(st.integers(0, 64), st.integers(0, 7)),
)
def test_setpoints_are_parsed_as_by_pymavlink(
    values: list[float],
    mask: int,
    addresses: tuple[int, int, int, int],
    frame: int,
    flipped: tuple[int, int] | None,
) -> None:
    """Complete packets, packets without trailing zeros, and packets with a flipped bit."""
    system, component, *target = addresses
    mav = dialect.MAVLink(None, system, component)
    message = dialect.MAVLink_set_position_target_local_ned_message(
        17, *target, frame, mask, *values
    )
    data = bytearray(message.pack(mav))
    if flipped is not None and flipped[0] < len(data):
        data[flipped[0]] ^= 1 << flipped[1]
    reader = dialect.MAVLink(None)
    reader.robust_parsing = True
    theirs = [
        wire.setpoint_of(one)
        for one in reader.parse_buffer(bytes(data)) or []
        if one.get_type() == "SET_POSITION_TARGET_LOCAL_NED"
    ]
    # A flipped bit may give an unknown message number, which has no answer.
    ours: list[Any] = [
        one
        for one in wire.Receiver().feed(bytes(data))
        if not isinstance(one, dialect.MAVLink_unknown)
    ]
    assert len(ours) == len(theirs)
    for one, other in zip(ours, theirs, strict=True):
        assert type(one) is wire.Setpoint
        assert one[:6] == other[:6]
        mine, others = ((*each.values, each.yaw, each.yaw_rate) for each in (one, other))
        assert all(same(a, b) for a, b in zip(mine, others, strict=True))


@settings(max_examples=200, deadline=None)
@given(st.sampled_from(sorted(wire.LAYOUTS)), st.binary(max_size=255), small)
def test_frames_equal_pymavlinks(name: str, content: bytes, sequence: int) -> None:
    layout = wire.LAYOUTS[name]
    if layout.number not in dialect.mavlink_map:
        return
    size = layout.struct.size
    body = content[:size].ljust(size, b"\0")
    sender = wire.Sender(7, 3)
    sender.sequence = sequence
    frame = sender.frame(layout.number, body, layout.seed)
    kind = dialect.mavlink_map[layout.number]
    writer = dialect.MAVLink(None, 7, 3)
    writer.seq = (sequence + 1) % 256
    message = kind.__new__(kind)
    dialect.MAVLink_message.__init__(message, kind.id, kind.msgname)
    theirs = dialect.MAVLink_message._pack(message, writer, kind.crc_extra, body)
    assert frame == bytes(theirs)


def test_pymavlink_parses_the_packed_telemetry() -> None:
    """Fields that are packed by position have their meaning in pymavlink."""
    emulator = Emulator(world(2, autopilot="ardupilot"))
    emulator.step(3.0)
    vehicle = emulator.vehicles[0]
    vehicle.charge, vehicle.voltage, vehicle.current = 0.634, 15.4, 12.3
    reader = dialect.MAVLink(None)
    sender = wire.Sender(1)
    said = {}
    for name in ("HEARTBEAT", "SYS_STATUS", "EXTENDED_SYS_STATE", "LOCAL_POSITION_NED"):
        layout, body = wire.LAYOUTS[name], telemetry.MESSAGES[name](vehicle)
        assert body is not None
        (said[name],) = reader.parse_buffer(sender.frame(layout.number, body, layout.seed))
    beat, status = said["HEARTBEAT"], said["SYS_STATUS"]
    autopilot = vehicle.autopilot
    assert (beat.type, beat.autopilot, beat.system_status, beat.mavlink_version) == (2, 3, 3, 3)
    assert (beat.base_mode, beat.custom_mode) == (autopilot.base_mode(), autopilot.custom_mode())
    assert (status.voltage_battery, status.current_battery) == (15_400, 1_230)
    assert (status.battery_remaining, status.load) == (64, 350)
    ready = bool(status.onboard_control_sensors_health & dialect.MAV_SYS_STATUS_PREARM_CHECK)
    assert ready == autopilot.ready_to_arm()
    assert said["EXTENDED_SYS_STATE"].landed_state == dialect.MAV_LANDED_STATE_ON_GROUND
    local = said["LOCAL_POSITION_NED"]
    meant = vehicle.to_local(vehicle.estimated())
    assert np.allclose((local.x, local.y, local.z), meant, atol=1e-3)


def test_attitudes_match_the_thrust() -> None:
    """Level, tilted in all directions, on the ground and tumbling; against a rotation matrix."""
    emulator = Emulator(world(5))
    b, reader, sender = emulator.bodies, dialect.MAVLink(None), wire.Sender(1)
    b.thrust[:] = [[0, 0, 9.8], [3, 0, 9], [-2, 4, 8], [0, 0, 0.5], [1, 1, 9]]
    b.yaw[:] = [0.0, 0.5, -2.0, 3.0, 1.0]
    b.yaw_rate[:] = 0.3
    b.tumbling[4], b.tumble[4] = True, 4.0
    b.refresh()
    for vehicle in emulator.vehicles:
        layout, body = wire.LAYOUTS["ATTITUDE"], telemetry.MESSAGES["ATTITUDE"](vehicle)
        assert body is not None
        (said,) = reader.parse_buffer(sender.frame(layout.number, body, layout.seed))
        angles = telemetry.attitude(vehicle)
        assert (said.roll, said.pitch, said.yaw) == pytest.approx(angles, abs=1e-6)
        assert said.yawspeed == pytest.approx(-0.3)
        assert said.time_boot_ms == telemetry.boot_ms(vehicle)
        if vehicle.index < 3:
            cr, sr, cp, sp = (f(a) for a in (said.roll, said.pitch) for f in (math.cos, math.sin))
            heading = np.array([math.cos(said.yaw), math.sin(said.yaw), 0.0])
            aside = np.array([-heading[1], heading[0], 0.0])
            # the body's up axis in NED, from pitch and roll
            up = -(sp * cr * heading - sr * aside) - np.array([0.0, 0.0, cp * cr])
            east, north, upward = b.thrust[vehicle.index] / np.linalg.norm(b.thrust[vehicle.index])
            assert up == pytest.approx([north, east, -upward], abs=1e-6)


@pytest.fixture(scope="module")
def followers() -> Emulator:
    """Return two flying vehicles that follow setpoints."""
    ground = Ground(Emulator(world(2)))
    ground.run(1.0)
    stream = ground.toward({i: (3.0 * (i - 1), 0.0, 5.0) for i in ground.ids})
    ground.run(0.5, stream)
    for i in ground.ids:
        ground.command(i, 176, 1, 6, 0)
        ground.command(i, 400, 1)
    ground.run(8.0, stream)
    assert all(vehicle.autopilot.follows_setpoints for vehicle in ground.emulator.vehicles)
    return ground.emulator


def changes_by_setpoints(emulator: Emulator, pieces: list[bytes]) -> list[Any]:
    """Return the changes by setpoints for vehicle 1, and restore the state."""
    b = emulator.bodies
    autopilot: Any = emulator.vehicles[0].autopilot
    before = b.state.copy(), b.goal_yaw.copy(), b.position_axes.copy(), b.velocity_axes.copy()
    axes = dict(b._axes)
    last, at = autopilot.offboard, autopilot.offboard_at
    for piece in pieces:
        emulator.receive(1, piece, emulator.time + 0.5)
    taken = [b.state[0].tolist(), b.goal_yaw[0], b.position_axes[0].tolist(), autopilot.offboard_at]
    taken.append(repr(autopilot.offboard))
    b.state[:], b.goal_yaw[:], b.position_axes[:], b.velocity_axes[:] = before
    b._axes = axes
    b.refresh()
    autopilot.offboard, autopilot.offboard_at = last, at
    autopilot.all_axes = True
    autopilot.v.links[0].receiver = wire.Receiver()
    return taken


@settings(max_examples=150, deadline=None)
@given(
    values=st.lists(numbers | st.floats(-50, 50, width=32), min_size=11, max_size=11),
    mask=st.sampled_from([2048, 3072, 2048 | 512, 3576, 0x1C0]) | st.integers(0, 65535),
    address=st.tuples(st.sampled_from([0, 1, 2]), st.sampled_from([0, 1, 2, 190])),
    frame=st.sampled_from([1, 1, 1, 7, 8]),
    flipped=st.none() | st.tuples(st.integers(0, 64), st.integers(0, 7)),
)
def test_setpoints_in_a_batch_equal_single_ones(
    followers: Emulator,
    values: list[float],
    mask: int,
    address: tuple[int, int],
    frame: int,
    flipped: tuple[int, int] | None,
) -> None:
    """The compiled loop parses a packet in one piece, pymavlink one in two pieces."""
    message = dialect.MAVLink_set_position_target_local_ned_message(
        17, *address, frame, mask, *values
    )
    data = bytearray(message.pack(dialect.MAVLink(None, 255, 190)))
    if flipped is not None and flipped[0] < len(data):
        data[flipped[0]] ^= 1 << flipped[1]
    whole = bytes(data)
    in_pieces = changes_by_setpoints(followers, [whole[:20], whole[20:]])
    assert repr(changes_by_setpoints(followers, [whole])) == repr(in_pieces)
