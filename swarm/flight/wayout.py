"""Leaving the plan together: to a moment that allows it, release and separate if asked, descend.

Landing is everybody straight down at one speed, so that chords and levels keep. Nobody is ever
sent home.
"""

from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from swarm.flight.options import rewind_limit
from swarm.mavlink.vehicle import Vehicle
from swarm.trajectory import Motion, leg

if TYPE_CHECKING:
    from swarm.flight.conductor import Conductor

Floats = npt.NDArray[np.float64]
Kind = Literal["land", "release"]

TOUCHDOWN = 0.05
"""Height of a setpoint in metres at which a vehicle is told to land."""
DISARM_AFTER = 5.0
"""Seconds on the ground after which a vehicle that has not disarmed by itself is told to."""
RELEASE_PATIENCE = 5.0
GIVE_UP = 120.0
SEPARATE_UP = 1.0
MOST_SPREAD = 4.0


class WayOut:
    """One way out of the plan, from the moment at which it was decided."""

    def __init__(self, flight: "Conductor", kind: Kind, *, move: bool) -> None:
        """``move`` allows going along the plan to the nearest moment that permits ``kind``."""
        self._flight = flight
        self.kind = kind
        self._since = flight.now
        self._stage: Literal["approach", "release", "separate", "descend"] = "approach"
        self._stage_since = flight.now
        self._target = self._moment() if move else None
        self._landing: set[int] = set()
        self._on_ground_since: dict[int, float] = {}

    def told_to_land(self, vehicle: Vehicle) -> bool:
        """Whether the vehicle was told to land, so that leaving offboard mode is meant."""
        return vehicle.system in self._landing

    def tick(self) -> bool:
        """Go on; return whether everybody is down and disarmed, or given up."""
        {
            "approach": self._approach,
            "release": self._release,
            "separate": self._separate,
            "descend": self._descend,
        }[self._stage]()
        return self._finished()

    def _moment(self) -> float | None:
        """The mission time at which this way out is open, nearest to where the clock can stop."""
        flight = self._flight
        options, clock = flight.options, flight.clock
        flags = options.can_land if self.kind == "land" else options.can_release
        phase = flight.phase
        gate_before = flight.gates[flight.gate - 1].time if flight.gate else 0.0
        gate_after = (
            flight.gates[flight.gate].time
            if flight.gate < len(flight.gates)
            else flight.plan.duration
        )
        low = rewind_limit(phase, gate_before, flight.budget_kept_since)
        stopping = 0.5 * clock.rate * abs(clock.rate) / clock.steepest
        moment = min(max(clock.time + stopping, gate_before), gate_after)
        bounded = clock.time if low is None else low
        return options.nearest(flags, moment, bounded, gate_after)

    def _approach(self) -> None:
        """Bring the clock to rest, at the moment that was chosen."""
        flight = self._flight
        clock, target = flight.clock, self._target
        if target is None or flight.stopped_for_good:
            clock.target = 0.0
        else:
            left = target - clock.time
            pace = (2.0 * clock.steepest * abs(left)) ** 0.5
            clock.target = 0.0 if abs(left) < 0.02 else float(np.sign(left) * min(1.0, 0.5 * pace))
        flight.advance_clock()
        arrived = target is None or abs(target - clock.time) < 0.1
        tired = flight.now - self._stage_since > flight.fleet.limits.hold
        if clock.stopped and (arrived or tired or flight.stopped_for_good):
            if self.kind == "release" and any(v.gripped for v in flight.flyers):
                self._begin_release()
            else:
                self._begin_descent()

    def _begin_release(self) -> None:
        self._enter("release")
        self._flight.say("release", "releasing all together")
        for vehicle in self._flight.flyers:
            if self._flight.grips:
                vehicle.grip(closed=False)
            else:
                vehicle.gripped = False

    def _release(self) -> None:
        flight = self._flight
        held = [vehicle for vehicle in flight.flyers if vehicle.gripped]
        if not held:
            motion = _separation(flight)
            flight.guidance.detour(motion, flight.now)
            self._enter("separate")
        elif flight.now - self._stage_since > RELEASE_PATIENCE:
            names = ", ".join(flight.name(vehicle) for vehicle in held)
            flight.say("failure", f"not released by {names}: landing where everybody is")
            self._begin_descent()

    def _separate(self) -> None:
        flight = self._flight
        if flight.now - self._stage_since > flight.guidance.detour_duration:
            self._begin_descent()

    def _begin_descent(self) -> None:
        self._enter("descend")
        flight = self._flight
        flight.guidance.descend(flight.setpoint, flight.fleet.limits.descent, flight.now)

    def _descend(self) -> None:
        """Tell each vehicle to land when its setpoint has come down, and to disarm after that."""
        flight = self._flight
        for k, vehicle in enumerate(flight.flyers):
            if not vehicle.armed:
                flight.streaming[k] = False
                continue
            if vehicle.flown_by_hand:
                continue
            if flight.setpoint[k, 2] <= TOUCHDOWN or not flight.streaming[k]:
                self._landing.add(vehicle.system)
            told = vehicle.system in self._landing
            if told and not vehicle.in_mode("land") and flight.heard(vehicle):
                vehicle.set_mode("land")
            if told and vehicle.on_ground:
                since = self._on_ground_since.setdefault(vehicle.system, flight.now)
                if flight.now - since > DISARM_AFTER:
                    vehicle.disarm()
        flight.stop_streams_of_landing()

    def _finished(self) -> bool:
        flight = self._flight
        lost = flight.fleet.limits.lost
        still = [
            vehicle
            for vehicle in flight.flyers
            if vehicle.armed and flight.heard(vehicle, lost) and not vehicle.flown_by_hand
        ]
        if not still:
            return True
        if flight.now - self._since > GIVE_UP + flight.fleet.limits.hold:
            names = ", ".join(flight.name(vehicle) for vehicle in still)
            flight.fail(f"still armed long after landing was begun: {names}")
            return True
        return False

    def _enter(self, stage: Literal["release", "separate", "descend"]) -> None:
        self._stage = stage
        self._stage_since = self._flight.now


def _separation(flight: "Conductor") -> Motion:
    """Away from the middle and up: scaling level distances brings nobody nearer to anybody."""
    start = flight.setpoint
    vehicles, clearance = flight.plan.mission.vehicles, flight.plan.mission.clearance
    middle = start.mean(axis=0)
    apart = 1.5 * (clearance.vehicle + 2.0 * vehicles.tracking)
    first, second = np.triu_indices(len(start), 1)
    level = np.linalg.norm(start[first, :2] - start[second, :2], axis=1)
    smallest = max(float(level.min()), 1e-3) if len(level) else apart
    stretch = min(MOST_SPREAD, max(1.0, apart / smallest))
    end = middle + (start - middle) * stretch
    end[:, 2] = start[:, 2] + SEPARATE_UP
    thrust = vehicles.max_acceleration - vehicles.braking_acceleration
    return leg(start, end, 0.5 * vehicles.max_speed, 0.5 * thrust)
