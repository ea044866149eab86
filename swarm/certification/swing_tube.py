"""The tube of the swinging cable: how far each part of a strand gets from its catenary.

It contains all strays that :mod:`.swing_runs` simulates, and bounds of what lies between the
simulated moments and of the error of the model: in the planned motion, and after ordinary and
urgent stops, rewinds and resumes of the mission clock at any moment. Clearances are certified in
the tube of the planned motion, and of ordinary stops with the resume that follows. Urgent stops and
rewinds swing a strand two to three times as far: in the tube with them, no plan of the figure-eight
was found. The budget counts all of them, for strands.

Both strands of a pair swing in the same motion, and strands that swing together keep their
distance: how much nearer they come than their catenaries is computed for each pair.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.cable_spans import all_pairs, exempt_length
from swarm.certification.strand_pieces import BIN, LEAVES, TubeRadii
from swarm.certification.swing_runs import (
    CHECKS,
    COURSES,
    ORDINARY_COURSES,
    SETTLING,
    Course,
    PlannedSwing,
    Swung,
    Wanted,
    aloft,
    planned_swing,
    swings_after,
)
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.distance import norms, polyline_polyline
from swarm.geometry.sensitivity import BOTH_ENDS, FAR_END, NEAR_END, linear_response
from swarm.jit import compiled
from swarm.planning import Plan
from swarm.planning.shaping import COMPARED
from swarm.signatures import Floats1, Floats2, Floats3, Floats4, Floats5, Ints1, Ints2, contiguous
from swarm.threads import both

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

WITHIN = 1.0
"""Metres between surfaces beyond which pairs are left out: tracking, swing, tolerances and the
required distance together take 0.6 m in the default missions."""

PIECES = 64
"""Pieces of a strand for its closest point: 5 cm of a strand of 3 m."""


@dataclass(frozen=True, eq=False)
class ClosePairs:
    """Closest points of pairs of strands at moments, all (r,) or (r, 2) or (r, 3).

    ``bins`` are the numbers of the intervals in the middle of which they were found, ascending;
    ``fractions`` those of the length; ``normal`` points from the second to the first strand,
    ``available`` is the distance between surfaces in metres, and ``left`` what tracking errors
    leave of it beyond the required one, to first order.
    """

    bins: Ints
    times: Floats
    pairs: Ints
    fractions: Floats
    normal: Floats
    available: Floats
    left: Floats

    def taken(self, where: Ints) -> "ClosePairs":
        """Return some of the pairs, in the same order."""
        return ClosePairs(*(getattr(self, each.name)[where] for each in fields(self)))


@dataclass(frozen=True, eq=False)
class PairSwing:
    """How much nearer the strands of ``close`` pairs come as both swing, (r,) metres.

    In the planned motion from ``start`` on, and after changes of the clock's rate.
    """

    start: float
    close: ClosePairs
    approach: Floats


def close_pairs(plan: Plan, times: Floats, exempt: float) -> ClosePairs:
    """Return all pairs that are nearer than WITHIN at mission times (k,); ``exempt`` in metres."""
    lengths = plan.layout.lengths
    place = plan.motion.at(times)[0]
    strands = solve_catenaries(place[:, :-1], place[:, 1:], lengths)
    points = strands.points(np.linspace(0.0, 1.0, PIECES + 1))
    none = np.empty((0, 5), dtype=np.intp), np.empty((0, 3)), np.empty(0)
    batches: list[tuple[Floats | Ints, ...]] = [none]
    box = cache(partial(_box, points))
    for (i, j), parts in zip(*all_pairs(lengths, exempt), strict=True):
        first = np.ceil(parts[:, 0] * PIECES).astype(np.intp)
        last = np.floor(parts[:, 1] * PIECES).astype(np.intp) + 1
        a, b = points[:, i, first[0] : last[0]], points[:, j, first[1] : last[1]]
        gap = _gap(box(i, first[0], last[0]), box(j, first[1], last[1]))
        near = np.flatnonzero(gap < WITHIN + plan.mission.cable.diameter)
        closest = polyline_polyline(a[near], b[near])
        here = np.rint(closest.first).astype(np.intp) + first[0]
        there = np.rint(closest.second).astype(np.intp) + first[1]
        apart = points[near, i, here] - points[near, j, there]
        size = norms(apart)
        kept = (size < WITHIN + plan.mission.cable.diameter) & (size > 1e-9)
        rows = np.column_stack([near, np.full(len(near), i), np.full(len(near), j), here, there])
        batches.append((rows[kept], apart[kept] / size[kept, None], size[kept]))
    rows, normal, size = (np.concatenate(parts) for parts in zip(*batches, strict=True))
    order = np.argsort(rows[:, 0], kind="stable")
    rows, normal, size = rows[order], normal[order], size[order]
    pairs, fractions = rows[:, 1:3], rows[:, 3:] / PIECES
    available = size - plan.mission.cable.diameter
    tracking = _tracking(plan, place[rows[:, 0]], pairs, fractions, normal)
    margins = available - tracking - plan.mission.clearance.cable
    return ClosePairs(rows[:, 0], times[rows[:, 0]], pairs, fractions, normal, available, margins)


def _tracking(plan: Plan, place: Floats, pairs: Ints, fractions: Floats, normal: Floats) -> Floats:
    """Return the largest approach (r,) of pairs by tracking errors of the team, at ``place``
    (r, n, 3)."""
    rows = np.arange(len(pairs))
    neighbours = pairs[:, 1] == pairs[:, 0] + 1
    total = np.zeros(len(rows))
    for side, alone in enumerate((NEAR_END, FAR_END)):
        segment, fraction = pairs[:, side], fractions[:, side]
        ends, lengths = (place[rows, segment], place[rows, segment + 1]), plan.layout.lengths
        response = linear_response(
            solve_catenaries(*ends, lengths[segment]), fraction,
            np.where(neighbours, alone, BOTH_ENDS), normal, (fraction, fraction),
            np.zeros(len(rows)),
        )  # fmt: skip
        moved = np.where(response.known, response.at_point, 1.0)
        total += np.where(neighbours, 2.0, 1.0) * moved
    return plan.mission.vehicles.tracking * total


def _box(points: Floats, strand: int, first: int, last: int) -> tuple[Floats, Floats]:
    """Return the lowest and highest coordinates (k, 3) of a part of a strand."""
    part = points[:, strand, first:last]
    return part.min(axis=1), part.max(axis=1)


def _gap(a: tuple[Floats, Floats], b: tuple[Floats, Floats]) -> Floats:
    """Return a lower bound (k,) of the distance of polylines: that of the boxes around them."""
    apart = np.maximum(a[0] - b[1], b[0] - a[1])
    return norms(np.maximum(apart, 0.0))


def collect_distances(bins: Ints, strays: Floats, most: Floats) -> None:
    """Raise ``most`` (k, n − 1, links + 1) to the sizes of strays of joints in these intervals.

    ``strays`` (m, n − 1, links + 1, 3) at moments in the intervals ``bins`` (m,); a stray that is
    not a number has no bound.
    """
    _raise_distances(bins, contiguous(strays), most)


@compiled
def _raise_distances(bins: Ints1, strays: Floats4, most: Floats3) -> None:
    for m in range(len(bins)):
        for i in range(strays.shape[1]):
            for j in range(strays.shape[2]):
                x, y, z = strays[m, i, j, 0], strays[m, i, j, 1], strays[m, i, j, 2]
                square, known = x * x + y * y + z * z, most[bins[m], i, j]
                # few are larger, and only these need a root; NaN fails both comparisons
                if not square <= known * known:
                    most[bins[m], i, j] = np.sqrt(square) if square >= 0.0 else np.inf


def collect_approaches(close: ClosePairs, bins: Ints, strays: Floats, most: Floats) -> None:
    """Raise ``most`` (r,) to how much nearer strands come by strays at their closest points.

    ``strays`` (m, n − 1, links + 1, 3) at moments in the intervals ``bins`` (m,). Moments in the
    interval before and after count, too: a change of the rate that begins between two simulated
    ones passes through each mission time at most half an interval from where one of them does.
    """
    links = strays.shape[2] - 1
    joints = np.rint(close.fractions * links).astype(np.intp)
    first = np.searchsorted(close.bins, bins - 1, side="left")
    last = np.searchsorted(close.bins, bins + 1, side="right")
    which = _Rows(first, last, close.pairs, joints)
    _raise_approaches(which, close.normal, contiguous(strays), most)


class _Rows(NamedTuple):
    """Close pairs (r, 2) and their nearest joints; moment m has those from first to last (m,)."""

    first: Ints1
    last: Ints1
    pairs: Ints2
    joints: Ints2


@compiled
def _raise_approaches(which: _Rows, normal: Floats2, strays: Floats4, most: Floats1) -> None:
    for m in range(len(which.first)):
        for row in range(which.first[m], which.last[m]):
            first, second = strays[m, which.pairs[row, 0]], strays[m, which.pairs[row, 1]]
            i, j = which.joints[row]
            nearer = (second[j, 0] - first[i, 0]) * normal[row, 0]
            nearer += (second[j, 1] - first[i, 1]) * normal[row, 1]
            nearer += (second[j, 2] - first[i, 2]) * normal[row, 2]
            most[row] = max(most[row], np.inf if np.isnan(nearer) else nearer)


def collect_settling(close: ClosePairs, bins: Ints, strays: Floats, most: Floats) -> None:
    """Raise ``most`` (r,) to the sum of both strands' amplitudes in the rest after each stop.

    Strands of unequal periods that begin to swing together swing against each other later, with no
    more than the amplitudes that air has left. ``strays`` (c, m, n − 1, links + 1, 3) are those of
    the last moments of stops that end in the intervals ``bins`` (c,), over half a period at least.
    """
    joints = np.rint(close.fractions * (strays.shape[3] - 1)).astype(np.intp)
    first, last = np.searchsorted(close.bins, [bins - 1, bins + 2])
    which = _Rows(first, last, close.pairs, joints)
    _raise_amplitudes(which, close.normal, contiguous(strays), most)


@compiled
def _raise_amplitudes(which: _Rows, normal: Floats2, strays: Floats5, most: Floats1) -> None:
    for c in range(len(which.first)):
        for row in range(which.first[c], which.last[c]):
            reached = 0.0
            for side in range(2):
                segment, joint = which.pairs[row, side], which.joints[row, side]
                largest = 0.0
                for m in range(strays.shape[1]):
                    aside = strays[c, m, segment, joint, 0] * normal[row, 0]
                    aside += strays[c, m, segment, joint, 1] * normal[row, 1]
                    aside += strays[c, m, segment, joint, 2] * normal[row, 2]
                    largest = max(largest, np.inf if np.isnan(aside) else abs(aside))
                reached += largest
            most[row] = max(most[row], reached)


BETWEEN_SAMPLES = 0.05
"""Share by which a stray can be larger between compared moments: ω²h²/8 for h = 0.1 s and a period
of 1 s, shorter than the first lateral mode of strands with a sag of 0.3 m."""

BETWEEN_STOPS = 0.005
"""Metres by which the stray after a stop can exceed those after the stops before and after it:
measured for stops every 0.25 s in the default overhand and figure-eight."""

BETWEEN_RESTS = 0.05
"""Share by which the stray after a stop and a resume can exceed them in addition, after a rest
between theirs: as in the overhand with five vehicles; each certified plan is checked."""

MODEL_ERROR = 0.006
"""Metres by which a finer chain strays farther: 2 mm with 96 links and 2.5 ms in the default
missions with ``fold.swing`` in metres, 6 mm in the overhand without."""

NEAR = 0.35
"""Metres that tracking errors leave of a pair's distance, beyond the required one, from which its
swing after an urgent stop is not simulated for repairs. In the first plan of the Carrick mat 99 %
of close pairs come nearer by less than 0.16 m after urgent stops, but one by 0.4 m: only the tube
is complete. The other changes of the clock's rate showed no short budget in the default missions
where urgent stops had shown none."""

_PLANNED = "planned motion"
"""Name of the motion without a change of the clock's rate, beside those of courses."""

_RESUMED = ORDINARY_COURSES[0].name
"""That of stops with their resumes."""

_LAST = round(SETTLING / COMPARED)
"""Compared moments at the end of a stop that show the amplitudes."""


@dataclass(frozen=True, eq=False)
class SwingTube:
    """The tube of a plan, from ``start`` on, and what it was made of, metres.

    ``planned`` (k, n − 1) are the simulated strays in the planned motion, ``changed`` the largest
    stray after each change of the clock's rate, by its name. ``all_changes`` are the radii for all
    of these, ``ordinary`` those for the planned motion and ordinary stops with their resumes.
    ``pairs`` are those near each other in the middles of the intervals, with the same bounds of how
    much nearer they come as both swing, after all changes.
    """

    start: float
    planned: Floats = field(repr=False)
    changed: dict[str, float]
    all_changes: TubeRadii = field(repr=False)
    ordinary: TubeRadii = field(repr=False)
    pairs: PairSwing = field(repr=False)

    @property
    def times(self) -> Floats:
        """Middles (k,) of the intervals, mission time in seconds."""
        return np.asarray(self.start + BIN * (np.arange(len(self.planned)) + 0.5))


def beyond_ordinary(plan: Plan, radii: TubeRadii) -> float:
    """Return how far other stops and resumes, with twice the links, come out of a plan's tube.

    In metres beyond the ``radii`` of :attr:`SwingTube.ordinary`; negative where they stay inside.
    Raises ValueError for a plan without a tube.
    """
    span = aloft(plan)
    if span is None:
        raise ValueError("a plan whose cable does not fold in the air has no tube")
    planned = planned_swing(plan, span, finer=True)
    largest: dict[str, Floats] = {}
    for swung in (planned.swung, *swings_after(plan, span, planned, CHECKS)):
        _collect_strays(span, swung, largest)
    most = _leaves(np.maximum.reduce(list(largest.values())))
    return float((most - radii.pieces[:, :, LEAVES:]).max())


_URGENT = tuple(course for course in COURSES if course.urgent)
_URGENT_STOPS = tuple(course for course in _URGENT if course.target == 0.0)


def _leaves(strays: Floats) -> Floats:
    """Return the largest strays (k, n − 1, 8) of parts of strands, from those of joints."""
    links = (strays.shape[2] - 1) // LEAVES
    leaves = [strays[:, :, k * links : (k + 1) * links + 1].max(axis=2) for k in range(LEAVES)]
    return np.stack(leaves, axis=2)


@dataclass(frozen=True, eq=False)
class Swings:
    """Largest ``strays`` (k, n − 1, links + 1) in each interval, by the name of the change,
    and the ``approach`` (r,) of ``close`` pairs, metres: of a plan in a span of mission time."""

    plan: Plan
    span: tuple[float, float]
    planned: PlannedSwing = field(repr=False)
    close: ClosePairs = field(repr=False)
    strays: dict[str, Floats] = field(repr=False)
    approach: Floats = field(repr=False)

    @staticmethod
    def planned_in(plan: Plan) -> "Swings | None":
        """Return the swings in the planned motion; None for a plan without a tube.

        A plan without a fold of cable has none, nor has one in which a chord exceeds its cable.
        """
        span = aloft(plan)
        if span is None:
            return None
        middles = np.asarray(span[0] + BIN * (np.arange(_intervals(span)) + 0.5), dtype=np.float64)
        close, planned = both(
            lambda: close_pairs(plan, middles, exempt_length(plan)),
            lambda: planned_swing(plan, span),
        )
        swings = Swings(plan, span, planned, close, {}, np.zeros(len(close.bins)))
        swings.collect([planned.swung])
        return swings

    def after(self, courses: Sequence[Course]) -> "Swings":
        """Return the swings with those after changes of the clock's rate."""
        largest = {name: strays.copy() for name, strays in self.strays.items()}
        swings = replace(self, strays=largest, approach=self.approach.copy())
        swings.collect(swings_after(self.plan, self.span, self.planned, courses))
        return swings

    def tube(self, ordinary: TubeRadii) -> SwingTube:
        """Add urgent changes to the swings after ordinary ones, and return the tube of all."""
        self.collect(swings_after(self.plan, self.span, self.planned, _URGENT))
        names = dict.fromkeys(course.name for course in COURSES)
        return SwingTube(
            start=self.span[0],
            planned=self.strays[_PLANNED].max(axis=2),
            changed={name: float(self.strays[name].max()) for name in names},
            all_changes=self.radii,
            ordinary=ordinary,
            pairs=self.pairs,
        )

    @property
    def radii(self) -> TubeRadii:
        """The radii for these swings.

        A change between two simulated ones passes through each mission time at most half their
        distance from where one of them does: the intervals before and after count, too.
        """
        larger = {_RESUMED: 1.0 + BETWEEN_RESTS}
        most = np.maximum.reduce(
            [larger.get(name, 1.0) * each for name, each in self.strays.items()]
        )
        wide = np.pad(most, ((1, 1), (0, 0), (0, 0)), mode="edge")
        most = np.maximum(most, np.maximum(wide[:-2], wide[2:]))
        bound = (1.0 + BETWEEN_SAMPLES) * _leaves(most) + BETWEEN_STOPS + MODEL_ERROR
        return TubeRadii.of_leaves(self.span[0], bound)

    @property
    def pairs(self) -> PairSwing:
        """Bounds of how much nearer close pairs come in these swings."""
        bound = (1.0 + BETWEEN_SAMPLES) * self.approach + 2.0 * (BETWEEN_STOPS + MODEL_ERROR)
        return PairSwing(self.span[0], self.close, bound)

    def near_pairs_after_urgent_stops(self, *, ordinary: bool = False) -> PairSwing:
        """Return bounds for the pairs that tracking errors bring nearer than NEAR, after these.

        No other strands are simulated, which takes a tenth of the time of the whole tube. Where
        budgets are short in it, they are short. With ``ordinary``, after the first of the ordinary
        stops and resumes, too.
        """
        courses = (*ORDINARY_COURSES[:1], *_URGENT_STOPS) if ordinary else _URGENT_STOPS
        near = self.nearer_than(NEAR)
        wanted = near.wanted(len(self.plan.layout.lengths))
        for swung in swings_after(self.plan, near.span, near.planned, courses, wanted):
            near.collect_pairs(swung)
        return near.pairs

    def wanted(self, strands: int) -> Wanted:
        """Return the strands of the close pairs, in their intervals and beside them."""
        wanted = np.zeros((_intervals(self.span), strands), np.bool_)
        for beside in (-1, 0, 1):
            bins = np.clip(self.close.bins + beside, 0, len(wanted) - 1)
            wanted[bins[:, None], self.close.pairs] = True
        return Wanted(self.span[0], wanted)

    def nearer_than(self, distance: float) -> "Swings":
        """Return those of the pairs of which tracking errors leave less, without the strays."""
        near = np.flatnonzero(self.close.left < distance)
        return replace(self, strays={}, close=self.close.taken(near), approach=self.approach[near])

    def collect(self, swings: Iterable[Swung]) -> None:
        """Add the swings."""
        for swung in swings:
            self.collect_pairs(swung)
            _collect_strays(self.span, swung, self.strays)

    def collect_pairs(self, swung: Swung) -> None:
        """Add the swings to the approach of close pairs alone."""
        bins = _bins(self.span, swung)
        collect_approaches(self.close, bins.ravel(), _moments(swung), self.approach)
        if swung.course is not None and swung.course.target == 0.0:
            last = swung.strays[:, -_LAST:]
            collect_settling(self.close, bins[:, -1], last, self.approach)


def _collect_strays(span: tuple[float, float], swung: Swung, largest: dict[str, Floats]) -> None:
    """Add a swing to the largest strays (k, n − 1, links + 1) in each interval, by its change."""
    strays = _moments(swung)
    name = swung.course.name if swung.course else _PLANNED
    most = largest.setdefault(name, np.zeros((_intervals(span), *strays.shape[1:3])))
    collect_distances(_bins(span, swung).ravel(), strays, most)


def _bins(span: tuple[float, float], swung: Swung) -> Ints:
    bins = ((swung.times - span[0]) / BIN).astype(np.intp)
    return np.minimum(bins, _intervals(span) - 1)


def _moments(swung: Swung) -> Floats:
    return swung.strays.reshape(-1, *swung.strays.shape[2:])


def _intervals(span: tuple[float, float]) -> int:
    return int(np.ceil((span[1] - span[0]) / BIN))
