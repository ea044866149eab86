"""Layouts of a grid diagram: cell sizes, sags and openings to try, and the foldings to them."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from swarm.errors import Refused
from swarm.folding.lane_assignment import assignment_cost
from swarm.folding.layout import KnotLayout, LayoutParameters, lay_out
from swarm.folding.margins import Margins
from swarm.folding.outlines import outline_strands
from swarm.folding.path import Guide
from swarm.folding.schedule import Schedule, make_schedule
from swarm.folding.soft_constraints import strand_costs
from swarm.knots.grid import OpenGrid
from swarm.mission import Mission
from swarm.threads import side_by_side

Progress = Callable[[str, float], None]

SAMPLING_ERROR = 0.015
"""Largest excess of sampled distances between polygons over the exact ones, metres."""

GOOD = 0.6
"""Missed margin at the worst moment below which a folding is likely to be certified; the others are
deferred. In units of a margin."""

_COMPARED, _MOST_COMPARED = 12, 96
"""Number of openings of the grid diagram that are compared at first, and at most."""

_WITHOUT_IMPROVEMENT = 30
"""Where the best of the first openings is obstructed, the comparison goes on until so many in a row
are not better."""

_OBSTRUCTED = 12.0
"""Cost of the lane assignment per segment above which an opening counts as obstructed."""

_BEST, _OTHERS = 3, 9
"""Number of openings that are folded, and number of further ones where none of them is cleared."""

_STEP = 0.4
"""Step of the lattice of progress, in cells."""

_SCALES = (1.0, 1.3, 1.7, 2.3)
"""Cell widths that are tried, over the width that clearances suggest."""

_ROOM = 0.1
"""Metres by which strands keep farther apart where the budget has to close: swing and stops take
0.15 m of it. Without, 1,500 moments of the Carrick mat were short, and repairs led from a fold of
254 s to 272, 291 or 339 s, as the last digit of a length decided; with it, 20 to 150 moments are,
and folds take 260 to 270 s."""

_CHORD_MARGIN = 2.2
"""Tracking errors by which the ends of a segment can be farther apart than its corners. With 0.2 m
more, the fold of the Carrick mat takes 265 s instead of 284 s, since one short segment limited its
speed; but no chord limits that of the overhand, whose cable would only be longer."""

_SMALLEST = 0.05
"""Least factor by which a layout is scaled to fit a cable."""

_SLOPE, _ROUNDING = 0.98, 0.5
"""Distance before a corner, in cells, at which level changes and turns begin."""


@dataclass(frozen=True, eq=False)
class Folding:
    """A layout, and the schedule that takes the team to it."""

    layout: KnotLayout
    schedule: Schedule


def layout_sizes(mission: Mission, margins: Margins) -> Iterator[LayoutParameters]:
    """Yield layouts to try, the smallest first. Numbers in the mission replace the defaults."""
    section = mission.layout
    strand = margins.cable + 5.0 * margins.tracking
    usual = planning_margins(mission).cable + 5.0 * margins.tracking
    least = max(2.2 * usual, 1.25 * (margins.vehicle + 2.0 * margins.tracking))
    for scale in _SCALES if section.cell == "auto" else (1.0,):
        cell = scale * least if section.cell == "auto" else section.cell
        yield LayoutParameters(
            cell=cell,
            gap=1.15 * strand if margins.tracking else 2.0 * strand,
            minimum_sag=0.2 * cell,
            slack=0.16,
            lane_over=section.lane_over if section.lane_over != "auto" else 0.6 * cell,
            lane_under=section.lane_under if section.lane_under != "auto" else 0.5 * cell,
            slope=_SLOPE * cell,
            rounding=_ROUNDING * cell,
            chord_margin=(
                section.chord_margin
                if section.chord_margin != "auto"
                else _CHORD_MARGIN * margins.tracking
            ),
            max_chord_ratio=0.98 * margins.max_chord_ratio,
            sag_over=None if section.sag_over == "auto" else section.sag_over,
            sag_under=None if section.sag_under == "auto" else section.sag_under,
            length=mission.cable.length,
        )


def fit_to_cable(
    diagram: OpenGrid, parameters: LayoutParameters, margins: Margins
) -> LayoutParameters:
    """Return the layout scaled so that the diagram uses its length of cable, or slightly less.

    Unchanged where the layout has no length. Raises :class:`swarm.errors.Refused` where even the
    smallest layout uses more.
    """
    if parameters.length is None:
        return parameters

    def used(factor: float) -> float:
        return float(lay_out_apart(diagram, parameters.scaled(factor), margins).lengths.sum())

    low, high = 1.0, 1.0
    while used(low) > parameters.length:
        low *= 0.7
        if low < _SMALLEST:
            raise Refused(
                f"cable.length {parameters.length:g} m: even with a cell of "
                f"{low * parameters.cell:.2f} m the layout takes {used(low):.1f} m"
            )
    while used(high) < parameters.length:
        high *= 1.4
    while high - low > 1e-6 * low:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if used(middle) <= parameters.length else (low, middle)
    return parameters.scaled(low)


def make_guide(layout: KnotLayout, slope: float, rounding: float) -> Guide:
    """Return the common path of all vehicles to a layout; see :class:`Guide`. Metres."""
    run_in = 1.1 * float(layout.lengths.sum()) + 2.0
    return Guide(layout.corners, layout.lanes, slope, rounding, run_in)


def fold_diagram(diagram: OpenGrid, parameters: LayoutParameters, margins: Margins) -> Folding:
    """Return the folding of a diagram: its layout, and the schedule to its corners."""
    parameters = fit_to_cable(diagram, parameters, margins)
    layout = lay_out_apart(diagram, parameters, margins)
    guide = make_guide(layout, parameters.slope, parameters.rounding)
    return Folding(layout, make_schedule(layout, guide, margins, _STEP * parameters.cell))


def rank_openings(
    opened: list[OpenGrid],
    parameters: LayoutParameters,
    margins: Margins,
    progress: Progress | None,
) -> Iterator[OpenGrid]:
    """Yield openings, best first: those with the least obstructed paths and the least cable.

    Less cable means less time. After the first ones, the others are compared.
    """
    opened = opened[:_MOST_COMPARED]
    best = _best(opened, parameters, margins, _BEST, _WITHOUT_IMPROVEMENT, progress)
    yield from (opened[k] for k in best)
    others = [diagram for k, diagram in enumerate(opened) if k not in best]
    yield from (
        others[k] for k in _best(others, parameters, margins, _OTHERS, _MOST_COMPARED, progress)
    )


def _best(
    opened: list[OpenGrid],
    parameters: LayoutParameters,
    margins: Margins,
    wanted: int,
    patience: int,
    progress: Progress | None,
) -> list[int]:
    """Return the indices of the best openings, at most ``wanted``, best first."""
    costs: list[float] = []
    scores: list[float] = []

    def cost_and_score(diagram: OpenGrid) -> tuple[float, float]:
        fit = fit_to_cable(diagram, parameters, margins)
        layout = lay_out_apart(diagram, fit, margins)
        guide = make_guide(layout, fit.slope, fit.rounding)
        square = float(layout.lengths.sum()) ** 2
        # by now: an opening that is not among the best of these is not among those of all
        chosen = sorted(scores)[:wanted]
        enough = chosen[-1] / square if len(chosen) == wanted else np.inf
        cost = assignment_cost(layout, guide, margins, _STEP * fit.cell, enough)
        return cost, cost * square

    for cost, score in side_by_side(cost_and_score, opened):
        costs.append(cost)
        scores.append(score)
        done, leading = len(scores), int(np.argmin(scores))
        if progress:
            progress("comparing openings of the grid diagram", done / len(opened))
        clear = costs[leading] < _OBSTRUCTED * len(opened[done - 1].corners)
        if done >= _COMPARED and (clear or done - leading > patience):
            break
    return [int(k) for k in np.argsort(scores, kind="stable")[:wanted]]


def distinct_openings(opened: tuple[OpenGrid, ...]) -> list[OpenGrid]:
    """Return openings without rotated or mirrored copies in plan view, which fold alike."""
    by_shape: dict[tuple[object, ...], OpenGrid] = {}
    for diagram in opened:
        steps = np.diff(np.array(diagram.corners, dtype=np.intp), axis=0)
        first = np.sign(steps[0])
        ahead, aside = steps @ first, steps @ np.array([-first[1], first[0]])
        aside *= np.sign(aside[np.flatnonzero(aside)[0]])
        by_shape.setdefault((diagram.crossings, tuple(ahead), tuple(aside)), diagram)
    return list(by_shape.values())


def planning_margins(mission: Mission) -> Margins:
    """Return the margins of a mission, enlarged by the error of sampled distances."""
    vehicles, clearance = mission.vehicles, mission.clearance
    return Margins(
        cable=clearance.cable + mission.cable.diameter + SAMPLING_ERROR,
        vehicle=clearance.vehicle,
        downwash=clearance.downwash,
        vehicle_cable=clearance.vehicle_cable
        + 0.5 * mission.cable.diameter
        + 3.0 * SAMPLING_ERROR
        + room_to_swing(mission),
        tracking=vehicles.tracking,
        radius=vehicles.radius,
        grip_offset=vehicles.grip_offset,
        exempt=4.0 * (clearance.cable + mission.cable.diameter + vehicles.tracking)
        + SAMPLING_ERROR,
    )


def room_to_swing(mission: Mission) -> float:
    """Return the limit of a certified swing, metres; 0 where none is certified.

    It is added to the distance of vehicles and cable: vehicles pass cable as near as is allowed,
    within a centimetre. Strands get no room: repairs for the budget lead them farther apart. With
    as much room between strands, the cable of the default overhand (0.06 m) is 7 % longer, and its
    fold takes 5 s more.
    """
    return 0.0 if mission.fold.swing == "auto" else mission.fold.swing


def grid_margins(mission: Mission) -> Margins:
    """Return the margins with which a grid diagram is folded: more where the budget has to close.

    Only where ``fold.swing`` is ``auto``: limits in metres are small, and their missions close with
    repairs alone. Nor where the cable's length is given, of which the room would take a part. The
    cells are as wide as without.
    """
    margins = planning_margins(mission)
    chosen = mission.fold.swing != "auto" or mission.cable.length is not None
    if chosen or mission.limits.accept_negative_budget:
        return margins
    return margins._replace(cable=margins.cable + _ROOM)


def lay_out_apart(diagram: OpenGrid, parameters: LayoutParameters, margins: Margins) -> KnotLayout:
    """Return the layout in which crossing strands keep their margins at rest, in any direction."""
    for _ in range(8):
        layout = lay_out(diagram.corners, diagram.crossings, parameters)
        pairs = np.array(layout.crossings, dtype=np.intp).reshape(-1, 2)
        at_rest = outline_strands(layout.corners[:-1], layout.corners[1:], layout.lengths)
        cost = strand_costs(at_rest.take(pairs[:, 0]), at_rest.take(pairs[:, 1]), margins)
        if not len(pairs) or cost.max() < 0.02:
            break
        parameters = replace(parameters, gap=1.08 * parameters.gap)
    return layout
