"""The certificate of stream losses: margins after the setpoints end, and the clock's rate for them.

A vehicle without setpoints continues with its last velocity until its autopilot's timeout (PX4:
COM_OF_LOSS_T, then Hold or Land; ArduPilot: GUID_TIMEOUT) and brakes; ArduPilot then returns to
where it was at the timeout, which is its last target (``posvelaccel_control_run``). Either the
whole team loses its setpoints, or one vehicle does: then the others continue until it has been
silent for the fleet's ``limits.silence``, and stop along their paths. Where a clearance or a chord
would fail, the mission clock's rate is limited: all these distances shrink with it. Rates are
chosen by samples every STEP seconds of the fold, at the ends of these motions and halfway, and then
certified for all times between (:class:`StreamLossBound`), or lowered until they are: for every
steady rate up to the limit. A clock that runs backwards has limits of its own, those of the
reversed motion. All clearances of :mod:`.team_margins` count, of vehicles that were exactly on the
plan, and of cable that hangs still.

In the bound, a box belongs to a case (0: the whole team loses its setpoints, else that vehicle) and
an interval of mission time. Its coordinates are the time of the loss, the coasting of the vehicles
without setpoints (in seconds at their velocity then), the advance of the others along the plan (in
mission seconds), and how far one that lands alone has descended. Margins are computed in the middle
of a box; bounds of velocities, accelerations and of the sensitivity of strands extend them to the
whole box.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import Boxes, Enclosure, search
from swarm.certification.findings import Finding
from swarm.certification.motion_bounds import BoundedMotion, largest_between, pieces_between
from swarm.certification.team_margins import (
    PLACES,
    Query,
    Required,
    Strands,
    Team,
    allocate_strands,
    allocate_team,
    cable_margins,
    required_of,
    smallest,
    vehicle_margins,
)
from swarm.geometry.distance import point_distance
from swarm.geometry.motion import evaluate_piece, find_piece, reverse
from swarm.jit import compiled, inner
from swarm.planning import Plan, digest
from swarm.planning.clock_limits import BANDWIDTH, SMOOTH, ClockLimits, clock_limits
from swarm.signatures import Floats1, Floats2, Floats3, Floats4, Ints1
from swarm.threads import both, side_by_side, usual_threads

Floats = npt.NDArray[np.float64]


class LossMotion(NamedTuple):
    """The planned motion of n vehicles, and how it continues without setpoints.

    ``times``, ``joints``, ``coefficients``, ``accelerations`` and ``jerks`` are those of a
    :class:`.motion_bounds.BoundedMotion`. If all coast, each is up to ``lag`` (n,) seconds of
    coasting behind the first. Within ``tracking`` metres of the planned positions at one time,
    everything is certified. ``end`` is the last mission time that is reached.
    """

    times: Floats1
    joints: Floats1
    coefficients: Floats4
    accelerations: Floats3
    jerks: Floats3
    lag: Floats1
    tracking: float
    end: float


class Box(NamedTuple):
    """A box: middles and half widths of the time of the loss, coasting, advance and descent.

    ``rate`` is the mission clock's rate; coasting is in seconds at the velocity at the loss, the
    advance in seconds of mission time, the descent of the vehicle without setpoints in metres.
    """

    case: int
    rate: float
    time: float
    half: float
    coast: float
    coast_half: float
    advance: float
    advance_half: float
    descent: float
    descent_half: float


@inner
def write_state(box: Box, motion: LossMotion, team: Team, uncertainty: Floats) -> bool:
    """Write the team's state, and whether a vehicle may be outside the tracking radius.

    ``uncertainty`` (4,) becomes the uncertainty that the widths of its coordinates cause.
    """
    position, slopes, spread = team.position, team.slopes, team.spread
    together = 1 if box.case == 0 else 2  # the coordinate in which the planned positions advance
    after, after_half = (
        (box.coast, box.coast_half) if box.case == 0 else (box.advance, box.advance_half)
    )
    moment, width = box.time + after, box.half + after_half
    later, until = min(moment, motion.end), min(moment + width, motion.end)
    piece, since, moving = find_piece(motion.times, later)
    pieces = pieces_between(motion.joints, later - width, until)
    largest = widest = 0.0
    for i in range(len(spread)):
        evaluate_piece(motion.coefficients[piece], i, since, moving, team.scratch)
        for axis in range(3):
            position[i, axis] = team.scratch[0, axis]
            slopes[0, i, axis] = slopes[together, i, axis] = team.scratch[1, axis]
            slopes[3 - together, i, axis] = 0.0
        acceleration = largest_between(motion.accelerations, pieces, i)
        # Planned positions, of all vehicles at the same time.
        spread[i] = 0.5 * acceleration * width * width
        if moment + width > motion.end:
            spread[i] += 2.0 * _norm(slopes[0, i]) * width
            widest = max(widest, spread[i])
        if box.case in (0, i + 1):
            largest = max(largest, _coast(box, i, motion, team))
    if largest <= motion.tracking:
        uncertainty[:] = 0.0
        return False
    uncertainty[3] = box.descent_half
    halves = box.half, box.coast_half, box.advance_half
    for coordinate in range(3):
        uncertainty[coordinate] = _apart(slopes[coordinate], team.scratch[0]) * halves[coordinate]
    # Beyond the end of the motion its slopes there, 0, do not tell how wide the box is.
    uncertainty[0] += widest * box.half / width
    uncertainty[together] += widest * after_half / width
    return True


@inner
def _apart(slopes: Floats, mean: Floats) -> float:
    """Return how far slopes (n, 3) differ from their mean at most, and a tenth of that.

    Distances of vehicles change with their differences, those from floor and fence with all of it.
    ``mean`` (3,) is working memory.
    """
    for axis in range(3):
        mean[axis] = 0.0
        for i in range(len(slopes)):
            mean[axis] += slopes[i, axis] / len(slopes)
    largest = 0.0
    for i in range(len(slopes)):
        square = 0.0
        for axis in range(3):
            square += (slopes[i, axis] - mean[axis]) ** 2
        largest = max(largest, square)
    return float(np.sqrt(largest) + 0.1 * _norm(mean) + 1e-3)


@inner
def _coast(box: Box, i: int, motion: LossMotion, team: Team) -> float:
    """Move vehicle i from its planned position to where it coasts.

    Returns its largest distance from the position that is planned for the state of the others.
    """
    position, velocity, acceleration = team.scratch[0], team.scratch[1], team.scratch[2]
    piece, since, moving = find_piece(motion.times, box.time)
    evaluate_piece(motion.coefficients[piece], i, since, moving, team.scratch)
    pieces = pieces_between(motion.joints, box.time - box.half, box.time + box.half)
    largest_acceleration = largest_between(motion.accelerations, pieces, i)
    largest_jerk = largest_between(motion.jerks, pieces, i)
    # Whole team: each has coasted as long as the last to stop, or less where it lags behind.
    earlier = box.rate * motion.lag[i] if box.case == 0 else 0.0
    middle, most = max(box.coast - 0.5 * earlier, 0.0), box.coast + box.coast_half
    fastest = _norm(velocity) + largest_acceleration * box.half
    deviation = 0.5 * (largest_acceleration + most * largest_jerk) * box.half
    deviation += largest_acceleration * (box.coast_half + 0.5 * earlier)
    spread = fastest * 0.5 * earlier + deviation * box.half + box.descent_half
    halves, off = (box.half, box.coast_half, box.advance_half), team.spread[i] + spread
    position[2] -= box.descent
    for axis in range(3):
        position[axis] += middle * velocity[axis]
        acceleration[axis] = velocity[axis] + middle * acceleration[axis]
    apart = 0.0
    for axis in range(3):
        apart += (position[axis] - team.position[i, axis]) ** 2
        team.position[i, axis] = position[axis]
    for coordinate in range(3):
        turned = 0.0
        for axis in range(3):
            # by time, by coasting, and not at all by the advance of the others
            slope = acceleration[axis] if coordinate == 0 else velocity[axis]
            if coordinate == 2:
                slope = 0.0
            turned += (slope - team.slopes[coordinate, i, axis]) ** 2
            team.slopes[coordinate, i, axis] = slope
        off += np.sqrt(turned) * halves[coordinate]
    team.spread[i] = spread
    return float(np.sqrt(apart) + off)


@inner
def _norm(vector: Floats) -> float:
    return float(np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2))


Ints = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]

_MOST_BOXES = 3_000
"""Undecided boxes of one interval from which it counts as not shown: a lower rate costs less time
than a longer search."""
_ROUNDS = 40
"""Rounds of halving after which the rest counts as not shown: boxes are then far below a
millisecond wide."""


_RATES = np.linspace(0.0, 1.0, 101)
"""Clock rates at which advances are bounded: between two of them an advance grows by 2 cs."""
_SAMPLES = 20
"""Parts of an interval of half a second, whose ends are sampled for the largest advance."""


@dataclass(frozen=True, eq=False)
class Overrun:
    """How far vehicles move on after a stream loss.

    At a clock of rate 1, each vehicle without setpoints coasts for up to ``coast_time`` (n,)
    seconds, of which ``braking_time`` (n,) is braking, and comes to rest where it was after
    ``rest_time`` (n,) seconds: farther back where it returns. The others advance for ``silence``
    seconds until the clock slows, as fast as ``limits`` allow. A vehicle that lands alone descends
    by up to ``descent`` (n,) metres before the others do.
    """

    coast_time: Floats
    rest_time: Floats
    braking_time: Floats
    silence: float
    limits: ClockLimits
    descent: Floats

    def advance(self, times: Floats, rates: Floats) -> Floats:
        """Return the mission seconds by which the team advances until it stands."""
        return self.limits.advance(times, rates, self.silence)

    def largest_advances(self, start: Floats, end: Floats) -> Floats:
        """Return bounds (k, r) of the advance after losses within intervals (k,), at _RATES.

        Where a stop ends never comes earlier for a later loss: between two samples the advance is
        at most that of the later one and their distance.
        """
        share = np.linspace(0.0, 1.0, _SAMPLES + 1)
        times = start[:, None] + share * (end - start)[:, None]
        advances = self.advance(times[:, :, None], _RATES).max(axis=1)
        largest: Floats = advances + ((end - start) / _SAMPLES)[:, None]
        return largest

    @property
    def lag(self) -> Floats:
        """How far (n,) each may be behind the others in seconds of coasting, if all coast."""
        farther = self.coast_time - self.rest_time[:, None]
        alike = (self.coast_time == self.coast_time[:, None]) & (
            self.rest_time == self.rest_time[:, None]
        )
        lag: Floats = np.where(alike, 0.0, np.maximum(farther, 0.0)).max(axis=1)
        return lag

    def largest_advance(
        self, lost: tuple[Floats, Floats], vehicle: Ints, coast: Floats, fastest: Floats,
        advances: Floats,
    ) -> Floats:  # fmt: skip
        """Return bounds (m,) of the team's advance when a vehicle has coasted for up to ``coast``.

        The setpoints were ``lost`` between these times (m,), at a clock rate up to ``fastest``
        (m,). ``advances`` (m, r) are bounds for the whole intervals that contain them, at _RATES:
        close ones where the times are far apart.
        """
        (first, last), rate = lost, np.minimum(coast / self.rest_time[vehicle], fastest)
        # a stop that begins earlier ends no later
        least = np.minimum(at_rate(advances, rate), self.advance(last, rate) + (last - first))
        return np.maximum(least, self.stopped(vehicle, rate))

    def least_advance(self, vehicle: Ints, coast: Floats) -> Floats:
        """Return bounds (m,) of the team's advance when a vehicle has coasted for ``coast``."""
        return coast * np.minimum(1.0, self.silence / self.coast_time[vehicle])

    def stopped(self, vehicle: Ints, rate: Floats | float) -> Floats:
        """Return the least advance (m,) that counts, for any clock: until a vehicle has stopped.

        One that returns has passed the place at a lower rate that counts with all of the advance.
        """
        returned = self.rest_time[vehicle] < self.coast_time[vehicle]
        stopped = self.coast_time[vehicle] + np.where(returned, 0.0, self.braking_time[vehicle])
        return rate * stopped


def at_rate(advances: Floats, rate: Floats) -> Floats:
    """Return the bounds (m,) of advances (m, r) at the next of _RATES: advances grow with it."""
    column = np.minimum(np.ceil(rate * (len(_RATES) - 1) - 1e-9), len(_RATES) - 1)
    bounds: Floats = advances[np.arange(len(rate)), column.astype(np.intp)]
    return bounds


class _Cases(NamedTuple):
    """Case and clock rate (m,) of boxes."""

    case: Ints1
    rate: Floats1


class _Workspace(NamedTuple):
    team: Team
    strands: Strands
    margins: Floats2


class _Margins(NamedTuple):
    """Lower bounds (m,) of margins in boxes, margins (m,) in their middles, widths (m, 4).

    Both are 0 where all margins are larger.
    """

    low: Floats1
    here: Floats1
    widths: Floats2


class StreamLossBound:
    """Certified margins of a plan after stream losses, for all times within intervals."""

    def __init__(self, plan: Plan, overrun: Overrun, end: float) -> None:
        """``end`` is the last mission time that is reached."""
        motion, n = BoundedMotion(plan.motion), plan.vehicles
        self._overrun = overrun
        times, joints, coefficients = (
            np.require(values, np.float64, ["C", "W"])
            for values in (plan.motion.times, plan.motion.times[1:-1], plan.motion.coefficients)
        )
        self._motion = LossMotion(
            times, joints, coefficients, motion.accelerations, motion.jerks,
            overrun.lag, plan.mission.vehicles.tracking, end,
        )  # fmt: skip
        self._required = required_of(plan)
        self._workspace = _Workspace(allocate_team(n), allocate_strands(n), np.empty((2, PLACES)))

    def holds(self, start: Floats, end: Floats, rate: Floats) -> Flags:
        """Return whether margins hold after losses within intervals (k,), at up to ``rate`` (k,).

        False where this is not shown.
        """
        count, rounds = len(start), 0
        advances = self._overrun.largest_advances(start, end)
        shown = np.ones(count, dtype=np.bool_)

        def relevant(boxes: Boxes) -> Flags:
            nonlocal rounds
            rounds += 1
            interval = boxes.group % count
            if rounds > _ROUNDS:
                shown[interval] = False
            where = shown[interval] & self._possible(boxes, rate, advances)
            open_ = np.bincount(interval[where], minlength=count)
            shown[open_ > _MOST_BOXES] = False
            where &= shown[interval]
            return where

        def undecided(boxes: Boxes, bounds: Enclosure) -> Flags:
            failed = self._reached(boxes, rate, advances) & (bounds.high < 0.0)
            shown[boxes.group[failed] % count] = False
            return bounds.low < 0.0

        search(
            lambda boxes: self._margins(boxes, rate),
            self._roots(start, end, rate, advances), undecided,
            relevant=relevant, cut=1.0,
        )  # fmt: skip
        return shown

    def _roots(self, start: Floats, end: Floats, rate: Floats, advances: Floats) -> Boxes:
        """One box for each case and interval."""
        n, k = len(self._overrun.coast_time), len(start)
        group = np.arange((n + 1) * k)
        case, interval = np.divmod(group, k)
        coast_time = np.append(self._overrun.coast_time.max(), self._overrun.coast_time)
        coast = coast_time[case] * rate[interval]
        advance = at_rate(advances[interval], rate[interval])
        stopped = self._overrun.stopped(np.maximum(case - 1, 0), rate[interval])
        advance = np.where(case > 0, np.maximum(advance, stopped), 0.0)
        widths = coast, advance, np.append(0.0, self._overrun.descent)[case]
        half = 0.5 * np.column_stack([(end - start)[interval], *widths])
        middle = half.copy()
        middle[:, 0] = 0.5 * (start + end)[interval]
        return Boxes(group, middle, half, np.full(len(group), -np.inf))

    def _possible(self, boxes: Boxes, rate: Floats, advances: Floats) -> Flags:
        """Boxes with possible states: the team neither goes back nor advances too far."""
        case, interval = np.divmod(boxes.group, len(advances))
        time, coast, advance, _ = boxes.middle.T
        time_half, coast_half, advance_half, _ = boxes.half.T
        longest = self._overrun.largest_advance(
            (time - time_half, time + time_half), np.maximum(case - 1, 0), coast + coast_half,
            rate[interval], advances[interval],
        )  # fmt: skip
        least = self._overrun.least_advance(np.maximum(case - 1, 0), coast - coast_half)
        behind = advance + advance_half < least
        beyond = advance - advance_half > longest
        possible: Flags = ~((case > 0) & (behind | beyond))
        return possible

    def _reached(self, boxes: Boxes, rate: Floats, advances: Floats) -> Flags:
        """Boxes whose middle is a possible state."""
        case, interval = np.divmod(boxes.group, len(advances))
        time, coast, advance, _ = boxes.middle.T
        longest = self._overrun.largest_advance(
            (time, time), np.maximum(case - 1, 0), coast, rate[interval], advances[interval]
        )
        least = self._overrun.least_advance(np.maximum(case - 1, 0), coast)
        reached: Flags = (case == 0) | ((advance >= least) & (advance <= longest))
        return reached

    def _margins(self, boxes: Boxes, rate: Floats) -> Enclosure:
        case, interval = np.divmod(boxes.group, len(rate))
        count = len(boxes)
        margins = _Margins(np.empty(count), np.empty(count), np.empty((count, 4)))
        _write_margins(
            _Cases(case, rate[interval]), (boxes.middle, boxes.half), self._motion, self._required,
            self._workspace, margins,
        )  # fmt: skip
        return Enclosure(margins.low, margins.here, margins.widths, np.empty((count, 0)))


@compiled
def _write_margins(
    cases: _Cases,
    boxes: tuple[Floats2, Floats2],
    motion: LossMotion,
    required: Required,
    workspace: _Workspace,
    margins: _Margins,
) -> None:
    """Write the margins of boxes with middles and half widths (m, 4)."""
    middle, half = boxes
    for m in range(len(middle)):
        box = Box(
            cases.case[m], cases.rate[m], middle[m, 0], half[m, 0], middle[m, 1], half[m, 1],
            middle[m, 2], half[m, 2], middle[m, 3], half[m, 3],
        )  # fmt: skip
        low, here = workspace.margins
        margins.low[m] = margins.here[m] = 0.0
        if write_state(box, motion, workspace.team, margins.widths[m]):
            asked = Query(box.case - 1, (box.half, box.coast_half, box.advance_half), 0.0, 0.0)
            vehicle_margins(asked, workspace.team, required, low, here)
            if smallest(low) >= 0.0:
                cable_margins(asked, workspace.team, required, workspace.strands, low, here)
            margins.low[m], margins.here[m] = smallest(low), smallest(here)


class Losses(NamedTuple):
    """Positions after losses at k moments, metres ENU.

    ``position`` (k, n, 3) at the loss. At each of s moments after it, ``moved`` (s, k, n, 3) is how
    far vehicles without setpoints have moved, and ``descended`` (s, n) how far one of them has
    descended; ``team`` (s, k, n, 3) are the planned positions of the others, and ``ahead`` those of
    all without setpoints. Within ``tracking`` metres of planned positions, everything is certified;
    with a negative one nothing is, and the plan itself counts as well.
    """

    position: Floats3
    moved: Floats4
    descended: Floats2
    team: Floats4
    ahead: Floats4
    tracking: float


class Memory(NamedTuple):
    """Working memory for one moment of n vehicles; ``margins`` (2, PLACES)."""

    team: Team
    strands: Strands
    margins: Floats2


def allocate_memory(n: int) -> Memory:
    """Return memory for a team."""
    return Memory(allocate_team(n), allocate_strands(n), np.empty((2, PLACES)))


@compiled
def write_margins(
    losses: Losses, required: Required, limits: tuple[float, float], memory: Memory,
    margins: Floats1, vehicles: Ints1,
) -> None:  # fmt: skip
    """Write the smallest margins (k,), and the vehicles (k,) without setpoints (0: the team).

    Those with a vehicle that has left the tracking radius: all others are certified. ``limits`` are
    the margin that counts as found, below which a moment is not computed further, and the one from
    which on none is computed.
    """
    target, enough = limits
    for k in range(len(margins)):
        margins[k], vehicles[k] = enough, 0
        # the last moment first: vehicles are farthest from the plan, so others are cut short
        for after in range(len(losses.moved) - 1, -1, -1):
            for who in range(-2 if losses.tracking < 0.0 else -1, losses.position.shape[1]):
                if margins[k] < target:
                    break
                if _place((k, after, who), losses, memory.team) > losses.tracking:
                    margin = _smallest(
                        Query(max(who, -1), (0.0, 0.0, 0.0), target, margins[k]), required, memory
                    )
                    if margin < margins[k]:
                        margins[k], vehicles[k] = margin, max(who + 1, 0)


@inner
def _place(which: tuple[int, int, int], losses: Losses, team: Team) -> float:
    """Move a team to where it is after a loss; return how far a vehicle is off the plan.

    All vehicles without setpoints (−1), one of them, or none (−2).
    """
    (k, after, who), farthest = which, 0.0
    for i in range(len(team.position)):
        planned = losses.ahead[after, k, i] if who == -1 else losses.team[after, k, i]
        for axis in range(3):
            if who in (-1, i):
                moved = losses.moved[after, k, i, axis]
                team.position[i, axis] = losses.position[k, i, axis] + moved
            else:
                team.position[i, axis] = planned[axis]
        if who == i:
            team.position[i, 2] -= losses.descended[after, i]
        farthest = max(farthest, point_distance(team.position[i], planned))
    return farthest


@inner
def _smallest(asked: Query, required: Required, memory: Memory) -> float:
    """Return the smallest margin of a team with its cable aloft; what is ``enough`` without one."""
    low, here = memory.margins
    vehicle_margins(asked, memory.team, required, low, here)
    cable_margins(asked, memory.team, required, memory.strands, low, here)
    return float(smallest(low))


STEP = 0.5
"""Seconds of mission time between samples; the certificate covers the times between."""
RATES = (1.0, 0.85, 0.72, 0.61, 0.52, 0.45, 0.38, 0.34, 0.3)
"""Clock rates that are tried, fastest first: each is about 85 % of the one before."""
FINE_RATES = tuple(float(rate) for rate in np.linspace(1.0, 0.3, 8))
"""Clock rates that are tried for plans' own timing."""
_BRAKING = (0.35, 0.12)
"""Seconds at its speed by which PX4 flies on after its timeout, and the additional seconds per m/s:
0.38, 0.43 and 0.57 s with 0.5, 1 and 2 m/s (PX4 1.16, COM_OF_LOSS_T 0.5 and MPC_ACC_HOR 3, in the
physics of this project; it holds 0.6 s of its speed and the braking distance farther on)."""
_TURNING = (0.45, 0.15)
"""Seconds at its speed by which ArduCopter passes the target at which its setpoints ended, and the
additional seconds per m/s: 0.51, 0.57 and 0.73 s with 0.5, 1 and 2 m/s (ArduCopter 4.6 and default
parameters, in its own simulator)."""
_LOWERED = 65
"""Rates between which the distance of braking is interpolated: 1 % of full rate apart."""
_LATE = 4.0 / BANDWIDTH
"""Seconds by which an ordinary change ends late: it begins a time constant late, and its last part
takes three."""
_SPEEDS = 0.1
"""Seconds between the moments whose speeds are compared."""
_SIDE_BY_SIDE = 100
"""Moments that are computed by several threads: a thread starts in the time of a few of them."""
_FOUND = 0.005
"""Metres of margin at a sample from which a rate is tried: exactly at none, no finite search can
show that it holds between samples."""


@dataclass(frozen=True)
class StreamLossModel:
    """How vehicles behave after a stream loss.

    They continue for ``timeout`` seconds (COM_OF_LOSS_T, GUID_TIMEOUT): one number per vehicle
    along the cable, or one for all. A vehicle that then lands descends by up to ``descent`` metres
    (as many numbers) before the others do; one that ``returns`` (likewise) goes back to where it
    was at the timeout. ``silence`` is the time in seconds after which the ground station holds the
    others.
    """

    timeout: tuple[float, ...] = (0.5,)
    silence: float = 0.7
    descent: tuple[float, ...] = (0.0,)
    returns: tuple[bool, ...] = (False,)

    @property
    def shortest(self) -> Self:
        """The same behaviour, with one number for all where all have the same."""
        alike = {
            name: values[:1]
            for name, values in vars(self).items()
            if name != "silence" and len(set(values)) == 1
        }
        return replace(self, **alike)

    def overrun(self, plan: Plan, span: tuple[float, float] | None = None) -> Overrun:
        """Return how far the vehicles of a plan move on, after losses in a span of mission time."""
        timeout, descent, returns = (
            np.broadcast_to(values, plan.vehicles)
            for values in (self.timeout, self.descent, self.returns)
        )
        braking, more = np.where(returns[:, None], _TURNING, _BRAKING).T
        braking_time = braking + more * _fastest(plan, *(span or plan.motion.times[[0, -1]]))
        coast_time = timeout + braking_time
        rest_time = np.where(returns, timeout, coast_time)
        limits = clock_limits(plan.motion, plan.mission.vehicles.braking_acceleration)
        return Overrun(coast_time, rest_time, braking_time, self.silence, limits, descent)


@dataclass(frozen=True)
class WorstLoss:
    """The stream loss with the smallest margin (m): mission time, and the vehicle without setpoints
    (counted from 1; 0: the whole team). The margin is infinite where all stay within the tracking
    radius, for which clearances are certified."""

    margin: float
    time: float
    vehicle: int

    @property
    def subject(self) -> str:
        """The vehicles without setpoints, in words."""
        return f"vehicle {self.vehicle}" if self.vehicle else "the whole team"


@dataclass(frozen=True, eq=False)
class StreamLossCertificate:
    """The largest rates (k,) of the mission clock at mission times (k,), for stream losses.

    ``rewind_rates`` are those of a clock that runs backwards, 1 in a fold that does not. ``worst``
    is the sample with the smallest margin at a limited rate. ``infeasible`` are the times around
    which even the slowest rate has no margin, or none can be shown. ``model`` is the behaviour of
    the vehicles, ``digest`` that of the plan.
    """

    times: Floats
    rates: Floats
    rewind_rates: Floats
    worst: WorstLoss
    infeasible: Floats
    model: StreamLossModel
    digest: str

    def holds_for(self, plan: Plan, model: StreamLossModel) -> bool:
        """Whether it was computed from exactly this plan and these vehicles."""
        return self.model == model and self.digest == digest(plan)

    def rate_limit(self, time: float, *, backwards: bool = False) -> float:
        """Return the largest rate at a mission time, of a clock that runs on or backwards."""
        if not len(self.times) or not self.times[0] <= time <= self.times[-1]:
            return 1.0
        after = min(int(np.searchsorted(self.times, time)), len(self.times) - 1)
        rates = self.rewind_rates if backwards else self.rates
        return float(min(rates[after], rates[max(after - 1, 0)]))

    @property
    def delay(self) -> float:
        """Additional duration of the fold at these rates, seconds."""
        return self.delay_after(-np.inf)

    def delay_after(self, time: float) -> float:
        """Return the additional duration of the fold after a mission time, seconds."""
        if not len(self.times):
            return 0.0
        slower = np.minimum(self.rates[1:], self.rates[:-1])
        ahead = np.diff(np.maximum(self.times, time))
        return float(np.sum(ahead * (1.0 / slower - 1.0)))

    def findings(self) -> list[Finding]:
        """Return the findings on stream losses; none without a fold."""
        if not len(self.times):
            return []
        worst = self.worst
        shown = "for clearances and chords after a stream loss"
        if len(self.infeasible):
            margin = (
                f"{worst.margin:.2f} m margin" if worst.margin < 0.0 else "no margin can be shown"
            )
            message = (
                f"{margin} {shown} near {self.infeasible[0]:.1f} s, even at {RATES[-1]:.0%} of the "
                f"clock rate (smallest for {worst.subject})"
            )
            return [Finding("warning", "stream loss", message, worst.time)]
        message = (
            f"{max(worst.margin, 0.0):.2f} m margin or more {shown} in the fold, of one vehicle or "
            f"of all (smallest for {worst.subject})"
        )
        if worst.margin == np.inf:
            message = (
                "vehicles stay within the tracking radius after a stream loss in the fold, of one "
                "vehicle or of all"
            )
        findings = [Finding("info", "stream loss", message, worst.time)]
        for rates, rewind in ((self.rates, ""), (self.rewind_rates, " of a rewind")):
            limited = rates < 1.0
            if limited.any():
                message = (
                    f"{rates.min():.0%} is the slowest clock rate{rewind} for that; it is below "
                    f"100% during {limited.mean():.0%} of the fold"
                )
                slowest = float(self.times[int(np.argmin(rates))])
                findings.append(Finding("info", "stream loss", message, slowest))
        return findings


def certify_stream_loss(
    plan: Plan,
    model: StreamLossModel = StreamLossModel(),
    ahead: "Callable[[], RateLimits] | None" = None,
    *,
    progress: Callable[[float], None] = lambda _: None,
) -> StreamLossCertificate:
    """Return the certificate of stream losses, of all or of single vehicles, during the fold.

    ``ahead`` returns its :func:`limits_ahead`, where they are kept. ``progress`` is called with the
    share of the fold's times, in both directions of the clock, for which the rate is known.
    """
    name, fold, shares = digest(plan), _fold(plan), {"ahead": 0.0, "back": 0.0}

    def report(direction: str, share: float) -> None:
        shares[direction] = share
        progress(0.5 * sum(shares.values()))

    def limits() -> RateLimits:
        if ahead is None:
            return limits_ahead(plan, model, partial(report, "ahead"))
        on = ahead()
        report("ahead", 1.0)
        return on

    if fold is None or not fold[2]:
        on = limits()
        return StreamLossCertificate(
            on.times, on.rates, np.ones(len(on.times)), on.worst, on.times[on.infeasible], model,
            name,
        )  # fmt: skip
    start, end, _ = fold
    times = _times(start, end)
    # mission time t is ``turned`` − t of the reversed motion
    turned = float(plan.motion.times[0] + plan.motion.times[-1])
    turned_plan = replace(plan, motion=reverse(plan.motion))
    on, back = both(
        limits,
        lambda: _limits_of(
            turned_plan, model, turned - times[::-1], turned - start, partial(report, "back")
        ),
    )
    worst = replace(back.worst, time=turned - back.worst.time)
    return StreamLossCertificate(
        times, on.rates, back.rates[::-1], min(on.worst, worst, key=lambda loss: loss.margin),
        times[on.infeasible | back.infeasible[::-1]], model, name,
    )  # fmt: skip


def _fold(plan: Plan) -> tuple[float, float, bool] | None:
    """Return start and end of the fold, and whether mission time may run backwards in it."""
    fold = [phase for phase in plan.phases if phase.name == "fold" and phase.cable == "aloft"]
    if not fold or plan.vehicles < 2:
        return None
    return fold[0].start, fold[-1].end, all(phase.reversible for phase in fold)


def _fastest(plan: Plan, start: float, end: float) -> float:
    """Return the largest speed of a vehicle between two times, m/s."""
    times = np.arange(start, end + _SPEEDS, _SPEEDS)
    speeds = np.linalg.norm(plan.motion.at(times)[1], axis=2)
    # a speed changes by at most this from the nearest of these times on
    between = 0.5 * _SPEEDS * plan.mission.vehicles.max_acceleration
    return float(speeds.max()) + between


class RateLimits(NamedTuple):
    """Rates (k,) in one direction of the clock at mission times (k,), the worst loss, and which
    (k,) are infeasible.

    ``asked`` (k,) are the rates that margins ask for until the next time and since the one before;
    ``rates`` those from which the clock can brake in time for all that are asked for later.
    """

    times: Floats
    asked: Floats
    rates: Floats
    worst: WorstLoss
    infeasible: Flags


def limits_ahead(
    plan: Plan, model: StreamLossModel, progress: Callable[[float], None] = lambda _: None
) -> RateLimits:
    """Return the limits of a clock that runs on, in the fold of a plan; none without a fold.

    ``progress`` is called with the share of its times for which the rate is known.
    """
    fold = _fold(plan)
    if fold is None:
        none = np.empty(0)
        return RateLimits(none, none, none, WorstLoss(np.inf, 0.0, 0), np.empty(0, dtype=np.bool_))
    start, end, _ = fold
    return _limits_of(plan, model, _times(start, end), end, progress)


def _times(start: float, end: float) -> Floats:
    """Return the mission times of a fold at which rates are limited."""
    return np.append(np.arange(start, end, STEP), end)


def _limits_of(
    plan: Plan, model: StreamLossModel, times: Floats, end: float,
    progress: Callable[[float], None],
) -> RateLimits:  # fmt: skip
    """Return the limits of a clock that runs on along a plan's motion, no farther than ``end``."""
    overrun = model.overrun(plan, (float(times[0]), end))
    accepted = _Accepted(_FOUND, exact=True)
    rates, margins, vehicles = _sampled_rates(plan, overrun, (times, end), RATES, accepted)
    lost = np.isnan(rates)
    rates[lost] = RATES[-1]
    unshown = _lower(StreamLossBound(plan, overrun, end), times, rates, lost, progress)
    tightest = int(np.argmin(margins))
    worst = WorstLoss(float(margins[tightest]), float(times[tightest]), int(vehicles[tightest]))
    reachable = _reachable(overrun.limits, times, rates)
    return RateLimits(times, rates, reachable, worst, lost | unshown)


def _lower(
    bound: StreamLossBound, times: Floats, rates: Floats, lost: Flags,
    progress: Callable[[float], None],
) -> Flags:  # fmt: skip
    """Lower rates (k,) in place until they are certified; return after which times none is.

    Between two times the clock runs at the lower of their rates.
    """
    unshown = np.zeros(len(times), dtype=np.bool_)
    open_ = np.flatnonzero(~(lost[:-1] | lost[1:]))
    count = len(open_)
    while len(open_):
        progress(1.0 - len(open_) / count)
        fastest = np.minimum(rates[open_], rates[open_ + 1])
        holds = bound.holds(times[open_], times[open_ + 1], fastest)
        open_, fastest = open_[~holds], fastest[~holds]
        slowest = fastest <= RATES[-1]
        unshown[open_[slowest]] = True
        open_, fastest = open_[~slowest], fastest[~slowest]
        for k, rate in zip(open_, fastest, strict=True):
            rates[k] = min(rates[k], max(slower for slower in RATES if slower < rate))
    progress(1.0)
    return unshown


def sampled_rates(
    plan: Plan, step: float, margin: float, tried: Sequence[float] = FINE_RATES
) -> tuple[Floats, Floats]:
    """Return mission times (k,) of the fold, and the largest rates (k,) with a margin in metres.

    Of the rates ``tried``, fastest first; the slowest where none has the margin. By samples
    ``step`` seconds apart alone, for vehicles with the default behaviour: certificates need
    :func:`certify_stream_loss`.
    """
    fold = plan.phase("fold")
    times = np.append(np.arange(fold.start, fold.end, step), fold.end)
    overrun = StreamLossModel().overrun(plan, (fold.start, fold.end))
    accepted = _Accepted(margin, exact=False)
    rates = _sampled_rates(plan, overrun, (times, fold.end), tried, accepted)[0]
    return times, np.nan_to_num(rates, nan=tried[-1])


class _Accepted(NamedTuple):
    """The ``least`` margin of a rate in metres, and whether margins are wanted exactly.

    Otherwise those above are at least that, those below an upper bound, and those of the plan count
    too: where that falls short, a slower motion, which is shaped less, is easier to repair.
    """

    least: float
    exact: bool

    @property
    def limits(self) -> tuple[float, float]:
        """Margins below and above which none is computed further."""
        return (-np.inf, np.inf) if self.exact else (self.least, self.least)


def _sampled_rates(
    plan: Plan, overrun: Overrun, when: tuple[Floats, float], tried: Sequence[float],
    accepted: _Accepted,
) -> tuple[Floats, Floats, Ints]:  # fmt: skip
    """Return the fastest of the rates with an accepted margin, NaN for none.

    At times (k,), in a motion up to an end. Also the margins (k,) at these rates, and the vehicles
    (k,) without setpoints that have them.
    """
    times, end = when
    rates = np.full(len(times), np.nan)
    margins, vehicles = np.full(len(times), -np.inf), np.zeros(len(times), dtype=np.intp)
    for rate in tried:
        open_ = np.flatnonzero(np.isnan(rates))
        if not len(open_):
            break
        margin, vehicle = _margins(plan, overrun, (times[open_], end), rate, accepted)
        better = margin > margins[open_]
        margins[open_[better]], vehicles[open_[better]] = margin[better], vehicle[better]
        rates[open_[margin >= accepted.least]] = rate
    return rates, margins, vehicles


def _margins(
    plan: Plan, overrun: Overrun, when: tuple[Floats, float], rate: float, accepted: _Accepted
) -> tuple[Floats, Ints]:
    """Return the margins (k,), and the vehicles (k,) without setpoints that have them."""
    times, end = when
    margins, vehicles = np.empty(len(times)), np.empty(len(times), dtype=np.intp)
    required = required_of(plan)

    def write(some: slice) -> None:
        margin, vehicle = np.empty(len(times[some])), np.empty(len(times[some]), dtype=np.intp)
        losses = _losses(plan, (times[some], end), rate, overrun)
        if not accepted.exact:
            losses = losses._replace(tracking=-1.0)
        memory = allocate_memory(plan.vehicles)
        write_margins(losses, required, accepted.limits, memory, margin, vehicle)
        margins[some], vehicles[some] = margin, vehicle

    # every other moment, because those that take long are next to each other
    count = usual_threads() if len(times) >= _SIDE_BY_SIDE else 1
    for _ in side_by_side(write, [slice(k, None, count) for k in range(count)], threads=count):
        pass
    return margins, vehicles


def _reachable(limits: ClockLimits, times: Floats, rates: Floats) -> Floats:
    """Lower rates ahead of limits, so that ordinary braking reaches each limit in time.

    The slope rises and falls at SMOOTH to lower the rate by x within a time T: T = 2 √(x / SMOOTH),
    or x / d + d / SMOOTH where it stays at the steepest d between, the least of all these times.
    The clock passes T times the mean rate meanwhile, and _LATE times the first.
    """
    limited = rates.copy()
    steepest = min(limits.at(time, urgent=False) for time in times)
    for k in np.flatnonzero(rates < 1.0):
        lowered = np.linspace(0.0, 1.0 - rates[k], _LOWERED)
        brief = lowered < steepest**2 / SMOOTH
        duration = np.where(
            brief, 2.0 * np.sqrt(lowered / SMOOTH), lowered / steepest + steepest / SMOOTH
        )
        distance = duration * (rates[k] + 0.5 * lowered) + _LATE * (rates[k] + lowered)
        reached = rates[k] + np.interp(times[k] - times[:k], distance, lowered)
        limited[:k] = np.minimum(limited[:k], reached)
    return limited


def _losses(plan: Plan, when: tuple[Floats, float], rate: float, overrun: Overrun) -> Losses:
    """Return the sampled positions after losses at times (k,) and a clock rate, up to an end."""
    times, end = when
    position, velocity, _ = plan.motion.at(times)
    # The team continues until the silence is detected; then the clock's rate falls to zero. Moments
    # are halfway, at the ends of these motions, and when vehicles have returned, if any does.
    stopped = overrun.stopped(np.arange(plan.vehicles), rate).max()
    advance = np.maximum(overrun.advance(times, np.array(rate)), stopped)
    coast, rest = rate * overrun.coast_time, rate * overrun.rest_time
    moments = [(0.5 * coast, 0.5), (coast, 1.0)]
    if (rest < coast).any():
        moments.append((rest, 1.0))
    seconds = np.array([coasted for coasted, _ in moments])
    share = np.array([share for _, share in moments])[:, None]
    team = plan.motion.at(np.minimum(times + share * advance, end))[0]
    ahead = plan.motion.at(np.minimum(times + seconds.max(axis=1, keepdims=True), end))[0]
    moved = seconds[:, None, :, None] * velocity
    tracking = plan.mission.vehicles.tracking
    return Losses(position, moved, share * overrun.descent, team, ahead, tracking)
