"""Rerun recordings of a plan, and of a flight beside its plan: whole motions, sent as columns."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import rerun as rr

from swarm.files import replaced
from swarm.flight.snapshot import Event
from swarm.flight.swinging import swing_curves
from swarm.flight.trace import Trace
from swarm.geometry.catenary import MAX_CHORD_RATIO
from swarm.planning import Plan
from swarm.planning.cable_shape import planned_grip
from swarm.reports import scene
from swarm.view.blueprint import comparison_blueprint, plan_blueprint
from swarm.view.rerun_scene import (
    GHOST_COLOUR,
    log_event,
    log_plan,
    log_style,
    quadrotor,
    vehicle_colours,
)

Floats = npt.NDArray[np.float64]

STEP: Final = 0.1
"""Seconds between two drawn moments of a plan."""


@dataclass(frozen=True)
class MotionSamples:
    """Centres of the vehicles and grip points of the cable (k, n, 3) at k moments, metres.

    ``rotations`` (k, n, 4) are the vehicles' quaternions xyzw, None where unknown; ``timelines``
    are the same k moments on one or more clocks, in seconds.
    """

    timelines: dict[str, Floats]
    centres: Floats
    cable: Floats
    rotations: Floats | None = None


def planned_motion(plan: Plan, step: float = STEP) -> MotionSamples:
    """Return the plan's motion at every ``step`` of mission time."""
    times = mission_times(plan, step)
    position, _, acceleration = plan.motion.at(times)
    above = np.array([0.0, 0.0, plan.mission.vehicles.grip_offset])
    return MotionSamples(
        {"mission_time": times},
        position + above,
        scene.planned_cable(plan, times),
        scene.thrust_quaternions(acceleration),
    )


def mission_times(plan: Plan, step: float) -> Floats:
    """Return mission times from the plan's start to its end, ``step`` seconds apart."""
    start, end = float(plan.motion.times[0]), plan.duration
    return np.linspace(start, end, max(2, round((end - start) / step) + 1))


def send_motion(stream: rr.RecordingStream, entity: str, plan: Plan, motion: MotionSamples) -> None:
    """Send vehicles, marks, trails and cable of a motion below ``entity``."""
    count, n = motion.centres.shape[:2]
    vehicles = plan.mission.vehicles
    log_style(stream, entity, vehicles.radius)
    stream.log(f"{entity}/vehicles", quadrotor(vehicles.radius, vehicles.grip_offset), static=True)
    poses = rr.InstancePoses3D.columns(
        translations=_flat(motion.centres),
        quaternions=None if motion.rotations is None else motion.rotations.reshape(-1, 4),
    )
    _send(stream, f"{entity}/vehicles", motion, poses.partition([n] * count))
    marks = rr.Points3D.columns(positions=_flat(motion.centres))
    _send(stream, f"{entity}/marks", motion, marks.partition([n] * count))
    labels = rr.Points3D.from_fields(
        labels=[str(i + 1) for i in range(n)], colors=[GHOST_COLOUR] * n
    )
    stream.log(f"{entity}/marks", labels, static=True)
    _send_trails(stream, entity, motion)
    _send_cable(stream, entity, plan, motion)


def _send_trails(stream: rr.RecordingStream, entity: str, motion: MotionSamples) -> None:
    count, n = motion.centres.shape[:2]
    pairs = np.stack([motion.centres[:-1], motion.centres[1:]], axis=2)
    strips = rr.LineStrips3D.columns(strips=pairs.reshape(-1, 2, 3))
    later = {name: times[1:] for name, times in motion.timelines.items()}
    _send(stream, f"{entity}/trails", later, strips.partition([n] * (count - 1)))
    style = rr.LineStrips3D.from_fields(colors=vehicle_colours(n), radii=[0.012])
    stream.log(f"{entity}/trails", style, static=True)


def _send_cable(stream: rr.RecordingStream, entity: str, plan: Plan, motion: MotionSamples) -> None:
    lengths = plan.layout.lengths
    shapes = scene.strands(motion.cable, lengths, scene.POINTS_PER_SEGMENT)
    colours = scene.tautness_colours(scene.tautness(motion.cable, lengths))
    strips = rr.LineStrips3D.columns(
        strips=shapes.reshape(-1, scene.POINTS_PER_SEGMENT, 3), colors=colours.reshape(-1, 3)
    )
    _send(stream, f"{entity}/cable", motion, strips.partition([len(lengths)] * len(shapes)))


def send_plan_curves(stream: rr.RecordingStream, plan: Plan) -> None:
    """Send the curves of a plan: speeds, tautness, and sampled distances of strands."""
    times = mission_times(plan, STEP)
    clock = {"mission_time": times}
    n = plan.vehicles
    speed = np.linalg.norm(plan.motion.at(times)[1], axis=-1)
    names = [f"vehicle {i + 1}" for i in range(n)]
    _curves(stream, "plan/speed", names, clock, speed)
    _limit(stream, "plan/speed/limit", plan.mission.vehicles.max_speed, "limit", clock)
    held = planned_grip(plan, times)
    taut = scene.tautness(scene.planned_cable(plan, times), plan.layout.lengths)
    taut[~held] = np.nan
    segments = [f"segment {i + 1}" for i in range(len(plan.layout.lengths))]
    _curves(stream, "plan/tautness", segments, clock, taut)
    _limit(stream, "plan/tautness/limit", MAX_CHORD_RATIO, "taut", clock)
    if len(segments) < 3:
        return
    sampled, distance = scene.planned_strand_distances(plan)
    clock = {"mission_time": sampled}
    _curves(stream, "plan/clearance", ["strands that are not neighbours"], clock, distance[:, None])
    _limit(stream, "plan/clearance/limit", plan.mission.clearance.cable, "required", clock)


def send_errors(stream: rr.RecordingStream, plan: Plan, trace: Trace) -> None:
    """Send the tracking errors of a trace and the tracking radius."""
    clocks = {"time": trace.time, "mission_time": trace.mission_time}
    error = np.linalg.norm(trace.position - trace.setpoint, axis=-1)
    names = [f"vehicle {i + 1}" for i in range(plan.vehicles)]
    _curves(stream, "error", names, clocks, error)
    _limit(stream, "error/limit", plan.mission.vehicles.tracking, "tracking radius", clocks)


def send_distances(stream: rr.RecordingStream, plan: Plan, trace: Trace) -> None:
    """Send the sampled distances of strands over mission time, planned and flown."""
    if len(plan.layout.lengths) < 3:
        return
    names = ("planned", "flown")
    sampled, planned = scene.planned_strand_distances(plan)
    where = np.flatnonzero(scene.fold_and_hold(trace))[:: scene.sampling_step(trace)]
    flown = scene.smallest_strand_distances(plan, trace.position[where])
    for name, times, values in zip(
        names, (sampled, trace.mission_time[where]), (planned, flown), strict=True
    ):
        if len(times):
            _curves(stream, f"distance/{name}", [name], {"mission_time": times}, values[:, None])
    clock = {"mission_time": sampled}
    _limit(stream, "distance/limit", plan.mission.clearance.cable, "required", clock)


def send_swing(stream: rr.RecordingStream, plan: Plan, trace: Trace) -> None:
    """Send the largest stray of the strands: estimated, planned, in the tube, and allowed."""
    swing = swing_curves(plan, trace)
    if swing is None:
        return
    clock = {"mission_time": swing.time}
    curves = {
        "estimated": swing.estimated,
        "planned": swing.planned,
        "tube": swing.tube,
        "allowed": swing.allowed,
    }
    for name, strays in curves.items():
        _curves(stream, f"swing/{name}", [name], clock, strays.max(axis=1)[:, None])


def send_phases(stream: rr.RecordingStream, entity: str, plan: Plan) -> None:
    """Send the plan's phases as a lane of states on the mission clock."""
    states = rr.StateChange.columns(state=[phase.name for phase in plan.phases])
    clock = {"mission_time": np.array([phase.start for phase in plan.phases])}
    _send(stream, entity, clock, states)


def _curves(
    stream: rr.RecordingStream,
    entity: str,
    names: Sequence[str],
    clock: dict[str, Floats],
    values: Floats,
) -> None:
    count = len(names)
    style = rr.SeriesLines(names=names, colors=vehicle_colours(count), widths=[1.5] * count)
    stream.log(f"plots/{entity}", style, static=True)
    columns = rr.Scalars.columns(scalars=values.reshape(-1)).partition([count] * len(values))
    _send(stream, f"plots/{entity}", clock, columns)


def _limit(
    stream: rr.RecordingStream, entity: str, value: float, name: str, clock: dict[str, Floats]
) -> None:
    style = rr.SeriesLines(names=f"{name} {value:g}", colors=(255, 80, 80), widths=2.0)
    stream.log(f"plots/{entity}", style, static=True)
    if not all(map(len, clock.values())):
        return
    ends = {timeline: times[[0, -1]] for timeline, times in clock.items()}
    _send(stream, f"plots/{entity}", ends, rr.Scalars.columns(scalars=[value, value]))


def _send(
    stream: rr.RecordingStream,
    entity: str,
    when: MotionSamples | dict[str, Floats],
    columns: rr.ComponentColumnList,
) -> None:
    clocks = when.timelines if isinstance(when, MotionSamples) else when
    indexes = [rr.TimeColumn(name, duration=times) for name, times in clocks.items()]
    stream.send_columns(entity, indexes=indexes, columns=columns)


def _flat(vectors: Floats) -> Floats:
    return vectors.reshape(-1, 3)


APPLICATION = "swarm"


def write_plan(plan: Plan, path: Path) -> None:
    """Write a plan as a Rerun recording: its motion, cable, curves and phases over mission time."""
    with replaced(path) as new:
        stream = _recording(plan)
        stream.save(new, default_blueprint=plan_blueprint(plan))
        log_plan(stream, plan)
        send_planned(stream, plan)
        send_plan_curves(stream, plan)
        stream.disconnect()


def send_planned(stream: rr.RecordingStream, plan: Plan) -> None:
    """Send the planned motion below ``plan/team`` and the phases, on the mission clock."""
    send_motion(stream, "plan/team", plan, planned_motion(plan))
    send_phases(stream, "plan/phase", plan)


def write_flight(plan: Plan, trace: Trace, events: Iterable[Event], path: Path) -> None:
    """Write a flight and its plan as one Rerun recording, side by side on the mission clock.

    It has the positions and setpoints of the trace. Batteries, modes and links are only in the
    recording of the live flight.
    """
    with replaced(path) as new:
        stream = _recording(plan)
        stream.save(new, default_blueprint=comparison_blueprint(plan))
        log_plan(stream, plan)
        send_planned(stream, plan)
        send_motion(stream, "flight", plan, flown_motion(plan, trace))
        send_errors(stream, plan, trace)
        send_distances(stream, plan, trace)
        send_swing(stream, plan, trace)
        for event in events:
            log_event(stream, event)
        stream.disconnect()


def flown_motion(plan: Plan, trace: Trace) -> MotionSamples:
    """Return the motion of a trace; the cable is gripped as planned."""
    above = np.array([0.0, 0.0, plan.mission.vehicles.grip_offset])
    return MotionSamples(
        {"time": trace.time, "mission_time": trace.mission_time},
        trace.position + above,
        scene.flown_cable(plan, trace),
    )


def _recording(plan: Plan) -> rr.RecordingStream:
    stream = rr.RecordingStream(APPLICATION)
    stream.set_log_tick_enabled(False)
    stream.set_log_time_enabled(False)
    stream.send_recording_name(plan.mission.name)
    return stream
