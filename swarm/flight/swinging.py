"""The swing of the cable in flight, estimated from what the vehicles report; and beside the plan's.

The lumped masses of :mod:`swarm.geometry.lumped_mass` hang from the reported grip points, from the
beginning of the fold, at rest. At the frequencies of strands the errors of reported positions are
as large as the motion that swings them; velocities are exact there. So grip points move by the
velocities and follow the positions slowly, and droppers lean as their vehicles do. Not in the
estimate: wind and downwash on the cable, and the swing that the lift has left.
"""

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm.certification.clearances import PlanChecks
from swarm.certification.excitation import allowed_swing
from swarm.certification.swing_runs import model_of
from swarm.certification.swing_tube import SwingTube
from swarm.flight.trace import Trace
from swarm.geometry.catenary import sample_strand
from swarm.geometry.distance import point_distance
from swarm.geometry.lumped_mass import Strands, SwingModel
from swarm.jit import compiled
from swarm.planning import Plan
from swarm.signatures import Floats1, Floats2, Floats4

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

INTERVAL = 0.1
"""Seconds between estimates: a tenth of the period of a strand with a sag of 0.3 m."""

_STEPS = 2
"""Steps of the masses in one of the certificate's: stable up to four times the planned tension,
which tracking errors can cause in a strand that is nearly taut."""

RECENT = 2.0
"""Seconds in which the largest stray counts: half the period of a sag of 4 m, so that a strand has
shown its amplitude."""

_FOLLOWING = 2.0
"""Time constant in seconds with which grip points follow reported positions. With 1 to 4 s the
estimates in a dry run of the overhand are equally good."""

_LONGEST = 1.0
"""Seconds without an estimate after which the strands count as at rest again."""

_STRAIGHT = 0.999
"""Ratio of chord to length from which on a strand is straight, and at rest when it sags again."""


@dataclass(frozen=True, eq=False)
class GripReports:
    """The reports of n vehicles at the time ``now``, in mission ENU.

    ``position`` (n, 3) are grip points below upright vehicles, ``velocity`` (n, 3) theirs, ``lean``
    (n, 3) the displacement of the grip points by the vehicles' attitude. ``fresh`` (n,) says whose
    position is recent.
    """

    now: float
    position: Floats
    velocity: Floats
    lean: Floats
    fresh: Flags


@dataclass(frozen=True, eq=False)
class Swing:
    """The estimate at the time ``at``.

    ``followed`` and ``grips`` (n, 3) are the grip points without and with the lean of the vehicles,
    ``velocity`` (n, 3) that without. ``states`` (2, n − 1, links + 1, 3) are the masses a ``step``
    ago, and now; ``recent`` (k, n − 1) the strays of the strands in the last RECENT seconds.
    """

    at: float
    step: float
    followed: Floats
    grips: Floats
    velocity: Floats
    states: Floats
    recent: Floats

    @property
    def stray(self) -> Floats:
        """Distances (n − 1,) of the strands from their catenaries now, metres."""
        now: Floats = self.recent[-1]
        return now

    @property
    def amplitude(self) -> Floats:
        """Largest of the recent strays (n − 1,), metres."""
        most: Floats = self.recent.max(axis=0)
        return most


@dataclass(frozen=True, eq=False)
class SwingEstimator:
    """The strands of a plan: their ``lengths`` (n − 1,), and the ``model`` of the cable."""

    lengths: Floats
    model: SwingModel

    @classmethod
    def of(cls, plan: Plan) -> "SwingEstimator | None":
        """Return the estimator of a plan; None for one without a fold of cable."""
        folds = any(phase.name == "fold" for phase in plan.phases)
        if not folds or not len(plan.layout.lengths):
            return None
        model = model_of(plan)
        return cls(plan.layout.lengths, replace(model, step=model.step / _STEPS))

    def _begin(self, reports: GripReports) -> Swing:
        """Return the estimate for strands at rest."""
        grips = reports.position + reports.lean
        states = np.full((2, len(self.lengths), self.model.links + 1, 3), np.nan)
        return Swing(
            reports.now, self.model.step, reports.position, grips, reports.velocity, states,
            self._strays(grips, states)[None],
        )  # fmt: skip

    def follow(self, before: Swing | None, reports: GripReports) -> Swing:
        """Return the estimate after new reports; without one lately, for strands at rest."""
        if before is None or not 0.0 < (duration := reports.now - before.at) <= _LONGEST:
            return self._begin(reports)
        share = np.where(reports.fresh, 1.0 - np.exp(-duration / _FOLLOWING), 0.0)[:, None]
        followed = before.followed + 0.5 * duration * (before.velocity + reports.velocity)
        followed += share * (reports.position - followed)
        grips = followed + reports.lean
        steps = max(1, round(duration / self.model.step))
        step = duration / steps
        along = np.linspace(0.0, 1.0, steps + 1)[:, None, None]
        ends = before.grips + along * (grips - before.grips)
        earlier, now = before.states
        states = np.stack([now - step / before.step * (now - earlier), now])
        model = replace(self.model, step=step)
        states = Strands.whole_chain(self.lengths, model).swing_on(states, ends, steps)[-1]
        strays = self._strays(grips, states)
        recent = before.recent[-round(RECENT / INTERVAL) + 1 :]
        return Swing(
            reports.now, step, followed, grips, reports.velocity, states,
            np.concatenate([recent, strays[None]]),
        )  # fmt: skip

    def _strays(self, grips: Floats, states: Floats) -> Floats:
        strays = np.empty(len(self.lengths))
        measure_strays(grips, self.lengths, states, np.empty(states.shape[2:]), strays)
        return strays


def lean(attitude: Floats, turn: Floats, offset: float) -> Floats:
    """Return the displacement (n, 3) of grip points as their vehicles lean, mission ENU.

    ``attitude`` (n, 3) are roll, pitch and yaw in radians (NaN: not known, taken as upright),
    ``turn`` (n, 3, 3) lead from each vehicle's NED to mission ENU, ``offset`` is the length of a
    dropper.
    """
    roll, pitch, yaw = np.nan_to_num(attitude).T
    aside, ahead = np.cos(roll) * np.sin(pitch), np.sin(roll)
    down = np.stack(
        [
            aside * np.cos(yaw) + ahead * np.sin(yaw),
            aside * np.sin(yaw) - ahead * np.cos(yaw),
            np.cos(roll) * np.cos(pitch) - 1.0,
        ],
        axis=1,
    )
    leant: Floats = offset * np.einsum("nij,nj->ni", turn, down)
    return leant


@compiled
def measure_strays(
    grips: Floats2, lengths: Floats1, states: Floats4, still: Floats2, strays: Floats1
) -> None:
    """Write the distances (n − 1,) of strands from their catenaries between grip points (n, 3).

    ``states`` (2, n − 1, k, 3) as of :meth:`swarm.geometry.lumped_mass.Strands.swing_on`. Strands
    that are straight or unknown (NaN) are put to rest. ``still`` (k, 3) is working memory.
    """
    for s in range(len(lengths)):
        chord = point_distance(grips[s], grips[s + 1])
        sample_strand(grips[s], grips[s + 1], max(lengths[s], chord / _STRAIGHT), still)
        joints, most = states[1, s], 0.0
        known = chord <= _STRAIGHT * lengths[s]
        for j in range(len(still)):
            square = 0.0
            for x in range(3):
                square += (joints[j, x] - still[j, x]) ** 2
            known = known and square < np.inf
            most = max(most, square)
        strays[s] = np.sqrt(most) if known else 0.0
        if not known:
            for j in range(len(still)):
                for x in range(3):
                    states[0, s, j, x] = states[1, s, j, x] = still[j, x]


@dataclass(frozen=True)
class LargestStray:
    """The largest stray that was estimated in a flight, in metres, of a ``segment`` (from 1)."""

    estimated: float
    segment: int
    mission_time: float


@dataclass(frozen=True)
class FlownSwing(LargestStray):
    """The same beside the plan's: ``planned`` is the largest stray of the planned motion,
    ``allowed`` the largest that tube and budget allow; ``within`` the share of moments at which
    every strand was estimated within what they allow it then."""

    planned: float
    allowed: float
    within: float

    @property
    def words(self) -> str:
        """The estimate, the plan, and the tube, in one line."""
        moments = "all" if self.within == 1.0 else f"{math.floor(100.0 * self.within)} % of the"
        return (
            f"estimated up to {self.estimated:.2f} m (segment {self.segment} at "
            f"{self.mission_time:.1f} s of the plan), {self.planned:.2f} m planned; within what "
            f"the budget allows, up to {self.allowed:.2f} m, at {moments} moments"
        )


@dataclass(frozen=True, eq=False)
class SwingCurves:
    """Strays of the strands (k, n − 1) in metres at k moments of a flight, which are given in
    mission ``time`` (k,): estimated, planned, the radii of the tube of all changes of the clock's
    rate, and what this tube and the budget allow (:mod:`swarm.certification.excitation`)."""

    time: Floats
    estimated: Floats
    planned: Floats
    tube: Floats
    allowed: Floats


def swing_curves(plan: Plan, trace: Trace) -> SwingCurves | None:
    """Return what was estimated in a flight, planned and allowed; None without an estimate."""
    known = np.isfinite(trace.stray).all(axis=1) if trace.stray.shape[1] else np.empty(0, np.bool_)
    tube = PlanChecks.of(plan).tube if known.any() else None
    if tube is None:
        return None
    time = trace.mission_time[known]
    return SwingCurves(
        time, trace.stray[known], _planned(tube, time),
        np.stack([tube.all_changes.strands(moment) for moment in time.tolist()]),
        allowed_swing(plan, tube, time),
    )  # fmt: skip


def largest_stray(trace: Trace) -> LargestStray | None:
    """Return the largest stray of a flight; None where none was estimated."""
    known = np.nan_to_num(trace.stray, nan=-1.0)
    if not known.size or known.max() < 0.0:
        return None
    row, segment = np.unravel_index(int(np.argmax(known)), known.shape)
    return LargestStray(
        float(known[row, segment]), int(segment) + 1, float(trace.mission_time[row])
    )


def flown_swing(plan: Plan, trace: Trace) -> FlownSwing | None:
    """Return the swing of a flight; None where it was not estimated."""
    largest, curves = largest_stray(trace), swing_curves(plan, trace)
    if largest is None or curves is None:
        return None
    return FlownSwing(
        **asdict(largest),
        planned=float(curves.planned.max()),
        allowed=float(curves.allowed.max()),
        within=float((curves.estimated <= curves.allowed).all(axis=1).mean()),
    )


def swing_object(swing: LargestStray | None) -> dict[str, Any] | None:
    """Return the swing of a flight as a JSON-ready object."""
    return asdict(swing) if swing is not None else None


def _planned(tube: SwingTube, time: Floats) -> Floats:
    nearest = np.abs(tube.times[:, None] - time).argmin(axis=0)
    strays: Floats = tube.planned[nearest]
    return strays
