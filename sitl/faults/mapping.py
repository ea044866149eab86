"""Faults that MAVLink injects, as data: MAV_CMD_INJECT_FAILURE and SIM_* parameters.

`MAV_CMD_INJECT_FAILURE` names a unit, a kind of failure and an instance. MAVLink has no unit for
the autopilot as a whole or for the cable: numbers 200 and 201 are this emulator's own.

`sitl.protocol.sim_parameters` has the SIM_* parameters. A parameter that returns to its default
ends the fault that it started.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

from sitl.protocol.sim_parameters import OF_ARDUPILOT, OWN, PARAMETERS

Values = dict[str, Any]
Parameters = Mapping[str, float]

_GYRO, _ACCELEROMETER, _COMPASS, _BAROMETER, _GPS, _VISION, _DISTANCE = 0, 1, 2, 3, 4, 6, 7
_BATTERY, _MOTOR, _SERVO, _RADIO, _SIGNAL = 100, 101, 102, 104, 105
AUTOPILOT, CABLE = 200, 201
"""FAILURE_UNIT."""
_OFF, _STUCK, _GARBAGE, _WRONG, _SLOW, _DELAYED, _INTERMITTENT = range(1, 8)
"""FAILURE_TYPE."""
_LOST = "Resolve system health failures first"

INJECTED: dict[tuple[int, int], Values] = {
    (_GYRO, _OFF): {"kind": "refuse_arming", "text": "Gyro sensor 0 missing"},
    (_ACCELEROMETER, _OFF): {"kind": "refuse_arming", "text": "Accel sensor 0 missing"},
    (_COMPASS, _OFF): {"kind": "refuse_arming", "text": "Compass sensor 0 missing"},
    (_BAROMETER, _WRONG): {"kind": "barometer_drift", "rate": 0.1},
    (_GPS, _OFF): {"kind": "gps_loss"},
    (_GPS, _WRONG): {"kind": "gps_jump", "offset": (3.0, 4.0, 0.0)},
    (_GPS, _GARBAGE): {"kind": "position_loss"},
    (_VISION, _OFF): {"kind": "position_loss"},
    (_VISION, _WRONG): {"kind": "origin_reset", "offset": (5.0, 0.0, 0.0)},
    (_DISTANCE, _WRONG): {"kind": "believes_landed"},
    (_BATTERY, _OFF): {"kind": "battery", "charge": 0.04},
    (_BATTERY, _WRONG): {"kind": "battery", "charge": 0.1},
    (_MOTOR, _OFF): {"kind": "motor_loss"},
    (_MOTOR, _WRONG): {"kind": "weak_thrust", "fraction": 0.7},
    (_MOTOR, _SLOW): {"kind": "weak_thrust", "fraction": 0.85},
    (_SERVO, _OFF): {"kind": "gripper_stuck_open"},
    (_SERVO, _STUCK): {"kind": "gripper_stuck_shut"},
    (_SERVO, _WRONG): {"kind": "gripper_slip"},
    (_RADIO, _OFF): {"kind": "rc_loss"},
    (_RADIO, _WRONG): {"kind": "pilot"},
    (_SIGNAL, _OFF): {"kind": "link", "loss": 1.0},
    (_SIGNAL, _GARBAGE): {"kind": "link", "duplicate": 0.3, "reorder": 0.3},
    (_SIGNAL, _SLOW): {"kind": "link", "bandwidth": 2000.0},
    (_SIGNAL, _DELAYED): {"kind": "link", "latency": 0.3, "jitter": 0.1},
    (_SIGNAL, _INTERMITTENT): {"kind": "link", "loss": 0.5, "burst": 0.3},
    (AUTOPILOT, _OFF): {"kind": "disarm"},
    (AUTOPILOT, _STUCK): {"kind": "freeze"},
    (AUTOPILOT, _GARBAGE): {"kind": "leave_offboard"},
    (AUTOPILOT, _WRONG): {"kind": "believes_landed"},
    (AUTOPILOT, _SLOW): {"kind": "slow_clock", "fraction": 0.9},
    (AUTOPILOT, _DELAYED): {"kind": "refuse_arming", "text": _LOST},
    (AUTOPILOT, _INTERMITTENT): {"kind": "reboot"},
    (CABLE, _STUCK): {"kind": "snag"},
}
UNITS = frozenset(unit for unit, _ in INJECTED)
_DIRECTIONS = ("both", "up", "down")


def fault_of_injection(unit: int, failure: int, instance: int) -> Values | None:
    """Return the keys of the fault that an injection starts, None if it is unknown.

    The instance of a MAVLink signal is the direction: 0 both, 1 to the vehicle, 2 from it.
    """
    values = INJECTED.get((unit, failure))
    if values is None or unit != _SIGNAL:
        return values
    return {**values, "direction": _DIRECTIONS[instance]} if 0 <= instance <= 2 else None


_LINK = ("SIM_UART_LOSS", *sorted(name for name in OWN if name.startswith("SIM_LINK_")))
_DEGREE = 111_195.0
_GRIPPER = {1: "gripper_stuck_open", 2: "gripper_stuck_shut", 3: "gripper_slip"}
_FULL, _EMPTY = 12.6, 9.9


def _link(p: Parameters) -> Values | None:
    if all(p[name] == PARAMETERS[name] for name in _LINK if name != "SIM_LINK_DIR"):
        return None
    direction = int(p["SIM_LINK_DIR"])
    return {
        "kind": "link",
        "loss": max(p["SIM_LINK_LOSS"], p["SIM_UART_LOSS"] / 100.0),
        "burst": p["SIM_LINK_BURST"],
        "latency": p["SIM_LINK_DELAY"],
        "jitter": p["SIM_LINK_JITTER"],
        "duplicate": p["SIM_LINK_DUP"],
        "reorder": p["SIM_LINK_REORD"],
        "bandwidth": p["SIM_LINK_BANDW"] or None,
        "direction": _DIRECTIONS[direction] if 0 <= direction <= 2 else "both",
    }


def _glitch(p: Parameters) -> Values | None:
    """GPS glitch: degrees of latitude and longitude, metres of altitude, as in ArduPilot."""
    offset = (
        p["SIM_GPS1_GLTCH_Y"] * _DEGREE,
        p["SIM_GPS1_GLTCH_X"] * _DEGREE,
        p["SIM_GPS1_GLTCH_Z"],
    )
    return {"kind": "gps_jump", "offset": offset} if any(offset) else None


def _wind(p: Parameters) -> Values | None:
    """Wind: SIM_WIND_DIR is the direction of its origin in degrees."""
    speed, angle = p["SIM_WIND_SPD"], math.radians(p["SIM_WIND_DIR"])
    if not speed and not p["SIM_WIND_TURB"]:
        return None
    steady = (-speed * math.sin(angle), -speed * math.cos(angle), 0.0)
    return {"kind": "wind", "steady": steady, "gust": p["SIM_WIND_TURB"]}


def _battery(p: Parameters) -> Values | None:
    """Battery voltage of ArduPilot's simulator, with three cells."""
    if p["SIM_BATT_VOLTAGE"] <= 0:
        return None
    charge = (p["SIM_BATT_VOLTAGE"] - _EMPTY) / (_FULL - _EMPTY)
    return {"kind": "battery", "charge": min(max(charge, 0.0), 1.0)}


def _snag(p: Parameters) -> Values | None:
    if p["SIM_SNAG_ARC"] < 0:
        return None
    hold = p["SIM_SNAG_HOLD"]
    return {"kind": "snag", "arc": p["SIM_SNAG_ARC"], "friction": hold if hold > 0 else None}


def _gripper(p: Parameters) -> Values | None:
    kind = _GRIPPER.get(int(p["SIM_GRIP_FAIL"]))
    return {"kind": kind} if kind else None


def _freeze(p: Parameters) -> Values | None:
    """Freeze for a number of seconds: a frozen autopilot accepts no command that ends it."""
    seconds = p["SIM_FREEZE"]
    return {"kind": "freeze", "duration": seconds} if seconds > 0 else None


def _switch(name: str, kind: str, off: float = 0.0) -> Callable[[Parameters], Values | None]:
    def fault(p: Parameters) -> Values | None:
        return None if p[name] == off else {"kind": kind}

    return fault


def _amount(name: str, kind: str, key: str) -> Callable[[Parameters], Values | None]:
    def fault(p: Parameters) -> Values | None:
        return None if p[name] == PARAMETERS[name] else {"kind": kind, key: p[name]}

    return fault


def _shift(name: str, *axis: float) -> Callable[[Parameters], Values | None]:
    def fault(p: Parameters) -> Values | None:
        offset = tuple(p[name] * x for x in axis)
        return {"kind": "origin_reset", "offset": offset} if p[name] else None

    return fault


_FAULTS: dict[str, Callable[[Parameters], Values | None]] = {
    **dict.fromkeys(_LINK, _link),
    **dict.fromkeys((name for name in OF_ARDUPILOT if "GLTCH" in name), _glitch),
    **dict.fromkeys((name for name in OF_ARDUPILOT if "WIND" in name), _wind),
    "SIM_ARM_REFUSE": _switch("SIM_ARM_REFUSE", "refuse_arming"),
    "SIM_BARO_DRIFT": _amount("SIM_BARO_DRIFT", "barometer_drift", "rate"),
    "SIM_BATT_VOLTAGE": _battery,
    "SIM_CLOCK_MUL": _amount("SIM_CLOCK_MUL", "slow_clock", "fraction"),
    "SIM_DISARM": _switch("SIM_DISARM", "disarm"),
    "SIM_ENGINE_FAIL": _switch("SIM_ENGINE_FAIL", "motor_loss"),
    "SIM_ENGINE_MUL": _amount("SIM_ENGINE_MUL", "weak_thrust", "fraction"),
    "SIM_FREEZE": _freeze,
    "SIM_GPS1_ENABLE": _switch("SIM_GPS1_ENABLE", "gps_loss", 1.0),
    "SIM_GRIP_FAIL": _gripper,
    "SIM_LANDED": _switch("SIM_LANDED", "believes_landed"),
    "SIM_LEAVE": _switch("SIM_LEAVE", "leave_offboard"),
    "SIM_ORIGIN_E": _shift("SIM_ORIGIN_E", 1.0, 0.0, 0.0),
    "SIM_ORIGIN_N": _shift("SIM_ORIGIN_N", 0.0, 1.0, 0.0),
    "SIM_PILOT": _switch("SIM_PILOT", "pilot"),
    "SIM_POS_LOSS": _switch("SIM_POS_LOSS", "position_loss"),
    "SIM_RC_FAIL": _switch("SIM_RC_FAIL", "rc_loss"),
    "SIM_REBOOT": _switch("SIM_REBOOT", "reboot"),
    "SIM_SNAG_ARC": _snag,
    "SIM_SNAG_HOLD": _snag,
}


def fault_of_parameter(name: str, parameters: Parameters) -> tuple[str, Values | None] | None:
    """Return the source of a changed SIM_* parameter and the keys of its fault, if any.

    All parameters of one source describe one fault together; None for an unknown name.
    """
    fault = _FAULTS.get(name)
    if fault is None:
        return None
    source = fault.__name__ if fault.__name__ != "fault" else name
    return source, fault(parameters)
