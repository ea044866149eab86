import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from swarm.mission.mission import BoxObstacle, CylinderObstacle, HalfSpaceObstacle
from swarm.planning.cable_shape import laid_grip_points
from swarm.reports import scene
from swarm.reports.layout_sheet import layout_sheet
from tests.reports.synthetic import CROSSINGS, snapshot_at, trefoil_plan

PLAN = trefoil_plan(fence=((-20.0, -20.0), (20.0, -20.0), (20.0, 20.0)))


def arc_lengths(strips: np.ndarray) -> np.ndarray:
    steps: np.ndarray = np.linalg.norm(np.diff(strips, axis=-2), axis=-1)
    total: np.ndarray = steps.sum(axis=-1)
    return total


def test_strands_have_the_length_of_the_cable_and_end_at_the_grips() -> None:
    corners, lengths = PLAN.layout.corners, PLAN.layout.lengths
    strips = scene.strands(corners, lengths, 400)
    assert arc_lengths(strips) == pytest.approx(lengths, rel=1e-4)
    np.testing.assert_allclose(strips[:, 0], corners[:-1], atol=1e-9)
    np.testing.assert_allclose(strips[:, -1], corners[1:], atol=1e-9)


def test_cable_lies_on_the_floor_and_never_below() -> None:
    grips = PLAN.layout.corners * [1.0, 1.0, 0.05]
    strips = scene.strands(grips, PLAN.layout.lengths)
    assert strips[..., 2].min() == 0.0


def test_bad_data_is_drawn() -> None:
    grips = np.array([[0, 0, 3], [5, 0, 3], [np.nan, 0, 3], [7, 0, 3], [7, 0, 3.0]])
    strips = scene.strands(grips, np.array([2.0, 2.0, 2.0, 1.0]), 5)
    np.testing.assert_allclose(strips[0, :, 0], np.linspace(0, 5, 5), atol=1e-3)
    np.testing.assert_allclose(strips[0, :, 2], 3.0, atol=1e-3)
    assert np.isnan(strips[1:3]).all()
    np.testing.assert_allclose(strips[3, 2], [7, 0, 2.5], atol=1e-6)


def test_closest_strands_are_not_neighbours() -> None:
    shapes = scene.strands(PLAN.layout.corners, PLAN.layout.lengths, 40)
    found = scene.closest_strands(shapes)
    assert found is not None
    distance, ends = found
    dense = scene.strands(PLAN.layout.corners, PLAN.layout.lengths, 300)
    brute = min(
        cdist(dense[i], dense[j]).min() for i in range(len(dense)) for j in range(i + 2, len(dense))
    )
    assert distance == pytest.approx(brute, abs=0.01)
    assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(distance, abs=1e-12)
    assert scene.closest_strands(shapes[:2]) is None
    shapes[2:] = np.nan
    assert scene.closest_strands(shapes) is None


def test_colours_show_the_tautness_of_segments() -> None:
    slack, near, taut, beyond, unknown = scene.tautness_colours(
        np.array([0.3, 0.9, 0.985, 1.2, np.nan])
    ).tolist()
    assert taut == beyond
    assert len({tuple(c) for c in (slack, near, taut, unknown)}) == 4


def test_crossings_are_where_the_strands_cross_in_plan_view() -> None:
    found = scene.crossings(PLAN.layout)
    assert [(c.over - 1, c.under - 1) for c in found] == list(CROSSINGS)
    strips = scene.strands(PLAN.layout.corners, PLAN.layout.lengths, 2000)
    for crossing in found:
        np.testing.assert_allclose(crossing.upper[:2], crossing.lower[:2], atol=1e-9)
        for segment, point in ((crossing.over, crossing.upper), (crossing.under, crossing.lower)):
            assert np.linalg.norm(strips[segment - 1] - point, axis=1).min() < 5e-3
        assert crossing.distance > 0


def test_the_worst_state_of_a_vehicle_is_shown() -> None:
    good = snapshot_at(PLAN, 50.0)
    assert scene.vehicle_states(good, 0.1) == ["attached"] * 9
    far = good.position + np.array([0.0, 0.0, 0.5])
    age = np.where(np.arange(9) == 3, np.nan, good.link_age)
    bad = replace(good, position=far, link_age=age)
    assert scene.vehicle_states(bad, 0.1) == ["off track"] * 3 + ["silent"] + ["off track"] * 5
    assert scene.vehicle_states(bad, 0.0)[0] == "attached"  # geometry only: no ball to leave
    assert scene.vehicle_states(snapshot_at(PLAN, 0.0), 0.1) == ["idle"] * 9


def test_cable_moves_with_its_grips_and_lies_where_it_was_released() -> None:
    held, gripped = laid_grip_points(PLAN), np.zeros(9, dtype=bool)
    assert (held[:, 2] == 0).all()
    before = held.copy()
    one = replace(snapshot_at(PLAN, 50.0), gripped=(True,) + (False,) * 8)
    held, gripped = scene.follow_grips(held, gripped, one)
    np.testing.assert_array_equal(held[0], one.position[0])
    np.testing.assert_array_equal(held[1:], before[1:])
    unknown = replace(one, position=np.full((9, 3), np.nan))
    held, gripped = scene.follow_grips(held, gripped, unknown)
    np.testing.assert_array_equal(held[0], one.position[0])
    dropped = replace(one, gripped=(False,) * 9)
    held, gripped = scene.follow_grips(held, gripped, dropped)
    np.testing.assert_array_equal(held[0], one.position[0] * [1, 1, 0])
    assert not gripped.any()


def test_planned_cable_follows_the_same_rules() -> None:
    grab, fold, land = PLAN.phase("grab"), PLAN.phase("fold"), PLAN.phase("land")
    times = np.array([0.0, grab.end - 0.1, fold.end, land.end])
    held = scene.planned_cable(PLAN, times)
    np.testing.assert_array_equal(held[0], laid_grip_points(PLAN))
    np.testing.assert_array_equal(held[1], laid_grip_points(PLAN))
    np.testing.assert_allclose(held[2], PLAN.layout.corners, atol=1e-9)
    assert (held[3][:, 2] == 0).all()
    np.testing.assert_allclose(held[3][:, :2], PLAN.layout.corners[:, :2], atol=0.2)


def test_fence_has_floor_ceiling_and_posts() -> None:
    floor, top, *posts = scene.workspace_lines(PLAN)["fence"]
    assert len(posts) == 3
    np.testing.assert_array_equal(floor[0], floor[-1])
    assert (top[:, 2] == PLAN.mission.workspace.ceiling).all()
    assert scene.workspace_lines(trefoil_plan()) == {}


def _numbers(rows: Sequence[Sequence[str]]) -> np.ndarray:
    return np.array([[float(number) for number in row] for row in rows])


def test_obstacles_are_drawn_on_their_surfaces() -> None:
    plan = trefoil_plan()
    box = BoxObstacle(name="table", shape="box", centre=(3.0, 1.0), size=(2.0, 1.0), turn=30, top=1)
    post = CylinderObstacle(
        name="post", shape="cylinder", centre=(0, 9), radius=0.5, bottom=1, top=4
    )
    net = HalfSpaceObstacle(name="net", shape="half-space", point=(0, -9, 0), normal=(0, 2, -1))
    far = HalfSpaceObstacle(name="far", shape="half-space", point=(0, -900, 0), normal=(0, 2, 0))
    workspace = plan.mission.workspace.model_copy(update={"obstacles": (box, post, net, far)})
    mission = plan.mission.model_copy(update={"workspace": workspace})
    found = scene.workspace_lines(replace(plan, mission=mission))
    assert list(found) == ["obstacle table", "obstacle post", "obstacle net"]
    floor, top, *posts = found["obstacle table"]
    assert (floor[:, 2].max(), top[:, 2].min(), len(posts)) == (0.0, 1.0, 4)
    turn = np.radians(30.0)
    local = (floor[:, :2] - [3.0, 1.0]) @ [
        [np.cos(turn), -np.sin(turn)],
        [np.sin(turn), np.cos(turn)],
    ]
    np.testing.assert_allclose(np.abs(local), np.tile([1.0, 0.5], (5, 1)))
    assert len({tuple(np.sign(corner)) for corner in local}) == 4
    ring, *_ = found["obstacle post"]
    np.testing.assert_allclose(np.hypot(ring[:, 0], ring[:, 1] - 9.0), 0.5)
    (plane,) = found["obstacle net"]
    np.testing.assert_allclose((plane - [0, -9, 0]) @ [0, 2, -1], 0.0, atol=1e-9)
    # the sheet has them too, true to scale: from pad to pad as from post to pad
    bounded = replace(plan, mission=mission)
    sheet = layout_sheet(bounded)
    names = re.findall(r">(obstacle \w+)</text>", sheet)
    assert names == list(found)
    pads = _numbers(re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)" r="13"', sheet))
    there = plan.motion.at(0.0)[0][:, :2]
    scale = np.hypot(*(pads[-1] - pads[0])) / np.hypot(*(there[-1] - there[0]))
    (first, *_) = re.findall(r'points="([^"]*)"[^>]*stroke-dasharray="7 4"', sheet)
    corner = _numbers([point.split(",") for point in first.split()])[0]
    to_corner = (floor[0, :2] - there[0]) * [scale, -scale]
    np.testing.assert_allclose(corner - pads[0], to_corner, atol=0.2)
    places = plan.motion.at(plan.motion.times)[0].reshape(-1, 3)
    assert (plane >= [*places.min(axis=0)[:2] - scene.AROUND - 1e-9, -1e-9]).all()
    assert (plane <= places.max(axis=0) + scene.AROUND + 1e-9).all()


@given(st.lists(st.floats(-8, 8), min_size=3, max_size=3))
def test_thrust_points_against_gravity_and_along_the_acceleration(given_acceleration) -> None:  # type: ignore[no-untyped-def]
    acceleration = np.array([given_acceleration])
    up = Rotation.from_quat(scene.thrust_quaternions(acceleration)[0]).apply([0.0, 0.0, 1.0])
    thrust = acceleration[0] + [0.0, 0.0, 9.80665]
    np.testing.assert_allclose(up, thrust / np.linalg.norm(thrust), atol=1e-9)
