"""Rerun recordings of a plan, and of a flight beside its plan."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import rerun as rr

from swarm.files import replaced
from swarm.flight.snapshot import Event
from swarm.flight.trace import Trace
from swarm.planning import Plan
from swarm.reports import scene
from swarm.view.blueprint import comparison_blueprint, plan_blueprint
from swarm.view.columns import (
    MotionSamples,
    planned_motion,
    send_distances,
    send_errors,
    send_motion,
    send_phases,
    send_plan_curves,
    send_swing,
)
from swarm.view.rerun_scene import log_event, log_plan

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
