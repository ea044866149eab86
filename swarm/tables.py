"""Many plans side by side: all knots with one mission, and one knot with more and less room."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, Final

from swarm import api
from swarm.certification.assessment import Assessment, Tightest
from swarm.certification.robustness import largest_tracking, robustness_of
from swarm.errors import InputError, Refused
from swarm.knots.catalog import lookup, names
from swarm.mission import Mission, mission_for_knot

Progress = Callable[[str, float], None]
Clock = Callable[[], float]

BEYOND: Final = ("granny", "square", "torus(2,9)", "torus(3,5)", "3_1#4_1#5_1")
"""Knots that are planned beside the prime ones: sums and torus knots."""

TRACKING: Final = (0.0, 0.05, 0.1, 0.15, 0.2)
"""Tracking errors, metres, for which the front asks for a plan with the least room."""

ROOM: Final = (1.15, 1.35)
"""Cells, over that of the mission's own plan, for which the front asks for a plan."""

COLUMNS: Final = (
    "knot", "crossings", "vehicles", "cleared", "cell", "cable", "fold", "cable_clearance",
    "vehicle_clearance", "vehicle_cable_clearance", "strand_over_cell", "tracking", "wind", "land",
    "release", "seconds", "says",
)  # fmt: skip
"""Columns of the table of all knots, in order."""


def knots_to_plan() -> tuple[str, ...]:
    """Return the names of all knots of the table: the prime ones, then BEYOND."""
    return (*names(), *BEYOND)


def knot_row(
    name: str, overrides: Sequence[str], clock: Clock, *, robustness: bool = True
) -> dict[str, Any]:
    """Plan one knot with the default mission and return its row, keyed by COLUMNS.

    Metres and seconds. ``seconds`` is what planning and certifying took by ``clock``, e* and w*
    (``tracking``, ``wind``, with ``robustness``) not counted; ``says`` is empty for a plan that is
    cleared, and otherwise what is wrong and what was tried.
    """
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    begun = clock()
    try:
        choice = lookup(name)
        row |= {"knot": name, "crossings": choice.crossings, "vehicles": choice.vehicles}
        planned = api.plan(mission_for_knot(name, overrides), robustness=False)
    except (Refused, InputError) as error:
        return row | {
            "knot": name, "cleared": False, "seconds": clock() - begun, "says": str(error),
        }  # fmt: skip
    taken = clock() - begun
    plan, found = planned.plan, planned.assessment
    fold, cell = plan.phase("fold"), plan.layout.cell
    row |= {
        "vehicles": plan.vehicles,
        "cleared": found.cleared,
        "cell": cell,
        "cable": float(plan.layout.lengths.sum()),
        "fold": fold.end - fold.start,
        "cable_clearance": _distance(found.cable),
        "vehicle_clearance": _distance(found.vehicle),
        "vehicle_cable_clearance": _distance(found.vehicle_cable),
        "land": found.contingencies.land.share if found.contingencies else None,
        "release": found.contingencies.release.share if found.contingencies else None,
        "seconds": taken,
        "says": "" if found.cleared else _wrong(found, plan.notes),
    }
    if cell and row["cable_clearance"] is not None:
        row["strand_over_cell"] = row["cable_clearance"] / cell
    if robustness and found.cleared:
        held = robustness_of(plan, found.moments)
        row |= {"tracking": held.tracking, "wind": held.wind}
    return row


def _distance(tightest: Tightest) -> float | None:
    return tightest.distance if isfinite(tightest.distance) else None


def _wrong(found: Assessment, notes: tuple[str, ...]) -> str:
    errors = [finding.message for finding in found.findings if finding.severity == "error"]
    return "; ".join([*errors, *notes])


@dataclass(frozen=True)
class Point:
    """A plan on the front: what was asked for, and what it takes and stands. Metres, seconds.

    ``tracking`` is e*, the largest tracking error for which it holds; ``beaten`` says that another
    plan is no worse in cable, fold time and e*.
    """

    asked: str
    cell: float
    cable: float
    fold: float
    tracking: float
    beaten: bool = False


def front(mission: Mission, progress: Progress | None = None) -> Iterator[Point | str]:
    """Plan a mission with more and less room; yields points, and words for what was refused.

    Asked for are the least layouts for the tracking errors TRACKING and for the mission's own, and
    cells ROOM times as wide as that of the latter.
    """
    own = mission.vehicles.tracking
    base: float | None = None
    asked = sorted({*TRACKING, own})
    for done, tracking in enumerate(asked):
        words = f"certified for {tracking:g} m" + (
            " (as in the mission)" if tracking == own else ""
        )
        point = _point(_with(mission, "vehicles", tracking=tracking), words, progress)
        if tracking == own and isinstance(point, Point):
            base = point.cell
        if progress:
            progress(f"{done + 1} of {len(asked) + len(ROOM)} plans", 1.0)
        yield point
    if not base:
        return
    for room in ROOM:
        words = f"{room:g} times the mission's cell"
        yield _point(_with(mission, "layout", cell=room * base), words, progress)


def marked(points: Sequence[Point]) -> list[Point]:
    """Return the points with those marked that another one beats."""

    def beats(one: Point, other: Point) -> bool:
        ours = (one.cable, one.fold, -one.tracking)
        theirs = (other.cable, other.fold, -other.tracking)
        return ours != theirs and all(a <= b for a, b in zip(ours, theirs, strict=True))

    return [
        Point(
            point.asked, point.cell, point.cable, point.fold, point.tracking,
            any(beats(other, point) for other in points),
        )
        for point in points
    ]  # fmt: skip


def _with(mission: Mission, section: str, **values: Any) -> Mission:
    changed = getattr(mission, section).model_copy(update=values)
    return mission.model_copy(update={section: changed})


def _point(mission: Mission, words: str, progress: Progress | None) -> Point | str:
    try:
        planned = api.plan(mission, progress, robustness=False)
    except Refused as refusal:
        return f"{words}: {refusal}"
    plan, found = planned.plan, planned.assessment
    if not found.cleared:
        return f"{words}: {_wrong(found, ())}"
    fold = plan.phase("fold")
    return Point(
        asked=words,
        cell=plan.layout.cell,
        cable=float(plan.layout.lengths.sum()),
        fold=fold.end - fold.start,
        tracking=largest_tracking(plan, found.moments) or 0.0,
    )
