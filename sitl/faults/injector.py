"""Applies faults at their times: what each one does to a vehicle, its link or the world."""

import functools
import heapq
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sitl.cable.rope import Rope
from sitl.faults.mapping import INJECTED, UNITS, injected, simulated
from sitl.faults.scenario import WORLDWIDE, Channel, Dice, Fault
from sitl.physics.dynamics import STEP, Array, Bodies
from sitl.protocol.vehicle import Vehicle
from sitl.world import WorldError

_SLIDING, _FASTEST_SLIDE = 1.0, 3.0


@dataclass
class Anchor:
    """A place in the world at which the cable is caught."""

    fault: Fault
    place: Array
    holds: bool = True


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
        dice = Dice(rng)
        self.up = [Channel(dice) for _ in vehicles]
        self.down = [Channel(dice) for _ in vehicles]
        self.troubled = False
        self.now = 0.0
        self.active: list[tuple[Fault, int]] = []
        self._simulated: dict[tuple[int, str], Fault] = {}
        self._calm = (bodies.steady_wind[0].copy(), bodies.gust_intensity)
        self.drifts: dict[int, float] = {}
        self.anchors: list[Anchor] = []
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

    def tick(self, now: float) -> bool:
        """Do what is due, let drifting barometers drift; tell whether anything happened."""
        self.now = now
        happened = bool(self._agenda) and self._agenda[0][0] <= now + 1e-9
        while self._agenda and self._agenda[0][0] <= now + 1e-9:
            heapq.heappop(self._agenda)[2]()
        if self.drifts:
            for i, rate in self.drifts.items():
                self.bodies.bias[i, 2] += rate * STEP
                self.vehicles[i].barometer += rate * STEP
        return happened

    def start(self, fault: Fault, sysid: int) -> None:
        """Begin a fault now."""
        v = self.by_id[sysid]
        v.environment.event("fault", sysid, fault=fault.kind)
        self.active.append((fault, sysid))
        _START[fault.kind](self, v, fault)
        self.bodies.touch()

    def end(self, fault: Fault, sysid: int) -> None:
        """End a fault now, if it is not over yet; what it did to some things stays done."""
        if (fault, sysid) not in self.active:
            return
        v = self.by_id[sysid]
        self.active.remove((fault, sysid))
        v.environment.event("fault over", sysid, fault=fault.kind)
        _END.get(fault.kind, _stays)(self, v, fault)
        self.bodies.touch()

    # Beginnings.

    def _link(self, v: Vehicle, _: Fault) -> None:
        """Of several faults in one direction the latest counts."""
        self.troubled = True
        mine = [f for f, sysid in self.active if sysid == v.system and f.kind == "link"]
        for channel, way in ((self.up[v.index], "up"), (self.down[v.index], "down")):
            faults = [fault for fault in mine if fault.direction in {way, "both"}]
            channel.suffer(faults[-1] if faults else None)

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
            if not v.global_valid and not v.environment.indoor:
                v.local_valid = False

        v.later.append((v.now + 4.0, give_up))

    def _gps_back(self, v: Vehicle, _: Fault) -> None:
        v.local_valid = True
        v.global_valid = not v.environment.indoor
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
        v.autopilot.pilot_override()

    def _pilot_over(self, v: Vehicle, _: Fault) -> None:
        v.autopilot.pilot = False

    def _radio(self, v: Vehicle, _: Fault) -> None:
        v.radio_lost = True

    def _radio_back(self, v: Vehicle, _: Fault) -> None:
        v.radio_lost = False

    def _leave(self, v: Vehicle, _: Fault) -> None:
        v.autopilot.leave_offboard()

    def _disarm(self, v: Vehicle, _: Fault) -> None:
        v.autopilot.disarm("fault")

    def _landed(self, v: Vehicle, _: Fault) -> None:
        self.bodies.landed[v.index] = True
        self.bodies.fooled[v.index] = True

    def _landed_over(self, v: Vehicle, _: Fault) -> None:
        self.bodies.fooled[v.index] = False

    def _stuck_open(self, v: Vehicle, _: Fault) -> None:
        v.gripper.stuck = "open"

    def _stuck_shut(self, v: Vehicle, _: Fault) -> None:
        v.gripper.stuck = "shut"

    def _unstuck(self, v: Vehicle, _: Fault) -> None:
        v.gripper.stuck = None

    def _slip(self, v: Vehicle, fault: Fault) -> None:
        """The cable slides through closed jaws by some metres, or out of them altogether."""
        if v.gripper.gripped and fault.slide is not None and self.rope is not None:
            self.rope.slide(v.index, fault.slide)
        elif v.gripper.gripped:
            v.environment.release(v.index)
            v.gripper.gripped = False

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
        steady, gust = self._calm
        before = tuple(float(x) for x in steady)
        self._wind(v, Fault(at=0.0, kind="wind", steady=before, gust=gust))

    def _snag(self, _: Vehicle, fault: Fault) -> None:
        """Hold the cable where it is at one arc length (default: its middle), by friction."""
        if self.rope is None:
            return
        middle = 0.5 * self.rope.length
        places = [self.bodies.grip_points(), *(anchor.place[None] for anchor in self.anchors)]
        self.rope.follow(np.vstack(places), 0.0)  # it may not have been looked at for a second
        arc = self.rope.free_near(middle if fault.arc is None else fault.arc)
        number = len(self.vehicles) + len(self.anchors)
        self.anchors.append(Anchor(fault, self.rope.place_of(arc)))
        self.rope.tie(number, arc)

    def _snag_over(self, _: Vehicle, fault: Fault) -> None:
        for k, anchor in enumerate(self.anchors):
            if anchor.holds and anchor.fault == fault and self.rope is not None:
                anchor.holds = False
                self.rope.let_go(len(self.vehicles) + k)
        if not any(anchor.holds for anchor in self.anchors):
            self.anchors.clear()

    def drop_snags(self) -> None:
        """Let snags fall with the cable when no vehicle holds that any more: it hung on itself."""
        rope, vehicles = self.rope, len(self.vehicles)
        if rope is None or any(holder < vehicles for _, holder in rope.grips):
            return
        for k, anchor in enumerate(self.anchors):
            anchor.holds = False
            rope.let_go(vehicles + k)
        self.anchors.clear()

    def drag(self, force: Array, interval: float) -> None:
        """Let snags slide that are pulled harder than their friction holds; force (m, 3) on them.

        Coulomb friction, regularised: above its threshold an anchor creeps along the pull.
        """
        for anchor, pull in zip(self.anchors, force, strict=True):
            size = float(np.linalg.norm(pull))
            hold = anchor.fault.friction
            if anchor.holds and hold is not None and size > hold:
                speed = min(_SLIDING * (size - hold) / hold, _FASTEST_SLIDE)
                anchor.place += interval * speed * pull / size

    # From MAVLink.

    def inject(self, v: Vehicle, unit: int, failure: int, instance: int) -> bool:
        """MAV_CMD_INJECT_FAILURE: a unit fails in a way (0: works again); False if not known."""
        if failure == 0:
            kinds = {values["kind"] for (one, _), values in INJECTED.items() if one == unit}
            for fault in [f for f, sysid in self.active if sysid == v.system and f.kind in kinds]:
                self.end(fault, v.system)
            return unit in UNITS
        values = injected(unit, failure, instance)
        if values is None:
            return False
        self.start(Fault.model_validate({"at": 0.0, **values}), v.system)
        return True

    def simulate(self, v: Vehicle, name: str, values: Mapping[str, float]) -> None:
        """A SIM_* parameter has been set: end what its source began, begin what it says now."""
        meant = simulated(name, values)
        if meant is None:
            return
        source, wanted = meant
        before = self._simulated.pop((v.system, source), None)
        if before is not None:
            self.end(before, v.system)
        if wanted is None:
            return
        fault = Fault.model_validate({"at": self.now, **wanted})
        self._simulated[v.system, source] = fault
        self.start(fault, v.system)
        if fault.duration is not None:
            over = functools.partial(self.end, fault, v.system)
            self._plan(self.now + fault.duration, over)


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
    "rc_loss": Injector._radio,
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
    "link": Injector._link,
    "motor_loss": Injector._healthy,
    "weak_thrust": Injector._healthy,
    "gps_loss": Injector._gps_back,
    "gps_jump": Injector._gps_jump_over,
    "position_loss": Injector._gps_back,
    "barometer_drift": Injector._barometer_over,
    "freeze": Injector._freeze_over,
    "refuse_arming": Injector._refuse_over,
    "pilot": Injector._pilot_over,
    "rc_loss": Injector._radio_back,
    "believes_landed": Injector._landed_over,
    "gripper_stuck_open": Injector._unstuck,
    "gripper_stuck_shut": Injector._unstuck,
    "slow_clock": Injector._clock_over,
    "wind": Injector._wind_over,
    "snag": Injector._snag_over,
}
