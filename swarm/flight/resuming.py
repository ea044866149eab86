"""Taking up a flight whose ground station ended: what its record tells, and finding the team again.

The vehicles hold where they stopped, until the fleet's T has passed since they last heard a ground
station; then they land by themselves, together.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from swarm.errors import InputError
from swarm.flight.preparation import request_streams
from swarm.flight.rejoining import rejoin
from swarm.flight.tlog import KnownFrames, replay
from swarm.mavlink.frames import Frames
from swarm.mission.fleet import Fleet
from swarm.planning import Plan

if TYPE_CHECKING:
    from swarm.flight.conductor import Conductor

Floats = npt.NDArray[np.float64]
Then = Literal["hold", "continue", "rewind", "land", "release"]

LARGEST = 1.0
"""Metres by which a vehicle may be off its place in the plan to be taken along it again."""
FRESH = 0.5
AROUND = 4.0
"""Seconds of mission time around the last one told in which the team is looked for: it coasted."""
_STEP = 0.05


@dataclass(frozen=True, eq=False)
class LeftOff:
    """Where a flight broke off.

    ``systems`` in order along the cable, with their ``frames`` and ``yaw`` (n,) in radians;
    ``mission_time`` is the last that the record tells, ``gripped`` whether the cable was held.
    """

    systems: tuple[int, ...]
    frames: Frames
    yaw: Floats
    mission_time: float
    gate: int
    gripped: bool

    @property
    def known(self) -> KnownFrames:
        """The frames, as a record keeps them."""
        return KnownFrames(self.systems, self.frames, self.yaw)


def left_off(tlog: bytes, plan: Plan, fleet: Fleet, known: KnownFrames | None = None) -> LeftOff:
    """Return where a flight broke off, from its .tlog; ``known`` are frames that it cannot tell.

    Raises :class:`InputError` where the record does not tell, or the flight was over or had not
    left the ground.
    """
    told = replay(tlog, plan, fleet, known)
    time, phase = float(told.trace.mission_time[-1]), told.trace.phase[-1]
    if not phase:
        raise InputError("the team was leaving the plan, or had not begun it: nothing to resume")
    if time <= 0.0:
        raise InputError("the team had not left the ground: fly it anew")
    passed = [gate for gate in plan.gates if gate.time < time - 1e-3]
    done = {gate.condition for gate in passed}
    return LeftOff(
        systems=told.systems,
        frames=told.frames,
        yaw=told.yaw,
        mission_time=time,
        gate=len(passed),
        gripped="gripped" in done and "released" not in done,
    )


def find(flight: "Conductor", left: LeftOff) -> None:
    """Look for the team: once everybody is heard, take up the plan where they are, and hold."""
    if flight.first_time(-1, "search"):
        flight.gate_since = flight.now
    missing = [
        vehicle
        for vehicle in flight.flyers
        if not (flight.heard(vehicle, FRESH) and flight.now - vehicle.position_at < FRESH)
        or vehicle.autopilot is None
    ]
    for k, vehicle in enumerate(flight.flyers):
        if flight.heard(vehicle) and flight.first_time(k, "streams"):
            request_streams(vehicle, flight.fleet)
    if missing:
        if flight.now - flight.gate_since > flight.fleet.limits.hold:
            names = ", ".join(flight.name(vehicle) for vehicle in missing)
            flight.finish_as("failed", f"not found: {names}; everybody lands by itself")
        return
    down = [v for v in flight.flyers if not v.armed]
    if down:
        names = ", ".join(flight.name(vehicle) for vehicle in down)
        flight.finish_as("failed", f"no longer flying: {names}; the others land by themselves")
        return
    time, off = _where(flight, left)
    flight.take_up(time)
    words = f"found everybody at {time:.1f} s of the plan, up to {off:.2f} m from it"
    flight.say("resume", words)
    landing = [vehicle for vehicle in flight.flyers if vehicle.in_mode("land")]
    if landing or off > LARGEST:
        why = "they land already" if landing else f"a vehicle is {off:.1f} m off its place"
        flight.leave("land", f"the flight cannot be taken up: {why}", move=False)
        return
    flight.hold("operator", "the flight was taken up")
    rejoin(flight)


def _where(flight: "Conductor", left: LeftOff) -> tuple[float, float]:
    """Return the mission time around the last one that fits best, and the largest distance."""
    gates = flight.gates
    low = gates[left.gate - 1].time if left.gate else 0.0
    high = gates[left.gate].time if left.gate < len(gates) else flight.plan.duration
    times = np.arange(
        max(low, left.mission_time - AROUND), min(high, left.mission_time + AROUND), _STEP
    )
    if not len(times):
        times = np.array([left.mission_time])
    off = np.linalg.norm(flight.plan.motion.at(times)[0] - flight.position, axis=2).max(axis=1)
    best = int(np.argmin(off))
    return float(times[best]), float(off[best])


def go_on(flight: "Conductor") -> None:
    """Do what the operator said in advance, once everybody follows again."""
    if flight.then == "hold" or flight.rejoining or not flight.streaming.all():
        return
    wish, flight.then = flight.then, "hold"
    flight.request("resume" if wish == "continue" else wish)
