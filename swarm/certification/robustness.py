"""Robustness of a plan: e*, the largest tracking error, and w*, the largest steady wind."""

import math
from collections.abc import Callable, Iterable, Mapping
from functools import cache

import numpy as np

from swarm.certification.air import wind_tilt
from swarm.certification.assessment import Robustness
from swarm.certification.branch_and_bound import Boxes
from swarm.certification.clearances import Moment, certified, families
from swarm.certification.family import ROOT, Family
from swarm.certification.minima import boxes_of, failing
from swarm.certification.strand_pieces import TILTS
from swarm.planning import Plan
from swarm.threads import both, side_by_side

Progress = Callable[[str, float], None]

MOST_TRACKING = 1.0
"""Largest tracking error that is tried, metres: as large as the default clearance of vehicles."""
TRACKING_STEP = 0.005
"""Resolution of e*, metres: half of the last digit that is shown."""
MOST_WIND = 15.0
"""Largest wind that is tried, m/s (Beaufort 7)."""
WIND_STEP = 0.1
"""Resolution of w*, m/s: the last digit that is shown."""
_GUESSED, _LOOKED_AT, _NARROW = 8, 48, 1e-5
"""Directions in which a value is tried before it is certified in all (of 48, some direction has at
least cos(π/48) of any heading's effect: 0.2 % less), and a width of no effect."""


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
    tracking = plan.mission.vehicles.tracking
    search = _Search(lambda error: families(plan, error), moments)
    return _largest(search, tracking, _all_hold(moments), MOST_TRACKING, TRACKING_STEP)


def largest_wind(plan: Plan, moments: Iterable[Moment] = ()) -> float | None:
    """Return w*, m/s: the certificate holds in every steady wind up to it, of any heading.

    All freely hanging strands tilt equally, with the drag of strands across the wind, at the
    mission's tracking radius, and keep their distance from each other, from vehicles, floor and
    fence; at most MOST_WIND. None where the certificate does not hold in still air. ``moments`` as
    for :func:`largest_tracking`.
    """
    moments = tuple(moments)
    search = _Search(lambda speed: _windy(plan, speed), moments)
    return _largest(search, 0.0, _all_hold(moments), MOST_WIND, WIND_STEP)


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
    for family in _windy(plan, speed):
        found = family.failing()
        if found is not None:
            return family.check, family.names[found[0]], found[1]
    return None


def _windy(plan: Plan, speed: float) -> tuple[Family, ...]:
    """Return the checks in still air, or those of steady winds up to a speed that it changes.

    Wind does not move vehicles here.
    """
    found = families(plan, plan.mission.vehicles.tracking, wind_tilt(plan, speed))
    if speed == 0.0:
        return found
    return tuple(family for family in found if family.check not in _WINDLESS)


_WINDLESS = frozenset(
    {
        "taut", "vehicle clearance", "ground", "ceiling", "reach on the floor",
        "over-stretched on the floor", "lying", "drawn out", "beside rotors", "straight down",
    }
)  # fmt: skip
"""Checks that are the same in any wind: of vehicles, of chords, and of the reach of cable."""


class _Search:
    """Tries values, first in the boxes in which earlier values failed, and at tight ``moments``."""

    def __init__(
        self, checks: Callable[[float], tuple[Family, ...]], moments: tuple[Moment, ...]
    ) -> None:
        self._families = cache(checks)
        self._tight = _tight_times(moments)
        self._margins: dict[str, float] = {}
        for moment in moments:
            least = self._margins.get(moment.check, math.inf)
            self._margins[moment.check] = min(least, moment.margin)
        self._failed: dict[int, set[tuple[int, float]]] = {}
        self._worst: int | None = None
        self._held: dict[int, float] = {}
        self._held_everywhere: dict[int, float] = {}

    def narrowed(self, good: float, bad: float, most: float, step: float) -> tuple[float, float]:
        """Return the largest value that holds in the tight boxes, and a value ``step`` above it.

        ``good`` holds everywhere, ``bad`` fails or is above ``most``. Each family is tried at the
        largest value that the ones before hold at, and only one that fails there is bisected: most
        are tried once. This is a guess; the result is certified in all boxes. It holds for smaller
        values too, which the same boxes contain: a ball of tracking errors the smaller ones, and a
        disc of tilts those of weaker winds.
        """
        halvings = math.ceil(math.log2((bad - good) / step))
        step = (bad - good) / 2**halvings
        largest = min(2**halvings - 1, math.floor((most - good) / step))
        for which in self._likely_first(good + largest * step):
            held = self._most_steps(which, largest, good, step)
            if held < largest:
                largest, self._worst = held, which
        return good + largest * step, good + (largest + 1) * step

    def _most_steps(self, which: int, most: int, good: float, step: float) -> int:
        """Return the largest number of steps above ``good``, of at most ``most``, that hold."""
        held, failed = 0, most + 1
        tried = most
        while failed - held > 1:
            if self._holds_in_tight_boxes(which, good + tried * step):
                held = tried
            else:
                failed = tried
            tried = (held + failed) // 2
        return held

    def _holds_in_tight_boxes(self, which: int, value: float) -> bool:
        if value <= self._held.get(which, -math.inf):
            return True
        family = self._families(value)[which]
        tight, failed = self._tight_of(family), self._failed.get(which, set())
        found = all(
            not times or _holds(family, _at_full_tilt(_boxes(family, times), family, directions))
            for times, directions in ((tight, _GUESSED), (failed, _LOOKED_AT))
        )
        if found:
            self._held[which] = value
        return found

    def _likely_first(self, value: float) -> list[int]:
        """All families: the last failed one, then those with the least margins."""
        every = [self._margins.get(family.check, math.inf) for family in self._families(value)]
        return sorted(range(len(every)), key=lambda which: (which != self._worst, every[which]))

    def _tight_of(self, family: Family) -> set[tuple[int, float]]:
        return {
            (pair, time)
            for pair, between in enumerate(family.names)
            for time in self._tight.get((family.check, between), ())
            if any(start <= time <= end for start, end in family.spans)
        }

    def holds(self, value: float) -> bool:
        """Return whether the value holds everywhere; keeps the box in which it fails.

        A family that held everywhere at a larger value is not searched again.
        """
        every = [
            which
            for which in self._likely_first(value)
            if value > self._held_everywhere.get(which, -math.inf)
        ]

        def failing(which: int) -> tuple[int, float] | None:
            found = self._families(value)[which].failing()
            if found is None:
                self._held_everywhere[which] = value
            return found

        for which, found in zip(every, side_by_side(failing, every), strict=True):
            if found is not None:
                self._failed.setdefault(which, set()).add(found)
                self._held.pop(which, None)
                self._worst = which
                return False
        return True


def _boxes(family: Family, tight: set[tuple[int, float]]) -> Boxes:
    """Boxes of a root's width around the times at which pairs are tight, within the spans."""
    rows = []
    for pair, time in sorted(tight):
        start, end = next(span for span in family.spans if span[0] <= time <= span[1])
        low, high = max(start, time - 0.5 * ROOT), min(end, time + 0.5 * ROOT)
        rows.append((pair, 0.5 * (low + high), 0.5 * (high - low)))
    pairs, middles, halves = (np.array(column) for column in zip(*rows, strict=True))
    return boxes_of(pairs.astype(np.intp), middles, halves, family.others)


def _holds(family: Family, boxes: Boxes) -> bool:
    return failing(family.evaluate, boxes, tolerance=family.tolerance) is None


def _at_full_tilt(boxes: Boxes, family: Family, directions: int) -> Boxes:
    """Return boxes at the full tilt in some directions, instead of all tilts: for a first guess."""
    if family.others[:2] != TILTS:
        return boxes
    cut = boxes.taken(np.repeat(np.arange(len(boxes)), directions))
    heading = np.tile(2.0 * math.pi * np.arange(directions) / directions, len(boxes))
    # Within the disc, whatever rounding does.
    cut.middle[:, 1], cut.middle[:, 2] = (1.0 - 1e-9) * np.stack([np.cos(heading), np.sin(heading)])
    cut.half[:, 1:3] = _NARROW
    return cut


Tight = Mapping[tuple[str, tuple[str, str]], Iterable[float]]
"""Tight times, by check and pair."""


def _tight_times(moments: Iterable[Moment]) -> Tight:
    times: dict[tuple[str, tuple[str, str]], list[float]] = {}
    for moment in moments:
        times.setdefault((moment.check, moment.between), []).append(moment.time)
    return times


def _all_hold(moments: tuple[Moment, ...]) -> bool:
    return bool(moments) and all(moment.margin >= 0.0 for moment in moments)


def _largest(
    search: _Search, likely: float, holds_there: bool, most: float, step: float
) -> float | None:
    """Largest value that holds, to ``step``; ``likely`` is tried first, unless it holds already.

    Bisects over the tight boxes, and searches all boxes only for the result: most values fail in
    few boxes. Where a search of all boxes fails at several values in turn, the next is lower by
    four times as much each time: margins that hold may take too many boxes to show.
    """
    good, bad, lower = 0.0, most + step, 0.0
    if holds_there or search.holds(likely):
        good = likely
    elif likely == 0.0 or not search.holds(0.0):
        return None
    else:
        bad = likely
    while bad - good > step:
        low, high = search.narrowed(good, bad, most, 0.25 * step)
        if low > bad - lower:
            low, high = max(bad - lower, 0.5 * (good + bad)), bad
        if low - good <= 0.25 * step:
            break
        if search.holds(low):
            good, bad = low, high
        else:
            bad, lower = low, max(4.0 * lower, 0.25 * step)
    return good
