"""Telemetry: each message declared once, with its fields and their values; streams; batteries.

A function with the decorator `_message` returns the values of a message's fields for a vehicle (or
its payload, where that is faster), None where the vehicle has no such data. Sensors are ideal.
"""

import math
import struct
from collections.abc import Callable, Iterable, Mapping
from heapq import heappop, heapreplace
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from sitl.physics.dynamics import Bodies
from sitl.physics.geodesy import GRAVITY
from sitl.protocol import wire
from sitl.protocol.vehicle import Vehicle
from sitl.protocol.wire import Link

MESSAGES: dict[str, Callable[[Vehicle], bytes | None]] = {}
"""The payload of each message of telemetry."""
_SENT: dict[str, tuple[Callable[[Vehicle], bytes | None], int, bytes]] = {}
"""The same with number and CRC seed."""


def _message(
    name: str, fields: str = "", **constant: Any
) -> Callable[[Callable[[Vehicle], Any]], Callable[[Vehicle], Any]]:
    """Declare a message: a function returns the values of ``fields``, others are ``constant``.

    Without ``fields`` it returns the payload.
    """
    fill = wire.template(name, fields, **constant)

    def declare(values: Callable[[Vehicle], Any]) -> Callable[[Vehicle], Any]:
        def pack(v: Vehicle) -> bytes | None:
            given = values(v)
            return None if given is None else fill(*given)

        build: Callable[[Vehicle], bytes | None] = pack if fields else values
        MESSAGES[name] = build
        _SENT[name] = build, wire.LAYOUTS[name].number, wire.LAYOUTS[name].seed
        return values

    return declare


def send_message(v: Vehicle, name: str, link: Link) -> bool:
    """Send one telemetry message now; return False if the vehicle has no such data."""
    build, number, seed = _SENT[name]
    body = build(v)
    if body is None:
        return False
    sender = link.sender
    link.outgoing.append(
        sender.frame(number, body, seed, v.signing_ticks() if sender.signer else 0)
    )
    return True


def send_now(v: Vehicle, *names: str) -> None:
    """Send telemetry messages now on all links, in addition to their streams."""
    for link in v.links:
        for name in names:
            send_message(v, name, link)


def default_streams(v: Vehicle, link: Link) -> Mapping[str, float]:
    """Return the rates (Hz) of the messages that the autopilot sends on this kind of link."""
    return v.autopilot.streams[link.kind]


def send_due(links: Iterable[tuple[Vehicle, Link]], now: float) -> None:
    """Send the messages that are due on these links, and set their next times.

    A simulated flight spends a sixth of its time here.
    """
    limit, messages = now + 1e-6, _SENT
    for v, link in links:
        due = link.due
        if not due or due[0][0] > limit:
            continue
        v.now = max(v.now, now)
        intervals, outgoing, sender = link.intervals, link.outgoing, link.sender
        frame, ticks = sender.frame, 0
        if sender.signer:
            ticks = v.signing_ticks()
        while due:
            time, name = due[0]
            if time > limit:
                break
            interval = intervals.get(name)
            if interval is None:
                heappop(due)
                continue
            following = time + interval
            heapreplace(due, (following if following > now - interval else now, name))
            build, number, seed = messages[name]
            body = build(v)
            if body is not None:
                outgoing.append(frame(number, body, seed, ticks))


_CAPACITY, _HOVER_CURRENT = 5000.0, 15.0
_FULL_CELL, _EMPTY_CELL, _CELL_RESISTANCE = 4.2, 3.3, 0.004


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


_LARGEST = 2**32
_ROW_BYTES = 48
"""Bytes of a vehicle in `Bodies.telemetry`: 24 of LOCAL_POSITION_NED, 24 of ATTITUDE."""
_pack_boot = struct.Struct("<I").pack


def boot_ms(v: Vehicle) -> int:
    """Return milliseconds since boot by the vehicle's clock."""
    return int((v.now - v.booted_at) * v.clock_rate * 1000) % _LARGEST


def _time_usec(v: Vehicle) -> int:
    return round(v.clock() * 1e6)


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


def local_ned(v: Vehicle) -> tuple[float, float, float, float, float, float]:
    """Return estimated position and velocity in the vehicle's own NED frame."""
    rows, i = v.bodies.rows(), v.index
    x, y, z = rows.position[i]
    vx, vy, vz = rows.velocity[i]
    ox, oy, oz = v.origin_xyz
    east, north = v.scale
    return (y - oy) * north, (x - ox) * east, oz - z, vy, vx, -vz


def _scaled_place(v: Vehicle, x: float, y: float, z: float) -> tuple[int, int, int]:
    """Return a point of world ENU as 1e-7 degrees, and millimetres above the sea."""
    latitude, longitude, altitude = v.environment.geodesy.degrees(x, y, z)
    return round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3)


def _height(v: Vehicle) -> float:
    return float(v.environment.geodesy.altitude + v.estimated()[2])


def _thrust_share(v: Vehicle) -> float:
    return float(v.bodies.thrust[v.index, 2] / v.bodies.thrust_limit[v.index])


_UNINITIALISED, _STANDBY, _ACTIVE, _CRITICAL = 0, 3, 4, 5


@_message("HEARTBEAT", "custom_mode autopilot base_mode system_status", type=2, mavlink_version=3)
def _heartbeat(v: Vehicle) -> tuple[int, ...]:
    p = v.autopilot
    return p.custom_mode(), 12 if v.is_px4 else 3, p.base_mode(), _state(v)


def _state(v: Vehicle) -> int:
    """Return MAV_STATE: PX4 is on standby while ready to arm, ArduPilot whenever landed."""
    if v.autopilot.failsafe_active:
        return _CRITICAL
    if not v.is_px4:
        return _STANDBY if v.landed else _ACTIVE
    if v.armed:
        return _ACTIVE
    return _STANDBY if v.autopilot.ready_to_arm() else _UNINITIALISED


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


def _sensors(v: Vehicle) -> tuple[int, int, int]:
    """Return the bits of the sensors present, enabled and healthy.

    PX4 reports the pre-arm bit only in the last, and enables the radio without one; ArduPilot
    enables its log while it is armed, and its fence by a parameter. Indoors its heading is that of
    the poses, and its compass is switched off.
    """
    gps = 0 if v.environment.indoor else _GPS
    if v.is_px4:
        radio = _RADIO if v.radio_connected else 0
        present, healthy = _PX4_PRESENT | gps | radio, _PX4_HEALTHY | gps | radio
        enabled = present | _RADIO
    else:
        compass = _MAG if v.environment.indoor else 0
        present = _ARDUPILOT_HEALTHY & ~compass | gps | _FENCE | _LOGGING
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
        healthy &= ~_XY if v.is_px4 else ~(_AHRS | _XY)
    if v.charge < 0.1:
        healthy &= ~_BATTERY
    return present, enabled, healthy


@_message(
    "SYS_STATUS",
    "onboard_control_sensors_present onboard_control_sensors_enabled "
    "onboard_control_sensors_health voltage_battery current_battery battery_remaining "
    "onboard_control_sensors_health_extended",
    load=350,
)
def _system_status(v: Vehicle) -> tuple[int, ...]:
    return (
        *_sensors(v), round(v.voltage * 1000), round(v.current * 100), _percentage(v),
        _PARACHUTE if v.is_px4 else 0,
    )  # fmt: skip


def _percentage(v: Vehicle) -> int:
    return max(0, min(100, math.ceil(v.charge * 100)))


@_message(
    "BATTERY_STATUS",
    "voltages current_battery current_consumed battery_remaining time_remaining charge_state",
    battery_function=1, type=1, temperature=32767, energy_consumed=-1,
)  # fmt: skip
def _battery(v: Vehicle) -> tuple[Any, ...]:
    cell = round(v.voltage * 1000 / v.cells)
    return (
        [cell] * v.cells + [0xFFFF] * (10 - v.cells),
        round(v.current * 100),
        round((1 - v.charge) * _CAPACITY),
        _percentage(v),
        round(v.charge * v.spec.endurance),
        1 if v.charge > 0.15 else 2 if v.charge > 0.07 else 3,
    )


_VTOL_MULTICOPTER = 3


@_message("EXTENDED_SYS_STATE", "vtol_state landed_state")
def _extended_state(v: Vehicle) -> tuple[int, int]:
    """Return MAV_LANDED_STATE: 1 on the ground, 2 in air, 3 taking off, 4 landing."""
    if v.landed:
        landed_state = 1
    elif v.autopilot.landing:
        landed_state = 4
    else:
        landed_state = 3 if v.autopilot.taking_off else 2
    return 0 if v.is_px4 else _VTOL_MULTICOPTER, landed_state


@_message(
    "GPS_RAW_INT",
    "time_usec fix_type lat lon alt alt_ellipsoid eph epv vel cog satellites_visible h_acc v_acc",
)
def _gps(v: Vehicle) -> tuple[int, ...] | None:
    """Return the fix of the receiver alone: the barometer's drift is not in its altitude."""
    if v.environment.indoor:
        return None
    x, y, z = v.bodies.rows().position[v.index]
    noise, accuracy = v.gps_noise, (15, 25)
    if noise:
        east, north, up = v.rng.normal(0.0, noise, 3).tolist()
        x, y, z = x + 0.4 * east, y + 0.4 * north, z + up
        accuracy = (round(1800 * noise), round(3560 * noise))
    if not v.global_valid:
        return (_time_usec(v), 1, 0, 0, 0, 0, 9999, 9999, 0, 0xFFFF, 2, *accuracy)
    latitude, longitude, height = _scaled_place(v, x, y, z - v.barometer)
    vx, vy, _ = v.bodies.rows().velocity[v.index]
    speed = min(round(100.0 * math.hypot(vx, vy)), 0xFFFE)
    course = round(100.0 * math.degrees(math.atan2(vx, vy))) % 36000
    place = latitude, longitude, height, height
    return (_time_usec(v), 6, *place, 60, 90, speed, course, 18, *accuracy)


@_message(
    "ESTIMATOR_STATUS", "time_usec flags pos_horiz_ratio pos_horiz_accuracy",
    vel_ratio=0.05, pos_vert_ratio=0.05, mag_ratio=0.05, pos_vert_accuracy=0.05,
    tas_ratio=math.nan,
)  # fmt: skip
def _estimator(v: Vehicle) -> tuple[float, ...]:
    flags = 1 | 4 | 32 | 64
    if v.local_valid:
        flags |= 2 | 8 | 256
    if v.global_valid:
        flags |= 16 | 512
    if v.landed:
        flags |= 128
    return (_time_usec(v), flags, *((0.05, 0.05) if v.local_valid else (2.0, 20.0)))


@_message(
    "EKF_STATUS_REPORT", "velocity_variance pos_horiz_variance flags",
    pos_vert_variance=0.05, compass_variance=0.05,
)  # fmt: skip
def _ekf(v: Vehicle) -> tuple[float, ...] | None:
    """Return ArduPilot's counterpart of ESTIMATOR_STATUS."""
    if v.is_px4:
        return None
    flags = 1 | 4 | 32
    flags |= 2 | 8 | 256 if v.local_valid else 128
    if v.global_valid and v.local_valid:
        flags |= 16 | 512
    variance = 0.05 if v.local_valid else 1.5
    return variance, variance, flags


_CAPABILITIES = (
    "MISSION_FLOAT", "PARAM_FLOAT", "MISSION_INT", "COMMAND_INT", "FTP", "SET_ATTITUDE_TARGET",
    "SET_POSITION_TARGET_LOCAL_NED", "FLIGHT_TERMINATION", "MAVLINK2", "MISSION_FENCE",
    "MISSION_RALLY",
)  # fmt: skip
_PX4_CAPABILITIES = ("PARAM_ENCODE_BYTEWISE",)
_ARDUPILOT_CAPABILITIES = ("SET_POSITION_TARGET_GLOBAL_INT", "TERRAIN", "COMPASS_CALIBRATION")
_BUILD = b"1a132e4b"
"""ArduPilot's commit."""


@_message(
    "AUTOPILOT_VERSION",
    "capabilities flight_sw_version middleware_sw_version os_sw_version board_version uid "
    "flight_custom_version uid2",
)
def _version(v: Vehicle) -> tuple[Any, ...]:
    own = _PX4_CAPABILITIES if v.is_px4 else _ARDUPILOT_CAPABILITIES
    flags = sum(
        int(getattr(dialect, f"MAV_PROTOCOL_CAPABILITY_{name}")) for name in (*_CAPABILITIES, *own)
    )
    if v.is_px4:
        release = _version_number(1, 16, 0)
        return flags, release, release, _version_number(11, 0, 0), 1, 0x5157_0000 + v.system, (), ()
    unique = f"emulated {v.system:3}".encode()
    return flags, _version_number(4, 6, 2), 0, 0, 0, 0, _BUILD, unique


def _version_number(major: int, minor: int, patch: int) -> int:
    return major << 24 | minor << 16 | patch << 8 | 255


@_message("LOCAL_POSITION_NED")
def _local(v: Vehicle) -> bytes:
    at = _ROW_BYTES * v.index
    return _pack_boot(boot_ms(v)) + v.bodies.telemetry()[at : at + 24]


@_message("ATTITUDE")
def _attitude(v: Vehicle) -> bytes:
    at = _ROW_BYTES * v.index
    return _pack_boot(boot_ms(v)) + v.bodies.telemetry()[at + 24 : at + 48]


@_message("ATTITUDE_QUATERNION", "time_boot_ms q1 q2 q3 q4 yawspeed")
def _quaternion(v: Vehicle) -> tuple[float, ...]:
    return boot_ms(v), *quaternion(*attitude(v)), -float(v.bodies.yaw_rate[v.index])


@_message("GLOBAL_POSITION_INT", "time_boot_ms lat lon alt relative_alt vx vy vz hdg")
def _global(v: Vehicle) -> tuple[int, ...] | None:
    if not v.global_valid:
        return None
    rows, i = v.bodies.rows(), v.index
    x, y, z = rows.position[i]
    vx, vy, vz = rows.velocity[i]
    heading = math.degrees(math.pi / 2 - rows.yaw[i]) % 360.0
    return (
        boot_ms(v), *_scaled_place(v, x, y, z), round((z - v.home_height()) * 1e3),
        *(max(-32767, min(32767, round(speed * 100))) for speed in (vy, vx, -vz)),
        round(heading * 100) % 36000,
    )  # fmt: skip


@_message("HOME_POSITION", "latitude longitude altitude x y z time_usec q")
def _home(v: Vehicle) -> tuple[Any, ...] | None:
    if v.home is None or not v.global_valid:
        return None
    time = round((v.home_set_at if v.is_px4 else v.clock()) * 1e6)
    q = (1.0, 0.0, 0.0, 0.0) if v.is_px4 else (math.nan,) * 4
    return *_scaled_place(v, *v.home.tolist()), *v.to_local(v.home), time, q


_ORIGIN_TIME = 1.0
"""Seconds after a change or request in which PX4 sends its origin."""


@_message("GPS_GLOBAL_ORIGIN", "latitude longitude altitude time_usec")
def _origin(v: Vehicle) -> tuple[int, ...] | None:
    if v.environment.indoor or not v.autopilot.has_origin:
        return None
    if v.is_px4 and v.now - v.origin_announced_at >= _ORIGIN_TIME:
        return None
    return *_scaled_place(v, *v.origin_xyz), _time_usec(v)


@_message("VFR_HUD", "airspeed groundspeed alt climb heading throttle")
def _hud(v: Vehicle) -> tuple[float, ...]:
    vx, vy, vz = v.bodies.velocity[v.index].tolist()
    heading = math.degrees(math.pi / 2 - float(v.bodies.yaw[v.index])) % 360.0
    speed = math.hypot(vx, vy)
    throttle = max(0, min(100, round(_thrust_share(v) * 100)))
    return speed, speed, _height(v), vz, int(heading), throttle


@_message(
    "ALTITUDE",
    "time_usec altitude_monotonic altitude_amsl altitude_local altitude_relative",
    altitude_terrain=math.nan, bottom_clearance=math.nan,
)  # fmt: skip
def _altitude(v: Vehicle) -> tuple[float, ...]:
    z = float(v.estimated()[2])
    amsl = v.environment.geodesy.altitude + z
    return _time_usec(v), amsl, amsl, z - float(v.origin[2]), z - v.home_height()


@_message("SYSTEM_TIME", "time_unix_usec time_boot_ms")
def _system_time(v: Vehicle) -> tuple[int, int]:
    unix = v.environment.unix_time + v.now + v.unix_offset
    return round(unix * 1e6), boot_ms(v)


_LOCAL_NED, _NO_MOTION = 1, 63
_DOWNWARDS = (*[math.nan] * 6, 0.0, 0.0, 100.0)
"""PX4's controller on the ground: no position or velocity, full downward acceleration."""


@_message(
    "POSITION_TARGET_LOCAL_NED",
    "time_boot_ms x y z vx vy vz afx afy afz yaw type_mask",
    coordinate_frame=_LOCAL_NED,
)
def _target(v: Vehicle) -> tuple[float, ...] | None:
    b, i, mask = v.bodies, v.index, v.autopilot.target_mask
    if mask is None:
        if not v.is_px4 or v.armed:
            return None
        return boot_ms(v), *_DOWNWARDS, _wrap(math.pi / 2 - float(b.yaw[i])), _NO_MOTION
    vx, vy, vz = b.goal_velocity[i].tolist()
    ax, ay, az = b.goal_acceleration[i].tolist()
    motion = (*v.to_local(b.goal_position[i]), vy, vx, -vz, ay, ax, -az)
    return boot_ms(v), *motion, _wrap(math.pi / 2 - float(b.goal_yaw[i])), mask


def _diagonal(*variances: float) -> list[float]:
    """Return the upper triangle of a covariance, row by row; only the diagonal is given."""
    return [variances[i] if i == j else math.nan for i in range(6) for j in range(i, 6)]


_ESTIMATOR_AUTOPILOT = 8


@_message(
    "ODOMETRY", "time_usec x y z vx vy vz q", frame_id=_LOCAL_NED, child_frame_id=_LOCAL_NED,
    pose_covariance=_diagonal(2.5e-3, 2.5e-3, 2.5e-3, 3e-4, 3e-4, 1e-2),
    velocity_covariance=_diagonal(1e-2, 1e-2, 1e-2, math.nan, math.nan, math.nan),
    estimator_type=_ESTIMATOR_AUTOPILOT,
)  # fmt: skip
def _odometry(v: Vehicle) -> tuple[Any, ...]:
    return _time_usec(v), *local_ned(v), quaternion(*attitude(v))


@_message("NAV_CONTROLLER_OUTPUT", "nav_roll nav_pitch nav_bearing alt_error")
def _navigation(v: Vehicle) -> tuple[float, ...]:
    roll, pitch, yaw = map(math.degrees, attitude(v))
    error = v.bodies.goal_position[v.index, 2] - v.bodies.position[v.index, 2]
    return roll, pitch, round(yaw), float(error)


@_message("RC_CHANNELS", "time_boot_ms", chancount=0, rssi=255)
def _channels(v: Vehicle) -> tuple[int] | None:
    """PX4 omits the message without a radio signal."""
    return (boot_ms(v),) if v.radio_connected or not v.is_px4 else None


_PX4_DISARMED = 900


@_message("SERVO_OUTPUT_RAW", " ".join(["time_usec", *(f"servo{k}_raw" for k in range(1, 17))]))
def _servo(v: Vehicle) -> tuple[int, ...]:
    share = _thrust_share(v) if v.armed else 0.0
    pulses = [round(1000 + 1000 * max(0.0, min(1.0, share)))] * 4 + [0] * 12
    if v.is_px4 and not v.armed:
        pulses = [_PX4_DISARMED] * 16
    return int(v.clock() * 1e6) % _LARGEST, *pulses


@_message("MISSION_CURRENT", "seq total")
def _mission_current(v: Vehicle) -> tuple[int, int]:
    return 0, len(v.mission[0]) or (0xFFFF if v.is_px4 else 0)


_MODE_INTERVAL = 0.49


@_message("CURRENT_MODE", "custom_mode intended_custom_mode standard_mode")
def _current_mode(v: Vehicle) -> tuple[int, ...] | None:
    """PX4 sends its mode after a change, and twice a second."""
    if not v.is_px4:
        return None
    mode = v.autopilot.custom_mode()
    reported, at = v.reported_mode
    if mode == reported and v.now - at < _MODE_INTERVAL:
        return None
    v.reported_mode = mode, v.now
    return mode, mode, v.autopilot.standard_mode()


_SEA_PRESSURE, _WARM, _LAPSE, _EXPONENT = 1013.25, 288.15, 0.0065, 5.2559
"""The standard atmosphere: hPa, K, K/m."""
_DOWN, _FARTHEST = 25, 10_000


def _pressure(v: Vehicle) -> float:
    return _SEA_PRESSURE * math.pow(1.0 - _LAPSE * _height(v) / _WARM, _EXPONENT)


@_message(
    "HIGHRES_IMU", "time_usec xacc yacc zacc abs_pressure pressure_alt",
    xmag=0.21, zmag=0.42, temperature=15.0, fields_updated=511,
)  # fmt: skip
def _inertial(v: Vehicle) -> tuple[float, ...]:
    fx, fy, fz = v.bodies.thrust[v.index].tolist()
    force = (0.0, 0.0, -GRAVITY) if v.landed else (fy, fx, -fz)
    return _time_usec(v), *force, _pressure(v) * 100.0, _height(v)


@_message(
    "DISTANCE_SENSOR", "time_boot_ms current_distance", max_distance=_FARTHEST, orientation=_DOWN
)
def _distance(v: Vehicle) -> tuple[int, int]:
    above = max(0.0, float(v.bodies.position[v.index, 2] - v.bodies.floor))
    return boot_ms(v), min(round(above * 100), _FARTHEST)


@_message("ATTITUDE_TARGET", "time_boot_ms q thrust")
def _attitude_target(v: Vehicle) -> tuple[Any, ...]:
    yaw = math.pi / 2 - float(v.bodies.goal_yaw[v.index] if v.armed else v.bodies.yaw[v.index])
    q = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
    return boot_ms(v), q, max(0.001, _thrust_share(v) if v.armed else 0.0)


@_message("SCALED_PRESSURE", "time_boot_ms press_abs", temperature=1182)
def _air_pressure(v: Vehicle) -> tuple[float, ...]:
    return boot_ms(v), _pressure(v)


@_message("VIBRATION", "time_usec")
def _vibration(v: Vehicle) -> tuple[int]:
    return (_time_usec(v),)


@_message("PING", "time_usec seq")
def _ping(v: Vehicle) -> tuple[int, int]:
    """Return a broadcast; PX4 does not evaluate the answers."""
    return _time_usec(v), int(v.clock()) % _LARGEST


@_message("LINK_NODE_STATUS", "timestamp", tx_rate=20_000, rx_rate=100)
def _link_status(v: Vehicle) -> tuple[int]:
    return (round(v.clock() * 1e3),)


@_message(
    "TIME_ESTIMATE_TO_TARGET", "safe_return",
    land=-1, mission_next_item=-1, mission_end=-1, commanded_action=-1,
)  # fmt: skip
def _time_to_target(v: Vehicle) -> tuple[int]:
    home = v.home if v.home is not None else v.origin
    return (math.ceil(math.dist(v.estimated(), home) if v.armed and not v.landed else 0.0),)


@_message("CURRENT_EVENT_SEQUENCE", "sequence")
def _events(v: Vehicle) -> tuple[int]:
    return (v.text_id,)


@_message("COMPONENT_METADATA", "time_boot_ms", uri="mftp://etc/extras/component_general.json.xz")
def _metadata(v: Vehicle) -> tuple[int]:
    return (boot_ms(v),)


@_message("TIMESYNC", "tc1 ts1")
def _clock_request(v: Vehicle) -> tuple[int, int]:
    return 0, round(v.clock() * 1e9)
