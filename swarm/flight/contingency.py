"""Leaving the plan together: to a moment that allows it, release and separate if asked, descend.

Landing is everybody straight down at one speed, so that chords and levels keep. Nobody is ever
sent home.
"""

import math
from typing import TYPE_CHECKING, Literal

import numpy as np

from swarm.analysis.separation import separation_motion, solo_landing_distance
from swarm.certification.contingency_windows import rotors_clear
from swarm.flight.pace import advance_clock, rewind_end
from swarm.flight.router import TIMESYNC_INTERVAL
from swarm.mavlink.vehicle import Vehicle

if TYPE_CHECKING:
    from swarm.flight.conductor import Conductor

Kind = Literal["land", "release", "cut loose"]
Stage = Literal["approach", "release", "separate", "descend"]

TOUCHDOWN = 0.05
"""Height of a setpoint in metres at which a vehicle is told to land."""
DISARM_AFTER = 5.0
"""Seconds on the ground after which a vehicle that has not disarmed by itself is told to."""
RELEASE_PATIENCE = 5.0
CUT_PATIENCE = 1.5
"""Seconds after which survivors do not wait any longer for grippers beside a falling vehicle."""
BLIND = 15.0
"""Seconds after the setpoints have come down at which nobody is waited for who is not heard."""
FALLEN_PATIENCE = 40.0
UNANSWERED = TIMESYNC_INTERVAL + 0.7
"""Seconds without an answer after which a vehicle may not hear; round trips take up to 0.7 s."""
GIVE_UP = 120.0


class Contingency:
    """One way out of the plan, from the moment at which it was decided."""

    def __init__(self, flight: "Conductor", kind: Kind, *, move: bool) -> None:
        """``move`` allows going along the plan to the nearest moment that permits ``kind``.

        Only a team that follows as one can: where one does not, everybody stays where it is. The
        team is ``cornered`` where it lands although landing is not open, and letting go neither.
        """
        self._flight = flight
        self.kind: Kind = kind
        self._since = flight.now
        self._stage: Stage = "approach"
        self._stage_since = flight.now
        self._target = self._moment() if move and flight.streaming.all() else None
        self._landing: set[int] = set()
        self._on_ground_since: dict[int, float] = {}
        self._others_wait = False
        self.cornered = False
        self._down_since: float | None = None
        if kind == "cut loose":
            self.cut()

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
        open_, clock = flight.windows, flight.clock
        flags = open_.land if self.kind == "land" else open_.release
        gate_before = flight.gates[flight.gate - 1].time if flight.gate else 0.0
        gate_after = (
            flight.gates[flight.gate].time
            if flight.gate < len(flight.gates)
            else flight.plan.duration
        )
        stopping = 0.5 * clock.rate * abs(clock.rate) / clock.steepest
        moment = min(max(clock.time + stopping, gate_before), gate_after)
        return open_.nearest(flags, moment, rewind_end(flight), gate_after)

    def _approach(self) -> None:
        """Bring the clock to rest, at the moment that was chosen."""
        flight = self._flight
        clock, target = flight.clock, self._target
        if target is None:
            clock.target = 0.0
        else:
            left = target - clock.time
            pace = (2.0 * clock.steepest * abs(left)) ** 0.5
            clock.target = 0.0 if abs(left) < 0.02 else float(np.sign(left) * min(1.0, 0.5 * pace))
        advance_clock(flight)
        arrived = target is None or abs(target - clock.time) < 0.1
        tired = flight.now - self._stage_since > flight.fleet.limits.hold
        if clock.stopped and (arrived or tired):
            held = any(vehicle.gripped for vehicle in flight.flyers)
            can_land = flight.windows.can_land(clock.time)
            drop = not can_land and self._may_release()
            self.cornered = held and not can_land and not drop
            if held and (self.kind == "release" or drop):
                self._begin_release()
            else:
                self._begin_descent()

    # Release

    def drop(self) -> None:
        """Let go of the cable after all, where nothing hangs above anybody."""
        flight = self._flight
        held = any(vehicle.gripped for vehicle in flight.flyers)
        if held and self._stage in {"approach", "descend"} and self._may_release():
            self.kind, self._target = "release", None
            self._begin_release()

    def _may_release(self) -> bool:
        """Whether nothing hangs above anybody: as planned, and where those are who do not follow.

        They stopped by themselves, the others along the path: some decimetres from each other.
        """
        flight = self._flight
        if not flight.windows.can_release(flight.clock.time):
            return False
        places, apart = flight.setpoint.copy(), False
        for k in np.flatnonzero(~flight.streaming).tolist():
            if k not in flight.dead and np.isfinite(flight.position[k]).all():
                places[k], apart = flight.position[k], True
        return not apart or bool(rotors_clear(flight.plan, places[None])[0])

    def _begin_release(self) -> None:
        """Let all go together; but first, who has not answered lately and may not hear of it: what
        the others let go of would swing on it."""
        flight = self._flight
        deaf = [vehicle for vehicle in self._unanswering() if vehicle.gripped]
        self._enter("release")
        self._others_wait = 0 < len(deaf) < len(flight.flyers)
        if self._others_wait:
            names = ", ".join(flight.name(vehicle) for vehicle in deaf)
            flight.say("release", f"releasing first, who has not answered lately: {names}")
            self._let_go([flight.number[vehicle.system] - 1 for vehicle in deaf])
        else:
            self._release_all()

    def _release_all(self) -> None:
        self._others_wait = False
        self._flight.say("release", "releasing all together")
        self._let_go(list(range(len(self._flight.flyers))))

    def cut(self) -> None:
        """Let go of those that fall, first of all; then beside them; then everywhere if it may be.

        Where cable hangs above a rotor, those that are not beside a fall keep holding: they come
        straight down together.
        """
        flight = self._flight
        self.kind, self._target = "cut loose", None
        if self._stage in {"separate", "descend"}:
            self._let_go(sorted(flight.dead))
            return
        self._enter("release")
        n = len(flight.flyers)
        beside = [k for j in sorted(flight.dead) for k in (j - 1, j + 1) if 0 <= k < n]
        order = [*sorted(flight.dead), *beside]
        if self._may_release():
            order += range(n)
        names = ", ".join(str(k + 1) for k in dict.fromkeys(order))
        flight.say("release", f"letting go, in this order: vehicles {names}")
        self._let_go(list(dict.fromkeys(order)))

    def _let_go(self, order: list[int]) -> None:
        for k in order:
            vehicle = self._flight.flyers[k]
            if self._flight.grips and vehicle.gripped:
                vehicle.grip(closed=False)
            else:
                vehicle.gripped = False

    def _release(self) -> None:
        flight = self._flight
        flight.clock.target = 0.0
        advance_clock(flight)
        held = [
            vehicle
            for k, vehicle in enumerate(flight.flyers)
            if vehicle.gripped and k not in flight.dead
        ]
        waited = flight.now - self._stage_since
        if self._others_wait:
            deaf = any(vehicle in held for vehicle in self._unanswering())
            if not deaf or waited > CUT_PATIENCE:
                self._release_all()
            return
        if not flight.clock.stopped and waited < RELEASE_PATIENCE:
            return
        if not held:
            self._begin_separation()
        elif waited > (CUT_PATIENCE if flight.dead else RELEASE_PATIENCE):
            names = ", ".join(flight.name(vehicle) for vehicle in held)
            flight.say("leave", f"{names} still hold the cable: landing where everybody is")
            self._begin_descent()

    def _unanswering(self) -> list[Vehicle]:
        """Who has missed the last question for the time, of those that answer it at all."""
        flight = self._flight
        return [
            vehicle
            for k, vehicle in enumerate(flight.flyers)
            if flight.now - vehicle.timesync_at > UNANSWERED
            and math.isfinite(vehicle.timesync_at)
            and k not in flight.dead
        ]

    def _begin_separation(self) -> None:
        """Take the path apart that the plan has for this moment, or away from the middle.

        One that does not follow stays where it is: the others go away from it. From two that stay,
        nobody can go away without going towards one of them.
        """
        flight = self._flight
        mission, start = flight.plan.mission, flight.setpoint.copy()
        staying = [k for k in np.flatnonzero(~flight.streaming).tolist() if k not in flight.dead]
        if flight.dead:
            dead = min(flight.dead)
            centre, spread = start[dead], flight.separations.at(flight.clock.time, dead)
        elif len(staying) > 1:
            self._begin_descent()
            return
        elif staying:
            (stays,) = staying
            if np.isfinite(flight.position[stays]).all():
                start[stays] = flight.position[stays]
            centre, spread = start[stays], flight.separations.at(flight.clock.time, stays)
        else:
            centre = start.mean(axis=0)
            first, second = np.triu_indices(len(start), 1)
            level = np.linalg.norm(start[first, :2] - start[second, :2], axis=1)
            nearest = max(float(level.min(initial=np.inf)), 1e-3)
            spread = float(np.clip(solo_landing_distance(mission) / nearest, 1.0, 4.0))
        flight.guidance.detour(separation_motion(start, centre, spread, mission), flight.moving)
        self._enter("separate")

    def _separate(self) -> None:
        flight = self._flight
        if flight.now - self._stage_since > flight.guidance.detour_duration:
            self._begin_descent()

    # Descent

    def _begin_descent(self) -> None:
        self._enter("descend")
        flight = self._flight
        flight.guidance.descend(flight.setpoint, flight.fleet.limits.descent, flight.moving)

    def _descend(self) -> None:
        """Tell each vehicle to land when its setpoint has come down, and to disarm after that."""
        flight = self._flight
        for k, vehicle in enumerate(flight.flyers):
            if not vehicle.armed:
                flight.streaming[k] = False
                continue
            if vehicle.in_manual_mode:
                continue
            if flight.setpoint[k, 2] <= TOUCHDOWN or not flight.streaming[k]:
                self._landing.add(vehicle.system)
            told = vehicle.system in self._landing
            if (
                told
                and not vehicle.in_mode("land")
                and (flight.heard(vehicle) or flight.first_time(k, "land unheard"))
            ):
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
            for k, vehicle in enumerate(flight.flyers)
            if vehicle.armed and not vehicle.in_manual_mode and not self._given_up(k)
        ]
        heard = [vehicle for vehicle in still if flight.heard(vehicle, lost)]
        if self._down_since is None and self._stage == "descend":
            self._down_since = flight.now if np.all(flight.setpoint[:, 2] <= TOUCHDOWN) else None
        blind = self._down_since is not None and flight.now - self._down_since > BLIND
        if not still or (blind and not heard):
            return True
        if flight.now - self._since > GIVE_UP + flight.fleet.limits.hold:
            names = ", ".join(flight.name(vehicle) for vehicle in still)
            flight.fail(f"still armed long after landing was begun: {names}")
            return True
        return False

    def _given_up(self, k: int) -> bool:
        """Whether a vehicle fell so long ago that it will not be heard to disarm."""
        return k in self._flight.dead and self._flight.now - self._since > FALLEN_PATIENCE

    def _enter(self, stage: Stage) -> None:
        self._stage = stage
        self._stage_since = self._flight.now
