"""Telemetry messages: one function per message, state → payload bytes.

Frequent messages pack their structure directly, in MAVLink's wire order; the rest use field names.
Batteries discharge by momentum theory.
"""

import math
import struct
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from sitl.autopilots import px4
from sitl.physics.dynamics import Bodies
from sitl.physics.geodesy import GRAVITY
from sitl.protocol import wire
from sitl.protocol.vehicle import Vehicle

_CAPACITY = 5000.0
_LOAD = 350
_pack_heartbeat = wire.LAYOUTS["HEARTBEAT"].struct.pack
_pack_status = wire.LAYOUTS["SYS_STATUS"].struct.pack
_pack_gps = wire.template(
    "GPS_RAW_INT",
    "time_usec fix_type lat lon alt alt_ellipsoid eph epv vel cog satellites_visible h_acc v_acc",
)  # fmt: skip
_pack_estimator = wire.template(
    "ESTIMATOR_STATUS", "time_usec flags pos_horiz_ratio pos_horiz_accuracy",
    vel_ratio=0.05, pos_vert_ratio=0.05, mag_ratio=0.05, pos_vert_accuracy=0.05,
    tas_ratio=math.nan,
)  # fmt: skip
_pack_extended = wire.LAYOUTS["EXTENDED_SYS_STATE"].struct.pack
_GYRO, _ACCEL, _MAG, _PRESSURE, _AIRSPEED, _GPS = 1, 2, 4, 8, 16, 32
_RATE, _ATTITUDE, _YAW, _Z, _XY, _MOTORS = 1 << 10, 1 << 11, 1 << 12, 1 << 13, 1 << 14, 1 << 15
_RADIO, _FENCE, _AHRS, _TERRAIN = 1 << 16, 1 << 20, 1 << 21, 1 << 22
_LOGGING, _BATTERY, _PROXIMITY = 1 << 24, 1 << 25, 1 << 26
_PREARM, _PROPULSION = 1 << 28, 1 << 30
_INERTIAL = _GYRO | _ACCEL | _MAG | _PRESSURE
_PX4_PRESENT = _INERTIAL | _XY | _BATTERY
_PX4_HEALTHY = _PX4_PRESENT | _AIRSPEED | _ATTITUDE | _MOTORS | _AHRS | _LOGGING
_ARDUPILOT_HEALTHY = (
    _INERTIAL | _RATE | _ATTITUDE | _YAW | _Z | _XY | _MOTORS | _RADIO | _AHRS | _TERRAIN
    | _BATTERY | _PREARM | _PROPULSION
)  # fmt: skip
_PARACHUTE = 1
"""In the extended health: PX4's recovery system, reported as healthy."""
_NO_TEMPERATURE = 32767
_VTOL_MULTICOPTER = 3
_UNINITIALISED, _STANDBY, _ACTIVE, _CRITICAL = 0, 3, 4, 5


def heartbeat(v: Vehicle) -> bytes:
    """Return HEARTBEAT: autopilot, mode, armed."""
    p = v.autopilot
    autopilot = 3 if v.spec.autopilot == "ardupilot" else 12
    return _pack_heartbeat(p.custom_mode(), 2, autopilot, p.base_mode(), _state(v), 3)


def _state(v: Vehicle) -> int:
    """Return MAV_STATE: PX4 is on standby while ready to arm, ArduPilot whenever landed."""
    p = v.autopilot
    if p.failsafe_active:
        return _CRITICAL
    if v.spec.autopilot == "ardupilot":
        return _STANDBY if v.landed else _ACTIVE
    if v.armed:
        return _ACTIVE
    return _STANDBY if p.ready_to_arm() else _UNINITIALISED


def sensors(v: Vehicle) -> tuple[int, int, int]:
    """Return the bits of the sensors present, enabled and healthy.

    PX4 reports the pre-arm bit only in the last, and enables the radio without one; ArduPilot
    enables its log while it is armed, and its fence by a parameter.
    """
    gps = 0 if v.environment.indoor else _GPS
    if v.spec.autopilot == "px4":
        radio = _RADIO if v.radio_connected else 0
        present, healthy = _PX4_PRESENT | gps | radio, _PX4_HEALTHY | gps | radio
        enabled = present | _RADIO
    else:
        present = _ARDUPILOT_HEALTHY | gps | _FENCE | _LOGGING
        healthy = present | _PROXIMITY
        enabled = present & ~(_FENCE | _LOGGING)
        enabled |= _LOGGING if v.autopilot.logging else 0
        enabled |= _FENCE if v.parameters["FENCE_ENABLE"] else 0
    if v.autopilot.ready_to_arm():
        healthy |= _PREARM
    else:
        healthy &= ~_PREARM
    if not v.global_valid:
        healthy &= ~_GPS
    if not v.local_valid:
        healthy &= ~(_AHRS | _XY) if v.spec.autopilot == "ardupilot" else ~_XY
    if v.charge < 0.1:
        healthy &= ~_BATTERY
    return present, enabled, healthy


def system_status(v: Vehicle) -> bytes:
    """Return SYS_STATUS: sensors, battery, pre-arm bit."""
    return _pack_status(
        *sensors(v),
        _LOAD,
        round(v.voltage * 1000),
        round(v.current * 100),
        0, 0, 0, 0, 0, 0,
        max(0, min(100, math.ceil(v.charge * 100))),
        0, 0, _PARACHUTE if v.spec.autopilot == "px4" else 0,
    )  # fmt: skip


def battery(v: Vehicle) -> bytes:
    """Return BATTERY_STATUS: cells, charge, remaining time."""
    cell = round(v.voltage * 1000 / v.cells)
    return wire.payload(
        "BATTERY_STATUS",
        {
            "battery_function": 1,
            "type": 1,
            "temperature": _NO_TEMPERATURE,
            "voltages": [cell] * v.cells + [0xFFFF] * (10 - v.cells),
            "current_battery": round(v.current * 100),
            "current_consumed": round((1 - v.charge) * _CAPACITY),
            "energy_consumed": -1,
            "battery_remaining": max(0, min(100, math.ceil(v.charge * 100))),
            "time_remaining": round(v.charge * v.spec.endurance),
            "charge_state": 1 if v.charge > 0.15 else 2 if v.charge > 0.07 else 3,
        },
    )


def landed_state(v: Vehicle) -> int:
    """Return MAV_LANDED_STATE: 1 on the ground, 2 in air, 3 taking off, 4 landing."""
    if v.landed:
        return 1
    if v.autopilot.landing:
        return 4
    return 3 if v.autopilot.taking_off else 2


def extended_state(v: Vehicle) -> bytes:
    """Return EXTENDED_SYS_STATE: on the ground or in flight."""
    kind = _VTOL_MULTICOPTER if v.spec.autopilot == "ardupilot" else 0
    return _pack_extended(kind, landed_state(v))


def gps(v: Vehicle) -> bytes | None:
    """Return GPS_RAW_INT of the receiver alone: the barometer's drift is not in its altitude."""
    if v.environment.indoor:
        return None
    x, y, z = v.bodies.rows().position[v.index]
    noise, accuracy = v.gps_noise, (15, 25)
    if noise:
        east, north, up = v.rng.normal(0.0, noise, 3).tolist()
        x, y, z = x + 0.4 * east, y + 0.4 * north, z + up
        accuracy = (round(1800 * noise), round(3560 * noise))
    latitude, longitude, altitude = v.environment.geodesy.degrees(x, y, z - v.barometer)
    good = v.global_valid
    time = round(v.clock() * 1e6)
    if not good:
        return _pack_gps(time, 1, 0, 0, 0, 0, 9999, 9999, 0, 0xFFFF, 2, *accuracy)
    height = round(altitude * 1e3)
    vx, vy, _ = v.bodies.rows().velocity[v.index]
    speed = min(round(100.0 * math.hypot(vx, vy)), 0xFFFE)
    course = round(100.0 * math.degrees(math.atan2(vx, vy))) % 36000
    place = round(latitude * 1e7), round(longitude * 1e7), height, height
    return _pack_gps(time, 6, *place, 60, 90, speed, course, 18, *accuracy)


def estimator(v: Vehicle) -> bytes:
    """Return ESTIMATOR_STATUS: valid estimates and their accuracy."""
    flags = 1 | 4 | 32 | 64
    if v.local_valid:
        flags |= 2 | 8 | 256
    if v.global_valid:
        flags |= 16 | 512
    if v.landed:
        flags |= 128
    ratio, accuracy = (0.05, 0.05) if v.local_valid else (2.0, 20.0)
    return _pack_estimator(round(v.clock() * 1e6), flags, ratio, accuracy)


def ekf(v: Vehicle) -> bytes | None:
    """Return EKF_STATUS_REPORT, ArduPilot's counterpart of ESTIMATOR_STATUS; None for PX4."""
    if v.spec.autopilot != "ardupilot":
        return None
    flags = 1 | 4 | 32
    flags |= 2 | 8 | 256 if v.local_valid else 128
    if v.global_valid and v.local_valid:
        flags |= 16 | 512
    variance = 0.05 if v.local_valid else 1.5
    return wire.payload(
        "EKF_STATUS_REPORT",
        {
            "velocity_variance": variance,
            "pos_horiz_variance": variance,
            "pos_vert_variance": 0.05,
            "compass_variance": 0.05,
            "flags": flags,
        },
    )


_CAPABILITIES = (
    "MISSION_FLOAT", "PARAM_FLOAT", "MISSION_INT", "COMMAND_INT", "FTP", "SET_ATTITUDE_TARGET",
    "SET_POSITION_TARGET_LOCAL_NED", "FLIGHT_TERMINATION", "MAVLINK2", "MISSION_FENCE",
    "MISSION_RALLY",
)  # fmt: skip
_AUTOPILOT_CAPABILITIES = {
    "px4": ("PARAM_ENCODE_BYTEWISE",),
    "ardupilot": ("SET_POSITION_TARGET_GLOBAL_INT", "TERRAIN", "COMPASS_CALIBRATION"),
}
_BUILD = (49, 97, 49, 51, 50, 101, 52, 98)
"""ArduPilot's commit, as text."""


def version(v: Vehicle) -> bytes:
    """Return AUTOPILOT_VERSION: versions and capabilities."""
    flags = sum(
        int(getattr(dialect, f"MAV_PROTOCOL_CAPABILITY_{name}"))
        for name in (*_CAPABILITIES, *_AUTOPILOT_CAPABILITIES[v.spec.autopilot])
    )
    if v.spec.autopilot == "ardupilot":
        unique = f"emulated {v.system:3}".encode()
        own = {"flight_sw_version": _version_number(4, 6, 2), "flight_custom_version": _BUILD,
               "uid2": list(unique)}  # fmt: skip
    else:
        own = {
            "flight_sw_version": _version_number(1, 16, 0),
            "middleware_sw_version": _version_number(1, 16, 0),
            "os_sw_version": _version_number(11, 0, 0),
            "board_version": 1,
            "uid": 0x5157_0000 + v.system,
        }
    return wire.payload("AUTOPILOT_VERSION", {"capabilities": flags, **own})


def _version_number(major: int, minor: int, patch: int) -> int:
    return major << 24 | minor << 16 | patch << 8 | 255


_FULL_CELL, _EMPTY_CELL, _CELL_RESISTANCE = 4.2, 3.3, 0.004
_HOVER_CURRENT = 15.0


def discharge(vehicles: Iterable[Vehicle], bodies: Bodies, interval: float) -> None:
    """Discharge the batteries by seconds of the present thrust: power is as thrust^1.5."""
    load = (np.maximum(np.linalg.norm(bodies.thrust, axis=1), 0.0) / GRAVITY) ** 1.5 * bodies.armed
    for vehicle, share in zip(vehicles, load.tolist(), strict=True):
        if share > 0.0:
            vehicle.charge = max(0.0, vehicle.charge - interval * share / vehicle.spec.endurance)
        vehicle.current = _HOVER_CURRENT * share + 0.3
        sag = _CELL_RESISTANCE * vehicle.current
        cell = _EMPTY_CELL + (_FULL_CELL - _EMPTY_CELL) * vehicle.charge - sag
        vehicle.voltage = cell * vehicle.cells


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
    standard = px4.STANDARD_MODES.get((mode >> 16 & 0xFF, mode >> 24 & 0xFF), 0)
    return _pack_mode(mode, mode, standard)


MESSAGES: dict[str, Callable[[Vehicle], bytes | None]] = {
    "HEARTBEAT": heartbeat,
    "LOCAL_POSITION_NED": _local,
    "ATTITUDE": _attitude,
    "ATTITUDE_QUATERNION": _quaternion,
    "GLOBAL_POSITION_INT": _global,
    "SYS_STATUS": system_status,
    "BATTERY_STATUS": battery,
    "EXTENDED_SYS_STATE": extended_state,
    "HOME_POSITION": _home,
    "GPS_GLOBAL_ORIGIN": _origin,
    "GPS_RAW_INT": gps,
    "VFR_HUD": _hud,
    "ALTITUDE": _altitude,
    "ESTIMATOR_STATUS": estimator,
    "EKF_STATUS_REPORT": ekf,
    "SYSTEM_TIME": _system_time,
    "POSITION_TARGET_LOCAL_NED": _target,
    "ODOMETRY": _odometry,
    "AUTOPILOT_VERSION": version,
    "NAV_CONTROLLER_OUTPUT": _nav,
    "RC_CHANNELS": _channels,
    "SERVO_OUTPUT_RAW": _servo,
    "MISSION_CURRENT": _mission_current,
    "CURRENT_MODE": _current_mode,
    **px4.TELEMETRY,
}
