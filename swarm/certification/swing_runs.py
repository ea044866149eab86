"""Simulated swings of a plan's cable: in the planned motion, and after changes of the clock's rate.

The lumped masses are simulated along the planned motion. From moments of it they are simulated
again with an ordinary and an urgent stop of the mission clock, an urgent change to full rate
backwards (a rewind), and, from rest, a start (a resume). Vehicles are exactly on their
trajectories, the air is still, and the cable is at rest when it comes aloft.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy

from swarm.certification.cable_spans import cable_spans
from swarm.geometry.catenary import STANDARD_GRAVITY, Catenaries, solve_catenaries
from swarm.geometry.lumped_mass import SwingModel, at_rest, cable_model, swing_on, swing_on_each
from swarm.planning import Plan
from swarm.planning.clock_limits import COURSE_STEP, clock_limits
from swarm.planning.shaping import COMPARED, steps_between_compared
from swarm.threads import side_by_side

Floats = npt.NDArray[np.float64]

STEP = COURSE_STEP
"""Seconds of a step of the simulation: strays of shaped default missions differ by less than 0.5 mm
from those with half of it."""

_LINKS = (48, 40, 32, 24, 16, 8)
"""Links of a strand, most first, in equal numbers for each of the tube's eighths."""

_FEWER, _COARSEST = 24, 0.1
"""Links that are enough where none is farther than the second, in metres, from the catenary that it
stands for. As the cable runs through a narrow bend, each link turns over with a jolt: a strand of
the Carrick mat, 12.5 m long with ends 2 to 4.5 m apart, strayed by 0.14 m with 24 links, 0.08 m
with 36, and 0.03 m with 48 or more, and its fold was slowed to 0.3 for that."""

_BETWEEN = 0.5
"""Seconds of mission time between the moments whose tensions determine the links: places move by a
part of a strand's span meanwhile."""

_TAUT = 0.999
"""Largest ratio of chord to length for which tensions are computed; plans are refused far below."""

_TOGETHER = 8
"""Courses that are simulated together, which bounds the memory."""


@dataclass(frozen=True)
class Course:
    """A change of the clock's rate, followed for ``duration`` seconds.

    It is simulated from beginnings ``apart`` seconds of mission time from each other, if not urgent
    at most _CERTIFIED_APART where the swing is certified; where the rate is 0, with the cable at
    rest. Courses of one name are stated together, and are urgent or not together.
    """

    name: str
    rate: float
    target: float
    urgent: bool
    duration: float
    apart: float


COURSES = (
    Course("urgent stop", 1.0, 0.0, True, 6.0, 0.5),
    Course("ordinary stop", 1.0, 0.0, False, 6.0, 2.0),
    Course("urgent rewind", 1.0, -1.0, True, 6.0, 0.3),
    Course("urgent rewind", 1.0, -1.0, True, 20.0, 1.0),
    Course("resume", 0.0, 1.0, False, 6.0, 2.0),
)
"""What the clock may do. Strays are largest within a period, about 2 s, after the clock has reached
its target: after 1.2 s in urgent stops, 4 s in ordinary ones. Ordinary stops and resumes swing half
as far as urgent stops: they need fewer beginnings. A rewind meets the same change of the planned
motion twice, twice as much later as it begins later: with beginnings every 0.5 s, 3 of 250 others
left the tube of the default overhand by up to 6 mm, with 0.3 s none. What it swings stays for
longer than the 6 s, and comes to where the planned motion hardly swings: of 100 such rewinds 3 left
the tube by up to 0.7 mm with beginnings every 4 s and every 2 s; with 1 s, 3.6 mm were left."""

_CERTIFIED_APART = 0.5
"""Seconds of mission time between the beginnings of ordinary changes, at most, where clearances are
certified for these alone: with 2 s, 1 of 150 ordinary stops of the default overhand left the tube
of ordinary changes by 1 mm, and 2 of 60 resumes by up to 9 mm; with 1 s, a resume by 0.03 mm."""

SETTLING = 2.0
"""Seconds at the end of a stop in which a strand reaches its amplitude to both sides: more than
half the period of a sag of 4 m."""


@dataclass(frozen=True, eq=False)
class Swung:
    """Strays (c, k, n − 1, links + 1, 3) from the catenaries at mission times (c, k), metres.

    In the planned motion (``course`` None), or in c courses of the clock.
    """

    times: Floats
    strays: Floats
    course: Course | None


def aloft(plan: Plan) -> tuple[float, float] | None:
    """Return the first and last time of the cable aloft, where the plan folds it.

    None too where a chord is longer than its cable then, which the checks of lengths report.
    """
    spans = cable_spans(plan)
    folds = any(phase.name == "fold" for phase in plan.phases)
    if not folds or spans.problems or not spans.aloft:
        return None
    span = spans.aloft[0][0], spans.aloft[-1][1]
    ends = plan.motion.at(_times(span, STEP))[0]
    taut = (np.linalg.norm(np.diff(ends, axis=1), axis=2) > plan.layout.lengths).any()
    return None if taut else span


def model_of(plan: Plan) -> SwingModel:
    """Return the model of a plan's cable, with as many links as the step permits.

    The stiffest mode of a chain of N links of l metres under tension T per mass per length moves
    its joints against each other, ω = 2√T/l, and Verlet's method is stable for ω·step < 2. Where
    few links would swing by their length alone, there are twice as many, with half the step; not
    where the mission accepts a negative budget, because few links swing too far, not too little.
    """
    cable, fold = plan.mission.cable, plan.phase("fold")
    places = plan.motion.at(np.arange(fold.start, fold.end, _BETWEEN))[0]
    strands = solve_catenaries(
        places[:, :-1], places[:, 1:], np.maximum(plan.layout.lengths, _chords(places) / _TAUT)
    )
    arc = np.abs(strands.slope * strands.parameter)
    farthest = np.maximum(arc, np.abs(strands.length - arc))
    waves = np.sqrt(STANDARD_GRAVITY * np.hypot(strands.parameter, farthest))
    coarse = _farthest_link(strands) > _COARSEST
    finer = coarse and not plan.mission.limits.accept_negative_budget
    step, wanted = (0.5 * STEP, _LINKS[0]) if finer else (STEP, _FEWER)
    most = float((plan.layout.lengths / (waves * step)).min())
    links = next((links for links in _LINKS if links <= wanted and links < most), _LINKS[-1])
    return replace(cable_model(cable.mass_per_length, cable.diameter), step=step, links=links)


def _farthest_link(strands: Catenaries) -> float:
    """Return how far one of few links is from its catenary where that turns over, metres."""
    lowest = -strands.slope * strands.parameter
    bent = (lowest > 0.0) & (lowest < strands.length)
    apart = (strands.length / _FEWER) ** 2 / (8.0 * strands.parameter)
    return float(np.where(bent, apart, 0.0).max())


def _chords(places: Floats) -> Floats:
    found: Floats = np.linalg.norm(np.diff(places, axis=1), axis=2)
    return found


def swings(plan: Plan, span: tuple[float, float]) -> Iterator[Swung]:
    """Yield all simulated swings of a plan between the times of :func:`aloft`."""
    planned = planned_swing(plan, span)
    yield planned.swung
    yield from swings_after(plan, span, planned)


@dataclass(frozen=True, eq=False)
class PlannedSwing:
    """The swing in the planned motion, and the ``states`` (k, …) of ``times``, COMPARED apart."""

    swung: Swung
    times: Floats
    states: Floats
    model: SwingModel


def planned_swing(plan: Plan, span: tuple[float, float]) -> PlannedSwing:
    """Return the swing in the planned motion between the times of :func:`aloft`."""
    lengths, model = plan.layout.lengths, model_of(plan)
    times, every = _times(span, model.step), steps_between_compared(model)
    ends = plan.motion.places(times)
    states = swing_on(at_rest(ends[0], lengths, model), ends, lengths, model, every)
    strays = _strays(states[:, 1], ends[::every], lengths)
    return PlannedSwing(Swung(times[None, ::every], strays[None], None), times, states, model)


def swings_after(plan: Plan, span: tuple[float, float], planned: PlannedSwing) -> Iterator[Swung]:
    """Yield the swings after all changes of the clock's rate, several courses together."""
    limits = clock_limits(plan.motion, plan.mission.vehicles.braking_acceleration)
    lengths, model = plan.layout.lengths, planned.model
    certified, every = plan.mission.fold.certifies_swing, steps_between_compared(model)

    def groups() -> Iterator[tuple[Course, Floats, Floats]]:
        for course in COURSES:
            apart = course.apart
            if certified and not course.urgent:
                apart = min(apart, _CERTIFIED_APART)
            steps = every * round(apart / COMPARED)
            chosen = np.arange(0, len(planned.times) - 1, steps)
            times = limits.course(
                planned.times[chosen], course.rate, course.target, course.duration,
                urgent=course.urgent,
            )  # fmt: skip
            times = np.clip(_with_step(times, model.step), span[0], span[1])
            for first in range(0, len(chosen), _TOGETHER):
                some = slice(first, first + _TOGETHER)
                yield course, times[some], planned.states[chosen[some] // every]

    def swung(group: tuple[Course, Floats, Floats]) -> Swung:
        course, times, begun = group
        moved = plan.motion.places(times)
        if course.rate == 0.0:
            begun = np.stack([at_rest(first, lengths, model) for first in moved[:, 0]])
        joints = swing_on_each(begun, moved, lengths, model, every)
        return Swung(times[:, ::every], _strays(joints, moved[:, ::every], lengths), course)

    return side_by_side(swung, groups())


def _with_step(times: Floats, step: float) -> Floats:
    """Return mission times (c, k) of courses, COURSE_STEP apart, ``step`` seconds apart."""
    if step == COURSE_STEP:
        return times
    given = COURSE_STEP * np.arange(times.shape[1])
    count = round(given[-1] / step)
    found: Floats = scipy.interpolate.CubicSpline(given, times, axis=1)(step * np.arange(count + 1))
    return found


def _times(span: tuple[float, float], step: float) -> Floats:
    found: Floats = np.minimum(np.arange(span[0], span[1] + step, step), span[1])
    return found


def _strays(joints: Floats, ends: Floats, lengths: Floats) -> Floats:
    """Return the strays (…, n − 1, links + 1, 3) of joints from their catenaries, metres."""
    fractions = np.linspace(0.0, 1.0, joints.shape[-2])
    still = solve_catenaries(ends[..., :-1, :], ends[..., 1:, :], lengths).points(fractions)
    found: Floats = np.subtract(joints, still, out=still)
    return found
