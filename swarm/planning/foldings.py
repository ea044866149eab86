"""Knot and limits → layouts to try, and their foldings: how large, how high, which opening."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from swarm.errors import Refused
from swarm.folding.lane_assignment import assignment_cost
from swarm.folding.layout import KnotLayout, LayoutParameters, lay_out
from swarm.folding.margins import Margins
from swarm.folding.path import Guide
from swarm.folding.schedule import Schedule, make_schedule
from swarm.folding.soft_constraints import outline_strands, strand_costs
from swarm.knots.grid import OpenGrid
from swarm.mission import Mission

Progress = Callable[[str, float], None]

SAMPLING_ERROR = 0.015
"""What sampled distances between polygons may miss of the least ones, metres."""

_OPENINGS, _IN_VAIN, _MORE = 12, 30, 96
"""Openings of the grid diagram that are compared, and how many where these are in the way: until so
many in a row were no better than the best of those before. All of the last, where none folds."""

_IN_THE_WAY = 12.0
"""Cost of ways, for every segment, from which on more openings are compared."""

_BEST, _OTHERS = 3, 9
"""So many of them are tried, and so many more where none of those folds."""

_STEP = 0.4
"""Step of the lattice of progress, in cells."""

_SCALES = (1.0, 1.3, 1.7, 2.3)
"""Cells that are tried, over the one that clearances suggest."""

_SMALLEST = 0.05
"""Layouts are not scaled down by more to fit a cable."""

_SLOPE, _ROUNDING = 0.98, 0.5
"""From how far before a corner, in cells, levels change and turns begin."""


@dataclass(frozen=True, eq=False)
class Folding:
    """A layout, and the schedule that takes the team to it."""

    layout: KnotLayout
    schedule: Schedule


def layout_sizes(mission: Mission, margins: Margins) -> Iterator[LayoutParameters]:
    """Layouts to try, the smallest first; numbers in the mission are taken as they are."""
    asked = mission.layout
    strand = margins.cable + 5.0 * margins.tracking
    least = max(2.2 * strand, 1.25 * (margins.vehicle + 2.0 * margins.tracking))
    for scale in _SCALES if asked.cell == "auto" else (1.0,):
        cell = scale * least if asked.cell == "auto" else asked.cell
        yield LayoutParameters(
            cell=cell,
            gap=1.15 * strand if margins.tracking else 2.0 * strand,
            minimum_sag=0.2 * cell,
            slack=0.16,
            lane_over=asked.lane_over if asked.lane_over != "auto" else 0.6 * cell,
            lane_under=asked.lane_under if asked.lane_under != "auto" else 0.5 * cell,
            slope=_SLOPE * cell,
            rounding=_ROUNDING * cell,
            chord_margin=2.2 * margins.tracking,
            max_chord_ratio=0.98 * margins.max_chord_ratio,
            sag_over=None if asked.sag_over == "auto" else asked.sag_over,
            sag_under=None if asked.sag_under == "auto" else asked.sag_under,
            length=mission.cable.length,
        )


def fit_to_cable(diagram: OpenGrid, shape: LayoutParameters, margins: Margins) -> LayoutParameters:
    """Scale a shape until the diagram hung in it takes the shape's length of cable, or just less.

    Raises :class:`swarm.errors.Refused` where the smallest layouts take more.
    """
    if shape.length is None:
        return shape

    def takes(factor: float) -> float:
        return float(lay_out_apart(diagram, shape.scaled(factor), margins).lengths.sum())

    low, high = 1.0, 1.0
    while takes(low) > shape.length:
        low *= 0.7
        if low < _SMALLEST:
            raise Refused(
                f"cable.length {shape.length:g} m: even with a cell of {low * shape.cell:.2f} m "
                f"the layout takes {takes(low):.1f} m"
            )
    while takes(high) < shape.length:
        high *= 1.4
    while high - low > 1e-6 * low:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if takes(middle) <= shape.length else (low, middle)
    return shape.scaled(low)


def make_guide(layout: KnotLayout, slope: float, rounding: float) -> Guide:
    """The line along which a layout's vehicles make progress; see :class:`Guide`."""
    run_in = 1.1 * float(layout.lengths.sum()) + 2.0
    return Guide(layout.corners, layout.lanes, slope, rounding, run_in)


def fold_diagram(diagram: OpenGrid, shape: LayoutParameters, margins: Margins) -> Folding:
    """Hang a diagram in a shape, and find everybody's way to its corners."""
    shape = fit_to_cable(diagram, shape, margins)
    layout = lay_out_apart(diagram, shape, margins)
    guide = make_guide(layout, shape.slope, shape.rounding)
    return Folding(layout, make_schedule(layout, guide, margins, _STEP * shape.cell))


def rank_openings(
    opened: list[OpenGrid], shape: LayoutParameters, margins: Margins, progress: Progress | None
) -> Iterator[OpenGrid]:
    """Openings along whose paths segments are least in the way of others, best first.

    Of openings that are about as good, those that take less cable, and with it less time. More are
    compared once the first ones were taken.
    """
    opened = opened[:_MORE]
    best = _best(opened, shape, margins, _BEST, _IN_VAIN, progress)
    yield from (opened[k] for k in best)
    others = [diagram for k, diagram in enumerate(opened) if k not in best]
    yield from (others[k] for k in _best(others, shape, margins, _OTHERS, _MORE, progress))


def _best(
    opened: list[OpenGrid],
    shape: LayoutParameters,
    margins: Margins,
    wanted: int,
    in_vain: int,
    progress: Progress | None,
) -> list[int]:
    """Which openings are the best, as many as are wanted."""
    costs: list[float] = []
    scores: list[float] = []
    for k, diagram in enumerate(opened):
        if k >= _OPENINGS:
            leading = int(np.argmin(scores))
            if costs[leading] < _IN_THE_WAY * len(diagram.corners) or k - leading > in_vain:
                break
        if progress:
            progress("comparing openings of the grid diagram", k / len(opened))
        fit = fit_to_cable(diagram, shape, margins)
        layout = lay_out_apart(diagram, fit, margins)
        guide = make_guide(layout, fit.slope, fit.rounding)
        square = float(layout.lengths.sum()) ** 2
        chosen = sorted(scores)[:wanted]
        enough = chosen[-1] / square if len(chosen) == wanted else np.inf
        costs.append(assignment_cost(layout, guide, margins, _STEP * fit.cell, enough))
        scores.append(costs[-1] * square)
    return [int(k) for k in np.argsort(scores, kind="stable")[:wanted]]


def distinct_openings(opened: tuple[OpenGrid, ...]) -> list[OpenGrid]:
    """Openings that are not turned or mirrored copies of others in plan view, which fold alike."""
    found: dict[tuple[object, ...], OpenGrid] = {}
    for diagram in opened:
        steps = np.diff(np.array(diagram.corners, dtype=np.intp), axis=0)
        first = np.sign(steps[0])
        ahead, aside = steps @ first, steps @ np.array([-first[1], first[0]])
        aside *= np.sign(aside[np.flatnonzero(aside)[0]])
        found.setdefault((diagram.crossings, tuple(ahead), tuple(aside)), diagram)
    return list(found.values())


def planning_margins(mission: Mission) -> Margins:
    """What a mission's team is to keep, with what sampled distances may miss."""
    vehicles, clearance = mission.vehicles, mission.clearance
    return Margins(
        cable=clearance.cable + mission.cable.diameter + SAMPLING_ERROR,
        vehicle=clearance.vehicle,
        downwash=clearance.downwash,
        vehicle_cable=clearance.vehicle_cable + 0.5 * mission.cable.diameter + 3.0 * SAMPLING_ERROR,
        tracking=vehicles.tracking,
        radius=vehicles.radius,
        grip_offset=vehicles.grip_offset,
        exempt=4.0 * (clearance.cable + mission.cable.diameter + vehicles.tracking)
        + SAMPLING_ERROR,
    )


def lay_out_apart(diagram: OpenGrid, shape: LayoutParameters, margins: Margins) -> KnotLayout:
    """Hang the knot so that its strands keep their margins at rest, in any direction."""
    for _ in range(8):
        layout = lay_out(diagram.corners, diagram.crossings, shape)
        pairs = np.array(layout.crossings, dtype=np.intp).reshape(-1, 2)
        at_rest = outline_strands(layout.corners[:-1], layout.corners[1:], layout.lengths)
        cost = strand_costs(at_rest[pairs[:, 0]], at_rest[pairs[:, 1]], margins)
        if not len(pairs) or cost.max() < 0.02:
            break
        shape = replace(shape, gap=1.08 * shape.gap)
    return layout
