"""Telemetry messages: one function per message, state → payload bytes.

Frequent messages pack their structure directly, in MAVLink's wire order; the rest use field names.
"""

import math
import struct
from collections.abc import Callable
from typing import Any

from sitl.autopilots import health
from sitl.autopilots.px4 import telemetry as px4_telemetry
from sitl.autopilots.px4.tables import STANDARD_MODES
from sitl.protocol import wire
from sitl.protocol.vehicle import Vehicle

_pack_boot = struct.Struct("<I").pack
_pack_quaternion = wire.LAYOUTS["ATTITUDE_QUATERNION"].struct.pack
_pack_global = wire.LAYOUTS["GLOBAL_POSITION_INT"].struct.pack
_pack_hud = wire.LAYOUTS["VFR_HUD"].struct.pack
_pack_target = wire.LAYOUTS["POSITION_TARGET_LOCAL_NED"].struct.pack


def _diagonal(*variances: float) -> list[float]:
    """Return the upper triangle of a covariance, row by row; only the diagonal is given."""
    return [variances[i] if i == j else math.nan for i in range(6) for j in range(i, 6)]


_NO_QUATERNION = (math.nan,) * 4
_pack_time = wire.LAYOUTS["SYSTEM_TIME"].struct.pack
_fill_home = {
    "px4": wire.template(
        "HOME_POSITION", "latitude longitude altitude x y z time_usec", q=(1.0, 0.0, 0.0, 0.0)
    ),
    "ardupilot": wire.template(
        "HOME_POSITION", "latitude longitude altitude x y z time_usec", q=_NO_QUATERNION
    ),
}
_fill_origin = wire.template("GPS_GLOBAL_ORIGIN", "latitude longitude altitude time_usec")
_pack_mode = wire.LAYOUTS["CURRENT_MODE"].struct.pack
_ESTIMATOR_AUTOPILOT = 8
_POSE_COVARIANCE = _diagonal(2.5e-3, 2.5e-3, 2.5e-3, 3e-4, 3e-4, 1e-2)
_SPEED_COVARIANCE = _diagonal(1e-2, 1e-2, 1e-2, math.nan, math.nan, math.nan)
_PX4_DISARMED = 900
_NO_MOTION = 63
_LARGEST = 2**32
_LOCAL_NED = 1
_ROW_BYTES = 48
"""Bytes of a vehicle in `Bodies.telemetry`: 24 of LOCAL_POSITION_NED, 24 of ATTITUDE."""
_MODE_INTERVAL = 0.49
_ORIGIN_TIME = 1.0
"""Seconds after a change or request in which PX4 sends its origin."""


def boot_ms(v: Vehicle) -> int:
    """Return milliseconds since boot by the vehicle's clock."""
    return int((v.now - v.booted_at) * v.clock_rate * 1000) % _LARGEST


def attitude(v: Vehicle) -> tuple[float, float, float]:
    """Return roll, pitch and yaw (NED, radians) of the thrust vector."""
    rows, i = v.bodies.rows(), v.index
    fx, fy, fz = rows.thrust[i]
    yaw = math.pi / 2 - rows.yaw[i]
    if rows.tumbling[i]:
        angle = float(v.bodies.tumble[i])
        return _wrap(angle), _wrap(0.3 * angle), _wrap(yaw + angle)
    if fz < 1.0:
        return 0.0, 0.0, _wrap(yaw)
    cos, sin = math.cos(yaw), math.sin(yaw)
    forward = fy * cos + fx * sin
    right = -fy * sin + fx * cos
    pitch = -math.atan2(forward, fz)
    roll = math.atan2(right * math.cos(pitch), fz)
    return roll, pitch, _wrap(yaw)


def _wrap(angle: float) -> float:
    return (angle + math.pi) % (2 * math.pi) - math.pi


def local_ned(v: Vehicle) -> tuple[float, float, float, float, float, float]:
    """Return estimated position and velocity in the vehicle's own NED frame."""
    rows, i = v.bodies.rows(), v.index
    x, y, z = rows.position[i]
    vx, vy, vz = rows.velocity[i]
    ox, oy, oz = v.origin_xyz
    east, north = v.scale
    return (y - oy) * north, (x - ox) * east, oz - z, vy, vx, -vz


def _local(v: Vehicle) -> bytes:
    at = _ROW_BYTES * v.index
    boot = int((v.now - v.booted_at) * v.clock_rate * 1000) % _LARGEST
    return _pack_boot(boot) + v.bodies.telemetry()[at : at + 24]


def _attitude(v: Vehicle) -> bytes:
    at = _ROW_BYTES * v.index
    boot = int((v.now - v.booted_at) * v.clock_rate * 1000) % _LARGEST
    return _pack_boot(boot) + v.bodies.telemetry()[at + 24 : at + 48]


def _quaternion(v: Vehicle) -> bytes:
    roll, pitch, yaw = attitude(v)
    q = quaternion(roll, pitch, yaw)
    rate = -float(v.bodies.yaw_rate[v.index])
    return _pack_quaternion(boot_ms(v), *q, 0.0, 0.0, rate, 0.0, 0.0, 0.0, 0.0)


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion (w, x, y, z) of roll, pitch and yaw."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def _global(v: Vehicle) -> bytes | None:
    if not v.global_valid:
        return None
    rows, i = v.bodies.rows(), v.index
    x, y, z = rows.position[i]
    latitude, longitude, altitude = v.environment.geodesy.degrees(x, y, z)
    vx, vy, vz = rows.velocity[i]
    home = v.home[2] if v.home is not None else v.origin[2]
    heading = math.degrees(math.pi / 2 - rows.yaw[i]) % 360.0
    return _pack_global(
        boot_ms(v),
        round(latitude * 1e7),
        round(longitude * 1e7),
        round(altitude * 1e3),
        round((z - float(home)) * 1e3),
        _centi(vy),
        _centi(vx),
        _centi(-vz),
        round(heading * 100) % 36000,
    )


def _centi(value: float) -> int:
    return max(-32767, min(32767, round(value * 100)))


def _home(v: Vehicle) -> bytes | None:
    if v.home is None or not v.global_valid:
        return None
    latitude, longitude, altitude = v.environment.geodesy.degrees(*v.home.tolist())
    px4 = v.spec.autopilot == "px4"
    return _fill_home[v.spec.autopilot](
        round(latitude * 1e7),
        round(longitude * 1e7),
        round(altitude * 1e3),
        *v.to_local(v.home),
        round((v.home_set_at if px4 else v.clock()) * 1e6),
    )


def _origin(v: Vehicle) -> bytes | None:
    """PX4 sends its origin on request, and once after a change."""
    if v.environment.indoor or not v.autopilot.has_origin:
        return None
    if v.spec.autopilot == "px4" and v.now - v.origin_announced_at >= _ORIGIN_TIME:
        return None
    latitude, longitude, altitude = v.environment.geodesy.degrees(*v.origin_xyz)
    return _fill_origin(
        round(latitude * 1e7),
        round(longitude * 1e7),
        round(altitude * 1e3),
        round(v.clock() * 1e6),
    )


def _hud(v: Vehicle) -> bytes:
    vx, vy, vz = v.bodies.velocity[v.index].tolist()
    heading = math.degrees(math.pi / 2 - float(v.bodies.yaw[v.index])) % 360.0
    altitude = v.environment.geodesy.altitude + float(v.estimated()[2])
    speed = math.hypot(vx, vy)
    throttle = float(v.bodies.thrust[v.index, 2] / v.bodies.thrust_limit[v.index])
    return _pack_hud(
        speed, speed, altitude, vz, int(heading), max(0, min(100, round(throttle * 100)))
    )


def _altitude(v: Vehicle) -> bytes:
    z = float(v.estimated()[2])
    home = float(v.home[2]) if v.home is not None else float(v.origin[2])
    amsl = v.environment.geodesy.altitude + z
    return wire.payload(
        "ALTITUDE",
        {
            "time_usec": round(v.clock() * 1e6),
            "altitude_monotonic": amsl,
            "altitude_amsl": amsl,
            "altitude_local": z - float(v.origin[2]),
            "altitude_relative": z - home,
            "altitude_terrain": math.nan,
            "bottom_clearance": math.nan,
        },
    )


def _system_time(v: Vehicle) -> bytes:
    unix = v.environment.unix_time + v.now + v.unix_offset
    return _pack_time(round(unix * 1e6), boot_ms(v))


def _target(v: Vehicle) -> bytes | None:
    mask = getattr(v.autopilot, "target_mask", None)
    if mask is None:
        return _idle_target(v)
    b, i = v.bodies, v.index
    north, east, down = v.to_local(b.goal_position[i])
    vx, vy, vz = b.goal_velocity[i].tolist()
    ax, ay, az = b.goal_acceleration[i].tolist()
    yaw = _wrap(math.pi / 2 - float(b.goal_yaw[i]))
    return _pack_target(
        boot_ms(v), north, east, down, vy, vx, -vz, ay, ax, -az, yaw, 0.0, mask, _LOCAL_NED
    )


def _idle_target(v: Vehicle) -> bytes | None:
    """PX4's controller on the ground: no position or velocity, full downward acceleration."""
    if v.spec.autopilot != "px4" or v.armed:
        return None
    unset = (math.nan,) * 6
    yaw = _wrap(math.pi / 2 - float(v.bodies.yaw[v.index]))
    return _pack_target(boot_ms(v), *unset, 0.0, 0.0, 100.0, yaw, 0.0, _NO_MOTION, _LOCAL_NED)


def _odometry(v: Vehicle) -> bytes:
    x, y, z, vx, vy, vz = local_ned(v)
    return wire.payload(
        "ODOMETRY",
        {
            "time_usec": round(v.clock() * 1e6),
            "frame_id": _LOCAL_NED,
            "child_frame_id": _LOCAL_NED,
            "x": x,
            "y": y,
            "z": z,
            "q": quaternion(*attitude(v)),
            "vx": vx,
            "vy": vy,
            "vz": vz,
            "pose_covariance": _POSE_COVARIANCE,
            "velocity_covariance": _SPEED_COVARIANCE,
            "estimator_type": _ESTIMATOR_AUTOPILOT,
        },
    )


def _nav(v: Vehicle) -> bytes:
    i, b = v.index, v.bodies
    roll, pitch, yaw = attitude(v)
    return wire.payload(
        "NAV_CONTROLLER_OUTPUT",
        {
            "nav_roll": math.degrees(roll),
            "nav_pitch": math.degrees(pitch),
            "nav_bearing": round(math.degrees(yaw)),
            "alt_error": float(b.goal_position[i, 2] - b.position[i, 2]),
        },
    )


def _channels(v: Vehicle) -> bytes | None:
    """PX4 omits the message without a radio signal."""
    if not v.radio_connected and v.spec.autopilot == "px4":
        return None
    return wire.payload("RC_CHANNELS", {"time_boot_ms": boot_ms(v), "chancount": 0, "rssi": 255})


def _servo(v: Vehicle) -> bytes:
    share = float(v.bodies.thrust[v.index, 2] / v.bodies.thrust_limit[v.index]) if v.armed else 0.0
    value = round(1000 + 1000 * max(0.0, min(1.0, share)))
    fields: dict[str, Any] = {f"servo{k}_raw": value for k in range(1, 5)}
    if v.spec.autopilot == "px4" and not v.armed:
        fields = {f"servo{k}_raw": _PX4_DISARMED for k in range(1, 17)}
    return wire.payload(
        "SERVO_OUTPUT_RAW", {"time_usec": int(v.clock() * 1e6) % _LARGEST, **fields}
    )


def _mission_current(v: Vehicle) -> bytes:
    items = len(v.mission[0])
    none = 0xFFFF if v.spec.autopilot == "px4" else 0
    fields = {"seq": v.mission_progress.seq, "total": items or none}
    return wire.payload("MISSION_CURRENT", fields)


def _current_mode(v: Vehicle) -> bytes | None:
    """PX4 sends its mode after a change, and twice a second."""
    if v.spec.autopilot != "px4":
        return None
    mode = v.autopilot.custom_mode()
    reported, at = v.reported_mode
    if mode == reported and v.now - at < _MODE_INTERVAL:
        return None
    v.reported_mode = mode, v.now
    standard = STANDARD_MODES.get((mode >> 16 & 0xFF, mode >> 24 & 0xFF), 0)
    return _pack_mode(mode, mode, standard)


MESSAGES: dict[str, Callable[[Vehicle], bytes | None]] = {
    "HEARTBEAT": health.heartbeat,
    "LOCAL_POSITION_NED": _local,
    "ATTITUDE": _attitude,
    "ATTITUDE_QUATERNION": _quaternion,
    "GLOBAL_POSITION_INT": _global,
    "SYS_STATUS": health.system_status,
    "BATTERY_STATUS": health.battery,
    "EXTENDED_SYS_STATE": health.extended_state,
    "HOME_POSITION": _home,
    "GPS_GLOBAL_ORIGIN": _origin,
    "GPS_RAW_INT": health.gps,
    "VFR_HUD": _hud,
    "ALTITUDE": _altitude,
    "ESTIMATOR_STATUS": health.estimator,
    "EKF_STATUS_REPORT": health.ekf,
    "SYSTEM_TIME": _system_time,
    "POSITION_TARGET_LOCAL_NED": _target,
    "ODOMETRY": _odometry,
    "AUTOPILOT_VERSION": health.version,
    "NAV_CONTROLLER_OUTPUT": _nav,
    "RC_CHANNELS": _channels,
    "SERVO_OUTPUT_RAW": _servo,
    "MISSION_CURRENT": _mission_current,
    "CURRENT_MODE": _current_mode,
    **px4_telemetry.MESSAGES,
}
