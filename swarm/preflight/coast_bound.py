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

from swarm.cable.distance import polyline_polyline
from swarm.cable.sketch import sketch
from swarm.plans import Plan
from swarm.preflight.coast_pairs import left_of_pairs, near_strands
from swarm.preflight.course import Course
from swarm.preflight.limits import TAUT
from swarm.preflight.sensitivity import BOTH_ENDS, LARGEST_RATIO, sensitivity

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]

TOLERANCE = 0.005
"""Metres by which a clearance may fall short and still count as kept: exactly at a limit nothing
can be told."""
_PIECES = 16
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


@dataclass(frozen=True, eq=False)
class _Middles:
    """Everybody in the middle of each box (m, n, 3), how fast they go there with the time at which
    the stream is lost, and what else each can move within the box (m, n)."""

    place: Floats
    along: Floats
    loose: Floats
    doubts: Floats

    def taken(self, where: Flags) -> "_Middles":
        return _Middles(*(getattr(self, one.name)[where] for one in fields(self)))


class CoastBound:
    """What a plan's team keeps, for all times within intervals."""

    def __init__(self, plan: Plan, ways: Ways, end: float) -> None:
        """``end`` is the mission time beyond which nobody goes."""
        self._course, self._ways, self._end = Course(plan.motion), ways, end
        self._lengths = plan.layout.lengths
        self._asked = plan.mission.clearance
        self._thick = plan.mission.cable.diameter
        self._ball = plan.mission.vehicles.tracking
        self._spacing = float(self._lengths.max(initial=0.0)) / _PIECES

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
        middles = self._middles(boxes, rate)
        strayed = self._deviation(boxes, middles) > self._ball
        boxes, middles = boxes.taken(strayed), middles.taken(strayed)
        low, here = self._left(boxes, middles)
        most = self._ways.most_on(np.maximum(boxes.case - 1, 0), boxes.coasted)
        real = (boxes.case == 0) | ((boxes.on >= boxes.coasted) & (boxes.on <= most))
        kept[boxes.interval[real & (here < -TOLERANCE)]] = False
        open_ = low < -TOLERANCE
        return boxes.taken(open_).halved(middles.doubts[open_])

    def _left(self, boxes: _Boxes, middles: _Middles) -> tuple[Floats, Floats]:
        """Bounds (m,) of what is left of all, and what is in the middle."""
        low, here = self._simple(boxes, middles)
        look = low > -TOLERANCE
        if look.any():
            by_strands = self._by_strands(boxes.taken(look), middles.taken(look))
            low[look] = np.minimum(low[look], by_strands[0])
            here[look] = np.minimum(here[look], by_strands[1])
        return low, here

    def _middles(self, boxes: _Boxes, rate: Floats) -> _Middles:
        course, n = self._course, len(self._ways.after)
        half, later = boxes.half[:, None], np.minimum(boxes.time + boxes.on, self._end)
        width = boxes.half + boxes.on_half
        place, along, _ = course.motion.at(later)
        bound = course.acceleration_bound(later - width, np.minimum(later + width, self._end))
        clipped = (boxes.time + boxes.on + width > self._end)[:, None]
        speed = np.linalg.norm(along, axis=-1)
        loose = speed * boxes.on_half[:, None] + 0.5 * bound * (width * width)[:, None]
        loose += np.where(clipped, 2.0 * speed * width[:, None], 0.0)

        begun, first, second = course.motion.at(boxes.time)
        strongest = course.acceleration_bound(boxes.time - boxes.half, boxes.time + boxes.half)
        jerk = course.jerk_bound(boxes.time - boxes.half, boxes.time + boxes.half)
        fastest = np.linalg.norm(first, axis=-1) + strongest * half
        # all: each has coasted by what the farthest has, or by as much less as it stops earlier
        reach = self._ways.after * rate[boxes.interval][:, None]
        early = reach.max(axis=1, keepdims=True) - reach
        coasted = boxes.coasted[:, None]
        behind = np.where((boxes.case == 0)[:, None], early, 0.0)
        middle = np.maximum(coasted - 0.5 * behind, 0.0)
        lost_place = begun + middle[..., None] * first
        lost_along = first + middle[..., None] * second
        most = coasted + boxes.coasted_half[:, None]
        lost_loose = fastest * (boxes.coasted_half[:, None] + 0.5 * behind)
        lost_loose += (0.5 * (strongest + most * jerk) * half + 0.5 * strongest * behind) * half
        lost = _lost(boxes.case, n)
        sinking = np.where((boxes.case == 0)[:, None], 0.0, self._ways.sinking)
        lost_place[..., 2] -= 0.5 * sinking
        lost_loose += 0.5 * sinking
        place = np.where(lost[..., None], lost_place, place)
        along = np.where(lost[..., None], lost_along, along)
        common = along.mean(axis=1, keepdims=True)
        doubts = np.stack(
            [
                (np.linalg.norm(along - common, axis=-1) * half).max(axis=1) + 1e-3 * boxes.half,
                (np.where(lost, fastest, 0.0) * boxes.coasted_half[:, None]).max(axis=1),
                (np.where(lost, 0.0, speed) * boxes.on_half[:, None]).max(axis=1),
            ],
            axis=1,
        )
        return _Middles(place, along, np.where(lost, lost_loose, loose), doubts)

    def _deviation(self, boxes: _Boxes, middles: _Middles) -> Floats:
        """How far anybody can be from where the certificate has it at one and the same time."""
        moment = boxes.time + np.where(boxes.case == 0, boxes.coasted, boxes.on)
        width = boxes.half + np.where(boxes.case == 0, boxes.coasted_half, boxes.on_half)
        planned, speed, _ = self._course.motion.at(np.minimum(moment, self._end))
        until = np.minimum(moment + width, self._end)
        bound = self._course.acceleration_bound(np.minimum(moment, self._end) - width, until)
        apart = np.linalg.norm(middles.place - planned, axis=-1)
        rest = np.linalg.norm(middles.along - speed, axis=-1) * boxes.half[:, None]
        size = np.linalg.norm(speed, axis=-1)
        slack = (width - boxes.half)[:, None] * size + 0.5 * bound * (width * width)[:, None]
        slack += np.where((moment + width > self._end)[:, None], 2.0 * size * width[:, None], 0.0)
        lost = _lost(boxes.case, planned.shape[1])
        off = np.where(lost, apart + rest + slack + middles.loose, 0.0)
        largest: Floats = off.max(axis=1)
        return largest

    def _simple(self, boxes: _Boxes, middles: _Middles) -> tuple[Floats, Floats]:
        """Bounds (m,) of what is left of chords and between vehicles, and what is in the middle."""
        low, here = np.empty((2, len(boxes)))
        left_of_pairs(
            boxes.case, boxes.half, middles.place, middles.along, middles.loose,
            TAUT * self._lengths, self._asked.vehicle, self._asked.downwash, low, here,
        )  # fmt: skip
        return low, here

    def _by_strands(self, boxes: _Boxes, middles: _Middles) -> tuple[Floats, Floats]:
        """The same between strands that share no vehicle."""
        count = len(boxes)
        low, here = np.full(count, np.inf), np.full(count, np.inf)
        required = self._asked.cable + self._thick
        row, first, second, one, other = near_strands(
            boxes.case, boxes.half, middles.place, middles.along, middles.loose,
            self._lengths, required,
        )  # fmt: skip
        if not len(row):
            return low, here
        place = middles.place[row]
        a, b = self._strand(place, first, one), self._strand(place, second, other)
        off = a[1] + b[1]
        # from above by the points, from below by a spacing less; in between it is worth measuring
        most = _between_points(a[0], b[0]) - required
        apart = most - self._spacing
        unsure = (apart < off) & (most >= off - TOLERANCE)
        apart[unsure] = polyline_polyline(a[0][unsure], b[0][unsure]).distance - required
        most[unsure] = apart[unsure]
        np.minimum.at(low, row, apart - off)
        np.minimum.at(here, row, most)
        return low, here

    def _strand(self, place: Floats, which: Ints, moved: Floats) -> tuple[Floats, Floats]:
        """Points (b, k, 3) of strands, and how far (b,) they and what is between them can be off
        when the ends move by ``moved`` (b,)."""
        row = np.arange(len(place))
        start, end, length = place[row, which], place[row, which + 1], self._lengths[which]
        chord = np.linalg.norm(end - start, axis=-1)
        held = np.maximum(length, chord / LARGEST_RATIO)
        points = sketch(start, end, held, _PIECES)
        step = np.linalg.norm(np.diff(points, axis=1), axis=-1)
        arc = (held / _PIECES)[:, None]
        bow = 0.5 * np.sqrt(np.maximum(arc * arc - step * step, 0.0)).max(axis=1)
        steep = (np.abs(end[:, 2] - start[:, 2]) + 2.0 * moved) / np.maximum(
            chord - 2.0 * moved, 1e-9
        )
        level, upright = sensitivity().largest(
            chord / length, 2.0 * moved / length, np.minimum(steep, 1.0),
            np.full(len(row), BOTH_ENDS), np.ones(len(row), dtype=np.intp),
        )  # fmt: skip
        off = bow + np.hypot(level, upright) * moved
        return points, np.where(chord + 2.0 * moved < LARGEST_RATIO * length, off, np.inf)


def _between_points(first: Floats, second: Floats) -> Floats:
    """Smallest distances (b,) of points (b, k, 3) from others; lines through points that are a
    spacing apart come nearer by a spacing at most, half of it on each."""
    squares = np.matmul(first, second.transpose(0, 2, 1))
    squares *= -2.0
    squares += np.einsum("bij,bij->bi", first, first)[:, :, None]
    squares += np.einsum("bij,bij->bi", second, second)[:, None, :]
    nearest: Floats = np.sqrt(np.maximum(squares.min(axis=(1, 2)), 0.0))
    return nearest


def _lost(case: Ints, n: int) -> Flags:
    """Who (m, n) has lost the stream."""
    lost: Flags = (case == 0)[:, None] | (np.arange(1, n + 1) == case[:, None])
    return lost
