"""What if the setpoints end here: how far everybody coasts, and how fast the team may be for it.

A vehicle without setpoints flies on with its last velocity until its autopilot notices (PX4:
COM_OF_LOSS_T, then Hold or Land; ArduPilot: GUID_TIMEOUT, then it stops) and brakes. Either all
lose their setpoints, or one does: then the others go on until it has been silent for the fleet's
``limits.silence``, and stop along their paths. Where a clearance or a chord would not survive, the
mission clock's rate is capped: all of these distances shrink with it. Rates are chosen by looking
every STEP seconds of the fold, at the ends of these motions and on the way, and then shown to do
for all times in between (:mod:`.stream_loss_bound`), or lowered until they are.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.findings import Finding
from swarm.certification.limits import TAUT
from swarm.certification.monitor import Monitor
from swarm.certification.stream_loss_bound import CoastBound, Ways
from swarm.mission import Mission
from swarm.planning import CableState, Plan, digest

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

STEP = 0.5
"""Seconds of mission time between the moments that are looked at."""
RATES = (1.0, 0.85, 0.72, 0.61, 0.52, 0.45, 0.38, 0.34, 0.3)
"""Rates of the clock that are tried, fastest first."""
BRAKING = 0.3
"""Seconds for which a vehicle that is told to stop moves on at its speed: both autopilots brake
with about 3 m/s², which takes less at speeds up to 2 m/s."""
_ON_THE_WAY = (0.5, 1.0)
"""Shares of a motion at which it is looked at."""
_LEVERAGE = 5.0
"""Metres by which strands can come closer for each metre that an end moves, and more: a sag grows
up to threefold where the chord shrinks, at the chords that are allowed."""
_PORTION = 128


@dataclass(frozen=True)
class StreamLossModel:
    """What decides how vehicles coast.

    After a lost stream they move on for ``timeout`` seconds (COM_OF_LOSS_T, GUID_TIMEOUT): one
    number per vehicle along the cable, or one for all. A vehicle that then lands descends by up to
    ``descent`` metres (as many numbers) before the others do. ``silence`` is the time in seconds
    after which the ground station holds the others.
    """

    timeout: tuple[float, ...] = (0.5,)
    silence: float = 0.7
    descent: tuple[float, ...] = (0.0,)

    def ways(self, mission: Mission, n: int) -> Ways:
        """Return how far each of n vehicles goes on."""
        vehicles = mission.vehicles
        steepest = vehicles.braking_acceleration / vehicles.max_speed
        after = np.broadcast_to(np.array(self.timeout) + BRAKING, n)
        sinking = np.broadcast_to(np.array(self.descent), n)
        return Ways(after, BRAKING, self.silence, steepest, sinking)


@dataclass(frozen=True)
class WorstLoss:
    """The moment at which least is left: margin in metres, mission time, and who coasts there
    (counted from 1; 0: everybody)."""

    margin: float
    time: float
    vehicle: int


@dataclass(frozen=True, eq=False)
class StreamLossCertificate:
    """The largest rate (k,) of the mission clock at mission times (k,), for lost setpoints.

    ``worst`` is the moment with the smallest margin at the capped rate, of those that were looked
    at; ``infeasible`` are the times from which on even the slowest rate leaves none, or none could
    be shown to be left; ``model`` is what it holds for, ``digest`` of which plan.
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
        """By how much longer the fold takes at these rates, seconds."""
        if not len(self.times):
            return 0.0
        slower = np.minimum(self.rates[1:], self.rates[:-1])
        return float(np.sum(np.diff(self.times) * (1.0 / slower - 1.0)))

    def findings(self) -> list[Finding]:
        """Return what a plan's reader must know of it."""
        if not len(self.times):
            return []
        who = f"vehicle {self.worst.vehicle}" if self.worst.vehicle else "the whole team"
        words = (
            f"whenever setpoints end in the fold, for all or for one, clearances and chords are "
            f"kept; least is left where {who} loses them, {max(self.worst.margin, 0.0):.2f} m"
        )
        if len(self.infeasible):
            lost = self.worst.margin
            what = f"is lost by {-lost:.2f} m" if lost < 0.0 else "cannot be shown to be kept"
            return [
                Finding(
                    "warning", "stream loss",
                    f"if setpoints end near {self.infeasible[0]:.1f} s, for all or for one, a "
                    f"clearance or chord {what} even at {RATES[-1]:.0%} of the pace ({who})",
                    self.worst.time,
                )
            ]  # fmt: skip
        found = [Finding("info", "stream loss", words, self.worst.time)]
        capped = self.rates < 1.0
        if capped.any():
            slowest = float(self.rates.min())
            found.append(
                Finding(
                    "info", "stream loss",
                    f"for that the clock runs at {slowest:.0%} at least and below 100% during "
                    f"{capped.mean():.0%} of the fold",
                    float(self.times[int(np.argmin(self.rates))]),
                )
            )  # fmt: skip
        return found


def certify_stream_loss(
    plan: Plan, model: StreamLossModel = StreamLossModel()
) -> StreamLossCertificate:
    """Work out what the ends of all and of single streams do at every moment of the fold."""
    fold = [one for one in plan.phases if one.name == "fold" and one.cable == "aloft"]
    if not fold or plan.vehicles < 2:
        nothing = np.empty(0)
        return StreamLossCertificate(
            nothing, nothing, WorstLoss(np.inf, 0.0, 0), nothing, model, digest(plan)
        )
    times = np.append(np.arange(fold[0].start, fold[-1].end, STEP), fold[-1].end)
    monitor = Monitor(plan)
    ways = model.ways(plan.mission, plan.vehicles)
    rates = np.full(len(times), np.nan)
    margins, whose = np.full(len(times), -np.inf), np.zeros(len(times), dtype=np.intp)
    for rate in RATES:
        open_ = np.flatnonzero(np.isnan(rates))
        if not len(open_):
            break
        left, who = _margins(plan, monitor, times[open_], rate, ways)
        better = left > margins[open_]
        margins[open_[better]], whose[open_[better]] = left[better], who[better]
        rates[open_[left >= 0.0]] = rate
    lost = np.isnan(rates)
    rates[lost] = RATES[-1]
    unshown = _lowered(CoastBound(plan, ways, fold[-1].end), times, rates, lost)
    tightest = int(np.argmin(margins))
    worst = WorstLoss(float(margins[tightest]), float(times[tightest]), int(whose[tightest]))
    return StreamLossCertificate(
        times, _reachable(plan.mission, times, rates), worst, times[lost | unshown], model,
        digest(plan),
    )  # fmt: skip


def _lowered(bound: CoastBound, times: Floats, rates: Floats, lost: Flags) -> Flags:
    """Lower rates (k,) in place until they do for all times; return from which times on none does.

    Between two times the clock runs at the lower of their rates.
    """
    unshown = np.zeros(len(times), dtype=np.bool_)
    open_ = np.flatnonzero(~(lost[:-1] | lost[1:]))
    while len(open_):
        fastest = np.minimum(rates[open_], rates[open_ + 1])
        kept = bound.keeps(times[open_], times[open_ + 1], fastest)
        open_, fastest = open_[~kept], fastest[~kept]
        slowest = fastest <= RATES[-1]
        unshown[open_[slowest]] = True
        open_, fastest = open_[~slowest], fastest[~slowest]
        for k, rate in zip(open_, fastest, strict=True):
            rates[k] = min(rates[k], max(slower for slower in RATES if slower < rate))
    return unshown


def _reachable(mission: Mission, times: Floats, rates: Floats) -> Floats:
    """Lower rates ahead of caps, so that braking along the path reaches each cap in time.

    The clock's rate changes by at most b / v per second; along mission time r dr/dτ = b / v.
    """
    steepest = mission.vehicles.braking_acceleration / mission.vehicles.max_speed
    capped = rates.copy()
    for k in range(len(times) - 2, -1, -1):
        room = 2.0 * steepest * (times[k + 1] - times[k])
        capped[k] = min(capped[k], float(np.sqrt(capped[k + 1] ** 2 + room)))
    return capped


def _margins(
    plan: Plan, monitor: Monitor, times: Floats, rate: float, ways: Ways
) -> tuple[Floats, npt.NDArray[np.intp]]:
    """Smallest margins (k,) after the ends of streams at ``times``, and who lost them (0: all)."""
    position, velocity, _ = plan.motion.at(times)
    smallest = np.full(len(times), np.inf)
    who = np.zeros(len(times), dtype=np.intp)
    nearest: dict[bytes, Floats] = {}
    for number, planned, places in _ends(plan, times, rate, position, rate * velocity, ways):
        key = planned.tobytes()
        if key not in nearest:
            nearest[key] = _look(monitor, planned, "aloft")[0]
        off = np.linalg.norm(places - planned, axis=2).max(axis=1)
        left = _apart(plan, monitor, places)
        # strands that are far apart in the plan stay so when their ends move a little
        close = (left > 0.0) & (nearest[key] - _LEVERAGE * off < plan.mission.clearance.cable)
        left[close] = _look(monitor, places[close], "aloft")[1]
        less = left < smallest
        smallest[less], who[less] = left[less], number
    return smallest, who


def _look(monitor: Monitor, places: Floats, cable: CableState) -> tuple[Floats, Floats]:
    """Return the distances between strands (k,) and the smallest margins (k,)."""
    seen = [
        one
        for k in range(0, len(places), _PORTION)
        for one in monitor.clearances(places[k : k + _PORTION], cable)
    ]
    return np.array([one.cable for one in seen]), np.array([one.margin for one in seen])


def _apart(plan: Plan, monitor: Monitor, places: Floats) -> Floats:
    """Smallest margins (k,) of chords and between vehicles."""
    chords = np.linalg.norm(np.diff(places, axis=1), axis=2)
    slack = (TAUT * plan.layout.lengths - chords).min(axis=1, initial=np.inf)
    between: Floats = np.minimum(_look(monitor, places, "free")[1], slack)
    return between


def _ends(
    plan: Plan, times: Floats, rate: float, position: Floats, velocity: Floats, ways: Ways
) -> Sequence[tuple[int, Floats, Floats]]:
    """Who loses the stream (0: all, else the vehicle), where the plan has everybody (k, n, 3), and
    the places (k, n, 3) to look at."""
    moved = ways.after[:, None] * velocity
    found = [(0, position, position + share * moved) for share in (0.0, *_ON_THE_WAY)]
    # until the silence is noticed the team goes on; then the clock's rate falls to zero
    on = float(ways.on(np.array(rate)))
    end = next(phase.end for phase in plan.phases if phase.name == "fold")
    for share in _ON_THE_WAY:
        team = plan.motion.at(np.minimum(times + share * on, end))[0]
        for k in range(plan.vehicles):
            places = team.copy()
            places[:, k] = position[:, k] + share * moved[:, k]
            places[:, k, 2] -= share * ways.sinking[k]
            found.append((k + 1, team, places))
    return found
