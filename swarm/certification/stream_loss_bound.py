"""Whether a team keeps apart after lost setpoints: over all time, not at samples.

A *box* is a case (who loses the stream: 0 all, else that vehicle), an interval of the mission time
at which it is lost, one of the way that the lost have coasted (in seconds at their speed then), and
one of the way by which the others have gone on along the plan (in mission seconds). In the middle
of a box everything is measured; from there, bounds of velocities, accelerations and of what a
strand does with its ends say how little can be left anywhere in it. Boxes in which too little may
be left are halved, until nothing is open, or the middle of one shows that too little is left.
"""

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from swarm.certification.limits import TAUT
from swarm.certification.motion_bounds import Course
from swarm.certification.stream_loss_pairs import (
    TOLERANCE,
    Kept,
    Sketches,
    left_of_pairs,
    left_of_strands,
    sketches_for,
)
from swarm.certification.stream_loss_team import Box, Leaving, Standing, room_for, stand
from swarm.geometry.sensitivity import sensitivity_tables
from swarm.jit import compiled
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]

_MOST_BOXES = 3_000
"""Open boxes of one interval at which it is given up as not shown."""
_HALVINGS = 40
_PORTION = 20_000


@dataclass(frozen=True, eq=False)
class Ways:
    """How far who goes on, per case: the most that each vehicle coasts, ``after`` (n,) in seconds
    at a clock of rate 1; ``braking``, its part that is braking; what the others go on by, in
    mission seconds at rate r: ``silence`` · r + r² / (2 · ``steepest``). One that lands alone comes
    down by up to ``sinking`` (n,) metres before the others do too."""

    after: Floats
    braking: float
    silence: float
    steepest: float
    sinking: Floats

    def on(self, rate: Floats) -> Floats:
        """Mission seconds by which the team goes on before it stands."""
        gone: Floats = self.silence * rate + 0.5 * rate * rate / self.steepest
        return gone

    def most_on(self, who: Ints, coasted: Floats) -> Floats:
        """The most that the team has gone on when vehicle ``who`` has coasted so far."""
        rate = coasted / self.after[who]
        stopped = rate * (self.after[who] + self.braking)
        return np.maximum(self.on(rate), stopped)


@dataclass(frozen=True, eq=False)
class _Boxes:
    interval: Ints
    case: Ints
    time: Floats
    half: Floats
    coasted: Floats
    coasted_half: Floats
    on: Floats
    on_half: Floats

    def __len__(self) -> int:
        return len(self.case)

    def taken(self, where: Flags | slice) -> "_Boxes":
        return _Boxes(*(getattr(self, one.name)[where] for one in fields(self)))

    def halved(self, doubts: Floats) -> "_Boxes":
        """Both halves of every box, cut where it is least certain; ``doubts`` (m, 3)."""
        which = doubts.argmax(axis=1)
        parts = []
        for sign in (-1.0, 1.0):
            moved = []
            for number, (middle, half) in enumerate(
                ((self.time, self.half), (self.coasted, self.coasted_half), (self.on, self.on_half))
            ):
                cut = np.where(which == number, 0.5 * half, 0.0)
                moved += [middle + sign * cut, half - cut]
            parts.append(_Boxes(self.interval, self.case, *moved))
        return _joined(*parts)


def _joined(*parts: _Boxes) -> _Boxes:
    names = [one.name for one in fields(_Boxes)]
    return _Boxes(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


class CoastBound:
    """What a plan's team keeps, for all times within intervals."""

    def __init__(self, plan: Plan, ways: Ways, end: float) -> None:
        """``end`` is the mission time beyond which nobody goes."""
        course, lengths, clearance = (
            Course(plan.motion),
            plan.layout.lengths,
            plan.mission.clearance,
        )
        self._ways = ways
        breaks, joints, coefficients = (
            np.require(values, np.float64, ["C", "W"])
            for values in (plan.motion.times, plan.motion.times[1:-1], plan.motion.coefficients)
        )
        self._leaving = Leaving(
            breaks, joints, coefficients, course.accelerations, course.jerks,
            np.array(ways.after), np.array(ways.sinking), plan.mission.vehicles.tracking, end,
        )  # fmt: skip
        tables = sensitivity_tables()
        self._kept = Kept(
            TAUT * lengths, clearance.vehicle, clearance.downwash,
            clearance.cable + plan.mission.cable.diameter, np.array(lengths), tables.norm,
            tables.integral,
        )  # fmt: skip

    def keeps(self, start: Floats, end: Floats, rate: Floats) -> Flags:
        """Whether all is kept when streams end within intervals (k,) at rates up to ``rate``."""
        kept = np.ones(len(start), dtype=np.bool_)
        open_ = self._roots(start, end, rate)
        for _ in range(_HALVINGS):
            open_ = open_.taken(kept[open_.interval] & self._possible(open_))
            count = np.bincount(open_.interval, minlength=len(kept))
            kept[count > _MOST_BOXES] = False
            open_ = open_.taken(kept[open_.interval])
            if not len(open_):
                return kept
            left = [
                self._open(open_.taken(slice(k, k + _PORTION)), rate, kept)
                for k in range(0, len(open_), _PORTION)
            ]
            open_ = _joined(*left)
        kept[open_.interval] = False
        return kept

    def _roots(self, start: Floats, end: Floats, rate: Floats) -> _Boxes:
        """One box for each interval and case."""
        n, k = len(self._ways.after), len(start)
        case = np.repeat(np.arange(n + 1), k)
        interval = np.tile(np.arange(k), n + 1)
        farthest = np.append(self._ways.after.max(), self._ways.after)[case] * rate[interval]
        on = np.where(case > 0, self._ways.on(rate)[interval], 0.0)
        on = np.where(case > 0, np.maximum(on, farthest + self._ways.braking * rate[interval]), 0.0)
        time, half = 0.5 * (start + end)[interval], 0.5 * (end - start)[interval]
        return _Boxes(
            interval, case, time, half, 0.5 * farthest, 0.5 * farthest, 0.5 * on, 0.5 * on
        )

    def _possible(self, boxes: _Boxes) -> Flags:
        """Which boxes hold anything that can happen: the team does not go back, nor on for ever."""
        longest = self._ways.most_on(
            np.maximum(boxes.case - 1, 0), boxes.coasted + boxes.coasted_half
        )
        one = boxes.case > 0
        behind = boxes.on + boxes.on_half < boxes.coasted - boxes.coasted_half
        beyond = boxes.on - boxes.on_half > longest
        return ~(one & (behind | beyond))

    def _open(self, boxes: _Boxes, rate: Floats, kept: Flags) -> _Boxes:
        """Return the halves of what is not shown; tell ``kept`` which intervals are lost."""
        low, here = np.empty((2, len(boxes)))
        doubts = np.empty((len(boxes), 3))
        _weigh(
            boxes.case, rate[boxes.interval], boxes.time, boxes.half, boxes.coasted,
            boxes.coasted_half, boxes.on, boxes.on_half, self._leaving, self._kept,
            room_for(len(self._ways.after)), sketches_for(len(self._kept.lengths)),
            low, here, doubts,
        )  # fmt: skip
        most = self._ways.most_on(np.maximum(boxes.case - 1, 0), boxes.coasted)
        real = (boxes.case == 0) | ((boxes.on >= boxes.coasted) & (boxes.on <= most))
        kept[boxes.interval[real & (here < -TOLERANCE)]] = False
        open_ = low < -TOLERANCE
        return boxes.taken(open_).halved(doubts[open_])


@compiled
def _weigh(
    case: Ints,
    rate: Floats,
    time: Floats,
    half: Floats,
    coasted: Floats,
    coasted_half: Floats,
    on: Floats,
    on_half: Floats,
    leaving: Leaving,
    kept: Kept,
    standing: Standing,
    sketches: Sketches,
    low: Floats,
    here: Floats,
    doubts: Floats,
) -> None:
    """Write bounds (m,) of what is left in boxes, what is in their middles, and doubts (m, 3)."""
    for m in range(len(case)):
        box = Box(
            case[m], rate[m], time[m], half[m], coasted[m], coasted_half[m], on[m], on_half[m]
        )
        low[m] = here[m] = np.inf
        if stand(box, leaving, standing, doubts[m]):
            low[m], here[m] = left_of_pairs(box.case, box.half, standing, kept)
            if low[m] > -TOLERANCE:
                strands = left_of_strands(box.case, box.half, standing, kept, sketches)
                low[m], here[m] = min(low[m], strands[0]), min(here[m], strands[1])
