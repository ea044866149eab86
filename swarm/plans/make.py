"""Mission → plan: lay the knot out, fold it, and fly it from the pads to the ground."""

from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt

from swarm.fold.clear import Margins, lift, strands
from swarm.fold.layout import Hanging, Shape, hanging
from swarm.fold.path import FoldPath
from swarm.fold.schedule import schedule, team_path
from swarm.knots.catalog import KnotChoice, choose
from swarm.knots.grid import OpenGrid, openings
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
    choice, knot = _knot(mission)
    opened = _roomy(openings(choice.grid))[0]
    shape = Shape(cell=3.4, gap=0.8, minimum_sag=1.2, lane_over=3.1, lane_under=3.1)
    yield _planned(mission, opened, knot, shape, progress)


def _knot(mission: Mission) -> tuple[KnotChoice, KnotSummary]:
    """The knot to tie, with its grid diagram."""
    asked = mission.knot
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


def _roomy(opened: tuple[OpenGrid, ...]) -> list[OpenGrid]:
    """Openings with long edges first: strands around short edges get into each other's way."""

    def shortest(diagram: OpenGrid) -> int:
        pairs = zip(diagram.corners, diagram.corners[1:], strict=False)
        return min(abs(a - c) + abs(b - d) for (a, b), (c, d) in pairs)

    return sorted(opened, key=lambda diagram: (len(diagram.crossings), -shortest(diagram)))


def _margins(mission: Mission) -> Margins:
    vehicles, clearance = mission.vehicles, mission.clearance
    return Margins(
        cable=clearance.cable + mission.cable.diameter,
        vehicle=clearance.vehicle,
        downwash=clearance.downwash,
        vehicle_cable=clearance.vehicle_cable + 0.5 * mission.cable.diameter,
        tracking=vehicles.tracking,
        radius=vehicles.radius,
        grip_offset=vehicles.grip_offset,
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
        0.95 * shape.cell,
        0.5 * shape.cell,
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
    hanging = strands(places[:, :-1], places[:, 1:], lengths)
    error = mission.vehicles.tracking * 1.1 * lift(hanging.ratio)
    lowest = float((hanging.points[..., 2].min(axis=-1) - error).min()) - 0.1
    margin = mission.clearance.floor + 0.5 * mission.cable.diameter
    return float(np.ceil(10.0 * (margin - lowest)) / 10.0)


def _raised(motion: Motion, height: float) -> Motion:
    coefficients = motion.coefficients.copy()
    coefficients[:, 0, :, 2] += height
    return Motion(motion.times, coefficients)
