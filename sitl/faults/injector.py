"""Start and end of faults, and their effects on a vehicle, its links or the world.

MAVLink injects them, too, by MAV_CMD_INJECT_FAILURE and SIM_* parameters.

`MAV_CMD_INJECT_FAILURE` names a unit, a kind of failure and an instance. MAVLink has no unit for
the autopilot as a whole or for the cable: numbers 200 and 201 are this emulator's own.

`sitl.protocol.parameter_protocol` has the SIM_* parameters. A parameter that returns to its default
ends the fault that it started.
"""

import functools
import heapq
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Any

import numpy as np

from sitl.cable.swinging import AnyRope
from sitl.faults.scenario import REACHABLE, SENSORS, WORLDWIDE, Fault
from sitl.physics.dynamics import STEP, Array, Bodies
from sitl.protocol.parameter_protocol import OF_ARDUPILOT, OWN, SIM_PARAMETERS
from sitl.protocol.vehicle import Vehicle
from sitl.world import WorldError

_BLOCK = 256
_LONGEST_QUEUE = 2.0
"""Seconds of waiting beyond which a link of limited bandwidth drops packets."""


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
        left = self._left
        while len(left) < count:
            left[:0] = self._rng.random(_BLOCK)[::-1].tolist()
        return left


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
    if all(p[name] == SIM_PARAMETERS[name] for name in _LINK if name != "SIM_LINK_DIR"):
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
        return None if p[name] == SIM_PARAMETERS[name] else {"kind": kind, key: p[name]}

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


_SLIDE_SPEED, _LARGEST_SLIDE_SPEED = 1.0, 3.0
"""m/s at twice the friction, and at most."""

_DEAD_RECKONING = {"px4": 5.0, "ardupilot": 15.0}
"""Seconds without a receiver for which a local position is reported: EKF2_NOAID_TOUT; measured."""


@dataclass
class Anchor:
    """A point (3,) in world ENU at which a snag holds the cable."""

    fault: Fault
    position: Array
    holds: bool = True


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
        self._initial_wind = (bodies.steady_wind[0].copy(), bodies.gust_intensity)
        self.drifts: dict[int, float] = {}
        self.anchors: list[Anchor] = []
        self._timers: list[tuple[float, int, Callable[[], None]]] = []
        self._count = 0
        for fault in faults:
            self.add(fault)

    def add(self, fault: Fault) -> None:
        """Schedule a fault; raise `WorldError` if it names a vehicle that does not exist."""
        named = fault.vehicle
        ids = [named] if isinstance(named, int) else named
        if ids == "all":
            ids = list(self.by_id)
        unknown = sorted(set(ids) - set(self.by_id))
        if unknown:
            raise WorldError(f"faults: expected vehicles of the world, got {unknown}")
        for system in () if fault.kind in WORLDWIDE else ids:
            self._refuse_unreachable(fault, self.by_id[system])
        for target in [self.vehicles[0].system] if fault.kind in WORLDWIDE else ids:
            self._schedule(fault.at, functools.partial(self.start, fault, target))
            if fault.duration is not None:
                self._schedule(
                    fault.at + fault.duration, functools.partial(self.end, fault, target)
                )

    def _refuse_unreachable(self, fault: Fault, vehicle: Vehicle) -> None:
        """Raise `WorldError` for a fault that the world cannot cause in real firmware."""
        if not self.bodies.outside[vehicle.index]:
            return
        kind = vehicle.spec.autopilot
        known = REACHABLE | (SENSORS if kind == "px4" else frozenset())
        if fault.kind not in known:
            raise WorldError(
                f"faults: expected one of {', '.join(sorted(known | WORLDWIDE))} for vehicle "
                f"{vehicle.system} with firmware ({kind}), got {fault.kind}"
            )

    def _schedule(self, at: float, action: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._timers, (at, self._count, action))

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
        return changed

    def start(self, fault: Fault, sysid: int) -> None:
        """Start a fault now."""
        v = self.by_id[sysid]
        v.environment.event("fault", sysid, fault=fault.kind)
        self.active.append((fault, sysid))
        _START[fault.kind](self, v, fault)
        self.bodies.refresh()

    def end(self, fault: Fault, sysid: int) -> None:
        """End a fault now if it is active; some effects, such as a drained battery, remain."""
        if (fault, sysid) not in self.active:
            return
        v = self.by_id[sysid]
        self.active.remove((fault, sysid))
        v.environment.event("fault ended", sysid, fault=fault.kind)
        _END.get(fault.kind, _no_effect)(self, v, fault)
        self.bodies.refresh()

    def _link(self, v: Vehicle, _: Fault) -> None:
        """Set the errors of both directions; the latest of several faults applies."""
        self.link_faults = True
        mine = [f for f, sysid in self.active if sysid == v.system and f.kind == "link"]
        for channel, direction in ((self.up[v.index], "up"), (self.down[v.index], "down")):
            faults = [fault for fault in mine if fault.direction in {direction, "both"}]
            channel.set_fault(faults[-1] if faults else None)

    def _motor_loss(self, v: Vehicle, _: Fault) -> None:
        """Leave little thrust, and tumble in flight, as a quadrotor without one motor does."""
        self.bodies.health[v.index] = 0.15
        outside = self.bodies.outside[v.index]
        self.bodies.tumbling[v.index] = outside or not self.bodies.landed[v.index]

    def _weak_thrust(self, v: Vehicle, fault: Fault) -> None:
        self.bodies.health[v.index] = fault.fraction

    def _restore_thrust(self, v: Vehicle, _: Fault) -> None:
        if self.bodies.outside[v.index]:
            self.bodies.tumbling[v.index] = False
        if not self.bodies.crashed[v.index]:
            self.bodies.health[v.index] = 1.0

    def _battery(self, v: Vehicle, fault: Fault) -> None:
        v.charge = min(v.charge, fault.charge)

    def _gps_loss(self, v: Vehicle, _: Fault) -> None:
        """End the global position; the local one drifts and ends after some dead reckoning."""
        v.global_valid = False
        self.bodies.drift[v.index] = self.rng.normal(0.0, 0.3, 3) * (1.0, 1.0, 0.2)

        def end_local_position() -> None:
            if not v.global_valid and not v.environment.indoor:
                v.local_valid = False

        v.timers.append((v.now + _DEAD_RECKONING[v.spec.autopilot], end_local_position))

    def _restore_position(self, v: Vehicle, _: Fault) -> None:
        v.local_valid = True
        v.global_valid = not v.environment.indoor
        self.bodies.drift[v.index] = 0.0

    def _position_loss(self, v: Vehicle, _: Fault) -> None:
        v.local_valid = v.global_valid = False
        self.bodies.drift[v.index] = self.rng.normal(0.0, 0.3, 3) * (1.0, 1.0, 0.2)

    def _gps_jump(self, v: Vehicle, fault: Fault) -> None:
        self.bodies.bias[v.index] += fault.offset

    def _end_gps_jump(self, v: Vehicle, fault: Fault) -> None:
        self.bodies.bias[v.index] -= fault.offset

    def _origin_reset(self, v: Vehicle, fault: Fault) -> None:
        v.move_origin(v.origin + fault.offset)

    def _barometer_drift(self, v: Vehicle, fault: Fault) -> None:
        self.drifts[v.index] = fault.rate

    def _end_barometer_drift(self, v: Vehicle, _: Fault) -> None:
        self.drifts.pop(v.index, None)

    def _freeze(self, v: Vehicle, _: Fault) -> None:
        v.frozen = True

    def _unfreeze(self, v: Vehicle, _: Fault) -> None:
        v.frozen = False

    def _reboot(self, v: Vehicle, _: Fault) -> None:
        v.reboot()

    def _refuse_arming(self, v: Vehicle, fault: Fault) -> None:
        v.refuse_arming = fault.text

    def _allow_arming(self, v: Vehicle, _: Fault) -> None:
        v.refuse_arming = None

    def _pilot(self, v: Vehicle, _: Fault) -> None:
        v.autopilot.pilot_override()

    def _end_pilot(self, v: Vehicle, _: Fault) -> None:
        v.autopilot.pilot = False

    def _radio_loss(self, v: Vehicle, _: Fault) -> None:
        v.radio_lost = True

    def _restore_radio(self, v: Vehicle, _: Fault) -> None:
        v.radio_lost = False

    def _leave_offboard(self, v: Vehicle, _: Fault) -> None:
        v.autopilot.leave_offboard()

    def _disarm(self, v: Vehicle, _: Fault) -> None:
        v.autopilot.disarm("fault")

    def _false_landing(self, v: Vehicle, _: Fault) -> None:
        self.bodies.landed[v.index] = True
        self.bodies.false_landing[v.index] = True

    def _end_false_landing(self, v: Vehicle, _: Fault) -> None:
        self.bodies.false_landing[v.index] = False

    def _stuck_open(self, v: Vehicle, _: Fault) -> None:
        v.gripper.stuck = "open"

    def _stuck_shut(self, v: Vehicle, _: Fault) -> None:
        v.gripper.stuck = "shut"

    def _free_gripper(self, v: Vehicle, _: Fault) -> None:
        v.gripper.stuck = None

    def _gripper_slip(self, v: Vehicle, fault: Fault) -> None:
        """Slide the cable through the closed jaws by some metres, or out of them."""
        if v.gripper.gripped and fault.slide is not None and self.rope is not None:
            self.rope.slide(v.index, fault.slide)
        elif v.gripper.gripped:
            v.environment.release(v.index)
            v.gripper.gripped = False

    def _slow_clock(self, v: Vehicle, fault: Fault) -> None:
        """Change the rate of the clock without a jump of its time."""
        time = v.clock()
        v.clock_rate = max(fault.fraction, 0.01)
        v.booted_at = v.now - time / v.clock_rate

    def _restore_clock(self, v: Vehicle, fault: Fault) -> None:
        self._slow_clock(v, fault.model_copy(update={"fraction": 1.0}))

    def _wind(self, _: Vehicle, fault: Fault) -> None:
        if fault.steady is not None:
            self.bodies.steady_wind[:] = fault.steady
            self.bodies.wind[:] = self.bodies.steady_wind
            if self.rope is not None:
                self.rope.set_wind(np.array(fault.steady))
        if fault.gust is not None:
            self.bodies.gust_intensity = fault.gust

    def _restore_wind(self, v: Vehicle, _: Fault) -> None:
        steady, gust = self._initial_wind
        before = tuple(float(x) for x in steady)
        self._wind(v, Fault(at=0.0, kind="wind", steady=before, gust=gust))

    def _snag(self, _: Vehicle, fault: Fault) -> None:
        """Hold the cable at its present place by friction (default: near its middle)."""
        if self.rope is None:
            return
        middle = 0.5 * self.rope.length
        places = [self.bodies.grip_points(), *(anchor.position[None] for anchor in self.anchors)]
        self.rope.update(np.vstack(places), 0.0)  # samples may be up to a second old
        arc = self.rope.nearest_free(middle if fault.arc is None else fault.arc)
        number = len(self.vehicles) + len(self.anchors)
        self.anchors.append(Anchor(fault, self.rope.position_at(arc)))
        self.rope.attach(number, arc)

    def _end_snag(self, _: Vehicle, fault: Fault) -> None:
        for k, anchor in enumerate(self.anchors):
            if anchor.holds and anchor.fault == fault and self.rope is not None:
                anchor.holds = False
                self.rope.release(len(self.vehicles) + k)
        if not any(anchor.holds for anchor in self.anchors):
            self.anchors.clear()

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
            kinds = {values["kind"] for (one, _), values in INJECTED.items() if one == unit}
            for fault in [f for f, sysid in self.active if sysid == v.system and f.kind in kinds]:
                self.end(fault, v.system)
            return unit in UNITS
        values = fault_of_injection(unit, failure, instance)
        if values is None:
            return False
        self.start(Fault.model_validate({"at": 0.0, **values}), v.system)
        return True

    def apply_parameter(self, v: Vehicle, name: str, values: Mapping[str, float]) -> None:
        """Apply a SIM_* parameter: end the fault of its source, and start its present fault."""
        found = fault_of_parameter(name, values)
        if found is None:
            return
        source, described = found
        before = self._parameter_faults.pop((v.system, source), None)
        if before is not None:
            self.end(before, v.system)
        if described is None:
            return
        fault = Fault.model_validate({"at": self.now, **described})
        self._parameter_faults[v.system, source] = fault
        self.start(fault, v.system)
        if fault.duration is not None:
            end = functools.partial(self.end, fault, v.system)
            self._schedule(self.now + fault.duration, end)


def _no_effect(_: Injector, __: Vehicle, ___: Fault) -> None:
    return


_Action = Callable[[Injector, Vehicle, Fault], None]
_START: dict[str, _Action] = {
    "link": Injector._link,
    "motor_loss": Injector._motor_loss,
    "weak_thrust": Injector._weak_thrust,
    "battery": Injector._battery,
    "gps_loss": Injector._gps_loss,
    "gps_jump": Injector._gps_jump,
    "position_loss": Injector._position_loss,
    "origin_reset": Injector._origin_reset,
    "barometer_drift": Injector._barometer_drift,
    "freeze": Injector._freeze,
    "reboot": Injector._reboot,
    "refuse_arming": Injector._refuse_arming,
    "pilot": Injector._pilot,
    "rc_loss": Injector._radio_loss,
    "leave_offboard": Injector._leave_offboard,
    "disarm": Injector._disarm,
    "believes_landed": Injector._false_landing,
    "gripper_stuck_open": Injector._stuck_open,
    "gripper_stuck_shut": Injector._stuck_shut,
    "gripper_slip": Injector._gripper_slip,
    "slow_clock": Injector._slow_clock,
    "wind": Injector._wind,
    "snag": Injector._snag,
}
_END: dict[str, _Action] = {
    "link": Injector._link,
    "motor_loss": Injector._restore_thrust,
    "weak_thrust": Injector._restore_thrust,
    "gps_loss": Injector._restore_position,
    "gps_jump": Injector._end_gps_jump,
    "position_loss": Injector._restore_position,
    "barometer_drift": Injector._end_barometer_drift,
    "freeze": Injector._unfreeze,
    "refuse_arming": Injector._allow_arming,
    "pilot": Injector._end_pilot,
    "rc_loss": Injector._restore_radio,
    "believes_landed": Injector._end_false_landing,
    "gripper_stuck_open": Injector._free_gripper,
    "gripper_stuck_shut": Injector._free_gripper,
    "slow_clock": Injector._restore_clock,
    "wind": Injector._restore_wind,
    "snag": Injector._end_snag,
}
