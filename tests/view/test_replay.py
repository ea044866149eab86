from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from swarm.flight.trace import Trace
from swarm.reports.scene import planned_strand_distances
from swarm.view import replay
from swarm.view.replay import mission_times, planned_motion
from tests.reports.synthetic import events, trefoil_plan

PLAN = trefoil_plan()


def timelines(path: Path) -> dict[str, tuple[int, set[str]]]:
    """Return the rows and timelines of every entity in a recording, without the static ones."""
    found: dict[str, tuple[int, set[str]]] = {}
    for chunk in RrdReader(path).stream():
        names = set(chunk.timeline_names)
        if names:
            rows, before = found.get(chunk.entity_path, (0, set()))
            found[chunk.entity_path] = (rows + chunk.num_rows, before | names)
    return found


def trace(step: float = 0.5) -> Trace:
    times = mission_times(PLAN, step)
    position = PLAN.motion.at(times)[0]
    position[3, 2] = np.nan
    phase = tuple(PLAN.phase_at(float(time)).name for time in times)
    return Trace(times + 2.0, times, position + 0.05, position, phase)


def test_a_plan_is_one_recording_over_mission_time(tmp_path: Path) -> None:
    path = tmp_path / "plan.rrd"
    replay.write_plan(PLAN, path)
    found = timelines(path)
    moments_drawn = len(mission_times(PLAN, 0.1))
    for entity in ("vehicles", "marks", "cable"):
        assert found[f"/plan/team/{entity}"] == (moments_drawn, {"mission_time"})
    assert found["/plan/team/trails"][0] == moments_drawn - 1
    assert found["/plan/phase"][0] == len(PLAN.phases)
    assert {"/plots/plan/clearance", "/plots/plan/speed", "/plots/plan/tautness"} <= set(found)


def test_a_flight_is_recorded_beside_its_plan(tmp_path: Path) -> None:
    path = tmp_path / "flight.rrd"
    flown = trace()
    replay.write_flight(PLAN, flown, events(PLAN), path)
    found = timelines(path)
    both = {"time", "mission_time"}
    assert found["/flight/vehicles"] == (len(flown.time), both)
    assert found["/flight/cable"] == (len(flown.time), both)
    assert found["/plots/error"] == (len(flown.time), both)
    assert found["/plan/team/vehicles"][1] == {"mission_time"}
    assert found["/log"] == (len(events(PLAN)), {"time"})


def test_planned_and_flown_distances_are_drawn_together(tmp_path: Path) -> None:
    path = tmp_path / "verification.rrd"
    replay.write_flight(PLAN, trace(), (), path)
    found = timelines(path)
    assert found["/plots/distance/planned"][0] > 10
    assert found["/plots/distance/flown"][0] > 10


def test_the_swing_of_a_flight_is_drawn_beside_what_is_planned_and_allowed(tmp_path: Path) -> None:
    path = tmp_path / "swing.rrd"
    flown = replace(trace(), stray=np.full((len(trace().time), PLAN.vehicles - 1), 0.05))
    replay.write_flight(PLAN, flown, (), path)
    found = timelines(path)
    for name in ("estimated", "planned", "tube", "allowed"):
        assert found[f"/plots/swing/{name}"] == (len(flown.time), {"mission_time"})


def test_planned_vehicles_are_above_their_grips() -> None:
    motion = planned_motion(PLAN, 1.0)
    times = motion.timelines["mission_time"]
    above = motion.centres - PLAN.motion.at(times)[0]
    np.testing.assert_allclose(above, np.broadcast_to([0, 0, 0.6], above.shape), atol=1e-12)
    assert motion.rotations is not None
    np.testing.assert_allclose(motion.rotations[0], [[0, 0, 0, 1]] * 9, atol=1e-9)


def test_the_last_strand_distance_is_that_of_the_folded_knot() -> None:
    times, distance = planned_strand_distances(PLAN)
    assert times[0] == PLAN.phase("fold").start
    assert times[-1] == PLAN.phase("hold").end
    # 1.01 m is the smallest vertical distance at a crossing; strands come nearer aslant.
    assert 0.3 < distance[-1] < 1.01
    assert distance[-1] == pytest.approx(distance[-2], abs=1e-9)
