"""Where an interrupted flight broke off, from its record.

The vehicles hold where they stopped, until the fleet's T has passed since they last received a
ground station; then they land by themselves, together.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from swarm.errors import InputError
from swarm.flight.tlog import KnownFrames, replay
from swarm.mavlink.frames import Frames
from swarm.mission.fleet import Fleet
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]
Then = Literal["hold", "continue", "rewind", "land", "release"]


@dataclass(frozen=True, eq=False)
class LeftOff:
    """Where a flight broke off.

    ``systems`` in order along the cable, with their ``frames`` and ``yaw`` (n,) in radians;
    ``mission_time`` is the last recorded one, ``gripped`` says whether the cable was held.
    """

    systems: tuple[int, ...]
    frames: Frames
    yaw: Floats
    mission_time: float
    gate: int
    gripped: bool

    @property
    def known(self) -> KnownFrames:
        """The frames, for the record."""
        return KnownFrames(self.systems, self.frames, self.yaw)


def left_off(tlog: bytes, plan: Plan, fleet: Fleet, known: KnownFrames | None = None) -> LeftOff:
    """Return where a flight broke off, from its .tlog; ``known`` are frames from its record.

    Raises :class:`InputError` where the log does not determine it, or the flight had ended or had
    not left the ground.
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
