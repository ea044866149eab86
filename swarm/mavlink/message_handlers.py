"""Handlers of MAVLink messages: each changes the state of a vehicle. One function per message."""

import math
from collections.abc import Callable, Mapping
from typing import Final

from pymavlink.dialects.v20 import common

from swarm.errors import printable
from swarm.mavlink.autopilots import flying_autopilot
from swarm.mavlink.fence import Fence
from swarm.mavlink.frames import Origin, to_local
from swarm.mavlink.packets import CURRENT_MODE, PARAM_VALUE, Message
from swarm.mavlink.telemetry_table import (
    ATTITUDE_TIME,
    BOOT_TIME,
    DIRECT,
    GLOBAL_TIME,
    LATE,
    follows,
    take_position_time,
    take_time,
)
from swarm.mavlink.vehicle_state import IN_AIR, ON_GROUND, TextChunks, VehicleState

_ARMED = int(common.MAV_MODE_FLAG_SAFETY_ARMED)
_PREARM = int(common.MAV_SYS_STATUS_PREARM_CHECK)
_POSITION_SENSORS = int(
    common.MAV_SYS_STATUS_AHRS | common.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
)
_ORIGIN_MOVED = 0.05
_MAX_POSITION_AGE = 0.3
_MAX_VERTICAL_SPEED = 1.0
"""m/s: below it, a receiver's height is at most 0.2 m behind: receivers are up to 0.2 s late; PX4
assumes 0.11 s (EKF2_GPS_DELAY). The least drift that counts is 0.3 m."""
_HEIGHT_DRIFT = 0.2
"""m/s: a receiver with an accuracy of one metre is averaged over five seconds."""
_MAX_MISMATCH = 1.0
_MISMATCH_SAMPLES = 3
_REBOOT_TIME = 0.5
"""Seconds for which no other clock than the new one must be received after a reboot."""
_CLOCK_TOLERANCE = 2.0
"""Seconds by which packets and clocks may be late: two clocks differ by more."""
_TEXT_LENGTH = 50
_TEXT_TIME = 1.0
"""Seconds within which all chunks of a text arrive: they are sent one after the other."""
_LOST_CHUNKS = "[…]".encode()


def _heartbeat(vehicle: VehicleState, message: Message, now: float) -> None:
    kind = flying_autopilot(vehicle.component, message)
    if kind is None:
        return
    vehicle.autopilot = vehicle.autopilot or kind
    first = vehicle.heartbeat_at == -math.inf
    vehicle.heartbeat_at = vehicle.received_at = now
    armed = bool(message.base_mode & _ARMED)
    if first:
        vehicle.report("discovered", f"discovered: {vehicle.autopilot.name}")
    if not vehicle.believes("heartbeat", (armed, message.custom_mode)):
        return
    vehicle.system_status = message.system_status
    _set_mode(vehicle, message.custom_mode, now)
    if armed != vehicle.armed:
        vehicle.armed = armed
        vehicle.report("armed" if armed else "disarmed", "armed" if armed else "disarmed")


def _current_mode(vehicle: VehicleState, message: Message, now: float) -> None:
    if vehicle.believes("mode", message.custom_mode):
        _set_mode(vehicle, message.custom_mode, now)


def _set_mode(vehicle: VehicleState, custom_mode: int, now: float) -> None:
    vehicle.mode_at = now
    if custom_mode != vehicle.custom_mode:
        vehicle.custom_mode = custom_mode
        vehicle.report("mode", f"mode {vehicle.mode}", vehicle.mode)


def _local_position(vehicle: VehicleState, message: Message, now: float) -> None:
    row, boot_ms = vehicle.values, float(message.time_boot_ms)
    if not take_time(row, BOOT_TIME, boot_ms):
        if not _rebooted(vehicle, boot_ms, now):
            return
        row[[BOOT_TIME, ATTITUDE_TIME, GLOBAL_TIME]] = -1.0
        take_time(row, BOOT_TIME, boot_ms)
        vehicle.report("rebooted", "rebooted: its clock went back")
    take_position_time(row, boot_ms, now)
    vehicle.position = (message.x, message.y, message.z)
    vehicle.velocity = (message.vx, message.vy, message.vz)


def _rebooted(vehicle: VehicleState, boot_ms: float, now: float) -> bool:
    """Return whether positions of another clock show that the vehicle has started anew.

    Late ones do not: positions of the known clock arrive between them, or they tell a longer time
    since boot than has passed since the last of those.
    """
    position_at, since, last, count = vehicle.other_clock
    if position_at != vehicle.position_at or not follows(boot_ms, last):
        since, count = now, 0
    vehicle.other_clock = vehicle.position_at, since, boot_ms, count + 1
    longest = now - vehicle.position_at + _CLOCK_TOLERANCE
    return count >= 2 and now - since >= _REBOOT_TIME and boot_ms * 1e-3 <= longest


def _global_position(vehicle: VehicleState, message: Message, now: float) -> None:
    if not take_time(vehicle.values, GLOBAL_TIME, float(message.time_boot_ms)):
        return
    position = Origin(message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3)
    vehicle.global_position = position
    _compare_positions(vehicle, position, now)


def _gps(vehicle: VehicleState, message: Message, now: float) -> None:
    if vehicle.order != DIRECT and message.time_usec <= vehicle.gps_time:
        return
    vehicle.gps_time = message.time_usec
    vehicle.fix_type, vehicle.satellites = message.fix_type, message.satellites_visible
    vehicle.horizontal_accuracy = message.h_acc * 1e-3 if message.h_acc else math.nan
    vehicle.vertical_accuracy = message.v_acc * 1e-3 if message.v_acc else math.nan
    if vehicle.origin is None or message.fix_type < 3:
        return
    age, sinking = now - vehicle.position_at, vehicle.velocity[2]
    if age < _MAX_POSITION_AGE and abs(sinking) < _MAX_VERTICAL_SPEED:
        height = vehicle.origin.altitude - vehicle.position[2] - age * sinking
        _average_height(vehicle, message.alt * 1e-3 - height, now)


def _average_height(vehicle: VehicleState, difference: float, now: float) -> None:
    """Average the satellite height, for longer if its stated accuracy is lower.

    The altitude of a poor receiver, and of PX4's simulated one, jumps by half a metre.
    """
    accuracy = vehicle.vertical_accuracy
    window = 0.0 if math.isnan(accuracy) else accuracy / _HEIGHT_DRIFT
    since, at, mean = vehicle.height_average
    if math.isnan(mean):
        since, mean = now, difference
    else:
        step = max(now - at, 1e-3)
        mean += (difference - mean) * step / (min(window, at - since) + step)
    vehicle.height_average = since, now, mean
    vehicle.height_difference = mean if now - since >= window else math.nan


def _compare_positions(vehicle: VehicleState, position: Origin, now: float) -> None:
    """Compare the global with the local position: both must refer to the same origin.

    A reset of the estimator moves one against the other. A single sample may be out of step.
    """
    age = now - vehicle.position_at
    if vehicle.origin is None or vehicle.autopilot is None or not age < _MAX_POSITION_AGE:
        return
    expected = to_local(vehicle.autopilot.name, vehicle.origin, position)
    local, velocity = vehicle.position, vehicle.velocity
    error = [expected[k] - local[k] - age * velocity[k] for k in (0, 1)]
    distance = math.hypot(*error)
    mismatch = distance > _MAX_MISMATCH
    vehicle.origin_mismatches = vehicle.origin_mismatches + 1 if mismatch else 0
    if vehicle.origin_mismatches == _MISMATCH_SAMPLES:
        vehicle.report("origin", f"its local and global positions are {distance:.1f} m apart")


def _attitude(vehicle: VehicleState, message: Message, _now: float) -> None:
    if take_time(vehicle.values, ATTITUDE_TIME, float(message.time_boot_ms)):
        vehicle.attitude = (message.roll, message.pitch, message.yaw)


def _global_origin(vehicle: VehicleState, message: Message, _now: float) -> None:
    # messages with different sequence numbers are never equal
    if not vehicle.believes("origin", (message.latitude, message.longitude, message.altitude)):
        return
    origin = Origin(message.latitude * 1e-7, message.longitude * 1e-7, message.altitude * 1e-3)
    if vehicle.origin is not None and _distance(origin, vehicle.origin) > _ORIGIN_MOVED:
        moved = _distance(origin, vehicle.origin)
        vehicle.report("origin", f"its estimator's origin moved by {moved:.2f} m")
    vehicle.origin = origin


def _extended_state(vehicle: VehicleState, message: Message, _now: float) -> None:
    if not vehicle.believes("landed", message.landed_state):
        return
    before, vehicle.landed_state = vehicle.landed_state, message.landed_state
    if before != vehicle.landed_state and vehicle.landed_state == ON_GROUND:
        vehicle.report("landed", "on the ground")
    elif before != vehicle.landed_state and vehicle.landed_state == IN_AIR:
        vehicle.report("airborne", "in the air")


def _system_status(vehicle: VehicleState, message: Message, _now: float) -> None:
    health = message.onboard_control_sensors_health & (_PREARM | _POSITION_SENSORS)
    if not vehicle.believes("health", health):
        return
    vehicle.battery = (
        message.battery_remaining / 100.0 if message.battery_remaining >= 0 else math.nan
    )
    vehicle.voltage = message.voltage_battery / 1000.0
    enabled = message.onboard_control_sensors_enabled & _POSITION_SENSORS
    vehicle.position_healthy = not enabled & ~message.onboard_control_sensors_health
    autopilot = vehicle.autopilot
    health_only = autopilot is not None and not autopilot.lists_prearm_as_present
    if health_only or message.onboard_control_sensors_present & _PREARM:
        vehicle.ready = bool(message.onboard_control_sensors_health & _PREARM)


def _status_text(vehicle: VehicleState, message: Message, now: float) -> None:
    read_text(vehicle, message, now, vehicle.component)


def read_text(vehicle: VehicleState, message: Message, now: float, component: int) -> None:
    """Read a STATUSTEXT of a component with the vehicle's system id.

    Chunks are joined as bytes, since a character may have several. A chunk with less than 50 bytes
    is the last. Id 0 stands for a text of one chunk; but PX4 counts its ids from 0, so a full chunk
    of that id may have a successor as well.
    """
    raw, place = message.text.split(b"\0", 1)[0], message.chunk_seq
    said = vehicle.said_texts.get(component)
    if said is not None and message.id == said.id != 0 and said.chunks.get(place) == raw:
        return
    text = vehicle.text_chunks.get(component)
    if text is not None and (text.id != message.id or text.chunks.get(place, raw) != raw):
        _end_text(vehicle, component, now)
        text = None
    if text is None:
        text = vehicle.text_chunks[component] = TextChunks(message.id, message.severity, now)
    text.chunks[place] = raw
    last = max(text.chunks)
    if len(text.chunks) == last + 1 and len(text.chunks[last]) < _TEXT_LENGTH:
        _end_text(vehicle, component, now)


def end_texts(vehicle: VehicleState, now: float) -> None:
    """Report the texts whose further chunks have not arrived in time."""
    late = [k for k, text in vehicle.text_chunks.items() if now - text.since > _TEXT_TIME]
    for component in late:
        _end_text(vehicle, component, now)


def _end_text(vehicle: VehicleState, component: int, now: float) -> None:
    """Report a text with the chunks that have arrived, and a mark in the place of lost ones."""
    ended = vehicle.said_texts[component] = vehicle.text_chunks.pop(component)
    joined, following = b"", 0
    for place, raw in sorted(ended.chunks.items()):
        joined += (_LOST_CHUNKS if place > following else b"") + raw
        following = place + 1
    if ended.id and len(ended.chunks[following - 1]) >= _TEXT_LENGTH:
        joined += _LOST_CHUNKS
    text = printable(joined.decode("utf-8", "replace")).strip()
    if not text:
        return
    if component == vehicle.component:
        vehicle.texts = [*vehicle.texts[-31:], (now, ended.severity, text)]
    else:
        text = f"component {component}: {text}"
    vehicle.report(_text_kind(ended.severity), text)


def _text_kind(severity: int) -> str:
    if severity <= common.MAV_SEVERITY_ERROR:
        return "text error"
    return "text warning" if severity == common.MAV_SEVERITY_WARNING else "text"


def _command_ack(vehicle: VehicleState, message: Message, now: float) -> None:
    if vehicle.order != LATE:
        vehicle.commands.acknowledge(message, now)


def _timesync(vehicle: VehicleState, message: Message, now: float) -> None:
    if message.tc1 == 0 or message.ts1 <= 0:
        return
    sent = message.ts1 * 1e-9
    if not 0.0 <= now - sent < 10.0 or sent < vehicle.timesync_sent:
        return
    round_trip, offset = now - sent, message.tc1 * 1e-9 - (sent + now) / 2.0
    if sent == vehicle.timesync_sent:
        apart = abs(offset - vehicle.latest_clock_offset)
        vehicle.second_clock |= apart > _CLOCK_TOLERANCE + round_trip / 2.0
        return
    vehicle.timesync_at, vehicle.timesync_sent, vehicle.asked_at = now, sent, math.inf
    vehicle.latest_round_trip, vehicle.latest_clock_offset = round_trip, offset
    if not vehicle.round_trip <= round_trip:
        vehicle.clock_offset = vehicle.latest_clock_offset
        vehicle.round_trip = round_trip


def _distance(one: Origin, other: Origin) -> float:
    """Return the approximate distance in metres between two places that are close together."""
    north = math.radians(one.latitude - other.latitude) * 6_371_000.0
    east = math.radians(one.longitude - other.longitude) * 6_371_000.0
    east *= math.cos(math.radians(one.latitude))
    return math.hypot(north, east, one.altitude - other.altitude)


def _parameter(vehicle: VehicleState, message: Message, now: float) -> None:
    if vehicle.autopilot is not None:
        bytewise = vehicle.autopilot.bytewise
        vehicle.parameters.receive(message, bytewise=bytewise, now=now)


def _to_fence(
    process: Callable[[Fence, Message], None],
) -> Callable[[VehicleState, Message, float], None]:
    return lambda vehicle, message, _: process(vehicle.fence, message)


HANDLERS: Final[Mapping[int, Callable[[VehicleState, Message, float], None]]] = {
    int(common.MAVLINK_MSG_ID_HEARTBEAT): _heartbeat,
    CURRENT_MODE: _current_mode,
    int(common.MAVLINK_MSG_ID_LOCAL_POSITION_NED): _local_position,
    int(common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT): _global_position,
    int(common.MAVLINK_MSG_ID_GPS_RAW_INT): _gps,
    int(common.MAVLINK_MSG_ID_ATTITUDE): _attitude,
    int(common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN): _global_origin,
    int(common.MAVLINK_MSG_ID_EXTENDED_SYS_STATE): _extended_state,
    int(common.MAVLINK_MSG_ID_SYS_STATUS): _system_status,
    int(common.MAVLINK_MSG_ID_STATUSTEXT): _status_text,
    int(common.MAVLINK_MSG_ID_COMMAND_ACK): _command_ack,
    int(common.MAVLINK_MSG_ID_TIMESYNC): _timesync,
    PARAM_VALUE: _parameter,
    int(common.MAVLINK_MSG_ID_MISSION_COUNT): _to_fence(Fence.counted),
    int(common.MAVLINK_MSG_ID_MISSION_REQUEST): _to_fence(Fence.requested),
    int(common.MAVLINK_MSG_ID_MISSION_REQUEST_INT): lambda v, message, _: v.fence.requested(
        message
    ),
    int(common.MAVLINK_MSG_ID_MISSION_ITEM_INT): _to_fence(Fence.item),
    int(common.MAVLINK_MSG_ID_MISSION_ACK): _to_fence(Fence.acknowledged),
}

HANDLED_MESSAGES: Final = frozenset(HANDLERS)
"""Numbers of the messages that a vehicle's state is made of."""
