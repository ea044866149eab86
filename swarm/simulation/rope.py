"""Simulated ropes beside a plan: moved by its planned motion, or by reported positions."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from swarm.analysis import rope
from swarm.analysis.rope_model import Grips
from swarm.errors import InputError, Problem
from swarm.flight.trace import Trace
from swarm.planning import Plan


@dataclass(frozen=True)
class Trajectory:
    """A motion of the grip points for a rope, with its name."""

    name: str
    plan: Plan
    grips: Grips


@dataclass(frozen=True)
class RopeResult:
    """A simulated rope; ``duration`` is the time of the simulation in seconds."""

    trajectory: Trajectory
    run: rope.RopeRun
    duration: float

    def document(self) -> dict[str, Any]:
        """Return the result as one JSON-ready object."""
        return {
            "trajectory": self.trajectory.name,
            "computing_time": self.duration,
            **rope.run_object(self.run, self.trajectory.plan),
        }


def planned_trajectory(name: str, plan: Plan) -> Trajectory:
    """Return the motion of a plan in fold and hold."""
    return Trajectory(name, plan, rope.planned_grips(plan))


def flown_trajectory(plan: Plan, trace: Trace, record: str) -> Trajectory:
    """Return the reported motion of a flight in fold and hold, on the clock of the flight.

    Raises :class:`InputError` that names the ``record`` if the flight did not reach its fold.
    """
    known = np.isin(np.array(trace.phase, dtype=str), ["fold", "hold"])
    known &= np.isfinite(trace.position).all(axis=(1, 2))
    if known.sum() < 2:
        raise InputError([Problem(record, "expected a flight that reached its fold")])
    return Trajectory("as flown", plan, Grips(trace.time[known], trace.position[known]))


def simulate_rope(
    trajectory: Trajectory,
    *,
    links: int | None = None,
    contact: bool = True,
    progress: rope.Progress | None = None,
) -> RopeResult:
    """Move a rope along a trajectory, in the steady wind of its mission.

    Arguments and errors as of :func:`swarm.analysis.rope.simulate_rope`.
    """
    start = time.perf_counter()
    plan = trajectory.plan
    wind = (plan.mission.wind.steady, 0.0, 0.0)
    run = rope.simulate_rope(
        plan, trajectory.grips, links=links, contact=contact, wind=wind, progress=progress
    )
    return RopeResult(trajectory, run, time.perf_counter() - start)
