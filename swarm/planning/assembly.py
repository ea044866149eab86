"""A fold → the whole plan: the fold timed and raised to its height, with the flight around it."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from swarm.folding.layout import KnotLayout, lay_out, lay_out_corners
from swarm.folding.margins import Margins
from swarm.folding.paper import edge_dips, paper_motion
from swarm.folding.schedule import team_path
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.motion import Motion, through_states
from swarm.geometry.sensitivity import BOTH_ENDS, sensitivity_tables
from swarm.knots.grid import OpenGrid
from swarm.mission import Mission
from swarm.planning.foldings import Folding, layout_sizes, room_to_swing
from swarm.planning.phase_motion import PhaseMotion, usable_acceleration
from swarm.planning.phase_sequence import PhaseSequence, flight_around_fold, join_phases
from swarm.planning.plan import KnotSummary, Phase, Plan
from swarm.planning.timing import time_path

Floats = npt.NDArray[np.float64]

_LONG = 10.0
"""Metres of segment from which the flight contracts beyond the line: with shorter ones, vehicles
were within 0.09 m of their setpoints in the lift; one of 13 m pulled its vehicle off by 0.13 m."""

_SAME = 1e-6
"""Seconds within which a breakpoint is the beginning or end of a phase: rounding of sums."""


def plan_of_folding(mission: Mission, knot: KnotSummary, folding: Folding) -> Plan:
    """Return the plan that flies a folding as fast as the limits on speed and acceleration allow.

    Neither the swing of the cable nor lost setpoints slow it yet.
    """
    layout, path = folding.layout, folding.schedule.path
    parameter, places, slopes, bends = team_path(folding.schedule)
    fold = time_path(
        parameter,
        places,
        slopes,
        bends,
        max_speed=mission.vehicles.max_speed,
        max_acceleration=usable_acceleration(mission),
    )
    return _assembled(mission, knot, layout, fold, path.line(400))


def paper_plan(mission: Mission, knot: KnotSummary, diagram: OpenGrid, margins: Margins) -> Plan:
    """Return the plan with the paper's own trajectory."""
    layout = _paper_layout(mission, diagram, margins)
    largest_sag = float(layout.sags.max())
    states = paper_motion(
        layout.corners,
        layout.lengths,
        largest_sag,
        mission.fold.delay,
        max_speed=mission.vehicles.max_speed,
        max_acceleration=usable_acceleration(mission),
    )
    fold = through_states(states.times, states.position, states.velocity, states.acceleration)
    layout = replace(layout, lanes=-edge_dips(len(layout.lengths), largest_sag))
    line = fold.at(np.linspace(fold.times[0], fold.times[-1], 400))[0][:, -1]
    plan = _assembled(mission, knot, layout, fold, line)
    return replace(plan, notes=("the paper's trajectory, as printed",))


def _paper_layout(mission: Mission, diagram: OpenGrid, margins: Margins) -> KnotLayout:
    """Return the mission's corners and sags, or else the diagram with two sags."""
    section = mission.layout
    if section.corners is not None and section.sags is not None:
        return lay_out_corners(
            section.corners, section.sags, 0.0 if section.cell == "auto" else section.cell
        )
    shape = next(layout_sizes(mission, margins))
    return lay_out(diagram.corners, diagram.crossings, replace(shape, two_sags=True))


def _assembled(
    mission: Mission, knot: KnotSummary, layout: KnotLayout, fold: Motion, line: Floats
) -> Plan:
    """Return the plan with a fold at its height and the rest of the flight around it.

    ``fold`` and ``line`` (k, 3), the curve that the vehicles follow, are at height 0.
    """
    height = _height(mission, fold, layout.lengths)
    flight = _flight(mission, layout, _raised(fold, height))
    up = np.array([0.0, 0.0, height])
    return Plan(
        mission=mission,
        knot=knot,
        layout=replace(layout, corners=layout.corners + up),
        motion=flight.motion,
        phases=flight.phases,
        gates=flight.gates,
        path=line + up,
    )


def fold_of(plan: Plan) -> Motion:
    """Return the motion of a plan's fold alone, from time 0."""
    return _motion_of(plan, plan.phase("fold"))


def _motion_of(plan: Plan, phase: Phase) -> Motion:
    """Return the motion of one phase, from time 0."""
    times = plan.motion.times
    first, last = np.searchsorted(times, [phase.start - _SAME, phase.end - _SAME])
    return Motion(times[first : last + 1] - times[first], plan.motion.coefficients[first:last])


def begins_aloft(plan: Plan) -> bool:
    """Return whether a plan begins with its fold, from where its vehicles hold the cable."""
    return plan.phases[0].name == "fold"


def with_fold(plan: Plan, fold: Motion) -> Plan:
    """Return the plan with another fold that ends in the same formation.

    The flight around it is planned again, higher where the fold's cable would come too low. Of a
    plan that :func:`begins_aloft`, the flight after the fold stays as it is.
    """
    if begins_aloft(plan):
        return beginning_with(plan, fold)
    rise = max(0.0, _height(plan.mission, fold, plan.layout.lengths))
    if plan.mission.layout.height != "auto":
        rise = 0.0
    flight = _flight(plan.mission, plan.layout, _raised(fold, rise))
    up = np.array([0.0, 0.0, rise])
    return replace(
        plan,
        layout=replace(plan.layout, corners=plan.layout.corners + up),
        motion=flight.motion,
        phases=flight.phases,
        gates=flight.gates,
        path=plan.path + up,
    )


def beginning_with(plan: Plan, fold: Motion) -> Plan:
    """Return the plan from a fold on, which begins where its vehicles are and ends as planned."""
    parts = []
    for phase in plan.phases[plan.phases.index(plan.phase("fold")) :]:
        motion = fold if phase.name == "fold" else _motion_of(plan, phase)
        at_end = (gate for gate in plan.gates if abs(gate.time - phase.end) < _SAME)
        gate, inner = next(((each.condition, each.inner) for each in at_end), (None, False))
        parts.append(PhaseMotion(phase.name, motion, phase.cable, phase.reversible, gate, inner))
    flight = join_phases(tuple(parts), [])
    return replace(
        plan, motion=flight.motion, phases=flight.phases, gates=flight.gates, path=np.empty((0, 3))
    )


def _flight(mission: Mission, layout: KnotLayout, fold: Motion) -> PhaseSequence:
    """Return the flight around a fold.

    Layouts without a grid, and long segments, contract beyond the line; the paper's do not.
    """
    long = layout.cell == 0.0 or bool(layout.lengths.max() >= _LONG)
    relaxed = mission.fold.method != "paper" and long
    return flight_around_fold(mission, layout.lengths, fold, relaxed=relaxed)


_ABOVE_FLOOR = 0.1
"""Metres, at least, of a fold's height for errors of its cable that are not sampled; as much as the
limit of a certified swing: with less, one of the endless knot came 1 cm too near the floor."""


def _height(mission: Mission, fold: Motion, lengths: Floats) -> float:
    """Return the least height of the corners, metres, for which the fold clears the floor."""
    if mission.layout.height != "auto":
        return mission.layout.height
    times = np.linspace(fold.times[0], fold.times[-1], 4 * len(fold.times))
    places = fold.at(times)[0]
    step, tracking = np.diff(places, axis=1), mission.vehicles.tracking
    chord = np.linalg.norm(step, axis=2)
    strands = solve_catenaries(places[:, :-1], places[:, 1:], np.maximum(lengths, chord))
    sine = np.abs(step[..., 2]) / np.maximum(chord, 1e-9)
    _, down = sensitivity_tables().largest(
        chord / lengths, 2.0 * tracking / lengths, sine, BOTH_ENDS, 1
    )
    reserve = max(_ABOVE_FLOOR, room_to_swing(mission))
    lowest = float((strands.lowest()[..., 2] - tracking * down).min()) - reserve
    margin = mission.clearance.floor + 0.5 * mission.cable.diameter
    return float(np.ceil(10.0 * (margin - lowest)) / 10.0)


def _raised(motion: Motion, height: float) -> Motion:
    coefficients = motion.coefficients.copy()
    coefficients[:, 0, :, 2] += height
    return Motion(motion.times, coefficients)
