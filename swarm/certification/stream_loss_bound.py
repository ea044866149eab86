"""Certified margins after a stream loss, over all time instead of samples.

A box belongs to a case (0: the whole team loses its setpoints, else that vehicle) and an interval
of mission time. Its coordinates are the time of the loss, the coasting of the vehicles without
setpoints (in seconds at their velocity then), and the advance of the others along the plan (in
mission seconds). Margins are computed in the middle of a box; bounds of velocities, accelerations
and of the sensitivity of strands extend them to the whole box.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import Boxes, Enclosure, search
from swarm.certification.motion_bounds import BoundedMotion
from swarm.certification.stream_loss_team import Box, LossMotion, write_state
from swarm.certification.team_margins import (
    KINDS,
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
from swarm.jit import compiled
from swarm.planning import Plan
from swarm.planning.clock_limits import ClockLimits
from swarm.signatures import Floats1, Floats2, Ints1

Floats = npt.NDArray[np.float64]
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
        found = self.advance(times[:, :, None], _RATES).max(axis=1)
        largest: Floats = found + ((end - start) / _SAMPLES)[:, None]
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
    found: Floats = advances[np.arange(len(rate)), column.astype(np.intp)]
    return found


class _Cases(NamedTuple):
    """Case and clock rate (m,) of boxes."""

    case: Ints1
    rate: Floats1


class _Workspace(NamedTuple):
    team: Team
    strands: Strands
    margins: Floats2


class _Margins(NamedTuple):
    """Lower bounds (m,) of margins in boxes, margins (m,) in their middles, doubts (m, 3).

    Both are 0 where all margins are larger.
    """

    low: Floats1
    here: Floats1
    doubts: Floats2


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
            overrun.lag, np.array(overrun.descent),
            plan.mission.vehicles.tracking, end,
        )  # fmt: skip
        self._required = required_of(plan)
        self._workspace = _Workspace(allocate_team(n), allocate_strands(n), np.empty((2, KINDS)))

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

        def undecided(boxes: Boxes, found: Enclosure) -> Flags:
            failed = self._reached(boxes, rate, advances) & (found.high < 0.0)
            shown[boxes.group[failed] % count] = False
            return found.low < 0.0

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
        middle = np.column_stack([0.5 * (start + end)[interval], 0.5 * coast, 0.5 * advance])
        half = np.column_stack([0.5 * (end - start)[interval], 0.5 * coast, 0.5 * advance])
        return Boxes(group, middle, half, np.full(len(group), -np.inf))

    def _possible(self, boxes: Boxes, rate: Floats, advances: Floats) -> Flags:
        """Boxes with possible states: the team neither goes back nor advances too far."""
        case, interval = np.divmod(boxes.group, len(advances))
        time, coast, advance = boxes.middle.T
        time_half, coast_half, advance_half = boxes.half.T
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
        time, coast, advance = boxes.middle.T
        longest = self._overrun.largest_advance(
            (time, time), np.maximum(case - 1, 0), coast, rate[interval], advances[interval]
        )
        least = self._overrun.least_advance(np.maximum(case - 1, 0), coast)
        reached: Flags = (case == 0) | ((advance >= least) & (advance <= longest))
        return reached

    def _margins(self, boxes: Boxes, rate: Floats) -> Enclosure:
        case, interval = np.divmod(boxes.group, len(rate))
        count = len(boxes)
        found = _Margins(np.empty(count), np.empty(count), np.empty((count, 3)))
        _write_margins(
            _Cases(case, rate[interval]), (boxes.middle, boxes.half), self._motion, self._required,
            self._workspace, found,
        )  # fmt: skip
        return Enclosure(found.low, found.here, found.doubts, np.empty((count, 0)))


@compiled
def _write_margins(
    cases: _Cases,
    boxes: tuple[Floats2, Floats2],
    motion: LossMotion,
    required: Required,
    workspace: _Workspace,
    found: _Margins,
) -> None:
    """Write the margins of boxes with middles and half widths (m, 3)."""
    middle, half = boxes
    for m in range(len(middle)):
        box = Box(
            cases.case[m], cases.rate[m], middle[m, 0], half[m, 0], middle[m, 1], half[m, 1],
            middle[m, 2], half[m, 2],
        )  # fmt: skip
        low, here = workspace.margins
        found.low[m] = found.here[m] = 0.0
        if write_state(box, motion, workspace.team, found.doubts[m]):
            asked = Query(box.case - 1, (box.half, box.coast_half, box.advance_half), 0.0, 0.0)
            vehicle_margins(asked, workspace.team, required, low, here)
            if smallest(low) >= 0.0:
                cable_margins(asked, workspace.team, required, workspace.strands, low, here)
            found.low[m], found.here[m] = smallest(low), smallest(here)
