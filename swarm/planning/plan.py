"""The plan: timed phases joined by gates, and one trajectory per vehicle.

Inside a phase, setpoints are a function of mission time alone. At a gate, the mission clock waits
for a condition of the team.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from swarm.folding.layout import KnotLayout
from swarm.geometry.motion import Motion
from swarm.knots.names import describe_knot
from swarm.mission import Mission

Floats = npt.NDArray[np.float64]

PhaseName = Literal[
    "takeoff", "grab", "contract", "lift", "fold", "hold",
    "unfold", "lower", "spread", "descend", "tighten", "finish", "land",
]  # fmt: skip
CableState = Literal["floor", "lifting", "aloft", "landing", "free"]
Condition = Literal["armed", "airborne", "gripped", "settled", "released", "landed"]


_WAITS: Final[Mapping[Condition, float]] = {
    "armed": 1.9,
    "airborne": 0.0,
    "gripped": 0.75,
    "settled": 1.0,
    "released": 0.75,
    "landed": 3.8,
}
"""Seconds that a gate waits, measured in dry runs of the default missions with PX4 vehicles."""


_SLOWING = 3.5
"""Seconds by which a flight with a knot takes longer: 2.3 to 4.3 s in dry runs of `missions/`, with
folds of 33 to 350 s. The clock slows in the lift, and in the fold until the drag is fitted."""


@dataclass(frozen=True)
class Phase:
    """An interval of mission time, seconds.

    ``cable`` is the state of the cable that the cable model assumes: on the ``floor`` (held or
    not), ``lifting`` (held as a line, partly on the floor), ``aloft`` (every segment a catenary),
    ``landing`` (held as a knot, in a common vertical descent until its strands lie on each other)
    or ``free`` (undefined: released, or held at both ends only).
    ``reversible`` states whether mission time may run backwards in the phase.
    """

    name: PhaseName
    start: float
    end: float
    cable: CableState
    reversible: bool

    @property
    def duration(self) -> float:
        """Seconds from ``start`` to ``end``."""
        return self.end - self.start


@dataclass(frozen=True)
class Gate:
    """The mission clock waits at ``time`` until ``condition`` holds for every vehicle.

    Commands lead to ``armed`` (arming), ``gripped`` and ``released`` (grippers, in the order of the
    vehicles) and ``landed`` (landing, disarming); ``settled`` needs none. With ``inner`` the gate
    is for all vehicles but the two at the ends of the cable.
    """

    time: float
    condition: Condition
    timeout: float
    inner: bool = False


@dataclass(frozen=True)
class KnotSummary:
    """The knot to tie: KnotInfo's name, chirality, Gauss code, and the columns of its grid."""

    type: str
    chirality: Literal["left", "right", "none"]
    gauss: str
    grid_columns: tuple[tuple[int, int], ...]


@dataclass(frozen=True, repr=False)
class Plan:
    """The whole flight, before its certification.

    ``layout`` is where the folded knot hangs, ENU metres. ``motion`` moves the n grip points from
    the pads (mission time 0) to the ground again. ``path`` (k, 3) is the curve that all vehicles
    follow in the fold, for pictures, and empty where they follow none. ``notes`` list the attempts
    of the planner.
    """

    mission: Mission
    knot: KnotSummary
    layout: KnotLayout
    motion: Motion
    phases: tuple[Phase, ...]
    gates: tuple[Gate, ...]
    path: Floats
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<Plan {self.mission.name}: {', '.join(self.figures().values())}>"

    def figures(self) -> dict[str, str]:
        """Return the figures for one line, by name: knot, vehicles, cable and duration."""
        count, cable = self.vehicles, float(self.layout.lengths.sum())
        return {
            "knot": describe_knot(self.knot.type, self.knot.chirality),
            "vehicles": f"{count} vehicle{'s' if count > 1 else ''}",
            "cable": f"{cable:.1f} m of cable" if cable else "no cable",
            "duration": f"{self.flight_duration:.0f} s",
        }

    @property
    def vehicles(self) -> int:
        """Number of vehicles n."""
        return int(self.motion.coefficients.shape[2])

    @property
    def duration(self) -> float:
        """Mission time from take-off to landing without waits at gates, seconds."""
        return float(self.motion.times[-1])

    @property
    def expected_waits(self) -> float:
        """Seconds for which an undisturbed flight waits at gates, from the command to arm on.

        Those of emulated vehicles; a cable that is tied on needs no time for its grips.
        """
        return sum(map(self.expected_wait, self.gates))

    def expected_wait(self, gate: Gate) -> float:
        """Return the seconds for which an undisturbed flight waits at a gate."""
        if self.mission.grab == "attached" and gate.condition in {"gripped", "released"}:
            return 0.0
        return _WAITS[gate.condition]

    @property
    def expected_slowing(self) -> float:
        """Seconds that an undisturbed flight takes longer, because vehicles lag behind setpoints.

        The mission clock slows before the largest lag of the team is the tracking radius.
        """
        folds = any(phase.name == "fold" for phase in self.phases)
        return _SLOWING if folds and self.mission.formation is None else 0.0

    @property
    def flight_duration(self) -> float:
        """Seconds of an undisturbed flight, with waits at gates and a slower clock."""
        return self.duration + self.expected_waits + self.expected_slowing

    def phase(self, name: PhaseName) -> Phase:
        """Return the phase of that name; raises :class:`KeyError` where the plan has none."""
        for phase in self.phases:
            if phase.name == name:
                return phase
        raise KeyError(name)

    def phase_at(self, time: float) -> Phase:
        """Return the phase at a mission time; where two phases meet, the later one."""
        for phase in self.phases:
            if time < phase.end:
                return phase
        return self.phases[-1]
