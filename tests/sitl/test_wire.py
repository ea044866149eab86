"""The emulator's quick ways to read and write packets, against pymavlink."""

import math
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as dialect

from sitl import Emulator, telemetry, wire
from tests.sitl.client import world

numbers = st.floats(width=32, allow_nan=True, allow_infinity=True)
small = st.integers(0, 255)


def same(one: float, other: float) -> bool:
    """Whether two numbers are the same; NaN is."""
    return one == other or (math.isnan(one) and math.isnan(other))


@settings(max_examples=200, deadline=None)
@given(
    values=st.lists(numbers, min_size=11, max_size=11),
    mask=st.integers(0, 65535),
    addresses=st.tuples(small, small, small, small),
    frame=st.integers(0, 255),
    flipped=st.none() | st.tuples(st.integers(0, 64), st.integers(0, 7)),
)
def test_setpoints_are_read_as_pymavlink_reads_them(
    values: list[float],
    mask: int,
    addresses: tuple[int, int, int, int],
    frame: int,
    flipped: tuple[int, int] | None,
) -> None:
    """Whole ones, those whose trailing zeros are cut off, and those with a flipped bit."""
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
    # A flipped bit may make a message of a number that nobody knows; nobody answers it.
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
def test_frames_are_pymavlinks_byte_for_byte(name: str, content: bytes, sequence: int) -> None:
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


def test_all_that_vehicles_say_is_read_by_pymavlink_as_it_is_meant() -> None:
    """States that are packed by place are what their names say."""
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
    autopilot = vehicle.personality
    assert (beat.type, beat.autopilot, beat.system_status, beat.mavlink_version) == (2, 3, 3, 3)
    assert (beat.base_mode, beat.custom_mode) == (autopilot.base_mode(), autopilot.custom_mode())
    assert (status.voltage_battery, status.current_battery) == (15_400, 1_230)
    assert (status.battery_remaining, status.load) == (64, 350)
    ready = bool(status.onboard_control_sensors_health & dialect.MAV_SYS_STATUS_PREARM_CHECK)
    assert ready == autopilot.ready()
    assert said["EXTENDED_SYS_STATE"].landed_state == dialect.MAV_LANDED_STATE_ON_GROUND
    local = said["LOCAL_POSITION_NED"]
    meant = vehicle.to_local(vehicle.estimated())
    assert np.allclose((local.x, local.y, local.z), meant, atol=1e-3)
