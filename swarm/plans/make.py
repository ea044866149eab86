"""Mission → plan: lay the knot out, fold it, and fly it from the pads to the ground."""

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import pdist

from swarm.cable.catenary import hang
from swarm.errors import Refused
from swarm.fold.clear import Margins, lift, strand_cost, strands
from swarm.fold.lanes import found_ways
from swarm.fold.layout import Hanging, Shape, given, hanging
from swarm.fold.paper import dips, printed_motion
from swarm.fold.path import Guide
from swarm.fold.schedule import Schedule, asked_more, improved, schedule, team_path
from swarm.knots.catalog import KnotChoice, choose
from swarm.knots.grid import OpenGrid, openings
from swarm.mission import Mission
from swarm.plans.flight import whole_flight
from swarm.plans.formation import formation_plan
from swarm.plans.plan import KnotSummary, Layout, Plan
from swarm.trajectory import Motion, through_states, timed

Floats = npt.NDArray[np.float64]
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Shortfall:
    """A moment at which a plan falls short of what a check asks, by metres."""

    check: str
    time: float
    metres: float


Shortfalls = Sequence[Shortfall]


def make_plan(mission: Mission, *, progress: Progress | None = None) -> Plan:
    """Return the planner's first choice for a mission; not yet certified.

    ``progress`` is told what is being done and how much of it is done, 0…1. Raises
    :class:`swarm.errors.Refused` where nothing that was tried works.
    """
    return next(candidates(mission, progress=progress))


def candidates(
    mission: Mission, *, progress: Progress | None = None
) -> Generator[Plan, Shortfalls | None, None]:
    """Yield plans for a mission, best first, for the certificate to judge.

    What a certificate finds missing may be sent in answer. Then the same plan is mended with so
    much more margin there, if it can be.

    Where nothing seems to keep the clearances, the plan that misses them least is the only one: the
    certificate says of it what is wrong. Its notes, as those of every plan, say what was tried.
    Raises :class:`swarm.errors.Refused` where vehicles could not even rest on the corners.
    """
    _refuse_unplanned(mission)
    if mission.formation is not None:
        yield formation_plan(mission, mission.formation)
        return
    choice, knot = _knot(mission)
    opened = _different(openings(choice.grid))
    margins = _margins(mission)
    if mission.fold.method == "paper":
        yield _printed(mission, knot, _paper_layout(mission, opened[0], margins))
        return
    if mission.layout.corners is not None:
        yield from _as_given(mission, knot, margins, progress)
        return
    _refuse_crowding(mission, knot, opened, margins)
    tried: list[str] = []
    doubtful: list[Folding] = []
    layouts = list(shapes(mission, margins))
    ranked = _ranked(opened[:_OPENINGS], layouts[0], margins, progress)
    roomy = layouts[1:] if len(opened[0].corners) > _MANY and len(layouts) > 1 else layouts
    for folding in _foldings(ranked, roomy, margins, progress):
        worst = folding.plan.worst
        tried.append(
            f"tried a cell of {folding.layout.cell:.2f} m: misses its margins by {worst:.2g}"
        )
        if worst < _GOOD:
            yield from _mended(mission, knot, folding, tried)
        else:
            doubtful.append(folding)
    doubtful.sort(key=lambda folding: folding.plan.worst)
    for folding in doubtful[:_DOUBTFUL]:
        yield from _mended(mission, knot, folding, tried)


def _mended(
    mission: Mission,
    knot: KnotSummary,
    folding: "Folding",
    tried: list[str],
) -> Generator[Plan, Shortfalls | None, None]:
    """A plan, and better ones of the same kind while its certificate says what is missing."""
    for _ in range(_MENDINGS):
        made = _planned(mission, knot, folding, tried)
        missing = yield made
        if not missing:
            break
        folding = replace(folding, plan=improved(_with_more(folding, made, missing)))
        tried.append("gave way by more where the certificate missed something")


def _with_more(folding: "Folding", made: Plan, missing: Shortfalls) -> Schedule:
    """A folding's schedule, asked for more where its plan falls short, by that and a little."""
    plan = folding.plan
    stages = np.arange(4.0 * plan.last) / 4.0
    places = plan.at(stages)[0] + (made.layout.corners[0] - folding.layout.corners[0])
    for check, margin in _MARGINS.items():
        found = [(each.time, each.metres) for each in missing if each.check == check]
        if found:
            times, metres = np.array(found).T
            apart = made.motion.at(times)[0][:, None] - places
            at = stages[np.argmin((apart**2).sum(axis=(2, 3)), axis=1)]
            asked = np.minimum(1.1 * metres + _SAMPLING, _MOST)
            plan = asked_more(plan, margin, at, asked)
    return plan


_MARGINS = {
    "cable clearance": "cable",
    "neighbouring segments": "beside",
    "vehicle clearance": "vehicle",
    "vehicle-cable clearance": "vehicle_cable",
    "rotor disc": "disc",
    "taut": "play",
}
"""What is asked for where a check fails."""

_MOST = 0.2
"""Metres that are asked for at once: bounds of a certificate that fails may be far from tight."""


def _refuse_unplanned(mission: Mission) -> None:
    """Refuse what the mission asks for and no plan would do; nothing is ignored in silence."""
    if mission.start != "line":
        raise Refused(
            f"start: {mission.start} is not planned: the fold begins on a straight line that takes "
            "most of the cable's length, so a bent lay line would save no room"
        )


def _refuse_crowding(
    mission: Mission, knot: KnotSummary, opened: list[OpenGrid], margins: Margins
) -> None:
    """Refuse a cell that brings vehicles at rest on their corners, all at one height, too close."""
    cell, key = mission.layout.cell, "layout.cell"
    if mission.cable.length is not None:
        shape = fitted(opened[0], next(shapes(mission, margins)), margins)
        cell, key = shape.cell, f"cable.length {mission.cable.length:g} m, a cell of"
    if cell == "auto":
        return
    apart = max(float(pdist(diagram.corners).min()) for diagram in opened) * cell
    least = margins.vehicle + 2.0 * margins.tracking
    if apart < least:
        raise Refused(
            f"no fold of {knot.type} keeps the clearances with {key} {cell:.3g} m: vehicles "
            f"would rest {apart:.2f} m apart, and clearance.vehicle with tracking errors of both "
            f"asks for {least:.2f} m"
        )


def _ranked(
    opened: list[OpenGrid], shape: Shape, margins: Margins, progress: Progress | None
) -> list[OpenGrid]:
    """The openings along whose paths segments are least in the way of others, best first."""
    costs = []
    for k, diagram in enumerate(opened):
        if progress:
            progress("comparing openings of the grid diagram", k / len(opened))
        fit = fitted(diagram, shape, margins)
        layout = _hung_apart(diagram, fit, margins)
        guide = _guide(layout, fit.slope, fit.rounding)
        costs.append(found_ways(layout, guide, margins, _STEP * fit.cell).cost)
    return [opened[k] for k in np.argsort(costs, kind="stable")[:_BEST]]


def _foldings(
    opened: list[OpenGrid], layouts: list[Shape], margins: Margins, progress: Progress | None
) -> Iterator["Folding"]:
    """Foldings of all openings in each layout."""
    for shape in layouts:
        for k, diagram in enumerate(opened):
            if progress:
                progress(f"folding with a cell of {shape.cell:.2f} m", k / len(opened))
            yield _folded(diagram, shape, margins)


_MENDINGS = 8
"""So often a plan that nearly holds is judged."""

_SAMPLING = 0.015
"""What sampled distances between polygons may miss of the least ones, metres."""

_OPENINGS = 12
"""Openings of the grid diagram that are compared."""

_BEST = 3
"""So many of them are tried with each layout."""

_GOOD = 0.3
"""Schedules that miss their margins by less, at the worst moment, are likely to be certified."""

_DOUBTFUL = 2
"""So many of the others are judged, the best first, once nothing better was found."""

_STEP = 0.4
"""Step of the lattice of progress, in cells."""

_SCALES = (1.0, 1.3, 1.7, 2.3)
"""Cells that are tried, over the one that clearances suggest."""

_MANY = 16
"""Teams of more vehicles than this begin with the second of these."""

_SMALLEST = 0.05
"""Layouts are not scaled down by more to fit a cable."""

_SLOPE, _ROUNDING = 0.98, 0.5
"""From how far before a corner, in cells, levels change and turns begin."""


def shapes(mission: Mission, margins: Margins) -> Iterator[Shape]:
    """Layouts to try, the smallest first; numbers in the mission are taken as they are."""
    asked = mission.layout
    strand = margins.cable + 5.0 * margins.tracking
    least = max(2.2 * strand, 1.25 * (margins.vehicle + 2.0 * margins.tracking))
    for scale in _SCALES if asked.cell == "auto" else (1.0,):
        cell = scale * least if asked.cell == "auto" else asked.cell
        yield Shape(
            cell=cell,
            gap=1.15 * strand if margins.tracking else 2.0 * strand,
            minimum_sag=0.2 * cell,
            slack=0.16,
            lane_over=asked.lane_over if asked.lane_over != "auto" else 0.6 * cell,
            lane_under=asked.lane_under if asked.lane_under != "auto" else 0.5 * cell,
            slope=_SLOPE * cell,
            rounding=_ROUNDING * cell,
            play=2.2 * margins.tracking,
            taut=0.98 * margins.taut,
            sag_over=None if asked.sag_over == "auto" else asked.sag_over,
            sag_under=None if asked.sag_under == "auto" else asked.sag_under,
            length=mission.cable.length,
        )


@dataclass(frozen=True, eq=False)
class Folding:
    """A layout with the path through it and everybody's progress."""

    layout: Hanging
    plan: Schedule


def fitted(diagram: OpenGrid, shape: Shape, margins: Margins) -> Shape:
    """Scale a shape until the diagram hung in it takes the shape's length of cable, or just less.

    Raises :class:`swarm.errors.Refused` where the smallest layouts take more.
    """
    if shape.length is None:
        return shape

    def takes(factor: float) -> float:
        return float(_hung_apart(diagram, shape.scaled(factor), margins).lengths.sum())

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


def _guide(layout: Hanging, slope: float, rounding: float) -> Guide:
    run_in = 1.1 * float(layout.lengths.sum()) + 2.0
    return Guide(layout.corners, layout.lanes, slope, rounding, run_in)


def _folded(diagram: OpenGrid, shape: Shape, margins: Margins) -> Folding:
    shape = fitted(diagram, shape, margins)
    layout = _hung_apart(diagram, shape, margins)
    guide = _guide(layout, shape.slope, shape.rounding)
    return Folding(layout, schedule(layout, guide, margins, _STEP * shape.cell))


def _knot(mission: Mission) -> tuple[KnotChoice, KnotSummary]:
    """The knot to tie, with its grid diagram."""
    asked = mission.knot
    if asked is None:
        raise Refused("the mission names no knot")
    choice = choose(
        name=asked.name,
        gauss=asked.gauss,
        dt=asked.dt,
        pd=asked.pd,
        grid=asked.grid,
        chirality=asked.chirality,
    )
    summary = KnotSummary(
        type=choice.name,
        chirality=choice.chirality,  # type: ignore[arg-type]
        gauss=choice.gauss,
        grid_columns=choice.grid.columns,
    )
    return choice, summary


def _different(opened: tuple[OpenGrid, ...]) -> list[OpenGrid]:
    """Openings that are not turned or mirrored copies of others in plan view, which fold alike."""
    found: dict[tuple[object, ...], OpenGrid] = {}
    for diagram in opened:
        steps = np.diff(np.array(diagram.corners, dtype=np.intp), axis=0)
        first = np.sign(steps[0])
        ahead, aside = steps @ first, steps @ np.array([-first[1], first[0]])
        aside *= np.sign(aside[np.flatnonzero(aside)[0]])
        found.setdefault((diagram.crossings, tuple(ahead), tuple(aside)), diagram)
    return list(found.values())


def _margins(mission: Mission) -> Margins:
    vehicles, clearance = mission.vehicles, mission.clearance
    return Margins(
        cable=clearance.cable + mission.cable.diameter + _SAMPLING,
        vehicle=clearance.vehicle,
        downwash=clearance.downwash,
        vehicle_cable=clearance.vehicle_cable + 0.5 * mission.cable.diameter + 3.0 * _SAMPLING,
        tracking=vehicles.tracking,
        radius=vehicles.radius,
        grip_offset=vehicles.grip_offset,
        hand=4.0 * (clearance.cable + mission.cable.diameter + vehicles.tracking) + _SAMPLING,
        beside=0.3 * vehicles.tracking,
    )


def _hung_apart(diagram: OpenGrid, shape: Shape, margins: Margins) -> Hanging:
    """Hang the knot so that its strands keep their margins at rest, in any direction."""
    for _ in range(8):
        layout = hanging(diagram.corners, diagram.crossings, shape)
        pairs = np.array(layout.crossings, dtype=np.intp).reshape(-1, 2)
        at_rest = strands(layout.corners[:-1], layout.corners[1:], layout.lengths)
        cost = strand_cost(at_rest[pairs[:, 0]], at_rest[pairs[:, 1]], margins)
        if not len(pairs) or cost.max() < 0.02:
            break
        shape = replace(shape, gap=1.08 * shape.gap)
    return layout


def _planned(
    mission: Mission,
    knot: KnotSummary,
    folding: Folding,
    tried: list[str],
) -> Plan:
    layout, path = folding.layout, folding.plan.path
    parameter, places, slopes, bends = team_path(folding.plan)
    vehicles = mission.vehicles
    fold = timed(
        parameter,
        places,
        slopes,
        bends,
        max_speed=vehicles.max_speed,
        max_acceleration=vehicles.max_acceleration - vehicles.braking_acceleration,
    )
    line = path.at(len(layout.corners) - 1, np.linspace(0.0, path.stops[-1], 400))[0]
    return _flown(mission, knot, layout, fold, line, tried)


def _as_given(
    mission: Mission, knot: KnotSummary, margins: Margins, progress: Progress | None
) -> Generator[Plan, Shortfalls | None, None]:
    """Plans for a layout given by its corners and sags, the most promising first.

    The lanes are ordered as the sags are, the segment that sags least highest; how far apart they
    are, where levels change and how wide turns are is tried.
    """
    asked = mission.layout
    layout = given(asked.corners or (), asked.sags or (), 0.0)
    edges = np.diff(layout.corners[:, :2], axis=0)
    shortest = float(np.linalg.norm(edges, axis=1).min())
    heading = edges[0] / np.linalg.norm(edges[0])
    turn = np.array([[heading[0], heading[1]], [-heading[1], heading[0]]])
    corners = layout.corners.copy()
    corners[:, :2] = (corners[:, :2] - corners[0, :2]) @ turn.T
    levels = np.unique(layout.sags.round(6), return_inverse=True)[1].astype(np.float64)
    tried: list[str] = []
    foldings: list[Folding] = []
    for done, (apart, slope, rounding) in enumerate(_GIVEN):
        if progress:
            progress("folding the given layout", done / len(_GIVEN))
        lanes = apart * shortest * (0.5 * levels.max() - levels)
        hung = replace(layout, corners=corners, lanes=lanes)
        guide = _guide(hung, slope * shortest, rounding * shortest)
        plan = schedule(hung, guide, margins, 0.06 * shortest)
        foldings.append(Folding(hung, plan))
        tried.append(
            f"tried lanes {apart * shortest:.2f} m apart: misses its margins by {plan.worst:.2g}"
        )
    foldings.sort(key=lambda folding: folding.plan.worst)
    for folding in foldings[:_MENDINGS]:
        yield from _mended(mission, knot, folding, tried)


_GIVEN = ((0.19, 0.17, 0.2), (0.1, 0.3, 0.15), (0.25, 0.3, 0.15))
"""Distance of lanes, reach of level changes and of turns, over the shortest edge."""


def _paper_layout(mission: Mission, diagram: OpenGrid, margins: Margins) -> Hanging:
    """The layout given by corners and sags, or else the diagram with two sags."""
    asked = mission.layout
    if asked.corners is not None and asked.sags is not None:
        return given(asked.corners, asked.sags, 0.0 if asked.cell == "auto" else asked.cell)
    shape = next(shapes(mission, margins))
    return hanging(diagram.corners, diagram.crossings, replace(shape, two_sags=True))


def _printed(mission: Mission, knot: KnotSummary, layout: Hanging) -> Plan:
    """The paper's own trajectory."""
    vehicles = mission.vehicles
    deepest = float(layout.sags.max())
    states = printed_motion(
        layout.corners,
        layout.lengths,
        deepest,
        mission.fold.delay,
        max_speed=vehicles.max_speed,
        max_acceleration=vehicles.max_acceleration - vehicles.braking_acceleration,
    )
    fold = through_states(states.times, states.position, states.velocity, states.acceleration)
    layout = replace(layout, lanes=-dips(len(layout.lengths), deepest))
    line = fold.at(np.linspace(fold.times[0], fold.times[-1], 400))[0][:, -1]
    return _flown(mission, knot, layout, fold, line, ["the paper's trajectory, as printed"])


def _flown(
    mission: Mission,
    knot: KnotSummary,
    layout: Hanging,
    fold: Motion,
    line: Floats,
    notes: list[str],
) -> Plan:
    """Put a fold at its height, and the rest of the flight around it."""
    height = _height(mission, fold, layout.lengths)
    fold = _raised(fold, height)
    flight = whole_flight(mission, layout.lengths, fold)
    return Plan(
        mission=mission,
        knot=knot,
        layout=_layout(layout, height),
        motion=flight.motion,
        phases=flight.phases,
        gates=flight.gates,
        path=line + np.array([0.0, 0.0, height]),
        notes=tuple(notes),
    )


def _layout(layout: Hanging, height: float) -> Layout:
    return Layout(
        corners=layout.corners + np.array([0.0, 0.0, height]),
        sags=layout.sags,
        lengths=layout.lengths,
        lanes=layout.lanes,
        crossings=layout.crossings,
        cell=layout.cell,
    )


def _height(mission: Mission, fold: Motion, lengths: Floats) -> float:
    """Height of the corners that keeps every strand of the fold off the floor, in metres."""
    if mission.layout.height != "auto":
        return mission.layout.height
    times = np.linspace(fold.times[0], fold.times[-1], 4 * len(fold.times))
    places = fold.at(times)[0]
    chord = np.linalg.norm(np.diff(places, axis=1), axis=2)
    hanging = hang(places[:, :-1], places[:, 1:], np.maximum(lengths, chord))
    error = mission.vehicles.tracking * 1.1 * lift(chord / lengths)
    lowest = float((hanging.lowest()[..., 2] - error).min()) - 0.1
    margin = mission.clearance.floor + 0.5 * mission.cable.diameter
    return float(np.ceil(10.0 * (margin - lowest)) / 10.0)


def _raised(motion: Motion, height: float) -> Motion:
    coefficients = motion.coefficients.copy()
    coefficients[:, 0, :, 2] += height
    return Motion(motion.times, coefficients)
