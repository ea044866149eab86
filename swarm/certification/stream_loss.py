"""The certificate of stream losses: margins after the setpoints end, and the clock's rate for them.

A vehicle without setpoints continues with its last velocity until its autopilot's timeout (PX4:
COM_OF_LOSS_T, then Hold or Land; ArduPilot: GUID_TIMEOUT) and brakes; ArduPilot then returns to
where it was at the timeout, which is its last target (``posvelaccel_control_run``). Either the
whole team loses its setpoints, or one vehicle does: then the others continue until it has been
silent for the fleet's ``limits.silence``, and stop along their paths. Where a clearance or a chord
would fail, the mission clock's rate is limited: all these distances shrink with it. Rates are
chosen by samples every STEP seconds of the fold, at the ends of these motions and halfway, and then
certified for all times between (:mod:`.stream_loss_bound`), or lowered until they are: for every
steady rate up to the limit. A clock that runs backwards has limits of its own, those of the
reversed motion. All clearances of :mod:`.team_margins` count, of vehicles that were exactly on the
plan, and of cable that hangs still.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from swarm.certification.findings import Finding
from swarm.certification.stream_loss_bound import Overrun, StreamLossBound
from swarm.certification.stream_loss_samples import Losses, allocate_memory, write_margins
from swarm.certification.team_margins import required_of
from swarm.geometry.motion import reverse
from swarm.planning import Plan, digest
from swarm.planning.clock_limits import BANDWIDTH, SMOOTH, ClockLimits, clock_limits
from swarm.threads import side_by_side, usual_threads

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]

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
        found = [Finding("info", "stream loss", message, worst.time)]
        for rates, rewind in ((self.rates, ""), (self.rewind_rates, " of a rewind")):
            limited = rates < 1.0
            if limited.any():
                message = (
                    f"{rates.min():.0%} is the slowest clock rate{rewind} for that; it is below "
                    f"100% during {limited.mean():.0%} of the fold"
                )
                slowest = float(self.times[int(np.argmin(rates))])
                found.append(Finding("info", "stream loss", message, slowest))
        return found


def certify_stream_loss(
    plan: Plan, model: StreamLossModel = StreamLossModel()
) -> StreamLossCertificate:
    """Return the certificate of stream losses, of all or of single vehicles, during the fold."""
    return _certificate_of(_Named(digest(plan), model, plan))


@dataclass(frozen=True)
class _Named:
    digest: str
    model: StreamLossModel
    plan: Plan = field(compare=False)


@lru_cache(maxsize=4)
def _certificate_of(named: _Named) -> StreamLossCertificate:
    """Certificate and fleet ask for the same plan, which is told by its digest."""
    plan, model, fold = named.plan, named.model, _fold(named.plan)
    if fold is None:
        none = np.empty(0)
        return StreamLossCertificate(
            none, none, none, WorstLoss(np.inf, 0.0, 0), none, model, named.digest
        )
    start, end, reversible = fold
    times, ahead = _times(start, end), _ahead_of(named)
    if not reversible:
        return StreamLossCertificate(
            times, ahead.rates, np.ones(len(times)), ahead.worst, times[ahead.infeasible], model,
            named.digest,
        )  # fmt: skip
    # mission time t is ``turned`` − t of the reversed motion
    turned = float(plan.motion.times[0] + plan.motion.times[-1])
    back = _limits_of(
        replace(plan, motion=reverse(plan.motion)), model, turned - times[::-1], turned - start
    )
    worst = replace(back.worst, time=turned - back.worst.time)
    return StreamLossCertificate(
        times, ahead.rates, back.rates[::-1], min(ahead.worst, worst, key=lambda one: one.margin),
        times[ahead.infeasible | back.infeasible[::-1]], model, named.digest,
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


def _times(start: float, end: float) -> Floats:
    return np.append(np.arange(start, end, STEP), end)


def rates_ahead(plan: Plan) -> tuple[Floats, Floats]:
    """Return the times (k,) and rates (k,) of a plan's certificate, for a clock that runs on.

    In half of its time; none without a fold.
    """
    fold = _fold(plan)
    if fold is None:
        return np.empty(0), np.empty(0)
    ahead = _ahead_of(_Named(digest(plan), StreamLossModel(), plan))
    return _times(fold[0], fold[1]), ahead.rates


class _Limits(NamedTuple):
    """Rates (k,) in one direction of the clock, the worst loss, and which (k,) are infeasible."""

    rates: Floats
    worst: WorstLoss
    infeasible: Flags


@lru_cache(maxsize=4)
def _ahead_of(named: _Named) -> _Limits:
    """Planner and certificate ask for the same plan, which is told by its digest."""
    fold = _fold(named.plan)
    if fold is None:
        raise ValueError("a plan without a fold has no limits for lost setpoints")
    start, end, _ = fold
    return _limits_of(named.plan, named.model, _times(start, end), end)


def _limits_of(plan: Plan, model: StreamLossModel, times: Floats, end: float) -> _Limits:
    """Return the limits of a clock that runs on along a plan's motion, no farther than ``end``."""
    overrun = model.overrun(plan, (float(times[0]), end))
    accepted = _Accepted(_FOUND, exact=True)
    rates, margins, vehicles = _sampled_rates(plan, overrun, (times, end), RATES, accepted)
    lost = np.isnan(rates)
    rates[lost] = RATES[-1]
    unshown = _lower(StreamLossBound(plan, overrun, end), times, rates, lost)
    tightest = int(np.argmin(margins))
    worst = WorstLoss(float(margins[tightest]), float(times[tightest]), int(vehicles[tightest]))
    return _Limits(_reachable(overrun.limits, times, rates), worst, lost | unshown)


def _lower(bound: StreamLossBound, times: Floats, rates: Floats, lost: Flags) -> Flags:
    """Lower rates (k,) in place until they are certified; return after which times none is.

    Between two times the clock runs at the lower of their rates.
    """
    unshown = np.zeros(len(times), dtype=np.bool_)
    open_ = np.flatnonzero(~(lost[:-1] | lost[1:]))
    while len(open_):
        fastest = np.minimum(rates[open_], rates[open_ + 1])
        holds = bound.holds(times[open_], times[open_ + 1], fastest)
        open_, fastest = open_[~holds], fastest[~holds]
        slowest = fastest <= RATES[-1]
        unshown[open_[slowest]] = True
        open_, fastest = open_[~slowest], fastest[~slowest]
        for k, rate in zip(open_, fastest, strict=True):
            rates[k] = min(rates[k], max(slower for slower in RATES if slower < rate))
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
