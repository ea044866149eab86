"""What each message changes in what is known of a vehicle: one function per message, one table."""

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Final

from pymavlink.dialects.v20 import common

from swarm.mavlink.autopilots import AUTOPILOTS
from swarm.mavlink.frames import Origin, to_local
from swarm.mavlink.packets import CURRENT_MODE, PARAM_VALUE, Message
from swarm.mavlink.telemetry_table import REBOOTED

if TYPE_CHECKING:
    from swarm.mavlink.vehicle import Vehicle

ON_GROUND = int(common.MAV_LANDED_STATE_ON_GROUND)
IN_AIR = int(common.MAV_LANDED_STATE_IN_AIR)
TAKING_OFF = int(common.MAV_LANDED_STATE_TAKEOFF)
_ARMED = int(common.MAV_MODE_FLAG_SAFETY_ARMED)
_PREARM = int(common.MAV_SYS_STATUS_PREARM_CHECK)
_LOCATING = int(common.MAV_SYS_STATUS_AHRS | common.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL)
_ORIGIN_MOVED = 0.05
_IN_STEP = 0.3
_LEVEL = 0.3
"""m/s up or down below which heights that are not reported at the same time can be compared."""
_HEIGHT_DRIFT = 0.2
"""m/s: a receiver that is good to a metre is averaged over five seconds."""
_FRAMES_APART = 1.0
_SAMPLES_APART = 3
_TEXT_LENGTH = 50


def _heartbeat(vehicle: "Vehicle", message: Message, now: float) -> None:
    if message.autopilot == common.MAV_AUTOPILOT_INVALID:
        return
    if vehicle.autopilot is None:
        vehicle.autopilot = AUTOPILOTS.get(message.autopilot)
    first = vehicle.heartbeat_at == -math.inf
    vehicle.heartbeat_at = vehicle.heard_at = now
    vehicle.component = vehicle.commands.component = vehicle.speaks_as
    armed = bool(message.base_mode & _ARMED)
    vehicle.system_status = message.system_status
    if first:
        vehicle.say("heard", f"heard: {vehicle.autopilot.name if vehicle.autopilot else 'unknown'}")
    _current_mode(vehicle, message, now)
    if armed != vehicle.armed:
        vehicle.armed = armed
        vehicle.say("armed" if armed else "disarmed", "armed" if armed else "disarmed")


def _current_mode(vehicle: "Vehicle", message: Message, now: float) -> None:
    vehicle.mode_at = now
    if message.custom_mode != vehicle.custom_mode:
        vehicle.custom_mode = message.custom_mode
        vehicle.say("mode", f"mode {vehicle.mode}", vehicle.mode)


def _local_position(vehicle: "Vehicle", message: Message, now: float) -> None:
    vehicle.position = (message.x, message.y, message.z)
    vehicle.velocity = (message.vx, message.vy, message.vz)
    vehicle.position_at = now
    _boot_time(vehicle, message.time_boot_ms)


def _boot_time(vehicle: "Vehicle", boot_ms: int) -> None:
    if boot_ms < vehicle.boot_ms - REBOOTED:
        vehicle.set_back += 1
        vehicle.say("rebooted", "rebooted: its clock went back")
    vehicle.boot_ms = boot_ms


def _global_position(vehicle: "Vehicle", message: Message, now: float) -> None:
    vehicle.place = Origin(message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3)
    vehicle.relative_altitude = message.relative_alt * 1e-3
    _compare(vehicle, vehicle.place, now)


def _gps(vehicle: "Vehicle", message: Message, now: float) -> None:
    vehicle.fix, vehicle.satellites = message.fix_type, message.satellites_visible
    vehicle.level_accuracy = message.h_acc * 1e-3 if message.h_acc else math.nan
    vehicle.upright_accuracy = message.v_acc * 1e-3 if message.v_acc else math.nan
    age = now - vehicle.position_at
    level = abs(vehicle.velocity[2]) < _LEVEL
    if vehicle.origin is not None and message.fix_type >= 3 and age < _IN_STEP and level:
        gap = message.alt * 1e-3 - (vehicle.origin.altitude - vehicle.position[2])
        _compare_heights(vehicle, gap, now)


def _compare_heights(vehicle: "Vehicle", gap: float, now: float) -> None:
    """Average what satellites say of the height, the longer the less they claim to know it.

    The altitude of a poor receiver, and of PX4's simulated one, jumps about by half a metre.
    """
    accuracy = vehicle.upright_accuracy
    patience = 0.0 if math.isnan(accuracy) else accuracy / _HEIGHT_DRIFT
    since, at, mean = vehicle.gaps
    if math.isnan(mean):
        since, mean = now, gap
    else:
        step = max(now - at, 1e-3)
        mean += (gap - mean) * step / (min(patience, at - since) + step)
    vehicle.gaps = since, now, mean
    vehicle.height_gap = mean if now - since >= patience else math.nan


def _compare(vehicle: "Vehicle", place: Origin, now: float) -> None:
    """Compare the place on earth with the local position: both must mean the same origin.

    A frame that is reset moves one against the other; a single sample may be out of step.
    """
    age = now - vehicle.position_at
    if vehicle.origin is None or vehicle.autopilot is None or not age < _IN_STEP:
        return
    local = to_local(vehicle.autopilot.name, vehicle.origin, place)
    position, velocity = vehicle.position, vehicle.velocity
    off = [local[k] - position[k] - age * velocity[k] for k in (0, 1)]
    apart = math.hypot(*off)
    vehicle.out_of_step = vehicle.out_of_step + 1 if apart > _FRAMES_APART else 0
    if vehicle.out_of_step == _SAMPLES_APART:
        vehicle.say("origin", f"its local and global positions are {apart:.1f} m apart")


def _attitude(vehicle: "Vehicle", message: Message, _now: float) -> None:
    vehicle.attitude = (message.roll, message.pitch, message.yaw)


def _global_origin(vehicle: "Vehicle", message: Message, _now: float) -> None:
    origin = Origin(message.latitude * 1e-7, message.longitude * 1e-7, message.altitude * 1e-3)
    if vehicle.origin is not None and _distance(origin, vehicle.origin) > _ORIGIN_MOVED:
        moved = _distance(origin, vehicle.origin)
        vehicle.say("origin", f"its estimator's origin moved by {moved:.2f} m")
    vehicle.origin = origin


def _extended_state(vehicle: "Vehicle", message: Message, _now: float) -> None:
    was, vehicle.landed_state = vehicle.landed_state, message.landed_state
    if was != vehicle.landed_state and vehicle.landed_state == ON_GROUND:
        vehicle.say("landed", "on the ground")
    elif was != vehicle.landed_state and vehicle.landed_state == IN_AIR:
        vehicle.say("airborne", "in the air")


def _system_status(vehicle: "Vehicle", message: Message, _now: float) -> None:
    vehicle.battery = (
        message.battery_remaining / 100.0 if message.battery_remaining >= 0 else math.nan
    )
    vehicle.voltage = message.voltage_battery / 1000.0
    asked = message.onboard_control_sensors_enabled & _LOCATING
    vehicle.located = not asked & ~message.onboard_control_sensors_health
    autopilot = vehicle.autopilot
    told = autopilot is not None and not autopilot.prearm_present
    if told or message.onboard_control_sensors_present & _PREARM:
        vehicle.ready = bool(message.onboard_control_sensors_health & _PREARM)


def _status_text(vehicle: "Vehicle", message: Message, now: float) -> None:
    text = message.text.split(b"\0", 1)[0].decode("utf-8", "replace")
    if message.id:
        key = vehicle.speaks_as << 16 | message.id
        parts = vehicle.chunks.setdefault(key, [])
        parts.append(text)
        if len(text) >= _TEXT_LENGTH and len(parts) < 16:
            return
        text = "".join(vehicle.chunks.pop(key))
    text = text.strip()
    if not text:
        return
    vehicle.texts = [*vehicle.texts[-31:], (now, message.severity, text)]
    vehicle.say(_text_kind(message.severity), text)


def _text_kind(severity: int) -> str:
    if severity <= common.MAV_SEVERITY_ERROR:
        return "text error"
    return "text warning" if severity == common.MAV_SEVERITY_WARNING else "text"


def _acknowledged(vehicle: "Vehicle", message: Message, now: float) -> None:
    vehicle.commands.acknowledge(message, now)


def _timesync(vehicle: "Vehicle", message: Message, now: float) -> None:
    if message.tc1 == 0 or message.ts1 <= 0:
        return
    sent = message.ts1 * 1e-9
    if not 0.0 <= now - sent < 10.0:
        return
    round_trip = vehicle.latest_round_trip = now - sent
    vehicle.answered_at = now
    vehicle.latest_clock_offset = message.tc1 * 1e-9 - (sent + now) / 2.0
    if not vehicle.round_trip <= round_trip:
        vehicle.clock_offset = vehicle.latest_clock_offset
        vehicle.round_trip = round_trip


def _distance(one: Origin, other: Origin) -> float:
    """Return metres between two near places, roughly."""
    north = math.radians(one.latitude - other.latitude) * 6_371_000.0
    east = math.radians(one.longitude - other.longitude) * 6_371_000.0
    east *= math.cos(math.radians(one.latitude))
    return math.hypot(north, east, one.altitude - other.altitude)


def _parameter(vehicle: "Vehicle", message: Message, now: float) -> None:
    if vehicle.autopilot is not None:
        bytewise = vehicle.autopilot.bytewise
        vehicle.parameters.receive(message, bytewise=bytewise, now=now)


HANDLERS: Final[Mapping[int, Callable[["Vehicle", Message, float], None]]] = {
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
    int(common.MAVLINK_MSG_ID_COMMAND_ACK): _acknowledged,
    int(common.MAVLINK_MSG_ID_TIMESYNC): _timesync,
    PARAM_VALUE: _parameter,
}

READ: Final = frozenset(HANDLERS)
"""Numbers of the messages that a vehicle's state is made of."""
