"""Many plans side by side: one of each knot, and the Pareto front of one mission."""

import csv
import io
import json
import re
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any, Final

from joblib import Parallel, delayed

from swarm import planner
from swarm.certification.assessment import Assessment
from swarm.certification.clearances import largest_tracking, robustness_of
from swarm.certification.distances import Tightest
from swarm.certification.kinds import FIGURES
from swarm.certification.loads import loads
from swarm.errors import InputError, Problem, Refused, reason
from swarm.files import parse_json, read_text
from swarm.geometry.catenary import STANDARD_GRAVITY
from swarm.knots.catalog import choose_knot, lookup_knot, table_names
from swarm.mission import Mission, mission_for_knot
from swarm.mission.validation import LARGEST_FILE
from swarm.planning.few_vehicles import least_vehicles
from swarm.simulation.workers import parallel_workers

Progress = Callable[[str, float], None]
Clock = Callable[[], float]

COMPOSITE_AND_TORUS: Final = ("granny", "square", "torus(2,9)", "torus(3,5)", "3_1#4_1#5_1")
"""Knots that are planned beside the prime knots."""

TRACKING_ERRORS: Final = (0.0, 0.05, 0.1, 0.15, 0.2)
"""Tracking errors of the Pareto front, metres; each gets the smallest layout."""

CELL_FACTORS: Final = (1.15, 1.35)
"""Cell widths of the Pareto front, as multiples of the cell width of the mission's own plan."""

COLUMNS: Final = (
    "knot", "crossings", "vehicles", "grid_vehicles", "least_vehicles", "cleared", "cell",
    "cable_length", "fold_time",
    *(f"{figure}_clearance" for figure in FIGURES), "cable_clearance_per_cell",
    "max_tracking_error", "max_wind", "budget", "land_share", "release_share", "planning_time",
    "message",
)  # fmt: skip
"""Columns of the table of all knots, in order."""


def knots_to_plan() -> tuple[str, ...]:
    """Return the names of all knots of the table: prime knots, then COMPOSITE_AND_TORUS."""
    return (*table_names(), *COMPOSITE_AND_TORUS)


def plan_row(
    name: str, overrides: Sequence[str], clock: Clock, *, robustness: bool = True
) -> dict[str, Any]:
    """Plan one knot with the default mission and return its row, keyed by COLUMNS.

    Lengths in metres, times in seconds, wind in m/s. ``planning_time`` is the time by ``clock`` of
    planning and certification, without the search for e* (``max_tracking_error``) and w*
    (``max_wind``), which are None without ``robustness``. ``budget`` is what remains at least of a
    distance of strands if all effects come together; it is not planned for, and a plan with a
    negative one is not refused, unlike for a flight, unless ``overrides`` set
    limits.accept_negative_budget to false: what is compared is the certificate.
    ``grid_vehicles`` are those of the grid diagram, 2N − 1, and ``least_vehicles`` a lower bound.
    ``message`` is empty for a cleared plan; otherwise it has the errors and the layouts that were
    tried.
    """
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    start = clock()
    try:
        choice = lookup_knot(name)
        row |= {
            "knot": name, "crossings": choice.crossings, "vehicles": choice.vehicles,
            "grid_vehicles": choice.vehicles, "least_vehicles": least_vehicles(choice.crossings),
        }  # fmt: skip
        mission = mission_for_knot(name, ["limits.accept_negative_budget=true", *overrides])
        planned = planner.plan(mission, robustness=False)
    except (Refused, InputError) as error:
        return row | {
            "knot": name, "cleared": False, "planning_time": clock() - start,
            "message": str(error),
        }  # fmt: skip
    planning_time = clock() - start
    plan, assessment = planned.plan, planned.assessment
    fold, cell = plan.phase("fold"), plan.layout.cell
    row |= {
        "vehicles": plan.vehicles,
        "cleared": assessment.cleared,
        "cell": cell,
        "cable_length": float(plan.layout.lengths.sum()),
        "fold_time": fold.duration,
        **{f"{name}_clearance": _distance(entry) for name, entry in assessment.distances.items()},
        "land_share": assessment.contingencies.land.share if assessment.contingencies else None,
        "release_share": assessment.contingencies.release.share
        if assessment.contingencies
        else None,
        "budget": min((entry.remaining for entry in assessment.budget), default=None),
        "planning_time": planning_time,
        "message": "" if assessment.cleared else _errors(assessment, plan.notes),
    }
    if cell and row["cable_clearance"] is not None:
        row["cable_clearance_per_cell"] = row["cable_clearance"] / cell
    if robustness and assessment.cleared:
        limits = robustness_of(plan, assessment.moments)
        row |= {"max_tracking_error": limits.tracking, "max_wind": limits.wind}
    return row


def matching_knots(pattern: str | None) -> list[str]:
    """Return the knots of the table whose names match a regular expression; None: all of them.

    Raises :class:`InputError` where the expression is wrong or matches no name.
    """
    try:
        expression = re.compile(pattern or "")
    except re.error as error:
        message = f"expected a regular expression, got {pattern!r}: {error}"
        raise InputError([Problem("--filter", message)]) from None
    names = [name for name in knots_to_plan() if expression.search(name)]
    if not names:
        raise InputError([Problem("--filter", f"no knot of the table matches {pattern!r}")])
    return names


def plan_rows(
    names: Sequence[str],
    overrides: Sequence[str],
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    robustness: bool = True,
) -> Generator[dict[str, Any], None, None]:
    """Plan knots; yield their rows as they are completed, in any order.

    They are planned in ``jobs`` processes of this machine, or by the workers of the Dask cluster at
    ``scheduler`` (tcp://host:port). ``planning_time`` is processor time. Close the generator to
    end the planning.
    """
    tasks = (
        delayed(plan_row)(name, overrides, time.process_time, robustness=robustness)
        for name in names
    )
    rows: Generator[dict[str, Any], None, None]
    with parallel_workers(jobs, scheduler):
        rows = Parallel(batch_size=1, return_as="generator_unordered")(tasks)
        with closing(rows):
            yield from rows


def read_rows(path: Path) -> dict[str, dict[str, Any]]:
    """Return the rows of a file by knot; an incomplete last line, after an interrupt, is ignored.

    Raises :class:`InputError` for a line that is no row.
    """
    if not path.exists():
        return {}
    rows: dict[str, dict[str, Any]] = {}
    lines = read_text(path, LARGEST_FILE).splitlines(keepends=True)
    for number, line in enumerate(lines, start=1):
        try:
            row = parse_json(line, str(path))
            rows[row["knot"]] = {name: _typed(name, row[name]) for name in COLUMNS}
        except (InputError, TypeError, KeyError):
            if line.startswith("{") and not line.endswith(("}", "\n")):
                break
            place = f"{path}: line {number}"
            raise InputError([Problem(place, "expected a row that --plan wrote")]) from None
    return rows


def _typed(name: str, value: Any) -> Any:
    """Return the value of a column; raises TypeError for one of another type."""
    kind = {"knot": str, "cleared": bool, "message": str}.get(name)
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (isinstance(value, kind) if kind else value is None or number):
        raise TypeError(name)
    return value


def append_row(path: Path, row: Mapping[str, Any]) -> None:
    """Append a row to a file of JSON lines."""
    try:
        with path.open("a+b") as file:
            file.seek(0)
            complete, end, _ = file.read().rpartition(b"\n")
            file.truncate(len(complete + end))  # without a line that an interrupt cut off
            file.write(json.dumps(row, ensure_ascii=False).encode() + b"\n")
    except OSError as error:
        raise InputError([Problem(str(path), reason(error))]) from None


def rows_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows as CSV with a header."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _distance(tightest: Tightest) -> float | None:
    return tightest.distance if isfinite(tightest.distance) else None


def _errors(assessment: Assessment, notes: tuple[str, ...]) -> str:
    errors = [finding.message for finding in assessment.findings if finding.severity == "error"]
    return "; ".join([*errors, *notes])


@dataclass(frozen=True)
class FrontPoint:
    """A cleared plan of the Pareto front. Metres, seconds, kilograms.

    ``variant`` names the change of the mission. ``cell`` is 0 where the layout has no cells.
    ``max_tracking_error`` is e*, ``payload`` the mass that weighs as much as the largest force of
    the cable on a vehicle. ``dominated`` is true if another plan is no worse in vehicles, cable
    length, fold time, e* and payload, and better in one of them.
    """

    variant: str
    vehicles: int
    cell: float
    cable_length: float
    fold_time: float
    max_tracking_error: float
    payload: float
    dominated: bool = False

    @property
    def _figures(self) -> tuple[float, ...]:
        """The figures that are compared; smaller ones are better."""
        return (
            self.vehicles, self.cable_length, self.fold_time, -self.max_tracking_error,
            self.payload,
        )  # fmt: skip

    def dominates(self, other: "FrontPoint") -> bool:
        """Return whether this plan is no worse in any figure than another, and better in one."""
        ours, theirs = self._figures, other._figures
        return ours != theirs and all(a <= b for a, b in zip(ours, theirs, strict=True))


def pareto_front(mission: Mission, progress: Progress | None = None) -> Iterator[FrontPoint | str]:
    """Plan variants of a mission; yield a point for each cleared plan, otherwise the reason.

    The variants are the smallest layouts for TRACKING_ERRORS and for the mission's own tracking
    error, layouts with CELL_FACTORS times the cell width of the latter, and layouts with every
    smaller number of vehicles from the lower bound on. A mission with a number of vehicles or with
    given corners keeps them.
    """
    own = mission.vehicles.tracking
    own_cell: float | None = None
    tracking_errors = sorted({*TRACKING_ERRORS, own})
    counts = numbers_of_vehicles(mission)
    total = len(tracking_errors) + len(CELL_FACTORS) + len(counts)
    for number, tracking in enumerate(tracking_errors, start=1):
        variant = f"certified for {tracking:g} m" + (
            " (as in the mission)" if tracking == own else ""
        )
        point = _point(_with(mission, "vehicles", tracking=tracking), variant, progress)
        if tracking == own and isinstance(point, FrontPoint):
            own_cell = point.cell
        if progress:
            progress(f"{number} of {total} plans", 1.0)
        yield point
    if own_cell:
        for number, factor in enumerate(CELL_FACTORS, start=len(tracking_errors) + 1):
            variant = f"{factor:g} times the mission's cell"
            yield _point(_with(mission, "layout", cell=factor * own_cell), variant, progress)
            if progress:
                progress(f"{number} of {total} plans", 1.0)
    for number, count in enumerate(counts, total - len(counts) + 1):
        yield _point(_with(mission, "vehicles", count=count), f"{count} vehicles", progress)
        if progress:
            progress(f"{number} of {total} plans", 1.0)


def numbers_of_vehicles(mission: Mission) -> Sequence[int]:
    """Return the numbers of vehicles between the lower bound of a mission's knot and its grid."""
    automatic = mission.vehicles.count == "auto" and mission.layout.corners is None
    if not automatic or mission.knot is None or mission.fold.method == "paper":
        return ()
    knot = choose_knot(**mission.knot.model_dump())
    return () if knot.name == "unknown" else range(least_vehicles(knot.crossings), knot.vehicles)


def mark_dominated(points: Sequence[FrontPoint]) -> list[FrontPoint]:
    """Return the points with ``dominated`` set."""
    return [
        replace(point, dominated=any(other.dominates(point) for other in points))
        for point in points
    ]


def _with(mission: Mission, section: str, **values: Any) -> Mission:
    changed = getattr(mission, section).model_copy(update=values)
    return mission.model_copy(update={section: changed})


def _point(mission: Mission, variant: str, progress: Progress | None) -> FrontPoint | str:
    try:
        planned = planner.plan(mission, progress, robustness=False)
    except Refused as refusal:
        return f"{variant}: {refusal}"
    plan, assessment = planned.plan, planned.assessment
    if not assessment.cleared:
        return f"{variant}: {_errors(assessment, ())}"
    fold = plan.phase("fold")
    return FrontPoint(
        variant=variant,
        vehicles=plan.vehicles,
        cell=plan.layout.cell,
        cable_length=float(plan.layout.lengths.sum()),
        fold_time=fold.duration,
        max_tracking_error=largest_tracking(plan, assessment.moments) or 0.0,
        payload=float(loads(plan).force.max(initial=0.0)) / STANDARD_GRAVITY,
    )
