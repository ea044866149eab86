"""Applies faults at their times: what each one does to a vehicle, its link or the world."""

import functools
import heapq
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from sitl.dynamics import STEP, Bodies
from sitl.faults import WORLDWIDE, Channel, Fault
from sitl.rope import Rope
from sitl.vehicle import Vehicle
from sitl.world import WorldError


class Injector:
    """Applies faults at their times and ends them at theirs."""

    def __init__(
        self,
        vehicles: Sequence[Vehicle],
        bodies: Bodies,
        rope: Rope | None,
        faults: Sequence[Fault],
        rng: np.random.Generator,
    ) -> None:
        self.vehicles = vehicles
        self.by_id = {vehicle.system: vehicle for vehicle in vehicles}
        self.bodies = bodies
        self.rope = rope
        self.rng = rng
        self.up = [Channel(rng) for _ in vehicles]
        self.down = [Channel(rng) for _ in vehicles]
        self.troubled = False
        self.drifts: dict[int, float] = {}
        self.anchors: list[tuple[int, np.ndarray[Any, Any]]] = []
        self._agenda: list[tuple[float, int, Callable[[], None]]] = []
        self._count = 0
        for fault in faults:
            self.add(fault)

    def add(self, fault: Fault) -> None:
        """Put a fault on the agenda; `WorldError` if it names a vehicle that is not there."""
        wanted = fault.vehicle
        ids = [wanted] if isinstance(wanted, int) else wanted
        if ids == "all":
            ids = list(self.by_id)
        unknown = sorted(set(ids) - set(self.by_id))
        if unknown:
            raise WorldError(f"faults: expected vehicles of the world, got {unknown}")
        for target in [self.vehicles[0].system] if fault.kind in WORLDWIDE else ids:
            self._plan(fault.at, functools.partial(self.start, fault, target))
            if fault.duration is not None:
                self._plan(fault.at + fault.duration, functools.partial(self.end, fault, target))

    def _plan(self, at: float, action: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._agenda, (at, self._count, action))

    def tick(self, now: float) -> None:
        """Do what is due; let drifting barometers drift."""
        while self._agenda and self._agenda[0][0] <= now + 1e-9:
            heapq.heappop(self._agenda)[2]()
        if self.drifts:
            for i, rate in self.drifts.items():
                self.bodies.bias[i, 2] += rate * STEP

    def start(self, fault: Fault, sysid: int) -> None:
        """Begin a fault now."""
        v = self.by_id[sysid]
        v.around.event("fault", sysid, fault=fault.kind)
        _START[fault.kind](self, v, fault)
        self.bodies.touch()

    def end(self, fault: Fault, sysid: int) -> None:
        """End a fault now; some cannot be undone."""
        v = self.by_id[sysid]
        v.around.event("fault over", sysid, fault=fault.kind)
        _END.get(fault.kind, _stays)(self, v, fault)
        self.bodies.touch()

    # Beginnings.

    def _link(self, v: Vehicle, fault: Fault) -> None:
        self.troubled = True
        if fault.direction in {"up", "both"}:
            self.up[v.index].fault = fault
        if fault.direction in {"down", "both"}:
            self.down[v.index].fault = fault

    def _link_over(self, v: Vehicle, fault: Fault) -> None:
        for channel in (self.up[v.index], self.down[v.index]):
            if channel.fault is fault or channel.fault == fault:
                channel.fault = None

    def _motor_loss(self, v: Vehicle, _: Fault) -> None:
        """A quadrotor without one motor keeps little thrust, and turns over."""
        self.bodies.health[v.index] = 0.15
        self.bodies.tumbling[v.index] = not self.bodies.landed[v.index]

    def _weak(self, v: Vehicle, fault: Fault) -> None:
        self.bodies.health[v.index] = fault.fraction

    def _healthy(self, v: Vehicle, _: Fault) -> None:
        if not self.bodies.crashed[v.index]:
            self.bodies.health[v.index] = 1.0

    def _battery(self, v: Vehicle, fault: Fault) -> None:
        v.charge = min(v.charge, fault.charge)

    def _gps_loss(self, v: Vehicle, _: Fault) -> None:
        """Local position outlives GPS by a few seconds of dead reckoning, drifting."""
        v.global_valid = False
        self.bodies.drift[v.index] = self.rng.normal(0.0, 0.3, 3) * (1.0, 1.0, 0.2)

        def give_up() -> None:
            if not v.global_valid and not v.around.indoor:
                v.local_valid = False

        v.later.append((v.now + 4.0, give_up))

    def _gps_back(self, v: Vehicle, _: Fault) -> None:
        v.local_valid = True
        v.global_valid = not v.around.indoor
        self.bodies.drift[v.index] = 0.0

    def _position_loss(self, v: Vehicle, _: Fault) -> None:
        v.local_valid = v.global_valid = False
        self.bodies.drift[v.index] = self.rng.normal(0.0, 0.3, 3) * (1.0, 1.0, 0.2)

    def _gps_jump(self, v: Vehicle, fault: Fault) -> None:
        self.bodies.bias[v.index] += fault.offset

    def _gps_jump_over(self, v: Vehicle, fault: Fault) -> None:
        self.bodies.bias[v.index] -= fault.offset

    def _origin_reset(self, v: Vehicle, fault: Fault) -> None:
        v.move_origin(v.origin + fault.offset)

    def _barometer(self, v: Vehicle, fault: Fault) -> None:
        self.drifts[v.index] = fault.rate

    def _barometer_over(self, v: Vehicle, _: Fault) -> None:
        self.drifts.pop(v.index, None)

    def _freeze(self, v: Vehicle, _: Fault) -> None:
        v.frozen = True

    def _freeze_over(self, v: Vehicle, _: Fault) -> None:
        v.frozen = False

    def _reboot(self, v: Vehicle, _: Fault) -> None:
        v.reboot()

    def _refuse(self, v: Vehicle, fault: Fault) -> None:
        v.refuse_arming = fault.text

    def _refuse_over(self, v: Vehicle, _: Fault) -> None:
        v.refuse_arming = None

    def _pilot(self, v: Vehicle, _: Fault) -> None:
        v.personality.pilot_takes_over()

    def _leave(self, v: Vehicle, _: Fault) -> None:
        v.personality.leave()

    def _disarm(self, v: Vehicle, _: Fault) -> None:
        v.personality.disarm("fault")

    def _landed(self, v: Vehicle, _: Fault) -> None:
        self.bodies.landed[v.index] = True
        self.bodies.fooled[v.index] = True

    def _landed_over(self, v: Vehicle, _: Fault) -> None:
        self.bodies.fooled[v.index] = False

    def _stuck_open(self, v: Vehicle, _: Fault) -> None:
        v.stuck = "open"

    def _stuck_shut(self, v: Vehicle, _: Fault) -> None:
        v.stuck = "shut"

    def _unstuck(self, v: Vehicle, _: Fault) -> None:
        v.stuck = None

    def _slip(self, v: Vehicle, _: Fault) -> None:
        if v.gripped:
            v.around.release(v.index)
            v.gripped = False

    def _clock(self, v: Vehicle, fault: Fault) -> None:
        """Change the clock's pace without a jump of its reading."""
        reading = v.clock()
        v.clock_rate = max(fault.fraction, 0.01)
        v.booted_at = v.now - reading / v.clock_rate

    def _clock_over(self, v: Vehicle, fault: Fault) -> None:
        self._clock(v, fault.model_copy(update={"fraction": 1.0}))

    def _wind(self, _: Vehicle, fault: Fault) -> None:
        if fault.steady is not None:
            self.bodies.steady_wind[:] = fault.steady
            self.bodies.wind = self.bodies.steady_wind.copy()
            if self.rope is not None:
                self.rope.set_wind(np.array(fault.steady))
        if fault.gust is not None:
            self.bodies.gust_intensity = fault.gust

    def _wind_over(self, v: Vehicle, _: Fault) -> None:
        self._wind(v, Fault(at=0.0, kind="wind", steady=(0.0, 0.0, 0.0), gust=0.0))

    def _snag(self, _: Vehicle, fault: Fault) -> None:
        """Pin the cable where it is at one arc length (default: its middle)."""
        if self.rope is None:
            return
        arc = 0.5 * self.rope.length if fault.arc is None else min(fault.arc, self.rope.length)
        place = self.rope.place_of(arc)
        number = len(self.vehicles) + len(self.anchors)
        self.anchors.append((number, place))
        self.rope.tie(number, arc)

    def _snag_over(self, _: Vehicle, __: Fault) -> None:
        if self.rope is not None and self.anchors:
            for number, _place in self.anchors:
                self.rope.let_go(number)
            self.anchors.clear()

    # From MAVLink.

    def inject(self, v: Vehicle, unit: int, kind: int) -> bool:
        """MAV_CMD_INJECT_FAILURE: a unit fails in a way (0: works again); False if not known."""
        if kind == 0:
            for name in _UNIT_FAULTS.get(unit, ()):
                _END.get(name, _stays)(self, v, self.up[v.index].fault or Fault(at=0.0, kind=name))
                for channel in (self.up[v.index], self.down[v.index]):
                    if name == "link":
                        channel.fault = None
            self.bodies.touch()
            return unit in _UNIT_FAULTS
        values = _INJECTED.get((unit, kind))
        if values is None:
            return False
        self.start(Fault.model_validate({"at": 0.0, **values}), v.system)
        return True

    def simulate(self, v: Vehicle, name: str, value: float) -> None:
        """ArduPilot's SIM_* parameters."""
        values: dict[str, Any] | None = None
        over = False
        if name == "SIM_GPS1_ENABLE":
            values, over = {"kind": "gps_loss"}, value != 0
        elif name == "SIM_ENGINE_MUL":
            values = {"kind": "weak_thrust", "fraction": min(max(value, 0.0), 2.0)}
        elif name == "SIM_ENGINE_FAIL":
            values, over = {"kind": "motor_loss"}, value == 0
        elif name == "SIM_BARO_DRIFT":
            values = {"kind": "barometer_drift", "rate": min(max(value, -5.0), 5.0)}
        elif name == "SIM_RC_FAIL":
            values = {"kind": "pilot"} if value else None
        if values is not None:
            fault = Fault.model_validate({"at": 0.0, **values})
            (self.end if over else self.start)(fault, v.system)


def _stays(_: Injector, __: Vehicle, ___: Fault) -> None:
    return


_Action = Callable[[Injector, Vehicle, Fault], None]
_START: dict[str, _Action] = {
    "link": Injector._link,
    "motor_loss": Injector._motor_loss,
    "weak_thrust": Injector._weak,
    "battery": Injector._battery,
    "gps_loss": Injector._gps_loss,
    "gps_jump": Injector._gps_jump,
    "position_loss": Injector._position_loss,
    "origin_reset": Injector._origin_reset,
    "barometer_drift": Injector._barometer,
    "freeze": Injector._freeze,
    "reboot": Injector._reboot,
    "refuse_arming": Injector._refuse,
    "pilot": Injector._pilot,
    "leave_offboard": Injector._leave,
    "disarm": Injector._disarm,
    "believes_landed": Injector._landed,
    "gripper_stuck_open": Injector._stuck_open,
    "gripper_stuck_shut": Injector._stuck_shut,
    "gripper_slip": Injector._slip,
    "slow_clock": Injector._clock,
    "wind": Injector._wind,
    "snag": Injector._snag,
}
_END: dict[str, _Action] = {
    "link": Injector._link_over,
    "motor_loss": Injector._healthy,
    "weak_thrust": Injector._healthy,
    "gps_loss": Injector._gps_back,
    "gps_jump": Injector._gps_jump_over,
    "position_loss": Injector._gps_back,
    "barometer_drift": Injector._barometer_over,
    "freeze": Injector._freeze_over,
    "refuse_arming": Injector._refuse_over,
    "believes_landed": Injector._landed_over,
    "gripper_stuck_open": Injector._unstuck,
    "gripper_stuck_shut": Injector._unstuck,
    "slow_clock": Injector._clock_over,
    "wind": Injector._wind_over,
    "snag": Injector._snag_over,
}

# FAILURE_UNIT × FAILURE_TYPE of MAVLink.
_BARO, _GPS, _BATTERY, _MOTOR, _SERVO, _RC, _SIGNAL = 3, 4, 100, 101, 102, 104, 105
_OFF, _STUCK, _GARBAGE, _WRONG, _SLOW, _DELAYED, _INTERMITTENT = range(1, 8)
_INJECTED: dict[tuple[int, int], dict[str, Any]] = {
    (_BARO, _WRONG): {"kind": "barometer_drift", "rate": 0.1},
    (_GPS, _OFF): {"kind": "gps_loss"},
    (_GPS, _WRONG): {"kind": "gps_jump", "offset": (3.0, 4.0, 0.0)},
    (_GPS, _GARBAGE): {"kind": "position_loss"},
    (_BATTERY, _OFF): {"kind": "battery", "charge": 0.04},
    (_BATTERY, _WRONG): {"kind": "battery", "charge": 0.1},
    (_MOTOR, _OFF): {"kind": "motor_loss"},
    (_MOTOR, _WRONG): {"kind": "weak_thrust", "fraction": 0.7},
    (_MOTOR, _SLOW): {"kind": "weak_thrust", "fraction": 0.85},
    (_SERVO, _STUCK): {"kind": "gripper_stuck_shut"},
    (_SERVO, _OFF): {"kind": "gripper_stuck_open"},
    (_RC, _WRONG): {"kind": "pilot"},
    (_SIGNAL, _OFF): {"kind": "link", "loss": 1.0},
    (_SIGNAL, _SLOW): {"kind": "link", "bandwidth": 2000.0},
    (_SIGNAL, _DELAYED): {"kind": "link", "latency": 0.3, "jitter": 0.1},
    (_SIGNAL, _INTERMITTENT): {"kind": "link", "loss": 0.5, "burst": 0.3},
}
_UNIT_FAULTS: dict[int, tuple[str, ...]] = {
    _BARO: ("barometer_drift",),
    _GPS: ("gps_loss",),
    _BATTERY: (),
    _MOTOR: ("motor_loss",),
    _SERVO: ("gripper_stuck_shut",),
    _RC: (),
    _SIGNAL: ("link",),
}
