"""Simulated swings of a plan's cable: in the planned motion, and after changes of the clock's rate.

The lumped masses are simulated along the planned motion. From moments of it they are simulated
again with an ordinary and an urgent stop of the mission clock, an urgent change to full rate
backwards (a rewind), and, from rest, a start (a resume). Vehicles are exactly on their
trajectories, the air is still, and the cable is at rest when it comes aloft.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from swarm.certification.cable_spans import cable_spans
from swarm.certification.strand_pieces import BIN
from swarm.geometry.catenary import STANDARD_GRAVITY, Catenaries, solve_catenaries
from swarm.geometry.lumped_mass import Held, Strands, SwingModel, cable_model, subtract_catenaries
from swarm.planning import Plan
from swarm.planning.clock_limits import COURSE_STEP, ClockLimits, clock_limits
from swarm.planning.shaping import COMPARED, steps_between_compared
from swarm.signatures import contiguous
from swarm.threads import side_by_side

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]

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

    It is simulated from beginnings ``apart`` seconds of mission time from each other, the first
    after ``delay``. A clock that stops first resumes after ``stopped`` seconds. Courses of one name
    are stated together, and are urgent or not together.
    """

    name: str
    rate: float
    target: float
    urgent: bool
    duration: float
    apart: float
    delay: float = 0.0
    stopped: float = 0.0

    def begins(self, other: "Course") -> bool:
        """Whether it is the beginning of the other, from where both are simulated."""
        return other == replace(self, duration=other.duration, apart=other.apart) and (
            self.duration < other.duration
        )

    def times(self, limits: ClockLimits, starts: Floats) -> Floats:
        """Return mission times (c, k), COURSE_STEP apart, of courses that begin at times (c,)."""
        if not self.stopped:
            return limits.course(starts, self.rate, self.target, self.duration, urgent=self.urgent)
        stop = limits.course(starts, self.rate, 0.0, self.stopped, urgent=self.urgent)
        rest = self.duration - self.stopped
        resumed = limits.course(stop[:, -1], 0.0, self.target, rest, urgent=self.urgent)
        return np.concatenate([stop[:, :-1], resumed], axis=1)


_STOPPED, _FOLLOWED = 9.0, 20.0
"""Seconds from the beginning of an ordinary stop to a clock that stands, and seconds for which a
resume is followed: what it swings stays, and comes to where the planned motion hardly swings."""


def _stops_and_resumes(name: str, rests: Sequence[float], apart: float) -> tuple[Course, ...]:
    """Return courses that begin ``apart`` seconds from each other, with each of the rests."""
    return tuple(
        Course(
            name, 1.0, 1.0, False, _STOPPED + rest + _FOLLOWED, apart * len(rests), apart * k,
            _STOPPED + rest,
        )
        for k, rest in enumerate(rests)
    )  # fmt: skip


ORDINARY_COURSES = _stops_and_resumes("stop and resume", (0.0, 0.7, 1.5, 2.4), 0.4)
"""An ordinary stop, and the resume in different phases of the swing that it has left; longer rests
leave less. Every 0.4 s of mission time with another rest: 180 others stay inside what is added for
those between, by 8 mm (docs/method.md)."""

CHECKS = _stops_and_resumes("other stop and resume", (0.3, 1.1, 1.9), 3.1)
"""Other beginnings and rests, which check each certified tube with twice the links."""

COURSES = (
    Course("urgent stop", 1.0, 0.0, True, 6.0, 0.5),
    *ORDINARY_COURSES,
    Course("urgent rewind", 1.0, -1.0, True, 6.0, 0.3),
    Course("urgent rewind", 1.0, -1.0, True, 20.0, 0.9),
)
"""What the clock may do. Strays are largest within a period, about 2 s, after the clock has reached
its target. A rewind meets the same change of the planned motion twice, twice as much later as it
begins later: with beginnings every 0.5 s, 3 of 250 others left the tube of the default overhand by
up to 6 mm, with 0.3 s none. What it swings stays for longer than the 6 s, and comes to where the
planned motion hardly swings: of 100 such rewinds 3 left the tube by up to 0.7 mm with beginnings
every 4 s and every 2 s; with 1 s, 3.6 mm were left. Every third of the short ones is the beginning
of a long one."""

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


@dataclass(frozen=True, eq=False)
class Wanted:
    """Strands (k, n − 1) whose swing is wanted in each interval of BIN seconds from ``start``."""

    start: float
    strands: Flags

    def at(self, times: Floats) -> Flags:
        """Return the strands (…, n − 1) that are wanted at mission times (…,)."""
        bins = ((times - self.start) / BIN).astype(np.intp)
        return np.asarray(self.strands[np.minimum(bins, len(self.strands) - 1)])


class _Group(NamedTuple):
    """Courses (c, …) that are simulated together, with the numbers of their first states and the
    strands (c, k, n − 1) that are wanted at compared moments."""

    course: Course
    times: Floats
    first: Ints
    wanted: Flags


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


def strands_of(plan: Plan) -> tuple[Strands, ...]:
    """Return the strands of a plan's cable with their models, the finest last.

    Strands of which few links would swing by their length alone have twice as many, with half the
    step; not where the mission accepts a negative budget, because few links swing too far, not too
    little.
    """
    fold, lengths = plan.phase("fold"), plan.layout.lengths
    places = plan.motion.at(np.arange(fold.start, fold.end, _BETWEEN))[0]
    hanging = solve_catenaries(
        places[:, :-1], places[:, 1:], np.maximum(lengths, _chords(places) / _TAUT)
    )
    accepted = plan.mission.limits.accept_negative_budget
    finer = (_farthest_link(hanging) > _COARSEST) & (not accepted)
    fine = _with_links(plan, hanging, np.flatnonzero(finer), _LINKS, 0.5 * STEP)
    most = fine.model.links if finer.any() else _LINKS[0]
    # few links have a joint at every second, or n-th, one of the many
    few = tuple(links for links in _LINKS if links <= _FEWER and most % links == 0)
    coarse = _with_links(plan, hanging, np.flatnonzero(~finer), few, STEP)
    return tuple(strands for strands in (coarse, fine) if len(strands.segments))


def _with_links(
    plan: Plan, hanging: Catenaries, segments: Ints, links: Sequence[int], step: float
) -> Strands:
    """Return segments as strands of as many of these numbers of links as the step permits.

    The stiffest mode of a chain of N links of l metres under tension T per mass per length moves
    its joints against each other, ω = 2√T/l, and Verlet's method is stable for ω·step < 2.
    """
    cable = plan.mission.cable
    lengths = plan.layout.lengths[segments]
    arc = np.abs(hanging.slope * hanging.parameter)
    farthest = np.maximum(arc, np.abs(hanging.length - arc))
    waves = np.sqrt(STANDARD_GRAVITY * np.hypot(hanging.parameter, farthest))[:, segments]
    most = float((lengths / (waves * step)).min(initial=np.inf))
    allowed = next((number for number in links if number < most), links[-1])
    model = cable_model(cable.mass_per_length, cable.diameter)
    return Strands(segments, lengths, replace(model, step=step, links=allowed))


def model_of(plan: Plan) -> SwingModel:
    """Return the finest of the models of a plan's strands."""
    return strands_of(plan)[-1].model


def _farthest_link(hanging: Catenaries) -> Floats:
    """Return how far one of few links is from its catenary where that turns over, (n − 1,)."""
    lowest = -hanging.slope * hanging.parameter
    bent = (lowest > 0.0) & (lowest < hanging.length)
    apart = (hanging.length / _FEWER) ** 2 / (8.0 * hanging.parameter)
    distances: Floats = np.where(bent, apart, 0.0).max(axis=0)
    return distances


def _chords(places: Floats) -> Floats:
    lengths: Floats = np.linalg.norm(np.diff(places, axis=1), axis=2)
    return lengths


def swings(plan: Plan, span: tuple[float, float]) -> Iterator[Swung]:
    """Yield all simulated swings of a plan between the times of :func:`aloft`."""
    planned = planned_swing(plan, span)
    yield planned.swung
    yield from swings_after(plan, span, planned, COURSES)


@dataclass(frozen=True, eq=False)
class PlannedSwing:
    """The swing in the planned motion, at ``times`` (k,) a step of the finest strands apart.

    ``states`` (m, …) are those of each of ``strands``, COMPARED seconds apart.
    """

    swung: Swung
    times: Floats
    strands: tuple[Strands, ...]
    states: tuple[Floats, ...]


def planned_swing(plan: Plan, span: tuple[float, float], *, finer: bool = False) -> PlannedSwing:
    """Return the swing in the planned motion between the times of :func:`aloft`.

    With ``finer``, of strands with twice the links, and half the step.
    """
    strands = strands_of(plan)
    if finer:
        strands = tuple(some.refined() for some in strands)
    model = strands[-1].model
    times, compared = _times(span, model.step), steps_between_compared(model)
    ends = plan.motion.places(times)

    def states_of(some: Strands) -> Floats:
        moved = ends[:: round(some.model.step / model.step)]
        return some.swing_on(some.at_rest(ends[0]), moved, steps_between_compared(some.model))

    states = tuple(side_by_side(states_of, strands))
    joints = [each[:, 1] for each in states]
    moments = ends[::compared]
    every = np.ones((len(moments), len(plan.layout.lengths)), np.bool_)
    strays = _strays(strands, joints, moments, model.links, every)
    return PlannedSwing(Swung(times[None, ::compared], strays[None], None), times, strands, states)


def swings_after(
    plan: Plan,
    span: tuple[float, float],
    planned: PlannedSwing,
    changes: Sequence[Course],
    wanted: Wanted | None = None,
) -> Iterator[Swung]:
    """Yield the swings after changes of the clock's rate, several courses together.

    Strands are followed as long as they are ``wanted`` at the times of these courses; their strays
    at other times are 0.
    """
    limits = clock_limits(plan.motion, plan.mission.vehicles.braking_acceleration)
    strands, model = planned.strands, planned.strands[-1].model
    compared = steps_between_compared(model)
    segments = len(plan.layout.lengths)

    def beginnings(course: Course) -> Ints:
        first, apart = (
            compared * round(seconds / COMPARED) for seconds in (course.delay, course.apart)
        )
        return np.arange(first, len(planned.times) - 1, apart)

    def groups() -> Iterator[_Group]:
        for course in changes:
            chosen = beginnings(course)
            for other in changes:
                if course.begins(other):
                    chosen = np.setdiff1d(chosen, beginnings(other))
            times = course.times(limits, planned.times[chosen])
            times = np.clip(_with_step(times, model.step), span[0], span[1])
            for first in range(0, len(chosen), _TOGETHER):
                some = slice(first, first + _TOGETHER)
                compared_times = times[some, ::compared]
                here = (
                    np.ones((*compared_times.shape, segments), np.bool_)
                    if wanted is None
                    else wanted.at(compared_times)
                )
                if here.any():
                    yield _Group(course, times[some], chosen[some] // compared, here)

    def swung(group: _Group) -> Swung:
        course, times = group.course, group.times
        ends = plan.motion.places(times)
        simulated, joints = [], []
        samples = _last(group.wanted)
        for every, states in zip(strands, planned.states, strict=True):
            here = np.flatnonzero(samples[:, every.segments].any(axis=0))
            if not len(here):
                continue
            some, begun = every.taken(here), states[group.first][:, :, here]
            moved = ends[:, :: round(some.model.step / model.step)]
            steps = steps_between_compared(some.model)
            joints.append(some.swing_on_each(begun, moved, steps, samples[:, some.segments]))
            simulated.append(some)
        strays = _strays(simulated, joints, ends[:, ::compared], model.links, group.wanted)
        return Swung(times[:, ::compared], strays, course)

    return side_by_side(swung, groups())


def _last(wanted: Flags) -> Ints:
    """Return the numbers (c, s) of moments up to the last of k that are wanted, (c, k, s)."""
    count = wanted.shape[1]
    numbers: Ints = np.where(wanted.any(axis=1), count - wanted[:, ::-1].argmax(axis=1), 0)
    return numbers


def _with_step(times: Floats, step: float) -> Floats:
    """Return mission times (c, k) of courses, COURSE_STEP apart, ``step`` seconds apart."""
    if step == COURSE_STEP:
        return times
    given = COURSE_STEP * np.arange(times.shape[1])
    count = round(given[-1] / step)
    clock: Floats = scipy.interpolate.CubicSpline(given, times, axis=1)(step * np.arange(count + 1))
    return clock


def _times(span: tuple[float, float], step: float) -> Floats:
    """Return times ``step`` apart, the last of which, the end of the span, is compared too."""
    count = round(COMPARED / step) * int(np.ceil((span[1] - span[0]) / COMPARED))
    times: Floats = np.minimum(span[0] + step * np.arange(count + 1), span[1])
    return times


def _strays(
    strands: Sequence[Strands], joints: Sequence[Floats], ends: Floats, links: int, wanted: Flags
) -> Floats:
    """Return the strays (…, n − 1, links + 1, 3) of joints from their catenaries, metres.

    ``joints`` (…, s, …, 3) are those of each of ``strands``; the strays of fewer links are
    interpolated where there is no joint. Those that are not ``wanted`` (…, n − 1) are 0.
    """
    count = ends.shape[-2] - 1
    strays = (np.empty if wanted.all() else np.zeros)((*ends.shape[:-2], count, links + 1, 3))
    for some, swung in zip(strands, joints, strict=True):
        held = Held(some.segments, contiguous(some.lengths), some.segments)
        places = contiguous(ends.reshape(-1, *ends.shape[-2:]))
        which = np.flatnonzero(wanted[..., some.segments])
        subtract_catenaries(places, held, _moments(swung), which, _moments(strays))
    return strays


def _moments(points: Floats) -> Floats:
    """Return points (…, s, joints, 3) with one axis of moments, as the kernel requires."""
    return contiguous(points.reshape(-1, *points.shape[-3:]))
