"""Faults of vehicles, links and the world: declared once, started from three sources.

Each kind of fault is a function below with the decorator `_kind`: its name is that of the fault, it
is called with ``on`` as the fault starts and without as it ends, and the decorator has its keys and
its sources. `Injector` starts and ends faults at their times; `Channel` is a link with errors.

1. Scenario files; times are emulated seconds since the start, no ``duration`` is for ever:

    schema: 1
    faults:
      - {at: 12.0, kind: weak_thrust, vehicle: 3, fraction: 0.7, duration: 5.0}
      - {at: 20.0, kind: link, vehicle: all, loss: 0.2, latency: 0.3, jitter: 0.1}

2. ``MAV_CMD_INJECT_FAILURE`` (for external test tools) names a unit, a kind of failure and an
   instance. MAVLink has no unit for the autopilot as a whole or for the cable: numbers 200 and 201
   are this emulator's own.
3. ``SIM_*`` parameters, which both autopilots have. ArduPilot's names keep ArduPilot's meanings;
   others exist in this emulator only. A parameter that returns to its default ends the fault that
   it started.

A frozen autopilot receives nothing, sends nothing and checks no timers; its controller continues
with the last goal. A rebooting one stops its motors. ``rc_loss`` has an effect if the world file
gives a vehicle a ``radio``. ``snag`` holds the cable at its present place by friction on other
cable: it falls when no vehicle holds the cable.
"""

import functools
import heapq
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from heapq import heappop, heappush
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from sitl.cable.swinging import AnyRope
from sitl.physics.dynamics import STEP, Array, Bodies
from sitl.protocol.vehicle import Vehicle
from sitl.world import WorldError, explain, parse_yaml, read_text

_BLOCK = 256
_LONGEST_QUEUE = 2.0
"""Seconds of waiting beyond which a link of limited bandwidth drops packets."""

Values = dict[str, Any]
Parameters = Mapping[str, float]
Effect = Callable[["Injector", Vehicle, "Fault", bool], None]


@dataclass(frozen=True)
class Source:
    """SIM_* parameters that describe one fault together: names and defaults.

    ``keys`` returns the keys of the fault that the parameters' values describe, None for no fault.
    """

    defaults: Mapping[str, float | int]
    keys: Callable[[Parameters], Values | None]


def _switch(name: str, default: int = 0) -> Source:
    return Source({name: default}, lambda p: None if p[name] == default else {})


def _amount(name: str, default: float, key: str) -> Source:
    return Source({name: default}, lambda p: None if p[name] == default else {key: p[name]})


def _shift(name: str, *axis: float) -> Source:
    return Source(
        {name: 0.0}, lambda p: {"offset": tuple(p[name] * x for x in axis)} if p[name] else None
    )


def _gripper_failure(number: int) -> Source:
    return Source({"SIM_GRIP_FAIL": 0}, lambda p: {} if int(p["SIM_GRIP_FAIL"]) == number else None)


Reach = Literal["emulated", "bodies", "sensors", "world"]
"""Where a fault acts: on emulated autopilots alone; on bodies and grippers, also those with real
firmware; on sensors, also those that the world simulates (PX4's firmware); on no single vehicle."""


@dataclass(frozen=True)
class Kind:
    """One kind of fault: effect, keys beside at, kind, vehicle and duration, reach, sources.

    ``injected`` has the keys that a unit and a type of MAV_CMD_INJECT_FAILURE stand for.
    """

    effect: Effect
    keys: tuple[str, ...]
    reach: Reach
    injected: Mapping[tuple[int, int], Values]
    sources: Sequence[Source]


KINDS: dict[str, Kind] = {}
"""The kinds of faults by name."""


def _kind(
    *keys: str,
    reach: Reach = "emulated",
    injected: Mapping[tuple[int, int], Values],
    sources: Sequence[Source] = (),
) -> Callable[[Effect], Effect]:
    """Declare the fault that has the name of a function."""

    def declare(effect: Effect) -> Effect:
        KINDS[effect.__name__.removeprefix("_")] = Kind(effect, keys, reach, injected, sources)
        return effect

    return declare


_GYRO, _ACCELEROMETER, _COMPASS, _BAROMETER, _GPS, _VISION, _DISTANCE = 0, 1, 2, 3, 4, 6, 7
_BATTERY, _MOTOR, _SERVO, _RADIO, _SIGNAL = 100, 101, 102, 104, 105
_AUTOPILOT, _CABLE = 200, 201
"""FAILURE_UNIT."""
_OFF, _STUCK, _GARBAGE, _WRONG, _SLOW, _DELAYED, _INTERMITTENT = range(1, 8)
"""FAILURE_TYPE."""
_UNHEALTHY = "Resolve system health failures first"
_DIRECTIONS = ("both", "up", "down")
_LINK_DEFAULTS: dict[str, float | int] = {
    "SIM_UART_LOSS": 0.0, "SIM_LINK_BANDW": 0.0, "SIM_LINK_BURST": 0.0, "SIM_LINK_DELAY": 0.0,
    "SIM_LINK_DIR": 0, "SIM_LINK_DUP": 0.0, "SIM_LINK_JITTER": 0.0, "SIM_LINK_LOSS": 0.0,
    "SIM_LINK_REORD": 0.0,
}  # fmt: skip
_DEGREE = 111_195.0
_FULL, _EMPTY = 12.6, 9.9
_DEAD_RECKONING = {"px4": 5.0, "ardupilot": 15.0}
"""Seconds without a receiver for which a local position is reported: EKF2_NOAID_TOUT; measured."""


def _link_keys(p: Parameters) -> Values | None:
    if all(p[name] == 0.0 for name in _LINK_DEFAULTS if name != "SIM_LINK_DIR"):
        return None
    direction = int(p["SIM_LINK_DIR"])
    return {
        "loss": max(p["SIM_LINK_LOSS"], p["SIM_UART_LOSS"] / 100.0),
        "burst": p["SIM_LINK_BURST"],
        "latency": p["SIM_LINK_DELAY"],
        "jitter": p["SIM_LINK_JITTER"],
        "duplicate": p["SIM_LINK_DUP"],
        "reorder": p["SIM_LINK_REORD"],
        "bandwidth": p["SIM_LINK_BANDW"] or None,
        "direction": _DIRECTIONS[direction] if 0 <= direction <= 2 else "both",
    }


@_kind(
    "loss", "burst", "latency", "jitter", "duplicate", "reorder", "bandwidth", "direction",
    injected={
        (_SIGNAL, _OFF): {"loss": 1.0},
        (_SIGNAL, _GARBAGE): {"duplicate": 0.3, "reorder": 0.3},
        (_SIGNAL, _SLOW): {"bandwidth": 2000.0},
        (_SIGNAL, _DELAYED): {"latency": 0.3, "jitter": 0.1},
        (_SIGNAL, _INTERMITTENT): {"loss": 0.5, "burst": 0.3},
    },
    sources=[Source(_LINK_DEFAULTS, _link_keys)],
)  # fmt: skip
def _link(world: "Injector", v: Vehicle, _: "Fault", __: bool) -> None:
    """Set the errors of both directions; the latest of several faults applies."""
    world.link_faults = True
    own = [f for f, sysid in world.active if sysid == v.system and f.kind == "link"]
    for channel, direction in ((world.up[v.index], "up"), (world.down[v.index], "down")):
        faults = [fault for fault in own if fault.direction in {direction, "both"}]
        channel.set_fault(faults[-1] if faults else None)


@_kind(reach="bodies", injected={(_MOTOR, _OFF): {}}, sources=[_switch("SIM_ENGINE_FAIL")])
def _motor_loss(world: "Injector", v: Vehicle, fault: "Fault", on: bool) -> None:
    """Leave little thrust, and tumble in flight, as a quadrotor without one motor does."""
    if not on:
        _weak_thrust(world, v, fault, on)
        return
    b, i = v.bodies, v.index
    b.health[i] = 0.15
    b.tumbling[i] = b.outside[i] or not b.landed[i]


@_kind(
    "fraction",
    reach="bodies",
    injected={(_MOTOR, _WRONG): {"fraction": 0.7}, (_MOTOR, _SLOW): {"fraction": 0.85}},
    sources=[_amount("SIM_ENGINE_MUL", 1.0, "fraction")],
)
def _weak_thrust(_: "Injector", v: Vehicle, fault: "Fault", on: bool) -> None:
    """Leave a share of the thrust; afterwards all of it, unless the vehicle has crashed."""
    b, i = v.bodies, v.index
    if on:
        b.health[i] = fault.fraction
        return
    if b.outside[i]:
        b.tumbling[i] = False
    if not b.crashed[i]:
        b.health[i] = 1.0


def _charge_keys(p: Parameters) -> Values | None:
    """Battery voltage of ArduPilot's simulator, with three cells."""
    charge = (p["SIM_BATT_VOLTAGE"] - _EMPTY) / (_FULL - _EMPTY)
    return {"charge": min(max(charge, 0.0), 1.0)} if p["SIM_BATT_VOLTAGE"] > 0 else None


@_kind(
    "charge",
    injected={(_BATTERY, _OFF): {"charge": 0.04}, (_BATTERY, _WRONG): {"charge": 0.1}},
    sources=[Source({"SIM_BATT_VOLTAGE": 0.0}, _charge_keys)],
)
def _battery(_: "Injector", v: Vehicle, fault: "Fault", on: bool) -> None:
    """Drain the battery; it stays drained."""
    if on:
        v.charge = min(v.charge, fault.charge)


@_kind(reach="sensors", injected={(_GPS, _OFF): {}}, sources=[_switch("SIM_GPS1_ENABLE", 1)])
def _gps_loss(world: "Injector", v: Vehicle, fault: "Fault", on: bool) -> None:
    """End the global position; the local one drifts and ends after some dead reckoning."""
    if not on:
        _position_loss(world, v, fault, on)
        return
    v.global_valid = False
    world.let_drift(v)

    def end_local_position() -> None:
        if not v.global_valid and not v.environment.indoor:
            v.local_valid = False

    v.timers.append((v.now + _DEAD_RECKONING[v.spec.autopilot], end_local_position))


def _glitch_keys(p: Parameters) -> Values | None:
    """GPS glitch: degrees of latitude and longitude, metres of altitude, as in ArduPilot."""
    offset = (
        p["SIM_GPS1_GLTCH_Y"] * _DEGREE,
        p["SIM_GPS1_GLTCH_X"] * _DEGREE,
        p["SIM_GPS1_GLTCH_Z"],
    )
    return {"offset": offset} if any(offset) else None


@_kind(
    "offset",
    reach="sensors",
    injected={(_GPS, _WRONG): {"offset": (3.0, 4.0, 0.0)}},
    sources=[Source(dict.fromkeys((f"SIM_GPS1_GLTCH_{x}" for x in "XYZ"), 0.0), _glitch_keys)],
)
def _gps_jump(_: "Injector", v: Vehicle, fault: "Fault", on: bool) -> None:
    if on:
        v.bodies.bias[v.index] += fault.offset
    else:
        v.bodies.bias[v.index] -= fault.offset


@_kind(injected={(_GPS, _GARBAGE): {}, (_VISION, _OFF): {}}, sources=[_switch("SIM_POS_LOSS")])
def _position_loss(world: "Injector", v: Vehicle, _: "Fault", on: bool) -> None:
    """End all positions; the estimate drifts."""
    if on:
        v.local_valid = v.global_valid = False
        world.let_drift(v)
        return
    v.local_valid = True
    v.global_valid = not v.environment.indoor
    v.bodies.drift[v.index] = 0.0


@_kind(
    "offset",
    injected={(_VISION, _WRONG): {"offset": (5.0, 0.0, 0.0)}},
    sources=[_shift("SIM_ORIGIN_E", 1.0, 0.0, 0.0), _shift("SIM_ORIGIN_N", 0.0, 1.0, 0.0)],
)
def _origin_reset(_: "Injector", v: Vehicle, fault: "Fault", on: bool) -> None:
    """Move the estimator's origin; it stays there."""
    if on:
        v.move_origin(v.origin + fault.offset)


@_kind(
    "rate",
    reach="sensors",
    injected={(_BAROMETER, _WRONG): {"rate": 0.1}},
    sources=[_amount("SIM_BARO_DRIFT", 0.0, "rate")],
)
def _barometer_drift(world: "Injector", v: Vehicle, fault: "Fault", on: bool) -> None:
    """Let the barometer's height drift, see `Injector.tick`; it stays where it is."""
    if on:
        world.drifts[v.index] = fault.rate
    else:
        world.drifts.pop(v.index, None)


@_kind("turn", injected={(_COMPASS, _WRONG): {"turn": 0.7}})
def _heading(_: "Injector", v: Vehicle, fault: "Fault", on: bool) -> None:
    """Let the estimator take over the heading of a disturbed compass: at once, as in its resets.

    The vehicle turns back to the heading that it is to hold, and is off by as much from then on: it
    pushes aside of where it wants to go.
    """
    turn = fault.turn if on else -fault.turn
    v.bodies.heading_error[v.index] += turn
    v.bodies.yaw[v.index] -= turn


def _freeze_keys(p: Parameters) -> Values | None:
    """Freeze for a number of seconds: a frozen autopilot accepts no command that ends it."""
    return {"duration": p["SIM_FREEZE"]} if p["SIM_FREEZE"] > 0 else None


@_kind(injected={(_AUTOPILOT, _STUCK): {}}, sources=[Source({"SIM_FREEZE": 0.0}, _freeze_keys)])
def _freeze(_: "Injector", v: Vehicle, __: "Fault", on: bool) -> None:
    v.frozen = on


@_kind(injected={(_AUTOPILOT, _INTERMITTENT): {}}, sources=[_switch("SIM_REBOOT")])
def _reboot(_: "Injector", v: Vehicle, __: "Fault", on: bool) -> None:
    if on:
        v.reboot()


@_kind(
    "text",
    injected={
        (_GYRO, _OFF): {"text": "Gyro sensor 0 missing"},
        (_ACCELEROMETER, _OFF): {"text": "Accel sensor 0 missing"},
        (_COMPASS, _OFF): {"text": "Compass sensor 0 missing"},
        (_AUTOPILOT, _DELAYED): {"text": _UNHEALTHY},
    },
    sources=[_switch("SIM_ARM_REFUSE")],
)
def _refuse_arming(_: "Injector", v: Vehicle, fault: "Fault", on: bool) -> None:
    v.refuse_arming = fault.text if on else None


@_kind(injected={(_RADIO, _WRONG): {}}, sources=[_switch("SIM_PILOT")])
def _pilot(_: "Injector", v: Vehicle, __: "Fault", on: bool) -> None:
    """Let a pilot take over; the mode stays when the pilot has left."""
    if on:
        v.autopilot.pilot_override()
    else:
        v.autopilot.pilot = False


@_kind(injected={(_RADIO, _OFF): {}}, sources=[_switch("SIM_RC_FAIL")])
def _rc_loss(_: "Injector", v: Vehicle, __: "Fault", on: bool) -> None:
    v.radio_lost = on


@_kind(injected={(_AUTOPILOT, _GARBAGE): {}}, sources=[_switch("SIM_LEAVE")])
def _leave_offboard(_: "Injector", v: Vehicle, __: "Fault", on: bool) -> None:
    if on:
        v.autopilot.leave_offboard()


@_kind(injected={(_AUTOPILOT, _OFF): {}}, sources=[_switch("SIM_DISARM")])
def _disarm(_: "Injector", v: Vehicle, __: "Fault", on: bool) -> None:
    if on:
        v.autopilot.disarm("fault")


@_kind(
    injected={(_DISTANCE, _WRONG): {}, (_AUTOPILOT, _WRONG): {}}, sources=[_switch("SIM_LANDED")]
)
def _believes_landed(_: "Injector", v: Vehicle, __: "Fault", on: bool) -> None:
    if on:
        v.bodies.landed[v.index] = True
    v.bodies.false_landing[v.index] = on


@_kind(reach="bodies", injected={(_SERVO, _OFF): {}}, sources=[_gripper_failure(1)])
def _gripper_stuck_open(_: "Injector", v: Vehicle, __: "Fault", on: bool) -> None:
    v.gripper.stuck = "open" if on else None


@_kind(reach="bodies", injected={(_SERVO, _STUCK): {}}, sources=[_gripper_failure(2)])
def _gripper_stuck_shut(_: "Injector", v: Vehicle, __: "Fault", on: bool) -> None:
    v.gripper.stuck = "shut" if on else None


@_kind("slide", reach="bodies", injected={(_SERVO, _WRONG): {}}, sources=[_gripper_failure(3)])
def _gripper_slip(world: "Injector", v: Vehicle, fault: "Fault", on: bool) -> None:
    """Slide the cable through the closed jaws by some metres, or out of them."""
    if not (on and v.gripper.gripped):
        return
    if fault.slide is not None and world.rope is not None:
        world.rope.slide(v.index, fault.slide)
    else:
        v.environment.release(v.index)
        v.gripper.gripped = False


@_kind(
    "fraction",
    injected={(_AUTOPILOT, _SLOW): {"fraction": 0.9}},
    sources=[_amount("SIM_CLOCK_MUL", 1.0, "fraction")],
)
def _slow_clock(_: "Injector", v: Vehicle, fault: "Fault", on: bool) -> None:
    """Change the rate of the clock without a jump of its time."""
    time = v.clock()
    v.clock_rate = max(fault.fraction, 0.01) if on else 1.0
    v.booted_at = v.now - time / v.clock_rate


def _wind_keys(p: Parameters) -> Values | None:
    """Wind: SIM_WIND_DIR is the direction of its origin in degrees."""
    speed, angle = p["SIM_WIND_SPD"], math.radians(p["SIM_WIND_DIR"])
    if not speed and not p["SIM_WIND_TURB"]:
        return None
    steady = (-speed * math.sin(angle), -speed * math.cos(angle), 0.0)
    return {"steady": steady, "gust": p["SIM_WIND_TURB"]}


@_kind(
    "steady", "gust",
    reach="world",
    injected={},
    sources=[
        Source({"SIM_WIND_DIR": 180.0, "SIM_WIND_SPD": 0.0, "SIM_WIND_TURB": 0.0}, _wind_keys)
    ],
)  # fmt: skip
def _wind(world: "Injector", _: Vehicle, fault: "Fault", on: bool) -> None:
    """Set the wind; afterwards it is the world's again."""
    if on:
        world.set_wind(fault.steady, fault.gust)
    else:
        world.set_wind(*world.initial_wind)


def _snag_keys(p: Parameters) -> Values | None:
    if p["SIM_SNAG_ARC"] < 0:
        return None
    hold = p["SIM_SNAG_HOLD"]
    return {"arc": p["SIM_SNAG_ARC"], "friction": hold if hold > 0 else None}


@_kind(
    "arc", "friction",
    reach="world",
    injected={(_CABLE, _STUCK): {}},
    sources=[Source({"SIM_SNAG_ARC": -1.0, "SIM_SNAG_HOLD": 0.0}, _snag_keys)],
)  # fmt: skip
def _snag(world: "Injector", _: Vehicle, fault: "Fault", on: bool) -> None:
    """Hold the cable at its present place by friction (default: near its middle)."""
    rope, anchors, vehicles = world.rope, world.anchors, len(world.vehicles)
    if rope is None:
        return
    if on:
        places = [world.bodies.grip_points(), *(anchor.position[None] for anchor in anchors)]
        rope.update(np.vstack(places), 0.0)  # samples may be up to a second old
        arc = rope.nearest_free(0.5 * rope.length if fault.arc is None else fault.arc)
        rope_holder = vehicles + len(anchors)
        anchors.append(Anchor(fault, rope.position_at(arc)))
        rope.attach(rope_holder, arc)
        return
    for k, anchor in enumerate(anchors):
        if anchor.holds and anchor.fault == fault:
            anchor.holds = False
            rope.release(vehicles + k)
    if not any(anchor.holds for anchor in anchors):
        anchors.clear()


@_kind("error", "body", reach="bodies", injected={})
def _capture(_: "Injector", __: Vehicle, ___: "Fault", ____: bool) -> None:
    """Let motion capture err: `sitl.server.MotionCapture` reads the fault in `Injector.active`."""


@_kind("height", "lean", "turn", reach="bodies", injected={})
def _handled(world: "Injector", v: Vehicle, fault: "Fault", on: bool) -> None:
    """Have a person lift the standing vehicle, lean it to its right and backwards, turn it to its
    left, and put it back: within ``duration``, see `Hands`."""
    if on and v.landed and not v.armed:
        world.hands[v.index] = Hands(
            fault, world.now, v.bodies.position[v.index].copy(), float(v.bodies.yaw[v.index])
        )
    elif not on and (hands := world.hands.pop(v.index, None)) is not None:
        hands.place(v.bodies, v.index, hands.end)


SIM_PARAMETERS: dict[str, float | int] = {
    name: default
    for kind in KINDS.values()
    for source in kind.sources
    for name, default in source.defaults.items()
}
"""The SIM_* parameters of both autopilots, and their defaults."""


def fault_of_injection(unit: int, failure: int, instance: int) -> Values | None:
    """Return the keys of the fault that an injection starts, None if it is unknown.

    The instance of a MAVLink signal is the direction: 0 both, 1 to the vehicle, 2 from it.
    """
    for name, kind in KINDS.items():
        keys = kind.injected.get((unit, failure))
        if keys is not None and unit != _SIGNAL:
            return {"kind": name, **keys}
        if keys is not None and 0 <= instance <= 2:
            return {"kind": name, **keys, "direction": _DIRECTIONS[instance]}
    return None


def fault_of_parameter(name: str, parameters: Parameters) -> tuple[str, Values | None] | None:
    """Return the source of a changed SIM_* parameter and the keys of its fault, if any.

    The source is the first of the parameters that describe one fault together; None for an unknown
    name.
    """
    first = ""
    for kind_name, kind in KINDS.items():
        for source in kind.sources:
            if name in source.defaults:
                first = next(iter(source.defaults))
                keys = source.keys(parameters)
                if keys is not None:
                    return first, {"kind": kind_name, **keys}
    return (first, None) if first else None


CaptureError = Literal["swapped", "mirrored", "turned", "flipping", "frozen", "lost"]
_Metres = Annotated[float, Field(ge=-1e4, le=1e4)]
_Wind = Annotated[float, Field(ge=-100.0, le=100.0)]
_Share = Annotated[float, Field(ge=0.0, le=1.0)]
_NotNegative = Annotated[float, Field(ge=0.0, le=1e6, allow_inf_nan=False)]
_Seconds = Annotated[float, Field(ge=0.0, le=1e6, allow_inf_nan=False)]
_Delay = Annotated[float, Field(ge=0.0, le=60.0, allow_inf_nan=False)]


class Fault(BaseModel):
    """One fault: start, kind, vehicles, duration, severity."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    at: _Seconds = Field(description="start, emulated seconds since the start")
    kind: Literal[tuple(KINDS)] = Field(  # type: ignore[valid-type]
        description="kind of fault; each kind has its own keys"
    )
    vehicle: int | list[int] | Literal["all"] = Field(
        default="all", description="system ids of the vehicles; without effect for wind and snag"
    )
    duration: _Seconds | None = Field(default=None, description="s; none: permanent")
    loss: _Share = Field(default=0.0, description="share of packets that are lost")
    burst: _Seconds = Field(default=0.0, description="mean length of a burst of losses, s")
    latency: _Delay = Field(default=0.0, description="delay of every packet, s")
    jitter: _Delay = Field(
        default=0.0, description="additional delay, s: uniform from 0 to this for each packet"
    )
    duplicate: _Share = Field(default=0.0, description="share of packets that arrive twice")
    reorder: _Share = Field(
        default=0.0, description="share of packets that later packets may overtake"
    )
    bandwidth: float | None = Field(default=None, gt=0, description="bytes per second")
    direction: Literal["up", "down", "both"] = Field(
        default="both", description="up: to the vehicle, down: from it"
    )
    fraction: Annotated[float, Field(ge=0.0, le=2.0)] = Field(
        default=0.7, description="remaining share of the thrust, or of the clock's rate"
    )
    charge: _Share = Field(default=0.1, description="remaining share of the battery's charge")
    offset: tuple[_Metres, _Metres, _Metres] = Field(
        default=(5.0, 0.0, 0.0), description="metres by which the position or origin jumps, ENU"
    )
    rate: Annotated[float, Field(ge=-5, le=5)] = Field(
        default=0.1, description="drift of the barometer's height, m/s"
    )
    text: Annotated[str, Field(max_length=100)] = Field(
        default="Resolve system health failures first",
        description="reason of the refusal",
    )
    steady: tuple[_Wind, _Wind, _Wind] | None = Field(
        default=None,
        description="steady wind, m/s, ENU, to where it blows; none: unchanged",
    )
    gust: Annotated[float, Field(ge=0, le=20)] | None = Field(
        default=None, description="Dryden intensity of gusts, m/s; none: unchanged"
    )
    arc: _NotNegative | None = Field(
        default=None, description="arc length along the cable, m; none: near its middle"
    )
    friction: float | None = Field(
        default=None,
        gt=0,
        description="newtons above which a snag slides; none: it never slides",
    )
    slide: _Metres | None = Field(
        default=None,
        description="metres by which the grip moves along the cable; none: the cable leaves it",
    )
    error: CaptureError = Field(
        default="lost",
        description="of motion capture: swapped with another body; mirrored at the plane x = 0; "
        "turned by 90 degrees on its vehicle; flipping by 180 degrees each half second; frozen; "
        "lost",
    )
    body: int | None = Field(default=None, description="system id whose body is swapped with it")
    height: Annotated[float, Field(ge=0.0, le=3.0)] = Field(
        default=0.5, description="metres by which a person lifts the vehicle"
    )
    lean: Annotated[float, Field(ge=0.0, le=1.2)] = Field(
        default=0.6, description="radians by which a person leans the vehicle"
    )
    turn: Annotated[float, Field(ge=0.0, le=3.0)] = Field(
        default=1.0,
        description="radians by which a person turns the vehicle, or by which its heading is off",
    )

    @model_validator(mode="after")
    def _fits(self) -> "Fault":
        keys = KINDS[self.kind].keys
        extra = sorted(self.model_fields_set - {"at", "kind", "vehicle", "duration", *keys})
        if extra:
            known = ", ".join(keys) or "no further keys"
            raise ValueError(f"{self.kind}: expected {known}, got {', '.join(extra)}")
        if self.kind == "handled" and not self.duration:
            raise ValueError("handled: expected a duration above 0: a person puts it back")
        if self.kind == "capture" and (self.error == "swapped") != (self.body is not None):
            raise ValueError("capture: expected a body with swapped, and with nothing else")
        return self


class Scenario(BaseModel):
    """A scenario file."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    schema_: Literal[1] = Field(default=1, alias="schema", description="version of this format")
    faults: list[Fault] = Field(description="faults, in any order")


def parse_scenario(text: str, name: str = "scenario") -> list[Fault]:
    """Return the faults in the text of a scenario file; raise `WorldError` with every error."""
    data = parse_yaml(text, name)
    try:
        return Scenario.model_validate(data, by_alias=True, by_name=False).faults
    except ValidationError as error:
        raise WorldError(explain(error, name)) from None


def load_scenario(path: str | Path) -> list[Fault]:
    """Return the faults of a scenario file; raise `WorldError` with every error."""
    return parse_scenario(read_text(Path(path)), str(path))


class UniformNumbers:
    """Uniform random numbers from 0 to 1, drawn in blocks: the same numbers as single draws."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._left: list[float] = []

    def draw(self) -> float:
        """Return the next number."""
        return self.at_least(1).pop()

    def at_least(self, count: int) -> list[float]:
        """Return the list of the next numbers, at least ``count``; callers pop from its end."""
        numbers = self._left
        while len(numbers) < count:
            numbers[:0] = self._rng.random(_BLOCK)[::-1].tolist()
        return numbers


@dataclass
class Channel:
    """One direction of a vehicle's link, with its errors; whole frames, in virtual time."""

    random: UniformNumbers
    fault: Fault | None = None
    queue: list[tuple[float, int, Any]] = field(default_factory=list)
    count: int = 0
    free_at: float = 0.0
    outage: bool = False
    checked_at: float = 0.0
    _plain: tuple[float, float, float] | None = field(init=False)
    """Loss, latency and jitter, if the fault has no other errors."""

    def __post_init__(self) -> None:
        self.set_fault(self.fault)

    def set_fault(self, fault: Fault | None) -> None:
        """Set the fault of this direction; None ends it."""
        self.fault, self._plain = fault, None
        if fault is not None and not (
            fault.burst or fault.reorder or fault.bandwidth or fault.duplicate
        ):
            self._plain = fault.loss, fault.latency, fault.jitter

    def push_all(self, items: Sequence[tuple[Any, ...]], now: float) -> None:
        """Send items into the channel, in the same way as `push`; each ends with its frame."""
        if self._plain is None:
            for item in items:
                self.push(item, len(item[-1]), now)
            return
        loss, latency, jitter = self._plain
        draw, queue = self.random.at_least(2 * len(items)).pop, self.queue
        count, soonest = self.count, now + latency
        for item in items:
            if loss > 0.0 and (loss >= 1.0 or draw() < loss):
                continue
            count += 1
            heappush(queue, (soonest + jitter * draw() if jitter else soonest, count, item))
        self.count = count

    def push(self, item: Any, size: int, now: float) -> None:
        """Send one frame into the channel."""
        fault, draw, at = self.fault, self.random.draw, now
        if fault is not None:
            if fault.burst > 0.0:
                if self._in_burst(fault, now):
                    return
            elif fault.loss > 0.0 and (fault.loss >= 1.0 or draw() < fault.loss):
                return
            at += fault.latency + (fault.jitter * draw() if fault.jitter else 0.0)
            if fault.reorder and draw() < fault.reorder:
                at += 0.02 + fault.jitter
            if fault.bandwidth:
                self.free_at = max(self.free_at, now) + size / fault.bandwidth
                if self.free_at - now > _LONGEST_QUEUE:
                    self.free_at -= size / fault.bandwidth
                    return
                at += self.free_at - now
        self.count += 1
        heappush(self.queue, (at, self.count, item))
        if fault is not None and fault.duplicate and draw() < fault.duplicate:
            self.count += 1
            heappush(self.queue, (at + 0.01 * draw(), self.count, item))

    def _in_burst(self, fault: Fault, now: float) -> bool:
        """Return whether a frame falls into a burst of losses (Gilbert's model).

        The mean length of a burst is ``burst`` seconds.
        """
        if fault.loss >= 1.0:
            return True
        elapsed, self.checked_at = now - self.checked_at, now
        mean = (
            fault.burst if self.outage else fault.burst * (1 - fault.loss) / max(fault.loss, 1e-9)
        )
        if self.random.draw() < 1 - math.exp(-elapsed / max(mean, 1e-6)):
            self.outage = not self.outage
        return self.outage

    def pop(self, now: float) -> list[Any]:
        """Return the items that have arrived by ``now``, and remove them."""
        arrived: list[Any] = []
        queue, limit = self.queue, now + 1e-9
        while queue and queue[0][0] <= limit:
            arrived.append(heappop(queue)[2])
        return arrived


_HELD = 9.81
"""Thrust in m/s² that stands for the attitude of a vehicle in a person's hands."""
_SLIDE_SPEED, _LARGEST_SLIDE_SPEED = 1.0, 3.0
"""m/s at twice the friction, and at most."""


@dataclass
class Anchor:
    """A point (3,) in world ENU at which a snag holds the cable."""

    fault: Fault
    position: Array
    holds: bool = True


@dataclass
class Hands:
    """A person who moves a vehicle from its place (3,) and yaw, and back."""

    fault: Fault
    began: float
    position: Array
    yaw: float

    @property
    def end(self) -> float:
        """When the vehicle stands again, seconds."""
        return self.began + (self.fault.duration or STEP)

    def pose(self, time: float) -> tuple[Array, Array]:
        """Return position (3,) and attitude of the vehicle at a time, seconds.

        The attitude is a quaternion (w, x, y, z): body FLU to world ENU.
        """
        position, yaw, right, back = self._angles(time)
        return position, _attitude(yaw, right, back)

    def _angles(self, time: float) -> tuple[Array, float, float, float]:
        """Return the position (3,), yaw, lean to the right and lean backwards at a time."""
        fault = self.fault
        share = (time - self.began) / (self.end - self.began)
        right = fault.lean * _bump(share, 0.1, 0.4)
        back = fault.lean * _bump(share, 0.35, 0.65)
        yaw = self.yaw + fault.turn * _bump(share, 0.6, 0.9)
        position = self.position.copy()
        position[2] += fault.height * _bump(share, 0.0, 1.0)
        return position, yaw, right, back

    def place(self, b: Bodies, i: int, time: float) -> None:
        """Place the emulated vehicle ``i`` as at a time; at the end it stands.

        Vehicles with real firmware are rigid bodies, which `pose` moves: theirs replaces this.
        """
        b.position[i], yaw, lean_right, lean_back = self._angles(time)
        b.velocity[i] = 0.0
        b.yaw[i] = b.goal_yaw[i] = yaw
        b.goal_position[i] = b.position[i]
        # an attitude is that of the thrust
        back, right = math.sin(lean_back), math.sin(lean_right) * math.cos(lean_back)
        up = math.cos(lean_right) * math.cos(lean_back)
        cos, sin = math.cos(yaw), math.sin(yaw)
        b.thrust[i] = (
            _HELD * (right * sin - back * cos),
            _HELD * (-right * cos - back * sin),
            _HELD * up,
        )
        b.thrust_rate[i] = 0.0
        if time >= self.end:
            b.thrust[i] = 0.0


def _attitude(yaw: float, right: float, back: float) -> Array:
    """Return the quaternion (w, x, y, z) of a heading, a lean to the right, then one backwards."""
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    cr, sr = math.cos(0.5 * right), math.sin(0.5 * right)
    cb, sb = math.cos(0.5 * back), math.sin(0.5 * back)
    w, x, y, z = cy * cr, cy * sr, sy * sr, sy * cr
    return np.array([w * cb + y * sb, x * cb + z * sb, y * cb - w * sb, z * cb - x * sb])


def _bump(share: float, start: float, end: float) -> float:
    """Return a smooth value between 0 and 1 that is 0 outside of start and end."""
    if not start < share < end:
        return 0.0
    return math.sin(math.pi * (share - start) / (end - start)) ** 2


class Injector:
    """Starts and ends faults at their times."""

    def __init__(
        self,
        vehicles: Sequence[Vehicle],
        bodies: Bodies,
        rope: AnyRope | None,
        faults: Sequence[Fault],
        rng: np.random.Generator,
    ) -> None:
        self.vehicles = vehicles
        self.by_id = {vehicle.system: vehicle for vehicle in vehicles}
        self.bodies = bodies
        self.rope = rope
        self.rng = rng
        random = UniformNumbers(rng)
        self.up = [Channel(random) for _ in vehicles]
        self.down = [Channel(random) for _ in vehicles]
        self.link_faults = False
        self.now = 0.0
        self.active: list[tuple[Fault, int]] = []
        self._parameter_faults: dict[tuple[int, str], Fault] = {}
        self.initial_wind = (tuple(bodies.steady_wind[0].tolist()), bodies.gust_intensity)
        self.drifts: dict[int, float] = {}
        self.anchors: list[Anchor] = []
        self.hands: dict[int, Hands] = {}
        self._timers: list[tuple[float, int, Callable[[], None]]] = []
        self._count = 0
        for fault in faults:
            self.add(fault)

    def add(self, fault: Fault) -> None:
        """Schedule a fault; raise `WorldError` if it names a vehicle that does not exist."""
        ids = [fault.vehicle] if isinstance(fault.vehicle, int) else fault.vehicle
        if ids == "all":
            ids = list(self.by_id)
        named = set(ids) | ({fault.body} if fault.body is not None else set())
        unknown = sorted(named - set(self.by_id))
        if unknown:
            raise WorldError(f"faults: expected vehicles of the world, got {unknown}")
        if KINDS[fault.kind].reach == "world":
            ids = [self.vehicles[0].system]
        else:
            for system in ids:
                self._refuse_unreachable(fault, self.by_id[system])
        for system in ids:
            self._schedule(fault.at, functools.partial(self.start, fault, system))
            self._schedule_end(fault, system)

    def _refuse_unreachable(self, fault: Fault, vehicle: Vehicle) -> None:
        """Raise `WorldError` for a fault that the world cannot cause in real firmware."""
        if not self.bodies.outside[vehicle.index]:
            return
        autopilot = vehicle.spec.autopilot
        reached = {"bodies", "world"} | ({"sensors"} if autopilot == "px4" else set())
        if KINDS[fault.kind].reach not in reached:
            known = sorted(name for name, kind in KINDS.items() if kind.reach in reached)
            raise WorldError(
                f"faults: expected one of {', '.join(known)} for vehicle "
                f"{vehicle.system} with firmware ({autopilot}), got {fault.kind}"
            )

    def _schedule(self, at: float, action: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._timers, (at, self._count, action))

    def _schedule_end(self, fault: Fault, system: int) -> None:
        if fault.duration is not None:
            end = functools.partial(self.end, fault, system)
            self._schedule(fault.at + fault.duration, end)

    def tick(self, now: float) -> bool:
        """Start and end the faults that are due, advance drifts; return whether a fault changed."""
        self.now = now
        changed = bool(self._timers) and self._timers[0][0] <= now + 1e-9
        while self._timers and self._timers[0][0] <= now + 1e-9:
            heapq.heappop(self._timers)[2]()
        if self.drifts:
            for i, rate in self.drifts.items():
                self.bodies.bias[i, 2] += rate * STEP
                self.vehicles[i].barometer += rate * STEP
        for i, hands in self.hands.items():
            hands.place(self.bodies, i, now)
        return changed

    def start(self, fault: Fault, sysid: int) -> None:
        """Start a fault now."""
        v = self.by_id[sysid]
        v.environment.event("fault", sysid, fault=fault.kind)
        self.active.append((fault, sysid))
        KINDS[fault.kind].effect(self, v, fault, True)
        self.bodies.refresh()

    def end(self, fault: Fault, sysid: int) -> None:
        """End a fault now if it is active; some effects, such as a drained battery, remain."""
        if (fault, sysid) not in self.active:
            return
        v = self.by_id[sysid]
        self.active.remove((fault, sysid))
        v.environment.event("fault ended", sysid, fault=fault.kind)
        KINDS[fault.kind].effect(self, v, fault, False)
        self.bodies.refresh()

    def let_drift(self, v: Vehicle) -> None:
        """Let the estimate of a vehicle drift with a random velocity."""
        self.bodies.drift[v.index] = self.rng.normal(0.0, 0.3, 3) * (1.0, 1.0, 0.2)

    def set_wind(self, steady: tuple[float, float, float] | None, gust: float | None) -> None:
        """Set the steady wind (m/s, ENU) and the intensity of gusts; None leaves them."""
        if steady is not None:
            self.bodies.steady_wind[:] = steady
            self.bodies.wind[:] = self.bodies.steady_wind
            if self.rope is not None:
                self.rope.set_wind(np.array(steady))
        if gust is not None:
            self.bodies.gust_intensity = gust

    def drop_snags(self) -> None:
        """Release all snags when no vehicle holds the cable: its own strands held it."""
        rope, vehicles = self.rope, len(self.vehicles)
        if rope is None or any(holder < vehicles for _, holder in rope.grips):
            return
        for k, anchor in enumerate(self.anchors):
            anchor.holds = False
            rope.release(vehicles + k)
        self.anchors.clear()

    def drag(self, force: Array, interval: float) -> None:
        """Move the snags whose force exceeds their friction; ``force`` (m, 3) in newtons.

        Regularised Coulomb friction: above its threshold an anchor creeps along the force.
        """
        for anchor, pull in zip(self.anchors, force, strict=True):
            size = float(np.linalg.norm(pull))
            hold = anchor.fault.friction
            if anchor.holds and hold is not None and size > hold:
                speed = min(_SLIDE_SPEED * (size - hold) / hold, _LARGEST_SLIDE_SPEED)
                anchor.position += interval * speed * pull / size

    def inject(self, v: Vehicle, unit: int, failure: int, instance: int) -> bool:
        """Execute MAV_CMD_INJECT_FAILURE; return whether the failure is known.

        Failure type 0 ends all faults of the unit.
        """
        if failure == 0:
            kinds = {
                name
                for name, kind in KINDS.items()
                if any(unit == known for known, _ in kind.injected)
            }
            for fault in [f for f, sysid in self.active if sysid == v.system and f.kind in kinds]:
                self.end(fault, v.system)
            return bool(kinds)
        values = fault_of_injection(unit, failure, instance)
        if values is None:
            return False
        self.start(Fault.model_validate({"at": 0.0, **values}), v.system)
        return True

    def apply_parameter(self, v: Vehicle, name: str, values: Mapping[str, float]) -> None:
        """Apply a SIM_* parameter: end the fault of its source, and start its present fault."""
        described = fault_of_parameter(name, values)
        if described is None:
            return
        source, keys = described
        before = self._parameter_faults.pop((v.system, source), None)
        if before is not None:
            self.end(before, v.system)
        if keys is None:
            return
        fault = Fault.model_validate({"at": self.now, **keys})
        self._parameter_faults[v.system, source] = fault
        self.start(fault, v.system)
        self._schedule_end(fault, v.system)
