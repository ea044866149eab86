"""Telemetry messages of PX4 only: one function per message, state → payload bytes.

The sensors are ideal.
"""

import math
from collections.abc import Callable

from sitl.physics.geodesy import GRAVITY
from sitl.protocol import wire
from sitl.protocol.vehicle import Vehicle

_LARGEST = 2**32
_SEA_PRESSURE, _WARM, _LAPSE, _EXPONENT = 1013.25, 288.15, 0.0065, 5.2559
"""The standard atmosphere: hPa, K, K/m."""
_LEVEL_FIELD = (0.21, 0.0, 0.42)
_ALL_UPDATED = 511
_DOWN, _FARTHEST = 25, 10_000
_RECEIVING, _SENDING = 100, 20_000


def _time_usec(v: Vehicle) -> int:
    return round(v.clock() * 1e6)


def _boot_ms(v: Vehicle) -> int:
    return int(v.clock() * 1000) % _LARGEST


def _height(v: Vehicle) -> float:
    return float(v.environment.geodesy.altitude + v.estimated()[2])


def _pressure(v: Vehicle) -> float:
    return _SEA_PRESSURE * math.pow(1.0 - _LAPSE * _height(v) / _WARM, _EXPONENT)


def _inertial(v: Vehicle) -> bytes:
    fx, fy, fz = v.bodies.thrust[v.index].tolist()
    force = (0.0, 0.0, -GRAVITY) if v.landed else (fy, fx, -fz)
    fields = {
        "time_usec": _time_usec(v), "xacc": force[0], "yacc": force[1], "zacc": force[2],
        "xmag": _LEVEL_FIELD[0], "ymag": _LEVEL_FIELD[1], "zmag": _LEVEL_FIELD[2],
        "abs_pressure": _pressure(v) * 100.0, "pressure_alt": _height(v), "temperature": 15.0,
        "fields_updated": _ALL_UPDATED,
    }  # fmt: skip
    return wire.payload("HIGHRES_IMU", fields)


def _distance(v: Vehicle) -> bytes:
    above = max(0.0, float(v.bodies.position[v.index, 2] - v.bodies.floor))
    fields = {"time_boot_ms": _boot_ms(v), "max_distance": _FARTHEST, "orientation": _DOWN,
              "current_distance": min(round(above * 100), _FARTHEST)}  # fmt: skip
    return wire.payload("DISTANCE_SENSOR", fields)


def _attitude_target(v: Vehicle) -> bytes:
    yaw = math.pi / 2 - float(v.bodies.goal_yaw[v.index] if v.armed else v.bodies.yaw[v.index])
    share = float(v.bodies.thrust[v.index, 2] / v.bodies.thrust_limit[v.index]) if v.armed else 0.0
    fields = {"time_boot_ms": _boot_ms(v), "q": (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)),
              "thrust": max(0.001, share)}  # fmt: skip
    return wire.payload("ATTITUDE_TARGET", fields)


def _air_pressure(v: Vehicle) -> bytes:
    fields = {"time_boot_ms": _boot_ms(v), "press_abs": _pressure(v), "temperature": 1182}
    return wire.payload("SCALED_PRESSURE", fields)


def _vibration(v: Vehicle) -> bytes:
    return wire.payload("VIBRATION", {"time_usec": _time_usec(v)})


def _ping(v: Vehicle) -> bytes:
    """A broadcast PING; PX4 does not evaluate the answers."""
    return wire.payload("PING", {"time_usec": _time_usec(v), "seq": int(v.clock()) % _LARGEST})


def _link_status(v: Vehicle) -> bytes:
    fields = {"timestamp": round(v.clock() * 1e3), "tx_rate": _SENDING, "rx_rate": _RECEIVING}
    return wire.payload("LINK_NODE_STATUS", fields)


def _time_to_target(v: Vehicle) -> bytes:
    home = v.home if v.home is not None else v.origin
    away = math.dist(v.estimated(), home) if v.armed and not v.landed else 0.0
    names = ("land", "mission_next_item", "mission_end", "commanded_action")
    fields = {"safe_return": math.ceil(away), **dict.fromkeys(names, -1)}
    return wire.payload("TIME_ESTIMATE_TO_TARGET", fields)


def _events(v: Vehicle) -> bytes:
    return wire.payload("CURRENT_EVENT_SEQUENCE", {"sequence": v.text_id})


def _metadata(v: Vehicle) -> bytes:
    fields = {"time_boot_ms": _boot_ms(v), "uri": "mftp://etc/extras/component_general.json.xz"}
    return wire.payload("COMPONENT_METADATA", fields)


def clock_request(v: Vehicle) -> bytes:
    """Return a TIMESYNC request."""
    return wire.payload("TIMESYNC", {"tc1": 0, "ts1": round(v.clock() * 1e9)})


MESSAGES: dict[str, Callable[[Vehicle], bytes | None]] = {
    "HIGHRES_IMU": _inertial,
    "DISTANCE_SENSOR": _distance,
    "ATTITUDE_TARGET": _attitude_target,
    "SCALED_PRESSURE": _air_pressure,
    "VIBRATION": _vibration,
    "PING": _ping,
    "LINK_NODE_STATUS": _link_status,
    "TIME_ESTIMATE_TO_TARGET": _time_to_target,
    "CURRENT_EVENT_SEQUENCE": _events,
    "COMPONENT_METADATA": _metadata,
    "TIMESYNC": clock_request,
}
