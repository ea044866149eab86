"""The smallest clearances of a plan over continuous time, for all tracking errors in the radius.

"Certified" means: in the quasi-static cable model, every segment the catenary of its length between
its two grip points; and with ``fold.swing`` in metres, in the tube around it, too
(:class:`.TubeRadii`).

Theory of operation. A *margin* is a distance less the required one. Each kind of clearance is a row
of the table :data:`.KINDS`, which makes a :class:`.Family` for a plan: its pairs of objects, the
spans of mission time in which it applies, and an evaluator. The evaluator gets boxes, each an
interval of time, in wind also of both parts of the tilt, and for strands of the fractions along
them, and returns for each box a lower bound of the margin in the whole box, and a margin that
occurs in it. The tracking ball, swing and wind are part of the bound, so that a box with a bound
above 0 needs no further proof.

:func:`families` walks that table. :func:`certified` asks whether every margin is kept,
:func:`tightest_moments` measures the smallest of each kind for the certificate, :func:`violations`
returns where margins fail, second by second, for the repair of a plan. A new
kind is a row with an evaluator; repairs, monitor, reports and pages walk the same table.
:class:`PlanChecks` is what all checks of one plan compute, each once.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache, partial
from itertools import chain

import numpy as np
import numpy.typing as npt

from swarm.certification.air import wind_tilt
from swarm.certification.branch_and_bound import Boxes
from swarm.certification.cable_spans import CableSpans, cable_spans
from swarm.certification.kinds import KINDS, ROOT, Family, Kind
from swarm.certification.minima import (
    Minima,
    boxes_of,
    most_steps,
    smallest,
    smallest_in_boxes,
)
from swarm.certification.motion_bounds import BoundedMotion
from swarm.certification.strand_pieces import HeldCable, TubeRadii
from swarm.certification.stream_loss import (
    RateLimits,
    StreamLossCertificate,
    StreamLossModel,
    certify_stream_loss,
    limits_ahead,
)
from swarm.certification.swing_runs import ORDINARY_COURSES
from swarm.certification.swing_tube import PairSwing, Swings, SwingTube
from swarm.planning import Plan, digest
from swarm.threads import both, side_by_side

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Place = tuple[float, float, float]
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Moment:
    """The tightest moment of two objects.

    ``distance`` is the certified lower bound over the whole plan, within the tracking radius, and
    ``required`` the required distance, both in metres. It was found at ``time`` near ``where``. The
    distance is −∞ where no bound was found. ``flown`` is the key of :attr:`.Kind.flown`.
    """

    check: str
    between: tuple[str, str]
    distance: float
    required: float
    time: float
    where: Place
    flown: str = ""

    @property
    def margin(self) -> float:
        """Distance less the required distance; negative where the check fails."""
        return self.distance - self.required


@dataclass(frozen=True)
class Robustness:
    """e* (largest tracking error, m) and w* (largest steady wind, m/s); None where unknown."""

    tracking: float | None = None
    wind: float | None = None


_DEFAULT = StreamLossModel()

_DISTANCES = tuple(kind for kind in KINDS if kind.unit == "m")
_LIMITS = tuple(kind for kind in KINDS if kind.unit != "m")

_LATEST = 5
"""Plans whose checks are remembered: the timings of one that the planner compares. Their swings
take 0.1 GB each for the Carrick mat."""


@dataclass(unsafe_hash=True)
class PlanChecks:
    """What the checks of a plan compute, each once, when it is first asked for; from :meth:`of`.

    Planner, certificate and flight ask for the same plan, one after the other: it is told by its
    ``digest``, because the arrays of a plan are writable.
    """

    digest: str
    plan: Plan = field(compare=False, repr=False)
    _certificates: dict[StreamLossModel, StreamLossCertificate] = field(
        default_factory=dict, compare=False, repr=False
    )
    _moments: tuple[Moment, ...] | None = field(default=None, compare=False, repr=False)

    @staticmethod
    def of(plan: Plan) -> "PlanChecks":
        """Return the checks of a plan; the same for the same plan, among the latest ones."""
        return _first_of_equal(PlanChecks(digest(plan), plan))

    @cached_property
    def spans(self) -> CableSpans:
        """The spans of time in which the cable is held."""
        return cable_spans(self.plan)

    @cached_property
    def motion(self) -> BoundedMotion:
        """The motion with its bounds."""
        return BoundedMotion(self.plan.motion)

    def moments(self, progress: Progress | None = None) -> tuple[Moment, ...]:
        """Return the tightest moments for the mission's tracking errors.

        ``progress`` is called with the name of the stage and the share of it that is done.
        """
        if self._moments is None:
            self._moments = tightest_moments(self.plan, progress=progress)
        return self._moments

    @cached_property
    def planned_swings(self) -> Swings | None:
        """The swings in the planned motion, with which all others begin; None without a tube."""
        return Swings.planned_in(self.plan)

    @cached_property
    def some_swings(self) -> Swings | None:
        """Those, and the swings after the first of the ordinary stops and resumes."""
        planned = self.planned_swings
        return None if planned is None else planned.after(ORDINARY_COURSES[:1])

    @cached_property
    def ordinary_swings(self) -> Swings | None:
        """Those, and the swings after all ordinary stops and resumes."""
        some = self.some_swings
        return None if some is None else some.after(ORDINARY_COURSES[1:])

    @cached_property
    def ordinary_tube(self) -> TubeRadii | None:
        """:attr:`.SwingTube.ordinary` of the tube, without the other changes."""
        swings = self.ordinary_swings
        return None if swings is None else swings.radii

    @property
    def certified_tube(self) -> TubeRadii | None:
        """The tube in which the clearances of a plan hold; None where it is quasi-static.

        It is that of the planned motion, ordinary stops and resumes: the budget counts urgent stops
        and rewinds, for strands. With ``fold.swing: auto`` the swing is not certified, since no
        limit was asked for.
        """
        return self.ordinary_tube if self.plan.mission.fold.certifies_swing else None

    @cached_property
    def tube(self) -> SwingTube | None:
        """The tube of the cable from the beginning of the fold to the end of its flight.

        None for a plan without a fold of cable, and where a chord exceeds its cable, which the
        checks of lengths report.
        """
        ordinary, swings = self.ordinary_tube, self.ordinary_swings
        # 0.1 GB for the Carrick mat, which the tube takes over
        for name in ("planned_swings", "some_swings", "ordinary_swings"):
            vars(self).pop(name, None)
        return None if swings is None or ordinary is None else swings.tube(ordinary)

    def swing_after_urgent_stops(self) -> PairSwing | None:
        """Return the part of :attr:`.SwingTube.pairs` that urgent stops of near pairs make.

        See :meth:`.Swings.near_pairs_after_urgent_stops`; None where there is no tube.
        """
        certified = self.plan.mission.fold.certifies_swing
        # those of all strands only where they are known already: near pairs take less time alone
        known = [name for name in ("ordinary_swings", "some_swings") if name in vars(self)]
        begun: Swings | None = getattr(self, known[0]) if certified and known else None
        begun = begun or self.planned_swings
        if begun is None:
            return None
        return begun.near_pairs_after_urgent_stops(ordinary=certified and not known)

    @cached_property
    def limits_ahead(self) -> RateLimits:
        """The limits of a clock that runs on, for stream losses, in half of the time that their
        certificate takes."""
        return limits_ahead(self.plan, _DEFAULT)

    def stream_loss(
        self,
        model: StreamLossModel = _DEFAULT,
        progress: Callable[[float], None] = lambda _: None,
    ) -> StreamLossCertificate:
        """Return :func:`.certify_stream_loss` of these vehicles."""
        if model not in self._certificates:
            ahead = (lambda: self.limits_ahead) if model == _DEFAULT else None
            self._certificates[model] = certify_stream_loss(
                self.plan, model, ahead, progress=progress
            )
        return self._certificates[model]


@lru_cache(maxsize=_LATEST)
def _first_of_equal(checks: PlanChecks) -> PlanChecks:
    return checks


def tightest_moments(
    plan: Plan,
    *,
    tracking: float | None = None,
    tilt: float = 0.0,
    checks: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> tuple[Moment, ...]:
    """Return the tightest moments of each kind of clearance, at most five per kind.

    ``tracking`` replaces the mission's; ``tilt`` is the largest one of the effective gravity, in
    any direction (:func:`.air.wind_tilt`); ``checks`` selects kinds (default: all).
    """
    if tracking is None:
        tracking = plan.mission.vehicles.tracking
    chosen = [
        family
        for family in families(plan, tracking, tilt)
        if checks is None or family.check in checks
    ]
    tightest: list[Moment] = []
    for done, moments in enumerate(side_by_side(moments_of, chosen)):
        if progress:
            progress("certificate", done / len(chosen))
        tightest += moments
    if progress:
        progress("certificate", 1.0)
    return tuple(tightest)


def violations(plan: Plan, *, swinging: bool = True, radii: float = 1.0) -> tuple[Moment, ...]:
    """Return the moments at which clearances do not hold, for some ``radii`` of tracking errors.

    For every pair, the worst moment of every second or less in which it fails, for the repair.
    Where clearances fail after a part of the ordinary stops already, the others are not simulated.
    Without ``swinging``, the cable is quasi-static, with ``fold.swing`` in metres too.
    """
    checks = PlanChecks.of(plan)
    if not swinging:
        return _failing(plan, None, radii)
    if plan.mission.fold.certifies_swing and "ordinary_swings" not in vars(checks):
        some = checks.some_swings
        failing = () if some is None else _failing(plan, some.radii, radii)
        if failing:
            return failing
    return _failing(plan, checks.certified_tube, radii)


def violations_in_wind(plan: Plan, speed: float) -> tuple[Moment, ...]:
    """Return the moments at which clearances do not hold in every steady wind up to a speed, m/s.

    As :func:`violations`, of the clearances that winds change; none without wind.
    """
    every = _in_wind(plan, speed) if speed else ()
    return tuple(chain.from_iterable(side_by_side(_violations, every)))


def _failing(plan: Plan, tube: TubeRadii | None, radii: float) -> tuple[Moment, ...]:
    every = _within(plan, tube, radii * plan.mission.vehicles.tracking, 0.0, _DISTANCES)
    return tuple(chain.from_iterable(side_by_side(_violations, every)))


def _violations(family: Family) -> list[Moment]:
    seconds, initial = family.doubtful()
    minima = smallest_in_boxes(family.evaluate, seconds, initial, family.tolerance)
    failing = np.flatnonzero(minima.low < 0.0)
    return [_moment(family, int(seconds.group[k]), minima, int(k)) for k in failing]


def certified(plan: Plan, *, tracking: float, tilt: float = 0.0) -> bool:
    """Return whether every clearance holds with a tracking radius and tilts up to the largest.

    Much faster than :func:`tightest_moments`, which measures margins.
    """
    return not PlanChecks.of(plan).spans.problems and all(
        failing is None for failing in side_by_side(Family.failing, families(plan, tracking, tilt))
    )


def moments_of(family: Family) -> list[Moment]:
    """Return up to five tightest moments of a family, tightest first, to its tolerance."""
    minima = smallest(
        family.evaluate, len(family.names), family.roots(), tolerance=family.tolerance
    )
    moments: list[Moment] = []
    for pair in minima.tightest():
        if family.names[pair] in (moment.between for moment in moments):
            continue  # neighbours have two entries; the tighter one came first
        moments.append(_moment(family, pair, minima, pair))
    return moments


def _moment(family: Family, pair: int, minima: Minima, entry: int) -> Moment:
    x, y, z = (float(value) for value in np.nan_to_num(minima.place[entry]))
    return Moment(
        check=family.check,
        between=family.names[pair],
        distance=float(minima.low[entry]) + family.required,
        required=family.required,
        time=float(minima.time[entry]),
        where=(x, y, z),
        flown=family.kind.flown,
    )


def families(
    plan: Plan, tracking: float, tilt: float = 0.0, kinds: Iterable[Kind] = _DISTANCES
) -> tuple[Family, ...]:
    """Return all non-empty families of a plan, with their spans and required distances.

    Distances of hanging cable hold for every tilt of the effective gravity up to the largest, of
    any heading, the same for all segments. The cable swings within the
    :attr:`.PlanChecks.certified_tube`.
    """
    return _within(plan, PlanChecks.of(plan).certified_tube, tracking, tilt, kinds)


def _within(
    plan: Plan, tube: TubeRadii | None, tracking: float, tilt: float, kinds: Iterable[Kind]
) -> tuple[Family, ...]:
    """Return :func:`families` where the cable swings within a tube, or is quasi-static."""
    checks = PlanChecks.of(plan)
    cable = HeldCable(checks.motion, plan.layout.lengths, tracking, tilt, tube)
    return _families(plan, checks.spans, cable, kinds)


def limits(plan: Plan) -> tuple[Family, ...]:
    """Return the limits of vehicles' motion, with margins in m/s and m/s².

    Every piece of the motion is a span of its own, since jerk is bounded within pieces only.
    """
    checks = PlanChecks.of(plan)
    cable = HeldCable(checks.motion, plan.layout.lengths, 0.0)
    return _families(plan, checks.spans, cable, _LIMITS)


def _families(
    plan: Plan, spans: CableSpans, cable: HeldCable, kinds: Iterable[Kind]
) -> tuple[Family, ...]:
    """Return the non-empty families of these kinds."""
    every = (kind.family(plan, spans, cable) for kind in kinds)
    return tuple(family for family in every if family is not None)


MOST_TRACKING = 1.0
"""Largest tracking error that is tried, metres: as large as the default clearance of vehicles."""
TRACKING_STEP = 0.0002
"""Resolution of e*, metres: a fiftieth of the last digit that is shown."""
MOST_WIND = 15.0
"""Largest wind that is tried, m/s (Beaufort 7)."""
WIND_STEP = 0.005
"""Resolution of w*, m/s: a twentieth of the last digit that is shown."""
_FIRST, _GUESS = 64, 8192
"""Steps that are tried first, and boxes of a kind of clearance that are searched for a guess."""


def robustness_of(
    plan: Plan, moments: Iterable[Moment], progress: Progress | None = None
) -> Robustness:
    """Return e* and w* of a plan with its tightest moments; ``progress`` is called for both."""
    moments = tuple(moments)
    stage = "largest tracking error and steady wind"
    if progress:
        progress(stage, 0.0)
    largest: list[float | None] = []
    searches = largest_tracking, largest_wind
    for value in side_by_side(lambda search: search(plan, moments), searches):
        largest.append(value)
        if progress:
            progress(stage, len(largest) / len(searches))
    tracking, wind = largest
    return Robustness(tracking, wind)


def largest_tracking(plan: Plan, moments: Iterable[Moment] = ()) -> float | None:
    """Return e*, metres: the largest tracking radius for which the certificate holds.

    Found to TRACKING_STEP from below, so the certificate does hold there, and for smaller errors,
    which the radius contains; at most MOST_TRACKING.
    None where it does not even hold for exact tracking. The tightest ``moments`` for the mission's
    own tracking radius are optional and make the search faster.
    """
    moments = tuple(moments)
    shown = plan.mission.vehicles.tracking if _all_hold(moments) else -TRACKING_STEP
    largest = _largest(partial(families, plan), moments, shown, MOST_TRACKING, TRACKING_STEP)
    return largest if largest >= 0.0 else None


def largest_wind(plan: Plan, moments: Iterable[Moment] = ()) -> float | None:
    """Return w*, m/s: the certificate holds in every steady wind up to it, of any heading.

    All freely hanging strands tilt equally, with the drag of strands across the wind, at the
    mission's tracking radius, and keep their distance from each other, from vehicles, floor and
    fence; at most MOST_WIND. None where the certificate does not hold in still air. ``moments`` as
    for :func:`largest_tracking`.
    """
    moments = tuple(moments)
    if not _all_hold(moments) and failure_in_wind(plan, 0.0) is not None:
        return None
    return _largest(partial(_in_wind, plan), moments, 0.0, MOST_WIND, WIND_STEP)


def confirmed(plan: Plan, recorded: Robustness) -> Robustness:
    """Return the recorded e* and w* for which the certificate holds; None in place of the others.

    One search each, without looking for larger values: about half of the time to compute them.
    """
    tracking, wind = recorded.tracking, recorded.wind
    held, calm = both(
        lambda: tracking is not None and certified(plan, tracking=tracking),
        lambda: wind is not None and failure_in_wind(plan, wind) is None,
    )
    return Robustness(tracking if held else None, wind if calm else None)


def failure_in_wind(plan: Plan, speed: float) -> tuple[str, tuple[str, str], float] | None:
    """Return the first check that fails in a steady wind up to ``speed`` (m/s), pair and time.

    At the mission's tracking radius, for all headings; None where all checks hold.
    """
    for family in _in_wind(plan, speed):
        failure = family.failing()
        if failure is not None:
            return family.check, family.names[failure[0]], failure[1]
    return None


def _in_wind(plan: Plan, speed: float, kinds: Iterable[Kind] = _DISTANCES) -> tuple[Family, ...]:
    """Return the checks in still air, or those that winds up to a speed change.

    Wind does not move vehicles here.
    """
    changed = kinds if speed == 0.0 else [kind for kind in kinds if kind.wind]
    return families(plan, plan.mission.vehicles.tracking, wind_tilt(plan, speed), changed)


def _largest(
    checks: Callable[..., tuple[Family, ...]],
    moments: tuple[Moment, ...],
    shown: float,
    most: float,
    step: float,
) -> float:
    """Return the largest value up to ``most`` at which the checks hold, in steps from ``shown`` on.

    They are taken to hold there, where they are not made. Every kind is first searched at its
    tight ``moments``, for ever larger values until one does not hold. Then all boxes are searched:
    of the kinds with the fewest coordinates first, and of those where the value fell last.
    """
    steps = max(math.floor((most - shown) / step), 0)
    kinds = [family.kind for family in checks(shown + steps * step)]
    order = list(kinds)
    at = cache(lambda kind, steps: checks(shown + steps * step, kinds=(kind,))[0])

    def kept(kind: Kind, steps: int, guess: int | None) -> int:
        if steps == 0:
            return 0
        family = at(kind, steps)
        boxes, initial = (_tight_boxes(family, moments), 0) if guess else family.doubtful()
        return most_steps(
            lambda fewer: at(kind, fewer).evaluate, steps, boxes, initial, family.tolerance, guess
        )

    def guessed(steps: int) -> int:
        for kind in kinds:
            fewer = kept(kind, steps, _GUESS)
            if fewer < steps:
                order.remove(kind)
                order.insert(0, kind)
            steps = fewer
        return steps

    tried = min(_FIRST, steps)
    while (held := guessed(tried)) == tried < steps:
        tried = min(2 * tried, steps)
    steps = held
    for kind in sorted(order, key=lambda kind: len(at(kind, 1).others)):
        steps = kept(kind, steps, None)
    return shown + steps * step


def _tight_boxes(family: Family, moments: tuple[Moment, ...]) -> Boxes:
    """Return boxes of a root's width around the tight times of pairs, within the spans."""
    rows = [
        (pair, max(start, moment.time - 0.5 * ROOT), min(end, moment.time + 0.5 * ROOT))
        for moment in moments
        if moment.check == family.check
        for pair, between in enumerate(family.names)
        if between == moment.between
        for start, end in family.spans
        if start <= moment.time <= end
    ]
    pair, low, high = np.reshape(rows, (-1, 3)).T
    return boxes_of(pair.astype(np.intp), 0.5 * (low + high), 0.5 * (high - low), family.others)


def _all_hold(moments: tuple[Moment, ...]) -> bool:
    return bool(moments) and all(moment.margin >= 0.0 for moment in moments)
