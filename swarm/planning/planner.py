"""Mission → plan: lay the knot out, fold it, and fly it from the pads to the ground."""

from collections.abc import Callable, Generator, Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import pdist

from swarm.errors import Refused
from swarm.folding.end_sensitivity import sag_responses
from swarm.folding.layout import KnotLayout, LayoutParameters, lay_out, lay_out_corners
from swarm.folding.margins import Margins
from swarm.folding.optimizer import BEYOND_REPAIR
from swarm.folding.paper import edge_dips, paper_motion
from swarm.folding.schedule import improve, make_schedule, team_path
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.motion import Motion, through_states
from swarm.knots.catalog import KnotChoice, choose
from swarm.knots.grid import OpenGrid, openings
from swarm.mission import Mission
from swarm.planning.flight import whole_flight
from swarm.planning.formation import formation_plan
from swarm.planning.plan import KnotSummary, Layout, Plan
from swarm.planning.repair import MENDABLE, Shortfalls, with_more
from swarm.planning.shapes import (
    Folding,
    different,
    fitted,
    folded,
    guided,
    keeping,
    ranked,
    shapes,
)
from swarm.planning.timing import timed

Floats = npt.NDArray[np.float64]
Progress = Callable[[str, float], None]


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

    Where nothing seems to keep the clearances, those plans follow that miss them least: the
    certificate says of them what is wrong. Their notes, as those of every plan, say what was tried.
    Raises :class:`swarm.errors.Refused` where vehicles could not even rest on the corners.
    """
    _refuse_unplanned(mission)
    if mission.formation is not None:
        yield formation_plan(mission, mission.formation)
        return
    choice, knot = _knot(mission)
    opened = different(openings(choice.grid))
    margins = keeping(mission)
    if mission.fold.method == "paper":
        yield _printed(mission, knot, _paper_layout(mission, opened[0], margins))
        return
    if mission.layout.corners is not None:
        yield from _as_given(mission, knot, margins, progress)
        return
    _refuse_crowding(mission, knot, opened, margins)
    tried: list[str] = []
    doubtful: list[Folding] = []
    overlong: list[Plan] = []
    layouts = list(shapes(mission, margins))
    best = ranked(opened, layouts[0], margins, progress)
    for folding in _foldings(best, layouts, margins, progress):
        worst = folding.plan.worst
        tried.append(
            f"tried a cell of {folding.layout.cell:.2f} m: misses its margins by {worst:.2g}"
        )
        if worst < _GOOD:
            yield from _mended(mission, knot, folding, tried, overlong)
        else:
            doubtful.append(folding)
    doubtful.sort(key=lambda folding: folding.plan.worst)
    for folding in doubtful[:_DOUBTFUL]:
        yield from _mended(mission, knot, folding, tried, overlong)
    if overlong:
        yield min(overlong, key=lambda made: made.duration)


def _mended(
    mission: Mission,
    knot: KnotSummary,
    folding: Folding,
    tried: list[str],
    overlong: list[Plan],
) -> Generator[Plan, Shortfalls | None, None]:
    """A plan, and better ones of the same kind while its certificate says what is missing.

    One that outlasts the batteries is put aside: no certificate mends that.
    """
    for _ in range(_MENDINGS):
        made = _planned(mission, knot, folding, tried)
        endurance = mission.vehicles.endurance
        if made.duration > endurance:
            tried.append(f"that took {made.duration:.0f} s of {endurance:g} s in the air")
            overlong.append(made)
            break
        missing = yield made
        if not missing or any(each.check not in MENDABLE for each in missing):
            break
        folding = replace(folding, plan=improve(with_more(folding, made, missing)))
        tried.append("gave way by more where the certificate missed something")
        if folding.plan.worst > BEYOND_REPAIR:
            break


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


def _foldings(
    opened: Iterator[OpenGrid],
    layouts: list[LayoutParameters],
    margins: Margins,
    progress: Progress | None,
) -> Iterator[Folding]:
    """Foldings of all openings in the first layout, and of the first ones in the others."""
    best: list[OpenGrid] = []
    for diagram in opened:
        best.append(diagram)
        yield _folding(diagram, layouts[0], margins, progress)
    for shape in layouts[1:]:
        for diagram in best[:_IN_OTHERS]:
            yield _folding(diagram, shape, margins, progress)


def _folding(
    diagram: OpenGrid, shape: LayoutParameters, margins: Margins, progress: Progress | None
) -> Folding:
    if progress:
        progress(f"folding with a cell of {shape.cell:.2f} m", 0.0)
    return folded(diagram, shape, margins)


_IN_OTHERS = 3
"""So many openings are tried with each layout but the smallest one."""

_MENDINGS = 8
"""So often a plan that nearly holds is judged."""

_GOOD = 0.6
"""Schedules that miss their margins by less, at the worst moment, are likely to be certified."""

_DOUBTFUL = 2
"""So many of the others are judged, the best first, once nothing better was found."""


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
    layout = lay_out_corners(asked.corners or (), asked.sags or (), 0.0)
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
        guide = guided(hung, slope * shortest, rounding * shortest)
        plan = make_schedule(hung, guide, margins, 0.06 * shortest)
        foldings.append(Folding(hung, plan))
        tried.append(
            f"tried lanes {apart * shortest:.2f} m apart: misses its margins by {plan.worst:.2g}"
        )
    foldings.sort(key=lambda folding: folding.plan.worst)
    overlong: list[Plan] = []
    for folding in foldings[:_MENDINGS]:
        yield from _mended(mission, knot, folding, tried, overlong)
    yield from overlong[:1]


_GIVEN = ((0.19, 0.17, 0.2), (0.1, 0.3, 0.15), (0.25, 0.3, 0.15))
"""Distance of lanes, reach of level changes and of turns, over the shortest edge."""


def _paper_layout(mission: Mission, diagram: OpenGrid, margins: Margins) -> KnotLayout:
    """The layout given by corners and sags, or else the diagram with two sags."""
    asked = mission.layout
    if asked.corners is not None and asked.sags is not None:
        return lay_out_corners(
            asked.corners, asked.sags, 0.0 if asked.cell == "auto" else asked.cell
        )
    shape = next(shapes(mission, margins))
    return lay_out(diagram.corners, diagram.crossings, replace(shape, two_sags=True))


def _printed(mission: Mission, knot: KnotSummary, layout: KnotLayout) -> Plan:
    """The paper's own trajectory."""
    vehicles = mission.vehicles
    deepest = float(layout.sags.max())
    states = paper_motion(
        layout.corners,
        layout.lengths,
        deepest,
        mission.fold.delay,
        max_speed=vehicles.max_speed,
        max_acceleration=vehicles.max_acceleration - vehicles.braking_acceleration,
    )
    fold = through_states(states.times, states.position, states.velocity, states.acceleration)
    layout = replace(layout, lanes=-edge_dips(len(layout.lengths), deepest))
    line = fold.at(np.linspace(fold.times[0], fold.times[-1], 400))[0][:, -1]
    return _flown(mission, knot, layout, fold, line, ["the paper's trajectory, as printed"])


def _flown(
    mission: Mission,
    knot: KnotSummary,
    layout: KnotLayout,
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


def _layout(layout: KnotLayout, height: float) -> Layout:
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
    strands = solve_catenaries(places[:, :-1], places[:, 1:], np.maximum(lengths, chord))
    ratio = chord / lengths
    error = mission.vehicles.tracking * 1.1 * sag_responses(ratio)
    lowest = float((strands.lowest()[..., 2] - error).min()) - 0.1
    margin = mission.clearance.floor + 0.5 * mission.cable.diameter
    return float(np.ceil(10.0 * (margin - lowest)) / 10.0)


def _raised(motion: Motion, height: float) -> Motion:
    coefficients = motion.coefficients.copy()
    coefficients[:, 0, :, 2] += height
    return Motion(motion.times, coefficients)
