"""What a vehicle says of its health and of what it is: state → payload bytes, as `telemetry`."""

import math

from pymavlink.dialects.v20 import common as dialect

from sitl import wire
from sitl.vehicle import Vehicle

_CAPACITY = 5000.0
_LOAD = 350
_pack_heartbeat = wire.LAYOUTS["HEARTBEAT"].struct.pack
_pack_status = wire.LAYOUTS["SYS_STATUS"].struct.pack
_fill_gps = wire.template(
    "GPS_RAW_INT", "time_usec fix_type lat lon alt eph epv satellites_visible h_acc v_acc",
    cog=0xFFFF,
)  # fmt: skip
_fill_estimator = wire.template(
    "ESTIMATOR_STATUS", "time_usec flags pos_horiz_ratio pos_horiz_accuracy",
    vel_ratio=0.05, pos_vert_ratio=0.05, mag_ratio=0.05, pos_vert_accuracy=0.05,
)  # fmt: skip
_pack_extended = wire.LAYOUTS["EXTENDED_SYS_STATE"].struct.pack
_GYRO, _ACCEL, _MAG, _PRESSURE, _GPS = 1, 2, 4, 8, 32
_RATE, _ATTITUDE, _YAW, _Z, _XY, _MOTORS = 1 << 10, 1 << 11, 1 << 12, 1 << 13, 1 << 14, 1 << 15
_AHRS, _BATTERY, _PREARM = 1 << 21, 1 << 25, 1 << 28
_SENSORS = _GYRO | _ACCEL | _MAG | _PRESSURE | _AHRS | _BATTERY | _RATE | _ATTITUDE | _YAW
_SENSORS |= _Z | _XY | _MOTORS | _PREARM


def heartbeat(v: Vehicle) -> bytes:
    """HEARTBEAT: who it is, its mode, whether it is armed."""
    p = v.personality
    status = 4 if v.armed else 3
    if getattr(p, "failsafe", False):
        status = 5
    autopilot = 3 if v.spec.autopilot == "ardupilot" else 12
    return _pack_heartbeat(p.custom_mode(), 2, autopilot, p.base_mode(), status, 3)


def system_status(v: Vehicle) -> bytes:
    """SYS_STATUS: which sensors are there and well, the battery, and the pre-arm bit."""
    sensors = _SENSORS if v.around.indoor else _SENSORS | _GPS
    health = sensors
    if not v.global_valid:
        health &= ~_GPS
    if not v.local_valid:
        health &= ~(_AHRS | _XY)
    if not v.personality.ready():
        health &= ~_PREARM
    if v.charge < 0.1:
        health &= ~_BATTERY
    return _pack_status(
        sensors,
        sensors,
        health,
        _LOAD,
        round(v.voltage * 1000),
        round(v.current * 100),
        0, 0, 0, 0, 0, 0,
        max(0, min(100, math.ceil(v.charge * 100))),
        0, 0, 0,
    )  # fmt: skip


def battery(v: Vehicle) -> bytes:
    """BATTERY_STATUS: cells, charge, and how long it lasts."""
    cell = round(v.voltage * 1000 / v.cells)
    return wire.payload(
        "BATTERY_STATUS",
        {
            "type": 1,
            "temperature": 2500,
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
    """MAV_LANDED_STATE: 1 on the ground, 2 in air, 3 taking off, 4 landing."""
    if v.landed:
        return 1
    return 4 if getattr(v.personality, "landing", False) else 2


def extended_state(v: Vehicle) -> bytes:
    """EXTENDED_SYS_STATE: whether it stands or flies."""
    return _pack_extended(0, landed_state(v))


def gps(v: Vehicle) -> bytes | None:
    """What the receiver says by itself: a barometer that drifts is not in its altitude."""
    if v.around.indoor:
        return None
    x, y, z = v.bodies.rows().position[v.index]
    noise, accuracy = v.gps_noise, (15, 25)
    if noise:
        east, north, up = v.rng.normal(0.0, noise, 3).tolist()
        x, y, z = x + 0.4 * east, y + 0.4 * north, z + up
        accuracy = (round(1800 * noise), round(3560 * noise))
    latitude, longitude, altitude = v.around.geodesy.degrees(x, y, z - v.barometer)
    good = v.global_valid
    time = round(v.clock() * 1e6)
    if not good:
        return _fill_gps(time, 1, 0, 0, 0, 9999, 9999, 2, *accuracy)
    place = round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3)
    return _fill_gps(time, 6, *place, 60, 90, 18, *accuracy)


def estimator(v: Vehicle) -> bytes:
    """ESTIMATOR_STATUS: which of its estimates hold, and how well."""
    flags = 1 | 4 | 32
    if v.local_valid:
        flags |= 2 | 8
    if v.global_valid:
        flags |= 16
    ratio, accuracy = (0.05, 0.05) if v.local_valid else (2.0, 20.0)
    return _fill_estimator(round(v.clock() * 1e6), flags, ratio, accuracy)


def ekf(v: Vehicle) -> bytes | None:
    """ArduPilot's counterpart of ESTIMATOR_STATUS; PX4 has no such message."""
    if v.spec.autopilot != "ardupilot":
        return None
    flags = 1 | 4 | 32
    flags |= 2 | 8 | 256 if v.local_valid else 128
    if v.global_valid and v.local_valid:
        flags |= 16 | 512
    poor = 0.05 if v.local_valid else 1.5
    return wire.payload(
        "EKF_STATUS_REPORT",
        {
            "velocity_variance": poor,
            "pos_horiz_variance": poor,
            "pos_vert_variance": 0.05,
            "compass_variance": 0.05,
            "flags": flags,
        },
    )


_CAPABILITIES = (
    "PARAM_FLOAT", "MISSION_INT", "COMMAND_INT", "FTP", "SET_POSITION_TARGET_LOCAL_NED",
    "SET_POSITION_TARGET_GLOBAL_INT", "FLIGHT_TERMINATION", "MAVLINK2", "MISSION_FENCE",
    "MISSION_RALLY",
)  # fmt: skip


def version(v: Vehicle) -> bytes:
    """AUTOPILOT_VERSION: what it is and can do."""
    ardupilot = v.spec.autopilot == "ardupilot"
    encoding = "PARAM_ENCODE_C_CAST" if ardupilot else "PARAM_ENCODE_BYTEWISE"
    flags = sum(
        int(getattr(dialect, f"MAV_PROTOCOL_CAPABILITY_{name}"))
        for name in (*_CAPABILITIES, encoding)
    )
    version = (4, 6, 2) if ardupilot else (1, 16, 0)
    number = version[0] << 24 | version[1] << 16 | version[2] << 8 | 255
    return wire.payload(
        "AUTOPILOT_VERSION",
        {
            "capabilities": flags,
            "flight_sw_version": number,
            "middleware_sw_version": number,
            "os_sw_version": 0x0B00_00FF,
            "uid": 0x5157_0000 + v.system,
        },
    )
