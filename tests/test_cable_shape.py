"""The shape of the cable in a plan at any time: catenaries of the right length, on the floor too."""

from dataclasses import replace

import numpy as np
import pytest

from swarm.errors import InputError
from swarm.geometry.catenary import OverStretched, solve_catenaries
from swarm.mission import parse_mission
from swarm.planning.cable_shape import cable_shape
from swarm.planning.candidates import make_plan
from tests.network import sideways

PLAN = sideways()


def middle(name):
    phase = PLAN.phase(name)
    return 0.5 * (phase.start + phase.end)


def test_held_segments_keep_their_lengths_and_hang_between_their_grips():
    times = np.linspace(PLAN.phase("lift").start, PLAN.phase("hold").end - 1e-6, 40)
    shape = cable_shape(PLAN, times, 400)
    assert shape.shape == (40, 2, 400, 3)
    grips = PLAN.motion(times)[0]
    np.testing.assert_allclose(shape[:, :, 0], grips[:, :-1], atol=1e-9)
    np.testing.assert_allclose(shape[:, :, -1], grips[:, 1:], atol=1e-9)
    arc = np.linalg.norm(np.diff(shape, axis=2), axis=-1).sum(axis=2)
    length = np.broadcast_to(PLAN.layout.lengths, arc.shape)
    aloft = times >= PLAN.phase("fold").start
    np.testing.assert_allclose(arc[aloft], length[aloft], rtol=1e-3)
    assert (arc <= length * (1.0 + 1e-9)).all()
    assert shape[..., 2].min() >= -1e-12


def test_the_cable_aloft_is_a_catenary():
    time = middle("fold")
    grips = PLAN.motion(time)[0]
    expected = solve_catenaries(grips[:-1], grips[1:], PLAN.layout.lengths).points(
        np.linspace(0, 1, 50)
    )
    np.testing.assert_allclose(cable_shape(PLAN, time, 50), expected, atol=1e-12)


def test_part_of_the_cable_is_on_the_floor_during_the_lift():
    lift = PLAN.phase("lift")
    shape = cable_shape(PLAN, lift.start + 0.2 * (lift.end - lift.start), 200)
    lying = (shape[..., 2] < 1e-9).sum(axis=1)
    assert (lying > 10).all()
    assert (lying < 190).all()


def test_before_the_grab_the_cable_lies_at_its_grip_points():
    before = cable_shape(PLAN, [0.0, middle("takeoff"), middle("grab")], 20)
    assert (before[..., 2] == 0.0).all()
    assert np.ptp(before, axis=0).max() == 0.0


def test_released_cable_is_undefined():
    assert np.isnan(cable_shape(PLAN, PLAN.duration, 20)).all()
    assert np.isnan(cable_shape(PLAN, [middle("hold"), PLAN.duration], 5)).any(
        axis=(1, 2, 3)
    ).tolist() == [False, True]


def test_cable_that_was_put_down_stays_there():
    mission = parse_mission(
        "{schema: 1, name: carry, finish: unfold, formation: {lengths: [4.0],"
        "places: [[[0, 0, 4], [3, 0, 4]]]}}", "m",
    )  # fmt: skip
    plan = make_plan(mission)
    first, last = cable_shape(plan, [0.0, plan.duration], 30)
    np.testing.assert_allclose(last, first, atol=1e-9)


def test_a_plan_without_cable_has_no_segments():
    text = "{schema: 1, name: hover, formation: {places: [[[0, 0, 3], [3, 0, 3]]]}}"
    assert cable_shape(make_plan(parse_mission(text, "m")), [1.0, 2.0], 7).shape == (2, 0, 7, 3)


def test_invalid_times_and_points_are_refused():
    with pytest.raises(InputError, match=r"time: expected finite seconds.*\n?points: expected at"):
        cable_shape(PLAN, [1.0, np.nan], 1)
    short = replace(PLAN, layout=replace(PLAN.layout, lengths=0.5 * PLAN.layout.lengths))
    with pytest.raises(OverStretched):
        cable_shape(short, middle("fold"), 10)
