"""The clearance budget: all effects that reduce the distance of two strands at a moment.

Every effect is a movement by which the closest points approach each other, in metres. The movements
of both strands are added, as if all effects came together; a movement that is known and takes them
apart does not count. Tracking, and with ``fold.swing`` in metres the swing in the planned motion
and after ordinary stops and resumes, are part of the certificate; the others are estimates, each
with its model.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, reduce
from itertools import product
from operator import add
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.air import (
    jet_speed,
    jet_width,
    wind_down,
)
from swarm.certification.cable_spans import all_pairs, exempt_length
from swarm.certification.clearances import (
    Moment,
    Place,
    PlanChecks,
)
from swarm.certification.distances import segment_name
from swarm.certification.excitation import (
    DEVIATIONS,
    STEP,
    Variances,
    modes,
    speeds_across,
    variances_along,
)
from swarm.certification.kinds import kind_of
from swarm.certification.strand_pieces import BIN
from swarm.certification.swing_tube import PIECES, PairSwing
from swarm.geometry.catenary import STANDARD_GRAVITY, Catenaries, solve_catenaries
from swarm.geometry.distance import polyline_polyline
from swarm.geometry.lumped_mass import AIR_DENSITY, NORMAL_DRAG, cable_model
from swarm.geometry.sensitivity import BOTH_ENDS, FAR_END, NEAR_END, linear_response
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]

SPEEDS = 0.25, 0.5, 0.75, 1.0
"""Shares of the steady wind for which its effect is estimated; the largest movement counts."""

DIRECTIONS = 8
"""Headings of wind and of braking, 45° apart; the largest movement of all counts."""

STILL_AIR = (0.0, 0.0, -1.0)
"""Unit vector of the effective gravity without wind: down, ENU."""

NEARLY_STRAIGHT = 0.9995
"""Largest ratio of chord to length at which strands are drawn: a straight strand has no catenary.
The taut check refuses plans far below it."""


EFFECTS: Final = {
    "tracking": "tracking",
    "amplification": "sag and tightening",
    "length": "length tolerance",
    "grip": "leaning droppers",
    "swing": "swing",
    "excited": "swing by tracking errors",
    "wind": "wind",
    "wash": "rotor wash",
}
"""Effects of the budget by the names of their fields, in words."""


_PAIRS = 12
"""Pairs of strands whose nearest moment is evaluated with all effects: four times as many as a
report lists."""
_ROWS = 4 * _PAIRS
"""Rows whose effects are remembered, those of the last four questions: of 84 that planning the
figure-eight asks for, 44 differ."""


@dataclass(frozen=True)
class Budget:
    """One row of the budget: the distance of two strands and the effects on it, metres.

    ``available`` is the distance between surfaces at the setpoints. Effects: ``tracking``, the
    displacement by the tracking error; ``amplification``, the additional movement because strands
    sag and tighten; ``length``, the tolerance of the segments' lengths; ``grip``, droppers that
    lean with the planned acceleration; ``swing``, how much nearer both strands come as they swing,
    in the planned motion and after stops, rewinds and resumes; ``excited``, the swing that tracking
    errors at the strands' own frequencies excite; ``wind``,
    the mission's steady wind and gusts; ``wash``, the downwash of vehicles above.
    """

    between: tuple[str, str]
    time: float
    available: float
    tracking: float
    amplification: float
    length: float
    grip: float
    swing: float
    excited: float
    wind: float
    wash: float
    required: float

    @property
    def effects(self) -> float:
        """Sum of all effects."""
        total: float = reduce(add, (getattr(self, name) for name in EFFECTS))
        return total

    @property
    def remaining(self) -> float:
        """Margin if all effects come together."""
        return self.available - self.effects - self.required


def least_remaining(rows: Iterable[Budget]) -> float:
    """Return what remains at least; 0 without rows."""
    return min((row.remaining for row in rows), default=0.0)


@dataclass(frozen=True, eq=False)
class _Strand:
    """A strand at a moment, its closest point as a fraction of length, and the direction."""

    segment: int
    start: Floats
    end: Floats
    length: float
    fraction: float
    normal: Floats

    def catenary(self, length: float | None = None, down: Floats | Place = STILL_AIR) -> Catenaries:
        chord = float(np.linalg.norm(self.end - self.start))
        length = max(self.length if length is None else length, chord / NEARLY_STRAIGHT)
        return solve_catenaries(self.start, self.end, length, down=down)

    @cached_property
    def drawn(self) -> Catenaries:
        """The catenary at the setpoints."""
        return self.catenary()

    @cached_property
    def point(self) -> Floats:
        """The closest point (3,)."""
        return self.drawn.points_at(self.fraction)

    def movement(self, length: float | None = None, down: Floats | Place = STILL_AIR) -> float:
        """Movement of the point along the normal when length or gravity change."""
        step = self.catenary(length, down).points_at(self.fraction)
        return float((step - self.point) @ self.normal)

    def displaced(self, first: Floats, last: Floats) -> float:
        """Movement of the point along the normal when the ends are displaced by (3,) each."""
        moved = replace(self, start=self.start + first, end=self.end + last)
        return float((moved.point - self.point) @ self.normal)

    def straightened(self) -> Floats:
        """Movement (3,) of the point under an infinite load there: both parts straight."""
        chord_vector = self.end - self.start
        chord = max(float(np.linalg.norm(chord_vector)), 1e-9)
        along = chord_vector / chord
        first, last = self.fraction * self.length, (1.0 - self.fraction) * self.length
        foot = (first**2 - last**2 + chord**2) / (2.0 * chord)
        below = np.array([0.0, 0.0, -1.0]) + along[2] * along
        below /= max(float(np.linalg.norm(below)), 1e-9)
        depth = math.sqrt(max(first**2 - foot**2, 0.0))
        point: Floats = self.start + foot * along + depth * below
        return point - self.point

    def response(self, ends: int = BOTH_ENDS) -> float:
        """Largest movement along the normal per metre of error of the given ends."""
        ones, drawn = np.ones(1), self.drawn
        strands = solve_catenaries(drawn.start[None], drawn.end[None], drawn.length[None])
        response = linear_response(
            strands, self.fraction * ones, np.array([ends]), self.normal[None],
            (self.fraction * ones, self.fraction * ones), 0.0 * ones,
        )  # fmt: skip
        return float(response.at_point[0]) if response.known[0] else 1.0


def budgets(plan: Plan, moments: Iterable[Moment]) -> tuple[Budget, ...]:
    """Return the rows for moments between two strands, in the given order."""
    checks = PlanChecks.of(plan)
    swing = checks.tube.pairs if checks.tube else None
    return tuple(
        _budget_at(checks, moment.between, moment.time, moment.required, swing)
        for moment in moments
        if kind_of(moment.check).budget
    )


def _budget_at(
    checks: PlanChecks,
    between: tuple[str, str],
    time: float,
    required: float,
    pairs: PairSwing | None,
) -> Budget:
    """Return the row of two segments, by their names, at a mission time.

    Swing in flight and swing by tracking errors come together; in a long hold the first has
    decayed, and the second has grown to what air damps. The larger sum counts.
    """
    effects = _effects(checks, between, time, required, pairs and pairs.start)
    if pairs is None:
        return effects.row
    close = pairs.close
    near = (close.pairs == effects.segments).all(axis=1) & (np.abs(close.times - time) <= BIN)
    swing = float(pairs.approach[near].max(initial=0.0))
    if swing + effects.moving > effects.held:
        return replace(effects.row, swing=swing, excited=effects.moving)
    return replace(effects.row, swing=0.0, excited=effects.held)


class _Effects(NamedTuple):
    """The row of two ``segments`` but for the swing of close pairs, and the swing that tracking
    errors excite in flight (``moving``) and in a long hold (``held``), metres."""

    row: Budget
    segments: list[int]
    moving: float
    held: float


@lru_cache(maxsize=_ROWS)
def _effects(
    checks: PlanChecks, between: tuple[str, str], time: float, required: float, since: float | None
) -> _Effects:
    """Return the effects of which repairs ask again, with wider and with other swings.

    Excited swing counts ``since`` a time. Without one, the swing of close pairs is not known:
    strands lean and stop.
    """
    plan, mission = checks.plan, checks.plan.mission
    segments = [int(name.split()[1]) - 1 for name in between]
    place, _, acceleration = plan.motion.at(time)
    available, strands = _closest(plan, place, segments)
    radius, tolerance = mission.vehicles.tracking, mission.cable.length_tolerance
    if segments[1] == segments[0] + 1:
        # Seen from the shared grip, the other ends are displaced by up to twice the radius.
        total = 2.0 * radius * (strands[0].response(NEAR_END) + strands[1].response(FAR_END))
    else:
        total = radius * sum(strand.response() for strand in strands)
    bodily = min(2.0 * radius, total)
    excited = [] if since is None else [_excited(plan, time, strand, since) for strand in strands]
    row = Budget(
        between=between,
        time=time,
        available=available,
        tracking=bodily,
        amplification=total - bodily,
        length=sum(
            max(abs(strand.movement(length=strand.length + sign * tolerance)) for sign in (-1, 1))
            for strand in strands
        ),
        grip=_grip(plan, acceleration, strands),
        swing=_sway(plan, acceleration, strands) if since is None else 0.0,
        excited=0.0,
        wind=_wind(plan, strands),
        wash=_wash(plan, place, strands),
        required=required,
    )
    moving, held = (
        DEVIATIONS * math.sqrt(sum(getattr(variances, name) for variances in excited))
        for name in ("moving", "held")
    )
    return _Effects(row, segments, moving, held)


def _grip(plan: Plan, acceleration: Floats, strands: tuple["_Strand", "_Strand"]) -> float:
    """Approach as droppers lean with the planned acceleration: a vehicle tilts towards it."""
    tilt = np.arctan(np.hypot(acceleration[:, 0], acceleration[:, 1]) / STANDARD_GRAVITY)
    heading = np.arctan2(acceleration[:, 1], acceleration[:, 0])
    level = np.stack([np.cos(heading), np.sin(heading), 0.0 * heading], axis=1)
    moved = -plan.mission.vehicles.grip_offset * np.sin(tilt)[:, None] * level
    first, second = (
        strand.displaced(moved[strand.segment], moved[strand.segment + 1]) for strand in strands
    )
    return max(0.0, second - first)


def _sway(plan: Plan, acceleration: Floats, strands: tuple["_Strand", "_Strand"]) -> float:
    """Approach of strands that lean and stop."""
    sway = sum(
        abs(strand.movement(down=effective_gravity(0.5 * (by[0] + by[1]))))
        for strand in strands
        for by in [acceleration[strand.segment : strand.segment + 2]]
    )
    return sway + _stop(strands, plan.mission.vehicles.braking_acceleration)


def _excited(plan: Plan, time: float, strand: "_Strand", since: float) -> Variances:
    """Variances of a strand's swing by tracking errors at its frequencies (:mod:`.excitation`)."""
    cable = plan.mission.cable
    past = np.arange(since, time, STEP)
    place, velocity, _ = plan.motion.at(past)
    ends = slice(strand.segment, strand.segment + 2)
    across = speeds_across(place[:, ends], velocity[:, ends])
    drawn = solve_catenaries(strand.start[None], strand.end[None], np.array([strand.length]))
    drag = cable_model(cable.mass_per_length, cable.diameter).normal_drag
    at = strand.fraction, strand.normal
    return variances_along(modes(drawn), at, plan.mission.vehicles.tracking, drag, across)


def _closest(
    plan: Plan, place: Floats, segments: list[int]
) -> tuple[float, tuple[_Strand, _Strand]]:
    """The surface distance of the compared parts, and both strands with their closest points."""
    ends = [(place[segment], place[segment + 1]) for segment in segments]
    lengths = [float(plan.layout.lengths[segment]) for segment in segments]
    points = [
        solve_catenaries(
            start, end, max(length, float(np.linalg.norm(end - start)) / NEARLY_STRAIGHT)
        ).points(np.linspace(0.0, 1.0, PIECES + 1))
        for (start, end), length in zip(ends, lengths, strict=True)
    ]
    pairs, parts = all_pairs(plan.layout.lengths, exempt_length(plan))
    candidates = []
    for compared in parts[(pairs == segments).all(axis=1)]:
        first = np.ceil(compared[:, 0] * PIECES).astype(np.intp)
        last = np.floor(compared[:, 1] * PIECES).astype(np.intp) + 1
        a, b = (p[i:j] for p, i, j in zip(points, first, last, strict=True))
        closest = polyline_polyline(a, b)
        candidates.append((closest.distance, first[0] + closest.first, first[1] + closest.second))
    at = min(candidates)[1:]
    fractions = [float(index) / PIECES for index in at]
    spots = [p[round(float(index))] for p, index in zip(points, at, strict=True)]
    apart = spots[0] - spots[1]
    size = float(np.linalg.norm(apart))
    normal = apart / size if size > 1e-9 else np.array([0.0, 0.0, 1.0])
    strand, other = (
        _Strand(segment, start, end, length, fraction, normal)
        for segment, (start, end), length, fraction in zip(
            segments, ends, lengths, fractions, strict=True
        )
    )
    return size - plan.mission.cable.diameter, (strand, other)


def effective_gravity(acceleration: Floats) -> Floats:
    """Return the effective gravity (3,) of a strand that accelerates together with its ends."""
    return np.array([0.0, 0.0, -STANDARD_GRAVITY]) - acceleration


def _stop(strands: tuple[_Strand, _Strand], braking: float) -> float:
    """Pendulum bound: strands that lean while braking swing equally far to the other side.

    Both may brake along any heading, also in opposite directions.
    """
    headings = 2.0 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS
    level = [braking * np.array([math.cos(h), math.sin(h), 0.0]) for h in headings]
    return sum(
        max(abs(strand.movement(down=effective_gravity(a))) for a in level) for strand in strands
    )


def _wind(plan: Plan, strands: tuple[_Strand, _Strand]) -> float:
    """Both lean in the steady wind, one of them also in the gust; the worst wind up to that.

    Weaker wind may part strands less or more: SPEEDS of it count, in DIRECTIONS.
    """
    steady, gust = plan.mission.wind.steady, plan.mission.wind.gust
    if steady + gust == 0.0:
        return 0.0
    first, second = strands
    worst = 0.0
    for k, share in product(range(DIRECTIONS), SPEEDS):
        heading, wind = 2.0 * math.pi * k / DIRECTIONS, share * steady
        calm, gusty = (wind_down(plan, speed, heading) for speed in (wind, wind + gust))
        worst = max(
            worst,
            abs(first.movement(down=gusty) - second.movement(down=calm)),
            abs(first.movement(down=calm) - second.movement(down=gusty)),
        )
    return worst


def _wash(plan: Plan, place: Floats, strands: tuple[_Strand, _Strand]) -> float:
    """Approach of the strands as the downwash of other vehicles presses them down.

    The strand that is pressed away from the other one may be spared, and does not count.
    """
    first, second = (float(_pressed(plan, place, strand) @ strand.normal) for strand in strands)
    return max(0.0, -first) + max(0.0, second)


def _pressed(plan: Plan, place: Floats, strand: _Strand) -> Floats:
    """Movement (3,) of the point by the strongest downwash of other vehicles there.

    The drag of the vehicle's jet on the cable within it (:func:`jet_speed`) is a point load. It
    deflects the strand by about F·s(1 − s)·span / H, H the horizontal tension, limited to the
    shape with both parts straight. The vehicles that hold the strand are left out: at their grip
    both of their segments begin in the same jet.
    """
    mission = plan.mission
    drawn, spot = strand.drawn, strand.point
    below = place[:, 2] + mission.vehicles.grip_offset - spot[2]
    aside = np.hypot(place[:, 0] - spot[0], place[:, 1] - spot[1])
    speed = jet_speed(mission, below, aside)
    speed[strand.segment : strand.segment + 2] = 0.0
    drag = 0.5 * AIR_DENSITY * NORMAL_DRAG * mission.cable.diameter * speed**2
    load = float(np.max(drag * 2.0 * jet_width(mission, np.maximum(below, 0.0))))
    horizontal = float(drawn.tension(mission.cable.mass_per_length)[0])
    share = strand.fraction * (1.0 - strand.fraction)
    deflection = load * share * float(drawn.span) / max(horizontal, 1e-6)
    farthest = strand.straightened()
    reached = min(1.0, deflection / max(float(np.linalg.norm(farthest)), 1e-9))
    return reached * farthest


def smallest_budgets(plan: Plan, swing: PairSwing) -> tuple[Budget, ...]:
    """Return the rows with the least that remains, one for each of up to 12 pairs of strands.

    All pairs are compared every half second while the cable is aloft, by the effects of tracking
    and swing; these rows then have all effects. Least first.
    """
    rows = _rows(plan, swing, swing.close.left - swing.approach)
    return tuple(sorted((row for _, row in rows), key=lambda row: row.remaining))


@dataclass(frozen=True)
class ShortBudget:
    """A moment at which the budget of two strands is short, by ``metres``.

    ``check`` is the check of their distance; ``swing`` how much nearer they come by swinging.
    """

    check: str
    time: float
    metres: float
    swing: float


def short_moments(plan: Plan, swing: PairSwing) -> tuple[ShortBudget, ...]:
    """Return the moments at which budgets are short.

    At all moments the other effects of a pair count as at its moment in :func:`smallest_budgets`.
    """
    moments: list[ShortBudget] = []
    close, margins = swing.close, swing.close.left - swing.approach
    for at, row in _rows(plan, swing, margins):
        pair = close.pairs[at]
        check = "neighbouring segments" if pair[1] == pair[0] + 1 else "cable clearance"
        short = margins - (margins[at] - row.remaining)
        at_fault = np.flatnonzero((close.pairs == pair).all(axis=1) & (short < 0.0))
        moments += [
            ShortBudget(check, float(close.times[k]), -float(short[k]), float(swing.approach[k]))
            for k in at_fault
        ]
    return tuple(moments)


def needed_distances(plan: Plan, swing: PairSwing) -> Floats:
    """Return the distances (r,) between surfaces at which the budget of close pairs closes, metres.

    As :func:`short_moments` has it; the other effects of pairs that have no row there count as
    nothing.
    """
    close, margins = swing.close, swing.close.left - swing.approach
    needed: Floats = close.available - margins
    for at, row in _rows(plan, swing, margins):
        needed[(close.pairs == close.pairs[at]).all(axis=1)] += margins[at] - row.remaining
    return needed


def _rows(plan: Plan, swing: PairSwing, margins: Floats) -> list[tuple[int, Budget]]:
    """Return the close pair of strands and the row, for each of the pairs with the least left."""
    chosen: dict[tuple[int, int], int] = {}
    for row in np.argsort(margins, kind="stable").tolist():
        i, j = swing.close.pairs[row].tolist()
        chosen.setdefault((i, j), row)
        if len(chosen) == _PAIRS:
            break
    checks, required = PlanChecks.of(plan), plan.mission.clearance.cable
    times = swing.close.times.tolist()
    return [
        (row, _budget_at(checks, (segment_name(i), segment_name(j)), times[row], required, swing))
        for (i, j), row in chosen.items()
    ]
