"""Telemetry messages of health and identity: one function per message, state → payload bytes."""

import math

from pymavlink.dialects.v20 import common as dialect

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
