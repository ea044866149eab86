"""Candidates for the plan of a mission, most promising first, and their repair.

A candidate is not certified. `swarm.planner` certifies candidates one after the other.
"""

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy

from swarm.errors import Refused
from swarm.folding.layout import LayoutParameters
from swarm.folding.margins import Margins
from swarm.folding.optimizer import BEYOND_REPAIR
from swarm.folding.schedule import Flown, improve
from swarm.folding.waypoints import WaypointPaths
from swarm.knots.catalog import KnotChoice, choose_knot
from swarm.knots.grid import OpenGrid, openings
from swarm.mission import Mission
from swarm.planning.assembly import paper_plan, plan_of_folding
from swarm.planning.estimates import refuse_overload
from swarm.planning.few_vehicles import FewVehicles, code_at_rest
from swarm.planning.foldings import (
    GOOD,
    Folding,
    distinct_openings,
    fit_to_cable,
    fold_diagram,
    grid_margins,
    layout_sizes,
    planning_margins,
    rank_openings,
)
from swarm.planning.formation import formation_plan
from swarm.planning.given_layout import foldings_of_given_layout
from swarm.planning.plan import KnotSummary, Plan
from swarm.planning.repair import Shortfall, with_larger_margins

Progress = Callable[[str, float], None]

_DEFERRED = 2
"""Number of deferred foldings that become candidates, best first, after all good ones."""

_IN_LARGER_CELLS = 3
"""Number of openings that are also folded in the larger cells."""

_ATTEMPTS, _ATTEMPTS_SEARCHED = 12, 16
"""Number of candidates from one folding, or from a plan of it that keeps all clearances: the first
one and its repairs. The Carrick mat takes 2 to 10, as last bits decide: with 8, one of five was
folded in larger cells, in 320 s instead of 267 s. A motion of 8_18 that was searched takes about
5 s to find and 0.4 s to repair; one with 10 vehicles needs 9 repairs, since shaping for the swing
cuts the corners of motions that change their directions often."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A plan before its certification, and the state from which it can be repaired.

    ``folding`` is the layout and schedule of its fold, None where the plan has none to repair
    (formations, the paper's trajectory); ``attempt`` counts the candidates of this folding from 1.
    ``notes`` list the attempts since the previous candidate.
    """

    plan: Plan
    folding: Folding | None = None
    attempt: int = 1
    notes: tuple[str, ...] = ()

    @property
    def searched(self) -> bool:
        """Whether the motion was searched, see :mod:`swarm.untangling`."""
        return self.folding is not None and isinstance(self.folding.schedule.path, WaypointPaths)

    @property
    def last_attempt(self) -> bool:
        """Whether it is the last candidate that :func:`repaired` makes of this folding."""
        return self.attempt >= (_ATTEMPTS_SEARCHED if self.searched else _ATTEMPTS)


def make_plan(mission: Mission, *, progress: Progress | None = None) -> Plan:
    """Return the plan of the first candidate, before its certification.

    ``progress`` is called with the name of a stage and its completed share, 0…1. Raises
    :class:`swarm.errors.Refused` where the mission has no candidate.
    """
    first = next(candidates(mission, progress=progress))
    return replace(first.plan, notes=first.notes)


def candidates(mission: Mission, *, progress: Progress | None = None) -> Iterator[Candidate]:
    """Yield the first candidate of every folding, most promising first.

    Foldings are computed one at a time, when the next candidate is needed. Foldings that
    miss their margins by much come last: their certificates state the errors.

    Raises :class:`swarm.errors.Refused` where vehicles are too close even at rest on their corners.
    """
    _refuse_unsupported_start(mission)
    if mission.formation is not None:
        yield _without_folding(formation_plan(mission, mission.formation))
        return
    choice, knot = _knot(mission)
    opened = distinct_openings(openings(choice.grid))
    margins = planning_margins(mission)
    if mission.fold.method == "paper":
        yield _without_folding(paper_plan(mission, knot, opened[0], margins))
        return
    if mission.layout.corners is not None:
        refuse_overload(mission, [np.asarray(mission.layout.corners, dtype=np.float64)])
        foldings = foldings_of_given_layout(mission.layout, margins, progress)
        given = tuple(note for _, note in foldings)
        for folding in sorted((fold for fold, _ in foldings), key=lambda fold: fold.schedule.worst):
            yield Candidate(plan_of_folding(mission, knot, folding), folding, notes=given)
            given = ()
        return
    notes: tuple[str, ...] = ()
    if mission.vehicles.count not in {"auto", len(opened[0].corners)}:
        count = mission.vehicles.count
        carried = mission.vehicles.payload / mission.cable.mass_per_length
        few = FewVehicles(choice, opened, count, margins, carried)  # type: ignore[arg-type]
        notes = yield from _with_few_vehicles(mission, knot, few, progress)
        if count != "fewest":
            return
        notes += ("no motion with fewer vehicles was cleared: the grid diagram is folded",)
    margins = grid_margins(mission)
    _refuse_crowding(mission, knot, opened, margins)
    refuse_overload(mission, _smallest_layouts(mission, opened, margins))
    for candidate in _folded_grids(mission, knot, opened, margins, progress):
        yield replace(candidate, notes=notes + candidate.notes)
        notes = ()


def repairable(candidate: Candidate, shortfalls: Sequence[Shortfall]) -> bool:
    """Return whether larger margins may help a candidate at all its shortfalls."""
    return (
        candidate.folding is not None
        and bool(shortfalls)
        and all(shortfall.margin is not None for shortfall in shortfalls)
        and not candidate.last_attempt
    )


def repaired(
    candidate: Candidate, shortfalls: Sequence[Shortfall], flown: Flown | None = None
) -> Candidate | None:
    """Return the next candidate of the same folding, with larger margins at the shortfalls.

    ``flown`` is how the folding's schedule is flown, as its plan is timed.

    None where larger margins cannot help: no shortfalls, a check without a margin, too many
    attempts, or a schedule that cannot keep the larger margins.
    """
    folding = candidate.folding
    if folding is None or not repairable(candidate, shortfalls):
        return None
    schedule = improve(with_larger_margins(folding, candidate.plan, shortfalls), flown)
    if schedule.worst > BEYOND_REPAIR:
        return None
    folding = replace(folding, schedule=schedule)
    return Candidate(
        plan_of_folding(candidate.plan.mission, candidate.plan.knot, folding),
        folding,
        candidate.attempt + 1,
        ("increased the margins where the certificate found shortfalls",),
    )


def _without_folding(plan: Plan) -> Candidate:
    return Candidate(plan, notes=plan.notes)


def _with_few_vehicles(
    mission: Mission, knot: KnotSummary, few: FewVehicles, progress: Progress | None
) -> Generator[Candidate, None, tuple[str, ...]]:
    """Yield a candidate for every folding of a search; return the notes on its end."""
    search = few.foldings(progress)
    while True:
        try:
            folding, notes = next(search)
        except StopIteration as end:
            ended: tuple[str, ...] = end.value
            return ended
        tied = replace(knot, gauss=code_at_rest(folding.layout).signed_text())
        yield Candidate(plan_of_folding(mission, tied, folding), folding, notes=notes)


def _folded_grids(
    mission: Mission,
    knot: KnotSummary,
    opened: list[OpenGrid],
    margins: Margins,
    progress: Progress | None,
) -> Iterator[Candidate]:
    """Yield a candidate for every good folding of the grid diagram, then for deferred ones."""
    notes: tuple[str, ...] = ()
    deferred: list[Folding] = []
    layouts = list(layout_sizes(mission, margins))
    best = rank_openings(opened, layouts[0], margins, progress)
    for folding in _foldings(best, layouts, margins, progress):
        worst = folding.schedule.worst
        notes += (
            f"tried a cell of {folding.layout.cell:.2f} m: misses its margins by {worst:.2g}",
        )
        if worst < GOOD:
            yield Candidate(plan_of_folding(mission, knot, folding), folding, notes=notes)
            notes = ()
        else:
            deferred.append(folding)
    deferred.sort(key=lambda folding: folding.schedule.worst)
    for folding in deferred[:_DEFERRED]:
        yield Candidate(plan_of_folding(mission, knot, folding), folding, notes=notes)
        notes = ()


def _foldings(
    opened: Iterator[OpenGrid],
    layouts: list[LayoutParameters],
    margins: Margins,
    progress: Progress | None,
) -> Iterator[Folding]:
    """Yield foldings of all openings in the smallest cells, then of the best in larger cells."""
    best: list[OpenGrid] = []
    for diagram in opened:
        best.append(diagram)
        yield _folding(diagram, layouts[0], margins, progress)
    for shape in layouts[1:]:
        for diagram in best[:_IN_LARGER_CELLS]:
            yield _folding(diagram, shape, margins, progress)


def _folding(
    diagram: OpenGrid, shape: LayoutParameters, margins: Margins, progress: Progress | None
) -> Folding:
    if progress:
        progress(f"folding with a cell of {shape.cell:.2f} m", 0.0)
    return fold_diagram(diagram, shape, margins)


def _refuse_unsupported_start(mission: Mission) -> None:
    """Refuse a start that no plan has, rather than ignore it."""
    if mission.start != "line":
        raise Refused(
            f"start: {mission.start} is not planned: the fold begins on a straight line that takes "
            "most of the cable's length, so a bent lay line would save no space"
        )


def _refuse_crowding(
    mission: Mission, knot: KnotSummary, opened: list[OpenGrid], margins: Margins
) -> None:
    """Refuse a cell that is too small for vehicles at rest on the corners, all at one height."""
    cell, key = mission.layout.cell, "layout.cell"
    if mission.cable.length is not None:
        shape = fit_to_cable(opened[0], next(layout_sizes(mission, margins)), margins)
        cell, key = shape.cell, f"cable.length {mission.cable.length:g} m, a cell of"
    if cell == "auto":
        return
    distance = (
        max(float(scipy.spatial.distance.pdist(diagram.corners).min()) for diagram in opened) * cell
    )
    required = margins.vehicle + 2.0 * margins.tracking
    if distance < required:
        raise Refused(
            f"no fold of {knot.type} keeps the clearances with {key} {cell:.3g} m: vehicles "
            f"would rest {distance:.2f} m apart, and clearance.vehicle with two tracking "
            f"errors requires {required:.2f} m"
        )


def _smallest_layouts(
    mission: Mission, opened: list[OpenGrid], margins: Margins
) -> list[npt.NDArray[np.float64]]:
    """Return the corners (n, 2) of every opening in metres, in the smallest cells to try."""
    smallest = next(layout_sizes(mission, margins))
    shapes = [fit_to_cable(diagram, smallest, margins) for diagram in opened]
    return [
        shape.cell * np.asarray(diagram.corners, dtype=np.float64)
        for diagram, shape in zip(opened, shapes, strict=True)
    ]


def _knot(mission: Mission) -> tuple[KnotChoice, KnotSummary]:
    """Return the knot of the mission with its grid diagram, and its summary for the plan."""
    section = mission.knot
    if section is None:
        raise Refused("the mission names no knot")
    choice = choose_knot(
        name=section.name,
        gauss=section.gauss,
        dt=section.dt,
        pd=section.pd,
        grid=section.grid,
        chirality=section.chirality,
    )
    summary = KnotSummary(
        type=choice.name,
        chirality=choice.chirality,  # type: ignore[arg-type]
        gauss=choice.gauss,
        grid_columns=choice.grid.columns,
    )
    return choice, summary
