"""The certificate of stream losses: margins after the setpoints end, and the clock's rate for them.

A vehicle without setpoints continues with its last velocity until its autopilot's timeout (PX4:
COM_OF_LOSS_T, then Hold or Land; ArduPilot: GUID_TIMEOUT, then it stops) and brakes. Either the
whole team loses its setpoints, or one vehicle does: then the others continue until it has been
silent for the fleet's ``limits.silence``, and stop along their paths. Where a clearance or a chord
would fail, the mission clock's rate is limited: all these distances shrink with it. Rates are
chosen by samples every STEP seconds of the fold, at the ends of these motions and halfway, and then
certified for all times between (:mod:`.stream_loss_bound`), or lowered until they are.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.findings import Finding
from swarm.certification.monitor import Monitor
from swarm.certification.stream_loss_bound import Overrun, StreamLossBound
from swarm.certification.stream_loss_samples import (
    Losses,
    Needed,
    allocate_memory,
    write_margins,
)
from swarm.planning import Plan, digest
from swarm.planning.clock_limits import ClockLimits, clock_limits
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
BRAKING_TIME = 0.3
"""Seconds for which a vehicle that is commanded to stop continues at its speed: both autopilots
brake with about 3 m/s², which takes less at speeds up to 2 m/s."""
_SIDE_BY_SIDE = 100
"""Moments that are computed by several threads: a thread starts in the time of a few of them."""
_SHARES = (0.5, 1.0)
"""Shares of a motion after a loss at which it is sampled."""


@dataclass(frozen=True)
class StreamLossModel:
    """How vehicles behave after a stream loss.

    They continue for ``timeout`` seconds (COM_OF_LOSS_T, GUID_TIMEOUT): one number per vehicle
    along the cable, or one for all. A vehicle that then lands descends by up to ``descent`` metres
    (as many numbers) before the others do. ``silence`` is the time in seconds after which the
    ground station holds the others.
    """

    timeout: tuple[float, ...] = (0.5,)
    silence: float = 0.7
    descent: tuple[float, ...] = (0.0,)

    def overrun(self, plan: Plan) -> Overrun:
        """Return how far the vehicles of a plan move on."""
        coast_time = np.broadcast_to(np.array(self.timeout) + BRAKING_TIME, plan.vehicles)
        descent = np.broadcast_to(np.array(self.descent), plan.vehicles)
        limits = clock_limits(plan.motion, plan.mission.vehicles.braking_acceleration)
        return Overrun(coast_time, BRAKING_TIME, self.silence, limits, descent)


@dataclass(frozen=True)
class WorstLoss:
    """The stream loss with the smallest margin (m): mission time, and the vehicle without setpoints
    (counted from 1; 0: the whole team)."""

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

    ``worst`` is the sample with the smallest margin at the limited rate. ``infeasible`` are the
    times after which even the slowest rate has no margin, or none can be shown. ``model`` is the
    behaviour of the vehicles, ``digest`` that of the plan.
    """

    times: Floats
    rates: Floats
    worst: WorstLoss
    infeasible: Floats
    model: StreamLossModel
    digest: str

    def holds_for(self, plan: Plan, model: StreamLossModel) -> bool:
        """Whether it was computed from exactly this plan and these vehicles."""
        return self.model == model and self.digest == digest(plan)

    def rate_limit(self, time: float) -> float:
        """Return the largest rate at a mission time."""
        if not len(self.times) or not self.times[0] <= time <= self.times[-1]:
            return 1.0
        after = min(int(np.searchsorted(self.times, time)), len(self.times) - 1)
        return float(min(self.rates[after], self.rates[max(after - 1, 0)]))

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
        if len(self.infeasible):
            margin = (
                f"{worst.margin:.2f} m margin" if worst.margin < 0.0 else "no margin can be shown"
            )
            message = (
                f"{margin} for clearances and chords after a stream loss near "
                f"{self.infeasible[0]:.1f} s, even at {RATES[-1]:.0%} of the clock rate (smallest "
                f"for {worst.subject})"
            )
            return [Finding("warning", "stream loss", message, worst.time)]
        message = (
            f"{max(worst.margin, 0.0):.2f} m margin or more for clearances and chords after a "
            f"stream loss in the fold, of one vehicle or of all (smallest for {worst.subject})"
        )
        found = [Finding("info", "stream loss", message, worst.time)]
        limited = self.rates < 1.0
        if limited.any():
            message = (
                f"{self.rates.min():.0%} is the slowest clock rate for that; it is below 100% "
                f"during {limited.mean():.0%} of the fold"
            )
            slowest = float(self.times[int(np.argmin(self.rates))])
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
    """Planner and certificate ask for the same plan, which is told by its digest."""
    plan, model = named.plan, named.model
    fold = [phase for phase in plan.phases if phase.name == "fold" and phase.cable == "aloft"]
    if not fold or plan.vehicles < 2:
        none = np.empty(0)
        return StreamLossCertificate(
            none, none, WorstLoss(np.inf, 0.0, 0), none, model, named.digest
        )
    times = np.append(np.arange(fold[0].start, fold[-1].end, STEP), fold[-1].end)
    overrun = model.overrun(plan)
    rates, margins, vehicles = _sampled_rates(plan, overrun, times, RATES, _Accepted(0.0, -np.inf))
    lost = np.isnan(rates)
    rates[lost] = RATES[-1]
    unshown = _lower(StreamLossBound(plan, overrun, fold[-1].end), times, rates, lost)
    tightest = int(np.argmin(margins))
    return StreamLossCertificate(
        times,
        _reachable(overrun.limits, times, rates),
        WorstLoss(float(margins[tightest]), float(times[tightest]), int(vehicles[tightest])),
        times[lost | unshown],
        model,
        named.digest,
    )


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
    overrun = StreamLossModel().overrun(plan)
    rates = _sampled_rates(plan, overrun, times, tried, _Accepted(margin, margin))[0]
    return times, np.nan_to_num(rates, nan=tried[-1])


class _Accepted(NamedTuple):
    """The ``least`` margin of a rate, and the margin ``exact`` from which on it is exact, metres.

    Below, it is an upper bound.
    """

    least: float
    exact: float


def _sampled_rates(
    plan: Plan, overrun: Overrun, times: Floats, tried: Sequence[float], accepted: _Accepted
) -> tuple[Floats, Floats, Ints]:
    """Return the fastest of the rates with an accepted margin, NaN for none, at times (k,).

    Also the margins (k,) at these rates, and the vehicles (k,) without setpoints that have them.
    """
    rates = np.full(len(times), np.nan)
    margins, vehicles = np.full(len(times), -np.inf), np.zeros(len(times), dtype=np.intp)
    for rate in tried:
        open_ = np.flatnonzero(np.isnan(rates))
        if not len(open_):
            break
        margin, vehicle = _margins(plan, overrun, times[open_], rate, accepted.exact)
        better = margin > margins[open_]
        margins[open_[better]], vehicles[open_[better]] = margin[better], vehicle[better]
        rates[open_[margin >= accepted.least]] = rate
    return rates, margins, vehicles


def _margins(
    plan: Plan, overrun: Overrun, times: Floats, rate: float, exact: float
) -> tuple[Floats, Ints]:
    """Return the margins (k,), and the vehicles (k,) without setpoints that have them."""
    margins, vehicles = np.empty(len(times)), np.empty(len(times), dtype=np.intp)

    def write(some: slice) -> None:
        monitor = Monitor(plan)
        needed = Needed(monitor.required, plan.mission.cable.diameter, exact)
        margin, vehicle = np.empty(len(times[some])), np.empty(len(times[some]), dtype=np.intp)
        losses = _losses(plan, times[some], rate, overrun)
        write_margins(losses, needed, allocate_memory(monitor), margin, vehicle)
        margins[some], vehicles[some] = margin, vehicle

    # every other moment, because those that take long are next to each other
    count = usual_threads() if len(times) >= _SIDE_BY_SIDE else 1
    for _ in side_by_side(write, [slice(k, None, count) for k in range(count)], threads=count):
        pass
    return margins, vehicles


def _reachable(limits: ClockLimits, times: Floats, rates: Floats) -> Floats:
    """Lower rates ahead of limits, so that ordinary braking reaches each limit in time.

    The clock's rate r changes by at most d per second; along mission time r dr/dτ = d.
    """
    limited = rates.copy()
    for k in range(len(times) - 2, -1, -1):
        slope = min(limits.at(time, urgent=False) for time in (times[k], times[k + 1]))
        gain = 2.0 * slope * (times[k + 1] - times[k])
        limited[k] = min(limited[k], float(np.sqrt(limited[k + 1] ** 2 + gain)))
    return limited


def _losses(plan: Plan, times: Floats, rate: float, overrun: Overrun) -> Losses:
    """Return the sampled positions after losses at ``times`` (k,) and a clock rate."""
    position, velocity, _ = plan.motion.at(times)
    # The team continues until the silence is detected; then the clock's rate falls to zero.
    advance = overrun.advance(times, np.array(rate))
    end = next(phase.end for phase in plan.phases if phase.name == "fold")
    after = np.array(_SHARES)
    team = plan.motion.at(np.minimum(times + after[:, None] * advance, end))[0]
    moved = overrun.coast_time[:, None] * (rate * velocity)
    return Losses(position, moved, np.array(overrun.descent), team, after)
