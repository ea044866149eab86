"""The timing of a fold: slowed where lost setpoints require it, shaped and slowed for the swing.

A time-optimal fold is flown at a varying rate and shaped. Its rate is lowered where clearances and
chords would fail after a loss of setpoints at full rate, and where the cable swings too far, until
neither is so: then the mission clock runs at rate 1 in an undisturbed flight.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy

from swarm.certification.clearances import PlanChecks
from swarm.certification.strand_pieces import BIN
from swarm.certification.stream_loss import FINE_RATES, sampled_rates
from swarm.certification.swing_runs import strands_of
from swarm.geometry.motion import Motion
from swarm.planning import Plan
from swarm.planning.assembly import fold_of, with_fold
from swarm.planning.phase_motion import usable_acceleration
from swarm.planning.plan import Phase
from swarm.planning.shaping import PacedMotion, Shaper, largest_stray, shape, shaper_for
from swarm.planning.timing import slow_to_limits

Floats = npt.NDArray[np.float64]

_GRID = 0.05
"""Seconds between the samples of the rate at which a fold is flown."""

_LOSS_AROUND, _LOSS_SMOOTHING = 21, 8.0
"""Samples around one that slow with it for lost setpoints, and standard deviation of their
smoothing: half a second, and 0.4 s; the shaper smooths further."""

_SWING_AROUND, _SWING_SMOOTHING = 61, 20.0
"""The same for the swing: a rate that changes within a period would excite swing itself."""

_STOP_BEFORE, _STOP_AFTER = 2, 8
"""Intervals of the tube before and after one that slow with it for stops, 1 s and 4 s: an urgent
stop that swings a strand begins at most a second before, a rewind a few seconds after."""

_LOSS_STEP, _LOSS_MARGIN = 0.25, 0.02
"""Seconds between sampled losses, and metres of margin that the certificate needs between them."""

_LEAST_FACTOR = 0.75
"""Smallest factor by which a rate is reduced for lost setpoints in one round: a slower motion is
shaped less, too, and so passes elsewhere. Reduced at once by what a round shows, to 0.3 where no
rate helps, the Carrick mat folds in 285 s instead of 267 s, and the granny knot in 155 s instead of
145 s."""

_SWING_EXPONENT = 0.7
"""Power of limit over stray by which a rate is reduced in one round: its neighbours are, too."""

_QUICKER_RATES = (2.0, 1.6, 1.35, 1.2, 1.1, *FINE_RATES)
"""Rates that are tried where a fold is made quicker again, at closer steps near 1."""

_QUICKER_EXPONENT, _QUICKER_ROUNDS = 0.7, 4
"""Power of the allowed rate by which one is raised in a round, and number of rounds. Rounds that
slow multiply: where the first found no rate, 10_50 was slowed to 0.2 and took 482 s, with half of
the slowed moments allowing 1.5 times their speed and more. Four rounds lead to 380 s."""

_LOSS_ROUNDS, _SWING_ROUNDS = 12, 10
"""Largest numbers of reductions; the certificate states what is missing after them."""

_SLOWEST_LOSS, _SLOWEST_SWING, _SLOWEST_STOPS = 0.2, 0.3, 0.2
"""Smallest rates: where they are not enough, slowing is not the remedy. At 0.3 one moment of the
Carrick mat's budget stayed 1 cm short; for the swing without stops 0.2 took 20 % more time."""

_AUTO_SHARE, _AUTO_SHARE_FEWER, _AUTO_LEAST = 0.0095, 0.01, 0.06
"""``fold.swing: auto`` as a share of the longest segment, and with fewer vehicles than the grid
diagram has corners, and at least, in metres: what shaping and moderate slowing reach in the default
missions (0.06 m overhand, 0.11 m Carrick mat). With 0.01 the Carrick mat swung by 0.122 m in a
finer model, where 0.12 m were asked for. With 0.0095 the fold of the overhand with five, whose
segments are longer, took 37.0 s instead of 32.6 s."""

_SHARES = (0.75, 0.5, 0.25)
"""Shares of the logarithm of a rate that are tried where a flight would exceed the endurance."""

_TARGET = 0.96
"""Share of the limit of the swing that rounds aim at."""


@dataclass(frozen=True, eq=False)
class Pacing:
    """How a fold is timed: ``base``, from time 0, at rates (k,) at its own times ``at`` (k,).

    ``loss`` are the rates for lost setpoints, ``swing`` those for the swing; their product counts.
    """

    base: Motion
    shaper: Shaper
    at: Floats
    loss: Floats
    swing: Floats

    @cached_property
    def paced(self) -> PacedMotion:
        """The base at the product of both rates, smoothed."""
        loss = _smooth(self.loss, _LOSS_AROUND, _LOSS_SMOOTHING)
        swing = _smooth(self.swing, _SWING_AROUND, _SWING_SMOOTHING)
        return PacedMotion(self.base, self.at, loss * swing)

    @cached_property
    def shaped(self) -> Motion:
        """The motion that is flown, but for limits of speed and acceleration."""
        return shape(self.paced, self.shaper)

    def slowed_for_loss(self, times: Floats, rates: Floats) -> "Pacing":
        """Return the pacing that is slower where ``rates`` (m,) at times (m,) are below 1."""
        least = scipy.ndimage.minimum_filter1d(rates, 3, mode="nearest")
        factors = np.maximum(self._least_during(times, least, 0.0), _LEAST_FACTOR)
        return replace(self, loss=np.maximum(self.loss * factors, _SLOWEST_LOSS))

    def quicker_for_loss(self, times: Floats, rates: Floats) -> "Pacing":
        """Return the pacing that is quicker where it was slowed and ``rates`` are above 1."""
        least = scipy.ndimage.minimum_filter1d(rates, 3, mode="nearest")
        factors = self._least_during(times, least, 0.0, _QUICKER_RATES[0])
        factors = np.where(factors > 1.0, factors**_QUICKER_EXPONENT, factors)
        return replace(self, loss=np.clip(self.loss * factors, _SLOWEST_LOSS, 1.0))

    def slowed_for_swing(self, times: Floats, excess: Floats, slowest: float) -> "Pacing":
        """Return the pacing that is slower before stray over limit, ``excess`` (m,), is above 1.

        Its rates for the swing are at least ``slowest``.
        """
        wanted = np.minimum(1.0, np.maximum(excess, 1e-9) ** -_SWING_EXPONENT)
        factors = self._least_during(times, wanted, 0.5)
        slowed = np.maximum(self.swing * factors, slowest)
        return replace(self, swing=np.minimum(self.swing, slowed))

    def _least_during(
        self, times: Floats, values: Floats, after: float, most: float = 1.0
    ) -> Floats:
        """Return for each sample the least value while its shares are flown, and shortly after.

        At most ``most``.
        """
        reached = self.paced.time
        first = np.searchsorted(times, reached)
        last = np.searchsorted(times, reached + self.shaper.delays[-1] + after) + 1
        # pairs of first and last, of which every other result is of the values between them
        windows = np.column_stack([first, np.minimum(last, len(values))]).ravel()
        least = np.minimum.reduceat(np.append(values, most), windows)[::2]
        lowest: Floats = np.where(first < len(values), np.minimum(least, most), most)
        return lowest


@dataclass(frozen=True, eq=False)
class PacedPlan:
    """A plan whose fold is timed, and how; None where it keeps its own timing."""

    plan: Plan
    pacing: Pacing | None = None


def timed_for_losses(plan: Plan) -> PacedPlan:
    """Return the plan with its fold shaped, and slowed for lost setpoints; not yet for the swing.

    Formations, the paper's trajectory and flights without cable keep their timing.
    """
    mission = plan.mission
    if mission.formation is not None or mission.fold.method == "paper":
        return PacedPlan(plan)
    fold = fold_of(plan)
    count = int(np.ceil(fold.times[-1] / _GRID)) + 1
    at = np.linspace(0.0, fold.times[-1], count)
    shaper = shaper_for(plan.layout.sags)
    pacing = _limited_for_loss(plan, Pacing(fold, shaper, at, np.ones(count), np.ones(count)))
    paced = _timed(plan, pacing)
    return _timed(plan, _quicker(plan, pacing)) if exceeds_endurance(paced.plan) else paced


def slowed_for_swing(paced: PacedPlan) -> PacedPlan:
    """Return the plan timed for ``fold.swing`` too; the same object where it keeps that already.

    Where no round reaches the limit of the swing, the one with the least swing counts. A limit that
    is ``auto`` may be exceeded where the flight would exceed its endurance: the budget states what
    the swing takes, and the plan is the same object where no slowing fits.
    """
    if paced.pacing is None:
        return paced
    plan, limit = paced.plan, swing_limit(paced.plan)
    pacing = best = paced.pacing
    least, strands = np.inf, strands_of(plan)
    for _ in range(_SWING_ROUNDS):
        times, stray = largest_stray(_fold(plan, pacing), strands)
        worst = stray.max(axis=1)
        if worst.max() < least:
            best, least = pacing, float(worst.max())
        if least <= limit:
            break
        pacing = pacing.slowed_for_swing(times, worst / (_TARGET * limit), _SLOWEST_SWING)
    if best is paced.pacing:
        return paced
    slowed = _timed(plan, _limited_for_loss(plan, best))
    if plan.mission.fold.certifies_swing or not exceeds_endurance(slowed.plan):
        return slowed
    return _slowed_in_part(paced, paced.pacing, best)


def _slowed_in_part(paced: PacedPlan, before: Pacing, slowed: Pacing) -> PacedPlan:
    """Return the plan slowed by the largest share of a slowing that its endurance allows."""
    for share in _SHARES:
        swing = before.swing * (slowed.swing / before.swing) ** share
        pacing = _limited_for_loss(paced.plan, replace(slowed, swing=swing))
        partly = _timed(paced.plan, pacing)
        if not exceeds_endurance(partly.plan):
            return partly
    return paced


def exceeds_endurance(plan: Plan) -> bool:
    """Return whether a flight takes longer than its vehicles can fly."""
    return plan.flight_duration > plan.mission.vehicles.endurance


def slowed_for_stops(paced: PacedPlan, times: Floats, excess: Floats) -> PacedPlan:
    """Return the plan flown slower around mission times (k,), where stops excite too much swing.

    ``excess`` (k,) is that swing over what is allowed: it grows like the speed of the vehicles.
    """
    if paced.pacing is None:
        return paced
    fold = paced.plan.phase("fold")
    grid = np.arange(0.0, fold.duration + BIN, BIN)
    most = np.ones(len(grid))
    bins = np.rint((times - fold.start) / BIN).astype(np.intp)
    np.maximum.at(most, np.clip(bins, 0, len(grid) - 1), excess)
    before, after = _STOP_BEFORE, _STOP_AFTER
    padded = np.pad(most, (after, before), constant_values=1.0)
    most = np.lib.stride_tricks.sliding_window_view(padded, before + after + 1).max(axis=1)
    stray = most ** (1.0 / _SWING_EXPONENT)
    pacing = paced.pacing.slowed_for_swing(grid, stray, _SLOWEST_STOPS)
    return _timed(paced.plan, _limited_for_loss(paced.plan, pacing))


def slower(paced: PacedPlan) -> PacedPlan | None:
    """Return the plan timed for the rates of its certificate; None where they are 1 already."""
    limits = PlanChecks.of(paced.plan).limits_ahead
    times, rates = limits.times, limits.rates
    if paced.pacing is None or not len(times) or rates.min() >= 1.0:
        return None
    pacing = paced.pacing.slowed_for_loss(times - paced.plan.phase("fold").start, rates)
    return slowed_for_swing(_timed(paced.plan, _limited_for_loss(paced.plan, pacing)))


def _timed(plan: Plan, pacing: Pacing) -> PacedPlan:
    return PacedPlan(with_fold(plan, _fold(plan, pacing)), pacing)


def swing_limit(plan: Plan) -> float:
    """Return the limit of the swing of a plan's cable, metres: as chosen, or by its segments."""
    chosen = plan.mission.fold.swing
    if chosen != "auto":
        return chosen
    fewer = plan.vehicles < 2 * len(plan.knot.grid_columns) - 1
    share = _AUTO_SHARE_FEWER if fewer else _AUTO_SHARE
    return max(share * float(plan.layout.lengths.max()), _AUTO_LEAST)


def _limited_for_loss(plan: Plan, pacing: Pacing) -> Pacing:
    for _ in range(_LOSS_ROUNDS):
        times, rates = _rates(plan, pacing, FINE_RATES)
        if rates.min() >= 1.0:
            break
        pacing = pacing.slowed_for_loss(times, rates)
    return pacing


def _quicker(plan: Plan, pacing: Pacing) -> Pacing:
    """Return the pacing without slowing that lost setpoints do not need."""
    for _ in range(_QUICKER_ROUNDS):
        pacing = pacing.quicker_for_loss(*_rates(plan, pacing, _QUICKER_RATES))
    return _limited_for_loss(plan, pacing)


def _rates(plan: Plan, pacing: Pacing, tried: tuple[float, ...]) -> tuple[Floats, Floats]:
    """Return times (k,) of the fold from its start, and the rates (k,) that losses allow there."""
    fold = _fold(plan, pacing)
    end = float(fold.times[-1])
    alone = replace(
        plan, motion=fold, phases=(Phase("fold", 0.0, end, "aloft", reversible=True),), gates=()
    )
    return sampled_rates(alone, _LOSS_STEP, _LOSS_MARGIN, tried)


def _fold(plan: Plan, pacing: Pacing) -> Motion:
    limits = plan.mission.vehicles.max_speed, usable_acceleration(plan.mission)
    return slow_to_limits(pacing.shaped, *limits)


def _smooth(rate: Floats, around: int, deviation: float) -> Floats:
    least = scipy.ndimage.minimum_filter1d(rate, around, mode="nearest")
    rates: Floats = scipy.ndimage.gaussian_filter1d(least, deviation, mode="nearest")
    return rates
