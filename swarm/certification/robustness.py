"""Robustness of a plan: e*, the largest tracking error, and w*, the largest steady wind."""

import math
from collections.abc import Callable, Iterable
from functools import cache

import numpy as np

from swarm.certification.air import wind_tilt
from swarm.certification.assessment import Robustness
from swarm.certification.branch_and_bound import Boxes
from swarm.certification.clearances import Moment, certified, families_of
from swarm.certification.family import ROOT, Family
from swarm.certification.minima import boxes_of, most_steps
from swarm.planning import Plan
from swarm.threads import both, side_by_side

Progress = Callable[[str, float], None]

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
    found: list[float | None] = []
    searches = largest_tracking, largest_wind
    for value in side_by_side(lambda search: search(plan, moments), searches):
        found.append(value)
        if progress:
            progress(stage, len(found) / len(searches))
    tracking, wind = found
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
    checks = families_of(plan)
    largest = _largest(checks, moments, shown, MOST_TRACKING, TRACKING_STEP)
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
    return _largest(_windy(plan), moments, 0.0, MOST_WIND, WIND_STEP)


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
    for family in _windy(plan)(speed):
        found = family.failing()
        if found is not None:
            return family.check, family.names[found[0]], found[1]
    return None


def _windy(plan: Plan) -> Callable[[float], tuple[Family, ...]]:
    """Return what makes the checks in still air, or those that winds up to a speed change.

    Wind does not move vehicles here.
    """
    checks = families_of(plan)

    def at(speed: float) -> tuple[Family, ...]:
        found = checks(plan.mission.vehicles.tracking, wind_tilt(plan, speed))
        if speed == 0.0:
            return found
        return tuple(family for family in found if family.check not in _WINDLESS)

    return at


_WINDLESS = frozenset(
    {
        "taut", "vehicle clearance", "ground", "ceiling", "reach on the floor",
        "over-stretched on the floor", "lying", "drawn out", "beside rotors", "straight down",
    }
)  # fmt: skip
"""Checks that are the same in any wind: of vehicles, of chords, and of the reach of cable."""


def _largest(
    checks: Callable[[float], tuple[Family, ...]],
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
    at = cache(lambda steps: checks(shown + steps * step))
    steps = max(math.floor((most - shown) / step), 0)

    def kept(which: int, steps: int, guess: int | None) -> int:
        if steps == 0:
            return 0
        family = at(steps)[which]
        boxes, initial = (_tight_boxes(family, moments), 0) if guess else family.doubtful()
        return most_steps(
            lambda fewer: at(fewer)[which].evaluate, steps, boxes, initial, family.tolerance, guess
        )

    order = list(range(len(at(steps))))

    def guessed(steps: int) -> int:
        for which in sorted(order):
            fewer = kept(which, steps, _GUESS)
            if fewer < steps:
                order.remove(which)
                order.insert(0, which)
            steps = fewer
        return steps

    tried = min(_FIRST, steps)
    while (held := guessed(tried)) == tried < steps:
        tried = min(2 * tried, steps)
    steps = held
    for which in sorted(order, key=lambda which: len(at(1)[which].others)):
        steps = kept(which, steps, None)
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
