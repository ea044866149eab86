"""Shorten the fold of a plan: one optimisation of all motions, the line's pose and the duration.

An interior-point method. The cost of the problem (:mod:`.fold_problem`) and a weight times the
logarithm of the duration are minimised by damped Newton steps, with the matrix of Gauss and Newton;
the weight grows while steps succeed, so that the motion follows the path of centres between all
limits towards a shortest one. After every step, what a motion shows is measured again: needs by
tracking errors, frequencies of the swing and its correction by lumped masses, and how far vehicles
move on without setpoints.

The certificate judges the result. Where it finds less than is needed, for a clearance in still air
or in wind, for the budget or after lost setpoints, needs grow there, and another round of steps
begins where the last one ended.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from swarm.certification.air import LEAST_SINKING, jet_width, wind_tilt
from swarm.certification.budget import needed_distances
from swarm.certification.cable_spans import exempt_length
from swarm.certification.clearances import PlanChecks, violations, violations_in_wind
from swarm.certification.distances import segment_name, vehicle_name
from swarm.certification.stream_loss import StreamLossModel
from swarm.certification.swing_runs import strands_of
from swarm.errors import Refused
from swarm.geometry.catenary import MAX_CHORD_RATIO
from swarm.geometry.lumped_mass import Strands, cable_model
from swarm.geometry.motion import Motion, through_states
from swarm.geometry.solids import grown, half_space, obstacles_of, rows, upright_box
from swarm.mission import Mission
from swarm.planner.fold_problem import (
    LOSS_EVERY,
    RESTING,
    Coasting,
    Evaluation,
    Fold,
    Frozen,
    Limits,
    Problem,
    Slopes,
    held_on,
    modes,
)
from swarm.planner.pacing import swing_limit
from swarm.planner.team_terms import Needs, Team, Walls, band_times
from swarm.planning import Plan
from swarm.planning.assembly import begins_aloft, fold_of, with_fold
from swarm.planning.phase_motion import TAKEOFF_HEIGHT, usable_acceleration
from swarm.planning.phase_sequence import PADS_ASIDE, laid_along
from swarm.planning.plan import Phase
from swarm.planning.shaping import largest_stray
from swarm.threads import both

Floats = npt.NDArray[np.float64]
Progress = Callable[[str, float], None]
Verdict = Literal["refused", "cleared", "enough"]
"""Of a plan with a shorter fold: ``enough`` also holds in wind."""

SAMPLE = 0.05
"""Seconds between the states of a fold."""

_CONTROL_POINTS, _POINTS_PER_SECOND = 40, 0.55
"""Control points of each vehicle at least, and for a second of the fold to be shortened: a fold of
a third of its duration has one in 0.6 s, a quarter of the period of a strand of 2.5 m."""

_WITHIN = 0.99
"""Share of each limit of motion that is used: quintics between the states exceed it by less."""

_ROOM, _ROOM_AFTER_LOSS, _MORE_AFTER_LOSS = 0.02, 0.05, 0.05
"""Metres beyond needs: for moments between the sampled ones, for polygons in place of strands, and
for a tracking error or a wind that are a little larger than asked for;
after lost setpoints, and in every further round where the certificate's bound needs more."""

_AIMED_WIND = 1.0
"""Steady wind, m/s, in which strands are kept apart at least: folds that use all room in still air
would hold in none, and in this one they are 0.0 s (overhand) and 0.3 s (figure-eight) longer."""

_LIFTED = 12
"""Heights in the lift at which vehicles are compared with walls: about every metre."""

_KEPT_AT_REST, _LEAST_AT_REST = 0.015, 0.3
"""Metres by which a need is less than what the folded knot keeps, where that is less than it, and
the least of such needs."""

_NEAR_KNOT = 0.5
"""Metres from its place in the knot up to which a vehicle counts as near it: a need of strands may
be missed by as much as vehicles are farther away."""

_MOST_LESS, _LEAST_ALLOWED = 0.5, 0.25
"""Shares of the limit of the swing: the most by which a round lowers it where the knot keeps too
little (from 1 to 0.25 at once, steps gave up clearances for it), and the least that remains."""

_RADII = 1.02
"""Tracking radii for which clearances are asked to hold: for 1.00 they hold by chance."""

_AROUND = 0.75
"""Seconds around a moment for which what the certificate finds there counts: its intervals are half
a second long, and a stop reaches farther."""


class Effort(NamedTuple):
    """Weights of the duration at ``first``, in ``later`` rounds and at ``last``, the decrement that
    ends a round when motions have ``converged``, and the largest numbers of ``rounds`` and of
    ``steps`` of each. A ``hurried`` search begins near its end, and the first cleared plan ends it.
    """

    first: float
    later: float
    last: float
    converged: float
    rounds: int
    steps: int
    hurried: bool


THOROUGH = Effort(300.0, 1500.0, 12_000.0, 30.0, 8, 80, hurried=False)
"""With 12,000, a hundred limits that hold the duration keep a 120th of their range. With 8,000, the
overhand and the figure-eight are 0.5 and 1.5 s longer (results of plans, optimised folds). At the
end, a step would save 0.1 % of the duration; with a third of that a seventh more steps, and the
same folds. The square knot needs five rounds."""

HURRIED = Effort(1500.0, 1500.0, 3000.0, 60.0, 3, 20, hurried=True)
"""For a team in the air, from a motion that is a plan's in part: folds are a sixth longer, after a
quarter of the steps (results of plans, the rest of a fold)."""

_GROWTH, _FASTER = 1.2, 0.3
"""Growth of the weight in a step, and by how much more it grows with a whole one: chosen among ten
variants (results of plans, optimised folds)."""

_BRIEF, _WHOLE, _NEAR_CENTRE, _FAR_FROM_CENTRE = 0.1, 0.3, 60.0, 200.0
"""Shares of a step from which on the weight grows, where the decrement is up to these."""

_SOFTEST, _SOFTENED = 12.0, 6000.0
"""How far barriers are relaxed, over :data:`.RELAXED`, at most, and that times the weight. Forces
on limits grow with the weight, and a barrier that is a parabola below a slack of r holds 2/r at
its limit: relaxed farther, limits are missed, and less far, steps are short. Chosen of 3,000, 4,500
and 6,000; twelve times at first, as before (results of plans, optimised folds)."""

_KEPT, _NEARLY_KEPT = 0.5, 5.0
"""Shares of the room beyond limits and needs, as of :func:`_exceeded`, that a motion may use at the
end of a round, so that half is left between the moments; and up to which the weight grows: from 1.5
to 7.5 the folds of three missions were the same (results of plans, optimised folds)."""

_STILL = 1.0
"""Decrement after which a motion that uses more room stays as it is: far less than
:attr:`Effort.converged`, because while barriers follow what the lumped masses stray, steps save
little for a while, and more again."""

_HALVINGS, _DAMPINGS = 9, 6
"""Largest numbers of shorter and of more damped steps that are tried."""

_STIFF = (1e-3, 1.0, 1.0, 1.0, 100.0)
"""Damping of the duration's logarithm and of the line's x, y, z and heading, over that of control
points."""

_SOLVED, _ITERATIONS = 1e-3, 40
"""Residual of a step's equations over its gradient, and most iterations for it: those of the
overhand in a band take 10 to 40."""

_LARGEST_MOVE, _LARGEST_TURN, _LARGEST_CHANGE = 2.0, 0.3, 0.15
"""Metres by which a step moves a control point or the line, radians by which it turns the line, and
logarithm by which it changes the duration, at most."""

_TOWARDS = 0.5
"""Share of a change of what is measured that counts, so that needs and motion do not chase each
other."""

_PERIOD, _LEAST_SWING, _LEAST_GAIN, _LARGEST_GAIN = 1.4, 0.15, 0.7, 8.0
"""Seconds in which strays and oscillators are compared, about a period; share of the limit that an
oscillator counts as swinging at least; and the range of its correction."""

_FURTHER = 2
"""Largest number of rounds after a first cleared plan, which may not hold in wind."""

_MOST_UNKNOWNS = 10_000
"""Unknowns of a problem: a step of 9,177 (the Carrick mat) takes 3 s of a processor."""


@dataclass(frozen=True, eq=False)
class Shortening:
    """A problem, the plan that it shortens, and what its rounds share.

    ``strands`` are those that are simulated. ``kept`` (m, m) are the needs of strands that the
    folded knot keeps, infinite where it has them far apart: near its end, a fold keeps no more.
    """

    plan: Plan
    problem: Problem
    strands: tuple[Strands, ...]
    kept: Floats

    @staticmethod
    def of(plan: Plan) -> "tuple[Shortening, Fold]":
        """Return the problem of a plan's fold, and its motion as the start."""
        problem, fold = _problem_of(plan)
        return Shortening(plan, problem, strands_of(plan), _kept(problem)), fold

    def motion(self, fold: Fold) -> Motion:
        """Return the motion from time 0: quintics through states every 0.05 s."""
        shares = np.linspace(0.0, 1.0, int(np.ceil(fold.duration / SAMPLE)) + 1)
        place, velocity, acceleration = self.problem.states(fold, shares)
        velocity[[0, -1]] = acceleration[[0, -1]] = 0.0
        return through_states(shares * fold.duration, place, velocity, acceleration)

    def plan_with(self, fold: Fold) -> Plan:
        """Return the plan with this fold, in which vehicles follow no common path."""
        return replace(with_fold(self.plan, self.motion(fold)), path=np.empty((0, 3)))

    def swinging_less(self, fold: Fold) -> "Shortening":
        """Return the problem with a lower limit of the swing, where lumped masses swing farther.

        Oscillators and their corrections may not agree with them to the last percent.
        """
        limits = self.problem.limits
        _, stray = largest_stray(self.motion(fold), self.strands)
        lower = replace(limits, swing=limits.swing * min(1.0, limits.swing / float(stray.max())))
        return replace(self, problem=replace(self.problem, limits=lower))

    def times(self, plan: Plan) -> Floats:
        """Return the mission times (s,) of the problem's moments in a plan."""
        fold = plan.phase("fold")
        return self.problem.shares * fold.duration + fold.start

    @property
    def loss_shares(self) -> Floats:
        """Shares (l,) of the duration at which setpoints are lost."""
        return self.problem.shares[::LOSS_EVERY]


def shorten(
    plan: Plan, accepted: Callable[[Plan], Verdict], progress: Progress, effort: Effort
) -> None:
    """Look for the shortest fold near that of a plan, from a line that may be elsewhere.

    One that :func:`.begins_aloft` begins at the same places. Its fold need not keep its limits: it
    has the right topology. ``accepted`` is called with plans, and tells whether one keeps what is
    required. ``progress`` is called with the name of the stage and the share of it that is done.

    Raises :class:`swarm.errors.Refused` for more vehicles and a longer fold than can be solved.
    """
    short, fold = Shortening.of(plan)
    require_solvable(plan.vehicles, fold.duration, short.problem.count)
    fold, frozen = _slow_enough(short, fold)
    wanted = Wanted.nothing(frozen.needs)
    if effort.hurried:
        # the start is as quick as the fold will be: budgets ask of it what they will ask of that
        draft = short.plan_with(fold)
        at = short.times(draft)
        most = _most(short, draft.motion.at(at)[0])
        wanted = wanted._replace(strands=np.minimum(_needed_for_budget(draft, at), most))
    room = np.full(len(short.loss_shares), _ROOM_AFTER_LOSS)
    last = effort.rounds - 1
    for number in range(effort.rounds):
        weights = effort._replace(first=effort.later) if number else effort
        centred = _centred(
            short, fold, frozen, (wanted, room), weights, partial(_show, progress, number)
        )
        if centred is None:
            break
        fold, frozen = centred
        draft = short.plan_with(fold)
        if PlanChecks.of(draft).spans.problems:
            break
        verdict = accepted(draft)
        missed = np.zeros(len(room), dtype=np.bool_)
        if verdict != "refused" or not effort.hurried:  # half of what a round takes
            missed = _missed_after_losses(short, draft)
        if verdict == "enough" and not missed.any():
            break
        if verdict != "refused":
            last = min(last, number + _FURTHER)
        if number == last:
            break
        wanted, room = _wanted(short, draft, frozen.needs, wanted), room + _MORE_AFTER_LOSS * missed
        short = short.swinging_less(fold)
    progress("shortening the fold", 1.0)


def _show(progress: Progress, number: int, share: float) -> None:
    """Tell which ``share`` of a round is done. Of a number that is not known, each round counts
    half of what remains."""
    progress("shortening the fold", 1.0 - 0.5 ** (number + share))


def _slow_enough(short: Shortening, fold: Fold) -> tuple[Fold, Frozen]:
    """Return a motion as slow as the limit of its swing asks for, and what is measured at it."""
    _, stray = largest_stray(short.motion(fold), short.strands)
    slower = max(1.0, float(np.sqrt(stray.max() / short.problem.limits.swing)))
    fold = replace(fold, duration=slower * fold.duration)
    return fold, _measured_first(short, fold)


def aimed_wind(mission: Mission) -> float:
    """Return the steady wind, m/s, in which a shorter fold is to hold."""
    return max(_AIMED_WIND, mission.wind.steady)


class Wanted(NamedTuple):
    """What the certificate asks for, metres: least needs of strands (s, m, m), of vehicles and
    strands (s, n, m), and of vehicles beside each other (s, n, n); and by how much ``less`` than
    the limit a strand may swing (s, m), where the knot keeps no more than it keeps."""

    strands: Floats
    bodies: Floats
    aside: Floats
    less: Floats

    @staticmethod
    def nothing(needs: Needs) -> "Wanted":
        """Return what asks for no more than ``needs``."""
        every = needs.strands, needs.bodies, needs.aside, needs.floor
        return Wanted(*(np.zeros_like(each) for each in every))


def require_solvable(vehicles: int, duration: float, control_points: int) -> None:
    """Raise :class:`swarm.errors.Refused` where a problem has more unknowns than can be solved."""
    unknowns = 3 * vehicles * control_points
    if unknowns > _MOST_UNKNOWNS:
        raise Refused(
            f"fold.method: expected certified for {vehicles} vehicles and a fold of "
            f"{duration:.0f} s, got optimised: {unknowns:,} unknowns, at most {_MOST_UNKNOWNS:,}"
        )


def _problem_of(plan: Plan) -> tuple[Problem, Fold]:
    mission, fold = plan.mission, fold_of(plan)
    end = float(fold.times[-1])
    first, last = fold.at(np.array([0.0, end]))[0]
    aloft = begins_aloft(plan)
    along = np.linalg.norm(first - first[0], axis=1)
    east, north, _ = first[-1] - first[0]
    pose = np.array([*(0.5 * (first[0] + first[-1])), np.arctan2(north, east)])
    swing = swing_limit(plan)
    limits = Limits(
        _WITHIN * mission.vehicles.max_speed, _WITHIN * usable_acceleration(mission),
        _WITHIN * swing, max(mission.vehicles.tracking, LEAST_SINKING),
    )  # fmt: skip
    problem = Problem(
        _team(plan, mission.vehicles.tracking, _ROOM, swing),
        _team(plan, 0.0, 0.0, 0.0),
        limits,
        last,
        along - 0.5 * along[-1],
        np.empty((0, 4))
        if aloft
        else _before(mission, plan.layout.lengths, along - 0.5 * along[-1]),
        max(_CONTROL_POINTS, round(_POINTS_PER_SECOND * end)),
        cable_model(mission.cable.mass_per_length, mission.cable.diameter).normal_drag,
        float(jet_width(mission, np.zeros(1))[0]),
        given=first if aloft else None,
    )
    places = fold.at(np.linspace(0.0, end, 8 * problem.count))[0]
    return problem, problem.fitted(places, pose, end)


def _before(mission: Mission, lengths: Floats, along: Floats) -> Floats:
    """Return the places (r, 4) of vehicles on their way to the line: see :class:`.Problem`.

    On pads and above them, above the cable on the floor, and in the lift.
    """
    laid = along if mission.lay == "slack" else laid_along(lengths)
    aside = PADS_ASIDE * mission.clearance.vehicle
    start = [
        (each, apart, 0.0, height)
        for each in laid
        for apart, height in ((aside, 0.0), (aside, TAKEOFF_HEIGHT), (0.0, TAKEOFF_HEIGHT))
    ]
    lifted = [(each, 0.0, share, 0.0) for each in along for share in np.linspace(0.0, 1.0, _LIFTED)]
    return np.array([*start, *lifted])


def _team(plan: Plan, tracking: float, room: float, swing: float) -> Team:
    mission = plan.mission
    clearance, radius = mission.clearance, 0.5 * mission.cable.diameter
    return Team(
        lengths=np.ascontiguousarray(plan.layout.lengths),
        walls=_walls(mission, tracking + room, radius + swing + room),
        exempt=exempt_length(plan),
        tracking=tracking,
        offset=mission.vehicles.grip_offset,
        chord=MAX_CHORD_RATIO,
        taut=2.0 * tracking + room,
        cable=clearance.cable + 2.0 * (radius + swing) + room,
        body=clearance.vehicle_cable + mission.vehicles.radius + radius + swing + room,
        floor=clearance.floor + radius + swing + room,
        aside=clearance.vehicle + 2.0 * tracking + room,
        above=clearance.downwash + 2.0 * tracking + room,
        tilt=wind_tilt(plan, aimed_wind(mission)) if tracking else 0.0,
    )


def _walls(mission: Mission, apart: float, beside: float) -> Walls:
    """Return ceiling, fence and obstacles, with ``apart`` and ``beside`` metres more than required
    from grip points and from the middles of strands.

    A side of a fence that has all of it on one side is a half-space; any other is an upright plate.
    """
    vehicles, workspace = mission.vehicles, mission.workspace
    fence = np.reshape(workspace.fence or (), (-1, 2))
    fence = fence[(np.roll(fence, -1, axis=0) != fence).any(axis=1)]  # no corner twice
    sides = np.roll(fence, -1, axis=0) - fence
    area = 0.5 * float((fence[:, 0] * sides[:, 1] - fence[:, 1] * sides[:, 0]).sum())
    bounds = []
    for (x, y), (east, north) in zip(fence, math.copysign(1.0, area) * sides, strict=True):
        length = math.hypot(east, north)
        if ((fence[:, 1] - y) * east - (fence[:, 0] - x) * north >= -1e-9 * length).all():
            bounds.append(half_space((x, y, 0.0), (-north, east, 0.0)))
        else:
            half = math.copysign(0.5, area)
            middle, turn = (x + half * east, y + half * north), math.atan2(north, east)
            bounds.append(upright_box(middle, (length, 0.0), turn, -math.inf, math.inf))
    above = half_space((0.0, 0.0, workspace.ceiling - vehicles.grip_offset), (0.0, 0.0, -1.0))
    obstacles, count = obstacles_of(mission), len(bounds)
    upright = grown(obstacles, vehicles.radius, vehicles.grip_offset)
    required = np.full(len(obstacles), mission.clearance.obstacle)
    return Walls(
        np.concatenate([rows([above, *bounds]), upright]),
        np.concatenate([rows(bounds), obstacles]),
        apart + np.concatenate([[0.0], np.full(count, vehicles.radius), required]),
        beside + np.concatenate([np.zeros(count), required]),
    )


def _needs(team: Team, room: Floats) -> Needs:
    """Return the needs (s rows) without movements of hanging cable, and ``room`` (s,) more."""
    n = len(team.lengths) + 1
    more = room[:, None, None]
    return Needs(
        team.cable + more + np.zeros((n - 1, n - 1)), team.body + more + np.zeros((n, n - 1)),
        team.floor + room[:, None] + np.zeros(n - 1), team.walls.inside + room[:, None],
        room[:, None] + np.zeros(n - 1), team.aside + more + np.zeros((n, n)),
        team.above + more + np.zeros((n, n)), team.taut + room,
    )  # fmt: skip


def _kept(problem: Problem) -> Floats:
    """Return :attr:`Shortening.kept`."""
    places = np.broadcast_to(problem.folded, (1, *problem.folded.shape)).copy()
    record = problem.shown_by(places, _needs(problem.team, np.ones(1)))
    distance, need = record.distances[0], record.strands[0]
    return np.where(need > 0.0, np.maximum(distance - _KEPT_AT_REST, _LEAST_AT_REST), np.inf)


def _most(short: Shortening, places: Floats) -> Floats:
    """Return the largest needs of strands (s, m, m) that places (s, n, 3) can keep.

    Near the end of a fold, they are those of the knot.
    """
    moved = np.linalg.norm(places - places[-1], axis=2).max(axis=1)
    most: Floats = short.kept + np.maximum(moved - _NEAR_KNOT, 0.0)[:, None, None]
    return most


def _measured_first(short: Shortening, fold: Fold) -> Frozen:
    problem, (s, m) = short.problem, (short.problem.moments, short.plan.vehicles - 1)
    squares, damping = modes(np.ones((s, m)))
    needs = _needs(problem.team, np.zeros(s))
    frozen = Frozen(needs, squares, damping, np.ones((s, m)), np.ones((s, m)), None)
    shown = problem.evaluate(fold, frozen)
    frozen = _with_needs(short, fold, frozen, shown, Wanted.nothing(needs), 1.0)
    for _ in range(2):
        shown = problem.evaluate(fold, frozen)
        frozen = replace(frozen, gains=_gains(short, fold, frozen, shown, 1.0)[0])
    return frozen


def _centred(
    short: Shortening, fold: Fold, frozen: Frozen, asked: tuple[Wanted, Floats], effort: Effort,
    done: Callable[[float], None] = lambda _share: None,
) -> tuple[Fold, Frozen] | None:  # fmt: skip
    """Return the motion at the end of a round of steps, and what is measured at it.

    None where that motion misses far more than the room beyond its needs.
    ``asked`` are what the certificate asks for, and the room (l,) after lost setpoints; ``done`` is
    called with the share of the way to the last weight.
    """
    problem, (wanted, room) = short.problem, asked
    weight = effort.first
    allowed = np.maximum(1.0 - wanted.less / problem.limits.swing, _LEAST_ALLOWED)
    frozen = replace(frozen, allowed=allowed, coasting=_coasting(short, fold, room))
    damping = 1.0
    for _ in range(effort.steps):
        frozen = replace(frozen, soft=min(_SOFTEST, _SOFTENED / weight))
        step = _newton_step(problem, fold, frozen, weight, damping)
        fold, shown, damping = step.fold, step.shown, step.damping
        (gains, stray), coasting = both(
            partial(_gains, short, fold, frozen, shown, _TOWARDS),
            partial(_coasting, short, fold, room),
        )
        frozen = _with_needs(short, fold, frozen, shown, wanted, _TOWARDS)
        frozen = replace(frozen, gains=gains, coasting=coasting)
        exceeded = _exceeded(problem.limits, shown, stray)
        last = weight == effort.last or exceeded >= _NEARLY_KEPT
        within = effort.converged if exceeded < _KEPT else _STILL
        if last and step.share > 0.0 and step.decrement < within:
            return (fold, frozen) if exceeded < _NEARLY_KEPT else None
        near = step.decrement < _NEAR_CENTRE
        enough = step.share > (_BRIEF if near else _WHOLE) and step.decrement < _FAR_FROM_CENTRE
        if enough and exceeded < _NEARLY_KEPT:
            weight = min(weight * (_GROWTH + _FASTER * step.share), effort.last)
        done(math.log(weight / effort.first) / math.log(effort.last / effort.first))
    return (fold, frozen) if shown.missed < _NEARLY_KEPT * _ROOM else None


def _exceeded(limits: Limits, shown: Evaluation, stray: float) -> float:
    """Return the largest share of the room beyond a limit or a need that a motion uses.

    The swing is that of lumped masses, a ``stray`` in metres. 0 where all are kept, 1 where no room
    is left for what the certificate finds between the moments.
    """
    used = (
        shown.speed / limits.speed, shown.acceleration / limits.acceleration,
        stray / limits.swing, shown.sinking / limits.sinking,
    )  # fmt: skip
    missed = max(shown.missed / _ROOM, shown.missed_after_losses / _ROOM_AFTER_LOSS)
    return max((max(used) - 1.0) / (1.0 / _WITHIN - 1.0), missed, 0.0)


def _with_needs(
    short: Shortening, fold: Fold, frozen: Frozen, shown: Evaluation, wanted: Wanted, share: float
) -> Frozen:
    """Return needs and modes as a motion shows them, by a ``share`` of their changes."""
    record, needs, team = shown.needs, frozen.needs, short.problem.team
    aside = np.maximum(team.aside, wanted.aside)

    def towards(old: Floats, new: Floats) -> Floats:
        return np.where(new > 0.0, old + share * (new - old), old)

    most = _most(short, short.problem.states(fold, short.problem.shares)[0])
    strands = np.minimum(np.maximum(record.strands, wanted.strands), most)
    bodies = np.where(record.bodies > 0.0, np.maximum(record.bodies, wanted.bodies), 0.0)
    needs = needs._replace(
        strands=towards(needs.strands, np.where(record.strands > 0.0, strands, 0.0)),
        bodies=towards(needs.bodies, bodies),
        floor=towards(needs.floor, record.floor),
        beside=towards(needs.beside, record.beside),
        aside=aside,
        above=team.above + aside - team.aside,
    )
    squares, damping = modes(record.sags)
    return replace(frozen, needs=needs, squares=squares, damping=damping)


def _gains(
    short: Shortening, fold: Fold, frozen: Frozen, shown: Evaluation, share: float
) -> tuple[Floats, float]:
    """Return the oscillators' corrections by lumped masses, by a ``share``, and the largest stray.

    What an oscillator swings in a period is compared with what its strand strays in it.
    """
    times, stray = largest_stray(short.motion(fold), short.strands)
    stray = np.minimum(stray, 1.0)
    count, moments = len(shown.swings), short.problem.moments
    step = fold.duration / (moments - 1)
    wide, gains = max(1, round(_PERIOD / step)), frozen.gains.copy()
    least = _LEAST_SWING * short.problem.limits.swing
    for i, old in enumerate(frozen.gains.T):
        alone = scipy.ndimage.maximum_filter1d(shown.swings[:, i] / held_on(old, count), wide)
        seen = np.interp(step * np.arange(count), times, stray[:, i])
        ratio = scipy.ndimage.maximum_filter1d(seen, wide) / np.maximum(alone, least)
        ratio = scipy.ndimage.maximum_filter1d(np.clip(ratio, _LEAST_GAIN, _LARGEST_GAIN), wide)
        smooth = scipy.ndimage.gaussian_filter1d(ratio, 0.3 * wide)[:moments]
        gains[:, i] = old * (smooth / old) ** share
    return gains, float(stray.max())


def _coasting(short: Shortening, fold: Fold, room: Floats) -> Coasting:
    """Return how far vehicles move on without setpoints, as the certificate has it."""
    end = fold.duration
    phases = (Phase("fold", 0.0, end, "aloft", reversible=True),)
    alone = replace(short.plan, motion=short.motion(fold), phases=phases, gates=())
    overrun = StreamLossModel().overrun(alone, (0.0, end))
    stopped = overrun.stopped(np.arange(short.plan.vehicles), 1.0).max()
    advance = overrun.advance(short.loss_shares * end, np.array(1.0))
    return Coasting(
        overrun.coast_time, np.maximum(advance, stopped), overrun.silence,
        _needs(short.problem.after, room),
    )  # fmt: skip


def _wanted(short: Shortening, plan: Plan, needs: Needs, before: Wanted) -> Wanted:
    """Return what the certificate asks for, beyond ``needs`` that are too small and ``before``."""
    at = short.times(plan)
    _, bodies, aside, _ = Wanted.nothing(needs)
    strands = _needed_for_budget(plan, at)
    segments = {segment_name(k): k for k in range(plan.vehicles - 1)}
    vehicles = {vehicle_name(k): k for k in range(plan.vehicles)}
    failing = violations(plan, radii=_RADII)
    for moment in (*failing, *violations_in_wind(plan, aimed_wind(plan.mission))):
        first, second = moment.between
        around = np.abs(at - min(moment.time, at[-1])) <= _AROUND
        for least, need, of_first, of_second in (
            (strands, needs.strands, segments, segments),
            (bodies, needs.bodies, vehicles, segments),
            (aside, needs.aside, vehicles, vehicles),
        ):
            if first in of_first and second in of_second:
                here = around, of_first[first], of_second[second]
                least[here] = np.maximum(least[here], need[here] - moment.margin + _ROOM)
    most = _most(short, plan.motion.at(at)[0])
    missed = np.maximum(strands - most, 0.0)
    less = 0.5 * np.maximum(missed.max(axis=1), missed.max(axis=2))
    less = np.minimum(less, _MOST_LESS * short.problem.limits.swing)
    # what swings at a moment has begun to in the period before
    wide = 2 * round(_PERIOD / (at[1] - at[0])) + 1
    less = scipy.ndimage.maximum_filter1d(less, wide, axis=0, origin=-(wide // 2), mode="constant")
    asked = Wanted(np.minimum(strands, most), bodies, aside, before.less + less)
    return Wanted(*map(np.maximum, before, asked))


def _needed_for_budget(plan: Plan, at: Floats) -> Floats:
    """Return the distances (s, m, m) between the middles of strands at which budgets close."""
    m, tube = plan.vehicles - 1, PlanChecks.of(plan).tube
    distances = np.zeros((len(at), m, m))
    if tube is None or plan.mission.limits.accept_negative_budget:
        return distances
    pairs, times = tube.pairs.close.pairs, tube.pairs.close.times
    needed = needed_distances(plan, tube.pairs) + plan.mission.cable.diameter + _ROOM
    for i, j in dict.fromkeys(map(tuple, pairs.tolist())):
        rows = np.flatnonzero((pairs == (i, j)).all(axis=1))
        near = np.abs(at[:, None] - times[rows]) <= _AROUND
        distances[:, i, j] = np.where(near, needed[rows], 0.0).max(axis=1)
    return distances


def _missed_after_losses(short: Shortening, plan: Plan) -> npt.NDArray[np.bool_]:
    """Return where (l,) the certificate does not show that clearances hold at full rate."""
    limits, fold = PlanChecks.of(plan).limits_ahead, plan.phase("fold")
    slow = np.minimum(limits.asked[:-1], limits.asked[1:]) < 1.0
    before, after = limits.times[:-1][slow], limits.times[1:][slow]
    lost = fold.start + fold.duration * short.loss_shares
    # setpoints that are lost between two moments count for both
    since, until = np.append(lost[0], lost[:-1]), np.append(lost[1:], lost[-1])
    overlapping = (before < until[:, None]) & (after > since[:, None])
    missed: npt.NDArray[np.bool_] = np.any(overlapping, axis=1)
    return missed


@dataclass(frozen=True, eq=False)
class Step:
    """A motion after a step and what it shows, the damping of the next one, the ``share`` of the
    step that was taken (0 where none succeeded), and its ``decrement``: twice what a whole step was
    to save."""

    fold: Fold
    shown: Evaluation
    damping: float
    share: float
    decrement: float


def _newton_step(
    problem: Problem, fold: Fold, frozen: Frozen, weight: float, damping: float
) -> Step:
    """Return the motion after a damped Newton step, as long as it lowers the cost."""
    shown, slopes = problem.derived(fold, frozen)
    quadratic = _by_unknowns(problem, fold, slopes, weight)
    gradient = quadratic.gradient
    before = shown.cost + weight * np.log(fold.duration)
    for _ in range(_DAMPINGS):
        try:
            step = quadratic.step(damping)
        except np.linalg.LinAlgError:
            damping *= 10.0
            continue
        decrement = -float(gradient @ step)
        moves = np.delete(step, (0, 4))
        share = 1.0 / max(
            1.0, float(np.abs(moves).max()) / _LARGEST_MOVE, abs(step[4]) / _LARGEST_TURN,
            abs(step[0]) / _LARGEST_CHANGE,
        )  # fmt: skip
        best: tuple[float, Fold, Evaluation, float] | None = None
        for _ in range(_HALVINGS):
            there = _moved(fold, step, share)
            seen = problem.evaluate(there, frozen)
            cost = seen.cost + weight * float(np.log(there.duration))
            if best is not None and cost >= best[0]:
                break
            if cost < before:
                best = cost, there, seen, share
            if cost < before - 0.25 * share * decrement:
                break
            share *= 0.5
        if best is not None:
            _, there, seen, share = best
            if share == 1.0:
                damping = max(0.3 * damping, 1e-3)
            elif share < 0.3:
                damping = min(3.0 * damping, 1e4)
            return Step(there, seen, damping, share, decrement)
        damping = min(8.0 * damping, 1e3)
    return Step(fold, shown, damping, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Quadratic:
    """Gradient and matrix of the cost by the duration's logarithm, the pose, and control points.

    ``gradient`` (5 + u,); of the matrix, the ``corner`` (5, 5) of the first unknowns, the
    ``border`` (u, 5) of these with control points, and what ``slopes`` have of the latter.
    """

    gradient: Floats
    corner: Floats
    border: Floats
    slopes: Slopes
    inner: slice

    def step(self, damping: float) -> Floats:
        """Return the damped Newton step (5 + u,), by conjugate gradients.

        Preconditioned by the matrix with memory only in a band, which is solved exactly.

        Raises :class:`numpy.linalg.LinAlgError` where rounding leaves a factor undefined.
        """
        band = self.slopes.band[self.inner].copy()
        if self.slopes.near is not self.slopes.band:
            band += self.slopes.near[self.inner]
        band[:, 0] += damping
        factor = scipy.linalg.cholesky_banded(
            band.T, overwrite_ab=True, lower=True, check_finite=False
        )

        def solved(sides: Floats) -> Floats:
            x: Floats = scipy.linalg.cho_solve_banded((factor, True), sides, check_finite=False)
            return x

        by_border = solved(self.border)
        # What remains of the first five unknowns when the others are solved for; with memory only
        # in a band it may have negative eigenvalues, whose sizes serve as well.
        corner = self.corner + damping * np.diag(_STIFF)
        values, axes = np.linalg.eigh(corner - self.border.T @ by_border)
        rest = (axes / np.maximum(np.abs(values), damping * _STIFF[0])) @ axes.T

        def preconditioned(vector: Floats) -> Floats:
            inner = solved(vector[5:])
            first = rest @ (vector[:5] - self.border.T @ inner)
            return np.concatenate([first, inner - by_border @ first])

        def times(vector: Floats) -> Floats:
            first, inner = vector[:5], vector[5:]
            moved = self._times(inner) + damping * inner + self.border @ first
            return np.concatenate([corner @ first + self.border.T @ inner, moved])

        size = (len(self.gradient),) * 2
        step, _ = scipy.sparse.linalg.cg(
            scipy.sparse.linalg.LinearOperator(size, times), -self.gradient, rtol=_SOLVED,
            maxiter=_ITERATIONS, M=scipy.sparse.linalg.LinearOperator(size, preconditioned),
        )  # fmt: skip
        x: Floats = step
        return x

    def _times(self, inner: Floats) -> Floats:
        """Return the matrix of the control points (u, u) times a vector (u,)."""
        whole = np.zeros(self.slopes.gradient.shape)
        whole.reshape(-1)[self.inner] = inner
        return matrix_times(self.slopes, whole[None]).reshape(-1)[self.inner]


def matrix_times(slopes: Slopes, vectors: Floats) -> Floats:
    """Return the Gauss-Newton matrix of all control points times vectors (v, k, 3n)."""
    products = np.empty(vectors.shape)
    count = len(vectors)
    band_times(slopes.band, vectors.reshape(count, -1), products.reshape(count, -1))
    for part in slopes.remembered:
        for vector, product in zip(vectors, products, strict=True):
            part.times(vector, product)
    return products


def _by_unknowns(problem: Problem, fold: Fold, slopes: Slopes, weight: float) -> Quadratic:
    """Return gradient and matrix by the duration's logarithm, the pose, and control points."""
    edge = RESTING * 3 * len(problem.folded)
    inner = slice(edge, slopes.gradient.size - edge)
    by_pose = problem.by_pose(fold.pose)
    flat, mixed = slopes.gradient.reshape(-1), slopes.mixed.reshape(-1)
    by_line = by_pose.T @ flat + slopes.pose
    gradient = np.concatenate([[slopes.by_duration + weight], by_line, flat[inner]])
    vectors = np.ascontiguousarray(by_pose.T).reshape(-1, *slopes.gradient.shape)
    moved = matrix_times(slopes, vectors).reshape(len(vectors), -1).T
    corner = np.empty((5, 5))
    corner[0, 0] = max(slopes.twice, 1e-3)
    corner[0, 1:] = corner[1:, 0] = by_pose.T @ mixed
    corner[1:, 1:] = by_pose.T @ moved + slopes.by_pose
    border = np.column_stack([mixed[inner], moved[inner]])
    return Quadratic(gradient, corner, border, slopes, inner)


def _moved(fold: Fold, step: Floats, share: float) -> Fold:
    return Fold(
        fold.free + share * step[5:].reshape(fold.free.shape),
        fold.pose + share * step[1:5],
        fold.duration * float(np.exp(share * step[0])),
    )
