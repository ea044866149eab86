"""The motion of a plan or of a flight as samples over time, for tables and logs."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from swarm.flight.snapshot import Event
from swarm.flight.trace import Trace
from swarm.mission import Mission
from swarm.planning import Plan
from swarm.reports import scene

Floats = npt.NDArray[np.float64]

PLAN_STEP = 0.05
"""Seconds between two samples of a plan, as in its CSV."""

FRAME = "map"
"""The mission's frame (ENU), by its usual name in ROS (REP 105) and Foxglove."""
CABLE_POINTS = 13
"""Points of a drawn segment of the cable: more enlarge the file, and are not seen."""
CABLE_WIDTH = 0.02
"""Metres of the drawn cable: one of 5 mm is not seen in a field of ten metres."""


@dataclass(frozen=True, eq=False)
class Samples:
    """A team of n vehicles at k moments, in the mission's frame (ENU, SI).

    ``time`` (k,) is in seconds from the start of the plan or of the record, which was ``started``
    seconds after 1970 (0 for a plan). ``mission_time`` (k,) is the mission clock; ``phase`` (k,) is
    empty outside the plan. ``vectors`` are (k, n, 3) and ``scalars`` (k, n) by name,
    "position" of the grip points among them; NaN where unknown. ``cable`` (k, n, 3) are the grip
    points of the cable, ``lengths`` (n − 1,) its segments, ``events`` those of a flight, on the
    clock of ``time``.
    """

    mission: Mission
    time: Floats
    mission_time: Floats
    phase: tuple[str, ...]
    vectors: Mapping[str, Floats]
    scalars: Mapping[str, Floats]
    cable: Floats
    lengths: Floats
    started: float = 0.0
    events: tuple[Event, ...] = field(default=())

    @property
    def vehicles(self) -> int:
        """Number of vehicles n."""
        return int(self.vectors["position"].shape[1])

    @property
    def centres(self) -> Floats:
        """Centres of the vehicles (k, n, 3), metres."""
        above = np.array([0.0, 0.0, self.mission.vehicles.grip_offset])
        places: Floats = self.vectors["position"] + above
        return places

    @property
    def stamps(self) -> list[int]:
        """The k moments in nanoseconds since 1970."""
        return [nanoseconds(self.started + time) for time in self.time.tolist()]


def nanoseconds(seconds: float) -> int:
    """Return whole nanoseconds, rounded to microseconds: seconds since 1970 have no more digits."""
    return max(0, round(seconds * 1e6)) * 1000


def sampled_plan(plan: Plan, step: float = PLAN_STEP) -> Samples:
    """Return a plan every ``step`` seconds, and at its end: position, velocity, acceleration."""
    times = np.append(np.arange(0.0, plan.duration, step), plan.duration)
    position, velocity, acceleration = plan.motion.at(times)
    return Samples(
        mission=plan.mission,
        time=times,
        mission_time=times,
        phase=tuple(plan.phase_at(time).name for time in times.tolist()),
        vectors={"position": position, "velocity": velocity, "acceleration": acceleration},
        scalars={"speed": np.linalg.norm(velocity, axis=-1)},
        cable=scene.planned_cable(plan, times),
        lengths=plan.layout.lengths,
    )


def sampled_flight(
    plan: Plan, trace: Trace, started: float = 0.0, events: tuple[Event, ...] = ()
) -> Samples:
    """Return a flight at the moments of its trace: position, setpoint, tracking error.

    ``started`` is time 0 of the trace in seconds since 1970; ``events`` are on the trace's clock.
    """
    return Samples(
        mission=plan.mission,
        time=trace.time,
        mission_time=trace.mission_time,
        phase=trace.phase,
        vectors={"position": trace.position, "setpoint": trace.setpoint},
        scalars={"tracking_error": np.linalg.norm(trace.position - trace.setpoint, axis=-1)},
        cable=scene.flown_cable(plan, trace),
        lengths=plan.layout.lengths,
        started=started,
        events=events,
    )
