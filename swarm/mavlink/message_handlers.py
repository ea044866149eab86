"""Handlers of MAVLink messages: each changes the state of a vehicle. One function per message."""

import math
from collections.abc import Callable, Mapping
from typing import Final

from pymavlink.dialects.v20 import common

from swarm.mavlink.autopilots import AUTOPILOTS
from swarm.mavlink.frames import Origin, to_local
from swarm.mavlink.packets import CURRENT_MODE, PARAM_VALUE, Message
from swarm.mavlink.telemetry_table import REBOOT_STEP
from swarm.mavlink.vehicle_state import IN_AIR, ON_GROUND, VehicleState

_ARMED = int(common.MAV_MODE_FLAG_SAFETY_ARMED)
_PREARM = int(common.MAV_SYS_STATUS_PREARM_CHECK)
_POSITION_SENSORS = int(
    common.MAV_SYS_STATUS_AHRS | common.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
)
_ORIGIN_MOVED = 0.05
_MAX_POSITION_AGE = 0.3
_MAX_VERTICAL_SPEED = 0.3
"""m/s: below it, heights that are not reported at the same time can be compared."""
_HEIGHT_DRIFT = 0.2
"""m/s: a receiver with an accuracy of one metre is averaged over five seconds."""
_MAX_MISMATCH = 1.0
_MISMATCH_SAMPLES = 3
_TEXT_LENGTH = 50


def _heartbeat(vehicle: VehicleState, message: Message, now: float) -> None:
    if message.autopilot == common.MAV_AUTOPILOT_INVALID:
        return
    if vehicle.autopilot is None:
        vehicle.autopilot = AUTOPILOTS.get(message.autopilot)
    first = vehicle.heartbeat_at == -math.inf
    vehicle.heartbeat_at = vehicle.received_at = now
    vehicle.component = vehicle.commands.component = vehicle.latest_component
    armed = bool(message.base_mode & _ARMED)
    vehicle.system_status = message.system_status
    if first:
        name = vehicle.autopilot.name if vehicle.autopilot else "unknown"
        vehicle.report("discovered", f"discovered: {name}")
    _current_mode(vehicle, message, now)
    if armed != vehicle.armed:
        vehicle.armed = armed
        vehicle.report("armed" if armed else "disarmed", "armed" if armed else "disarmed")


def _current_mode(vehicle: VehicleState, message: Message, now: float) -> None:
    vehicle.mode_at = now
    if message.custom_mode != vehicle.custom_mode:
        vehicle.custom_mode = message.custom_mode
        vehicle.report("mode", f"mode {vehicle.mode}", vehicle.mode)


def _local_position(vehicle: VehicleState, message: Message, now: float) -> None:
    vehicle.position = (message.x, message.y, message.z)
    vehicle.velocity = (message.vx, message.vy, message.vz)
    vehicle.position_at = now
    _boot_time(vehicle, message.time_boot_ms)


def _boot_time(vehicle: VehicleState, boot_ms: int) -> None:
    if boot_ms < vehicle.boot_ms - REBOOT_STEP:
        vehicle.reboots += 1
        vehicle.report("rebooted", "rebooted: its clock went back")
    vehicle.boot_ms = boot_ms


def _global_position(vehicle: VehicleState, message: Message, now: float) -> None:
    position = Origin(message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3)
    vehicle.global_position = position
    _compare_positions(vehicle, position, now)


def _gps(vehicle: VehicleState, message: Message, now: float) -> None:
    vehicle.fix_type, vehicle.satellites = message.fix_type, message.satellites_visible
    vehicle.horizontal_accuracy = message.h_acc * 1e-3 if message.h_acc else math.nan
    vehicle.vertical_accuracy = message.v_acc * 1e-3 if message.v_acc else math.nan
    if vehicle.origin is None or message.fix_type < 3:
        return
    age = now - vehicle.position_at
    if age < _MAX_POSITION_AGE and abs(vehicle.velocity[2]) < _MAX_VERTICAL_SPEED:
        difference = message.alt * 1e-3 - (vehicle.origin.altitude - vehicle.position[2])
        _average_height(vehicle, difference, now)


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
    vehicle.attitude = (message.roll, message.pitch, message.yaw)


def _global_origin(vehicle: VehicleState, message: Message, _now: float) -> None:
    origin = Origin(message.latitude * 1e-7, message.longitude * 1e-7, message.altitude * 1e-3)
    if vehicle.origin is not None and _distance(origin, vehicle.origin) > _ORIGIN_MOVED:
        moved = _distance(origin, vehicle.origin)
        vehicle.report("origin", f"its estimator's origin moved by {moved:.2f} m")
    vehicle.origin = origin


def _extended_state(vehicle: VehicleState, message: Message, _now: float) -> None:
    before, vehicle.landed_state = vehicle.landed_state, message.landed_state
    if before != vehicle.landed_state and vehicle.landed_state == ON_GROUND:
        vehicle.report("landed", "on the ground")
    elif before != vehicle.landed_state and vehicle.landed_state == IN_AIR:
        vehicle.report("airborne", "in the air")


def _system_status(vehicle: VehicleState, message: Message, _now: float) -> None:
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
    text = message.text.split(b"\0", 1)[0].decode("utf-8", "replace")
    if message.id:
        key = vehicle.latest_component << 16 | message.id
        parts = vehicle.text_chunks.setdefault(key, [])
        parts.append(text)
        if len(text) >= _TEXT_LENGTH and len(parts) < 16:
            return
        text = "".join(vehicle.text_chunks.pop(key))
    text = text.strip()
    if not text:
        return
    vehicle.texts = [*vehicle.texts[-31:], (now, message.severity, text)]
    vehicle.report(_text_kind(message.severity), text)


def _text_kind(severity: int) -> str:
    if severity <= common.MAV_SEVERITY_ERROR:
        return "text error"
    return "text warning" if severity == common.MAV_SEVERITY_WARNING else "text"


def _command_ack(vehicle: VehicleState, message: Message, now: float) -> None:
    vehicle.commands.acknowledge(message, now)


def _timesync(vehicle: VehicleState, message: Message, now: float) -> None:
    if message.tc1 == 0 or message.ts1 <= 0:
        return
    sent = message.ts1 * 1e-9
    if not 0.0 <= now - sent < 10.0:
        return
    round_trip = vehicle.latest_round_trip = now - sent
    vehicle.timesync_at = now
    vehicle.latest_clock_offset = message.tc1 * 1e-9 - (sent + now) / 2.0
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
}

HANDLED_MESSAGES: Final = frozenset(HANDLERS)
"""Numbers of the messages that a vehicle's state is made of."""
