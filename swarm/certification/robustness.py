"""How much worse than planned it may be: e*, the tracking error, and w*, the steady wind."""

import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial

import numpy as np

from swarm.certification.air import wind_down
from swarm.certification.assessment import Robustness
from swarm.certification.branch_and_bound import Boxes
from swarm.certification.clearances import ROOT, STILL_AIR, Family, Moment, families
from swarm.certification.minima import failing, holds, whole_strands
from swarm.planning import Plan

Progress = Callable[[str, float], None]

MOST_TRACKING = 1.0
TRACKING_STEP = 0.005
MOST_WIND = 15.0
WIND_STEP = 0.1
DIRECTIONS = 8


def robustness_of(
    plan: Plan, moments: Iterable[Moment], progress: Progress | None = None
) -> Robustness:
    """Return e* and w* of a plan with its tightest moments; ``progress`` is told of both."""
    moments = tuple(moments)
    if progress:
        progress("largest tracking error", 0.0)
    tracking = largest_tracking(plan, moments)
    if progress:
        progress("largest steady wind", 0.2)
    found = Robustness(tracking, largest_wind(plan, moments))
    if progress:
        progress("largest steady wind", 1.0)
    return found


def largest_tracking(plan: Plan, moments: Iterable[Moment] = ()) -> float | None:
    """Return e*, metres: the largest tracking ball for which the certificate holds.

    Found to TRACKING_STEP from below, so it does hold there; None where the certificate does not
    even hold for exact tracking. At most MOST_TRACKING. The tightest ``moments`` of the mission's
    own tracking ball need not be given; where they are, the answer comes sooner.
    """
    moments = tuple(moments)

    def cases(error: float) -> Cases:
        return {0: lambda: families(plan, error, STILL_AIR)}

    tracking = plan.mission.vehicles.tracking
    search = _Search(cases, _tight(moments))
    return _largest(search, tracking, _all_held(moments), MOST_TRACKING, TRACKING_STEP)


def largest_wind(plan: Plan, moments: Iterable[Moment] = ()) -> float | None:
    """Return w*, m/s: the largest steady wind that the certificate bears, from DIRECTIONS headings.

    All strands that hang free tilt with their drag, at the mission's tracking ball, and keep from
    each other, from vehicles, floor and fence. None where the certificate does not hold in still
    air. At most MOST_WIND. ``moments`` as for :func:`largest_tracking`.
    """
    moments = tuple(moments)
    search = _Search(lambda speed: _windy(plan, speed), _tight(moments))
    return _largest(search, 0.0, _all_held(moments), MOST_WIND, WIND_STEP)


def failure_in_wind(plan: Plan, speed: float) -> tuple[str, tuple[str, str], float] | None:
    """Return what the certificate loses first with the strands tilted by a steady wind, m/s.

    That is the check, between which two things, and when; None where everything holds. At the
    mission's tracking ball, for DIRECTIONS directions.
    """
    for case in _windy(plan, speed).values():
        for family in case():
            found = failing(family.evaluate, family.roots())
            if found is not None:
                return family.check, family.names[found[0]], found[1]
    return None


Cases = Mapping[int, Callable[[], tuple[Family, ...]]]
"""What must hold together, each case with a number that it keeps when the value changes."""


def _windy(plan: Plan, speed: float) -> Cases:
    """Still air, or the wind from every direction that is tried; it moves no vehicle here."""
    tracking = plan.mission.vehicles.tracking
    if speed == 0.0:
        return {0: lambda: families(plan, tracking, STILL_AIR)}

    def blown(towards: float) -> tuple[Family, ...]:
        every = families(plan, tracking, wind_down(plan, speed, towards))
        return tuple(family for family in every if family.check not in _WINDLESS)

    headings = 2.0 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS
    return {k: partial(blown, float(heading)) for k, heading in enumerate(headings)}


_WINDLESS = frozenset(
    {
        "taut", "vehicle clearance", "ground", "ceiling", "reach on the floor",
        "over-stretched on the floor", "lying", "drawn out", "beside rotors", "straight down",
    }
)  # fmt: skip
"""Checks that are the same in any wind: of vehicles, of chords, and of what cable can reach."""


class _Search:
    """Tries values, those boxes first in which earlier ones failed."""

    def __init__(self, cases: Callable[[float], Cases], tight: "Tight") -> None:
        self._cases = cases
        self._tight = tight
        self._known: dict[tuple[int, int], set[tuple[int, float]]] = {}
        self._worst = 0

    def narrowed(self, good: float, bad: float, most: float, step: float) -> tuple[float, float]:
        """Return the largest value that holds in the boxes that are known to matter, and one that
        does not, ``step`` apart; quick.

        ``good`` holds everywhere, ``bad`` does not or is above ``most``. A case is bisected only
        where it does not hold what those before it hold.
        """
        least = good
        for number, case in enumerate(self._likely_first(0.5 * (good + bad))):
            if number:
                if least == good or self._holds_where_it_is_tight(case, least):
                    continue
                bad = least
            least = good
            while bad - least > step:
                middle = 0.5 * (least + bad)
                fine = middle <= most and self._holds_where_it_is_tight(case, middle)
                least, bad = (middle, bad) if fine else (least, middle)
            self._worst = case
        return least, bad

    def _holds_where_it_is_tight(self, case: int, value: float) -> bool:
        for index, family in enumerate(self._cases(value)[case]()):
            known = self._known.setdefault((case, index), self._tight_of(family))
            if known and not holds(family.evaluate, _boxes(family, known)):
                return False
        return True

    def _likely_first(self, value: float) -> list[int]:
        """All cases, the one first that failed last: it is the likeliest to fail again."""
        return sorted(self._cases(value), key=lambda case: case != self._worst)

    def _tight_of(self, family: Family) -> set[tuple[int, float]]:
        return {
            (pair, time)
            for pair, between in enumerate(family.names)
            for time in self._tight.get((family.check, between), ())
            if any(start <= time <= end for start, end in family.spans)
        }

    def holds(self, value: float) -> bool:
        """Whether the value holds everywhere; where it does not, that box is known from now on."""
        cases = self._cases(value)
        for case in self._likely_first(value):
            for index, family in enumerate(cases[case]()):
                found = failing(family.evaluate, family.roots())
                if found is not None:
                    self._known.setdefault((case, index), set()).add(found)
                    self._worst = case
                    return False
        return True


def _boxes(family: Family, known: set[tuple[int, float]]) -> Boxes:
    """Boxes of a root's width around where pairs failed, within the family's times."""
    rows = []
    for pair, time in sorted(known):
        start, end = next(span for span in family.spans if span[0] <= time <= span[1])
        low, high = max(start, time - 0.5 * ROOT), min(end, time + 0.5 * ROOT)
        rows.append((pair, 0.5 * (low + high), 0.5 * (high - low)))
    pairs, middles, halves = (np.array(column) for column in zip(*rows, strict=True))
    return whole_strands(pairs.astype(np.intp), middles, halves, strands=family.strands)


Tight = Mapping[tuple[str, tuple[str, str]], Iterable[float]]
"""Times that are known to be tight, by check and pair."""


def _tight(moments: Iterable[Moment]) -> Tight:
    times: dict[tuple[str, tuple[str, str]], list[float]] = {}
    for moment in moments:
        times.setdefault((moment.check, moment.between), []).append(moment.time)
    return times


def _all_held(moments: tuple[Moment, ...]) -> bool:
    return bool(moments) and all(moment.margin >= 0.0 for moment in moments)


def _largest(search: _Search, likely: float, known: bool, most: float, step: float) -> float | None:
    """Largest value that holds, to ``step``; ``likely`` is tried first, or ``known`` to hold.

    Bisects over the boxes that are known to be tight, and asks for all of them only about what is
    left: most values are refused by few boxes.
    """
    good, bad = 0.0, most + step
    if known or search.holds(likely):
        good = likely
    elif likely == 0.0 or not search.holds(0.0):
        return None
    else:
        bad = likely
    while bad - good > step:
        low, high = search.narrowed(good, bad, most, 0.25 * step)
        if low - good <= 0.25 * step:
            break
        if search.holds(low):
            good, bad = low, high
        else:
            bad = low
    return good
