"""Mission → plan: lay the knot out, fold it, and fly it from the pads to the ground."""

from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt

from swarm.cable.catenary import hang
from swarm.errors import Refused
from swarm.fold.layout import Hanging, Shape, hanging
from swarm.fold.path import FoldPath
from swarm.fold.schedule import Margins, schedule, team_path
from swarm.knots.grid import OpenGrid, diagram_gauss, grid_of_columns, openings
from swarm.mission import Mission
from swarm.plans.flight import whole_flight
from swarm.plans.plan import KnotSummary, Layout, Plan
from swarm.trajectory import Motion, timed

Floats = npt.NDArray[np.float64]
Progress = Callable[[str, float], None]


def make_plan(mission: Mission, *, progress: Progress | None = None) -> Plan:
    """Return the planner's first choice for a mission; not yet certified.

    ``progress`` is told what is being done and how much of it is done, 0…1. Raises
    :class:`swarm.errors.Refused` where nothing that was tried works.
    """
    return next(candidates(mission, progress=progress))


def candidates(mission: Mission, *, progress: Progress | None = None) -> Iterator[Plan]:
    """Yield plans for a mission, best first, for the certificate to judge."""
    opened, knot = _knot(mission)
    shape = Shape(cell=2.4, gap=0.6, minimum_sag=1.6, lane_over=2.8, lane_under=2.2)
    yield _planned(mission, opened, knot, shape, progress)


def _knot(mission: Mission) -> tuple[OpenGrid, KnotSummary]:
    asked = mission.knot
    overhand = asked.gauss == "1- 2+ 3- 1+ 2- 3+" or asked.name in {"overhand", "3_1"}
    if not overhand or asked.chirality == "left":
        raise Refused("only the right-handed overhand can be planned so far")
    grid = grid_of_columns([[1, 4], [3, 5], [2, 4], [1, 3], [2, 5]])
    opened = openings(grid)
    found = [o for o in opened if o.corners[0] == (4, 1) and o.corners[1] == (4, 3)]
    code = diagram_gauss(found[0])
    return found[0], KnotSummary("3_1", "right", code.signed_text(), grid.columns)


def _margins(mission: Mission) -> Margins:
    vehicles, clearance = mission.vehicles, mission.clearance
    error = vehicles.tracking
    return Margins(
        cable=clearance.cable + mission.cable.diameter + 3.0 * error,
        vehicle=clearance.vehicle + 2.0 * error,
        downwash=clearance.downwash + 2.0 * error,
        vehicle_cable=clearance.vehicle_cable + 0.5 * mission.cable.diameter + 3.0 * error,
        tracking=error,
        radius=vehicles.radius,
        grip_offset=vehicles.grip_offset,
        spacing=0.85,
    )


def _planned(
    mission: Mission,
    opened: OpenGrid,
    knot: KnotSummary,
    shape: Shape,
    progress: Progress | None,
) -> Plan:
    layout = hanging(opened.corners, opened.crossings, shape)
    margins = _margins(mission)
    path = FoldPath(
        layout.corners,
        layout.lanes,
        0.9 * shape.cell,
        0.4 * shape.cell,
        1.1 * float(layout.lengths.sum()) + 2.0,
    )

    def report(share: float) -> None:
        if progress:
            progress("scheduling the fold", share)

    plan = schedule(path, layout.lengths, margins, 0.18 * shape.cell, report)
    parameter, places, slopes, bends = team_path(path, plan)
    vehicles = mission.vehicles
    fold = timed(
        parameter,
        places,
        slopes,
        bends,
        max_speed=vehicles.max_speed,
        max_acceleration=vehicles.max_acceleration - vehicles.braking_acceleration,
    )
    height = _height(mission, fold, layout.lengths)
    fold = _raised(fold, height)
    flight = whole_flight(mission, layout.lengths, fold)
    line = path.at(len(layout.corners) - 1, np.linspace(0.0, path.stops[-1], 400))[0]
    return Plan(
        mission=mission,
        knot=knot,
        layout=_layout(layout, height),
        motion=flight.motion,
        phases=flight.phases,
        gates=flight.gates,
        path=line + np.array([0.0, 0.0, height]),
        notes=(f"schedule misses its margins by {plan.cost:.3g}",),
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
    times = np.linspace(fold.times[0], fold.times[-1], 3 * len(fold.times))
    places = fold.at(times)[0]
    chord = np.linalg.norm(np.diff(places, axis=1), axis=2)
    strands = hang(places[:, :-1], places[:, 1:], np.maximum(lengths, chord))
    lowest = float(strands.lowest()[..., 2].min())
    margin = mission.clearance.floor + 3.0 * mission.vehicles.tracking + mission.cable.diameter
    return float(np.ceil(10.0 * (margin - lowest)) / 10.0)


def _raised(motion: Motion, height: float) -> Motion:
    coefficients = motion.coefficients.copy()
    coefficients[:, 0, :, 2] += height
    return Motion(motion.times, coefficients)
