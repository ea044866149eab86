"""The emulated cable against an independent solver; grips, breaks and falling parts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl.cable.rope import Rope
from sitl.physics.geodesy import GRAVITY
from sitl.world import CableSpec
from swarm.geometry import catenary
from swarm.geometry.catenary import rest_on_floor

STILL = np.zeros((9, 3))


def rope(length: float, ties: list[float], floor: float = -100.0, wind=(0, 0, 0), **spec) -> Rope:
    cable = CableSpec(points=[(0, 0, 0), (length, 0, 0)], **spec)
    made = Rope(cable, floor, np.array(wind, dtype=float))
    for vehicle, arc in enumerate(ties):
        made.attach(vehicle, arc)
    return made


coordinate = st.floats(-3.0, 3.0)


@settings(max_examples=60, deadline=None)
@given(coordinate, coordinate, coordinate, st.floats(1.01, 3.0))
def test_spans_equal_the_planners_catenaries(x: float, y: float, z: float, ratio: float) -> None:
    stop = np.array([x, y, z])
    chord = float(np.linalg.norm(stop))
    if chord < 0.3 or np.hypot(x, y) < 0.05:
        return
    length = ratio * chord
    made = rope(length, [0.0, length])
    grips = np.array([[0.0, 0.0, 0.0], stop])
    force = made.forces(grips, STILL[:2])
    hung = catenary.solve_catenaries(grips[:1], grips[1:], np.array([length]))
    expected = hung.end_forces(made.spec.mass_per_length, GRAVITY)
    weight = made.spec.mass_per_length * GRAVITY * length
    assert force[0] == pytest.approx(expected[0][0], abs=2e-3 * weight, rel=2e-3)
    assert force[1] == pytest.approx(expected[1][0], abs=2e-3 * weight, rel=2e-3)
    shape = made.update(grips, 0.0)
    theirs = hung.points(made.arc / length)[0]
    assert np.abs(shape - theirs).max() < 2e-3 * length


@settings(max_examples=40, deadline=None)
@given(st.floats(0.0, 1.5), st.floats(0.0, 1.5), st.floats(0.5, 4.0), st.floats(1.001, 1.6))
def test_spans_on_the_floor_pull_with_the_lifted_weight(
    left: float, right: float, across: float, ratio: float
) -> None:
    length = ratio * float(np.hypot(across, left - right))
    made = rope(length, [0.0, length], floor=0.0)
    grips = np.array([[0.0, 0.0, left], [across, 0.0, right]])
    force = made.forces(grips, STILL[:2])
    weight = made.weight
    assert -force[:, 2].sum() <= weight * length * (1 + 1e-3) + 1e-6
    assert force[0, 0] == pytest.approx(-force[1, 0], rel=1e-3, abs=1e-4), "no friction"
    shape = made.update(grips, 0.0)
    assert shape[:, 2].min() > -1e-6
    steps = np.linalg.norm(np.diff(shape, axis=0), axis=1)
    assert steps.sum() <= length * (1 + 5e-3)
    assert np.linalg.norm(shape[0] - grips[0]) < 5e-3 * length
    assert np.linalg.norm(shape[-1] - grips[1]) < 5e-3 * length


@settings(max_examples=60, deadline=None)
@given(st.floats(0.05, 1.5), st.floats(0.05, 1.5), st.floats(0.5, 4.0), st.floats(1.02, 1.6))
def test_spans_on_the_floor_pull_as_the_planners(
    left: float, right: float, across: float, ratio: float
) -> None:
    length = ratio * float(np.hypot(across, left - right))
    made = rope(length, [0.0, length], floor=0.0)
    grips = np.array([[0.0, 0.0, left], [across, 0.0, right]])
    force = made.forces(grips, STILL[:2])
    theirs = rest_on_floor(grips[0], grips[1], length)
    expected = theirs.end_forces(made.spec.mass_per_length, GRAVITY)
    weight = made.spec.mass_per_length * GRAVITY * length
    assert force[0] == pytest.approx(expected[0], abs=2e-3 * weight, rel=2e-3)
    assert force[1] == pytest.approx(expected[1], abs=2e-3 * weight, rel=2e-3)


def test_crosswind_tilts_the_plane_by_drag_over_weight() -> None:
    made = rope(5.0, [0.0, 5.0], wind=(0.0, 5.0, 0.0))
    grips = np.array([[0.0, 0.0, 10.0], [4.0, 0.0, 10.0]])
    made.forces(grips, STILL[:2])
    middle = made.update(grips, 0.0)[len(made.arc) // 2]
    angle = np.arctan2(middle[1], 10.0 - middle[2])
    drag = 0.5 * 1.2 * 1.1 * 0.006 * 5.0**2
    assert angle == pytest.approx(np.arctan(drag / (0.012 * GRAVITY)), rel=1e-6)


def test_a_taut_span_stretches_and_breaks_at_its_breaking_load() -> None:
    made = rope(4.0, [0.0, 4.0], breaking_load=50.0, stiffness=2000.0)
    grips = np.array([[0.0, 0.0, 0.0], [4.05, 0.0, 0.0]])
    force = made.forces(grips, STILL[:2])
    assert 15.0 < force[0, 0] < 50.0
    assert not made.breaks
    grips[1, 0] = 4.2
    made.forces(grips, STILL[:2])
    assert len(made.breaks) == 1
    force = made.forces(grips, STILL[:2])
    assert abs(force[:, 0]).max() < 1e-9, "two loose ends hang down"
    assert force[:, 2].sum() == pytest.approx(-made.weight * 4.0, rel=1e-9)


def test_forces_of_a_team_carry_the_whole_cable() -> None:
    made = rope(30.0, [1.0 + 3.5 * k for k in range(9)])
    grips = np.zeros((9, 3))
    grips[:, 0] = 3.0 * np.arange(9)
    grips[:, 2] = np.sin(np.arange(9))
    force = made.forces(grips, STILL)
    assert force[:, 2].sum() == pytest.approx(-30.0 * made.weight, rel=1e-9)
    assert abs(force[:, :2].sum(axis=0)).max() < 1e-9
    shape = made.update(grips, 0.0)
    assert np.linalg.norm(np.diff(shape, axis=0), axis=1).sum() == pytest.approx(30.0, rel=5e-3)
    for arc, vehicle in made.grips:
        assert made.position_at(arc) == pytest.approx(grips[vehicle], abs=0.06)


def test_a_gripper_grabs_the_nearest_free_cable() -> None:
    made = rope(10.0, [], floor=0.0)
    assert made.grab(0, np.array([3.33, 0.14, 0.0])) == pytest.approx(3.33)
    assert made.grab(1, np.array([5.0, 0.16, 0.0])) is None
    assert made.grab(1, np.array([3.33, 0.0, 0.0])) is None, "held there already"
    assert made.grab(1, np.array([6.0, 0.0, 0.1])) == pytest.approx(6.0)
    assert [vehicle for _, vehicle in made.grips] == [0, 1]
    assert made.release(0)
    assert not made.release(0)
    assert [vehicle for _, vehicle in made.grips] == [1]


def test_cable_on_the_floor_stays_while_others_grab_it() -> None:
    """Slack in bows between the grip points is still there for the last gripper."""
    points = [(0.0, 0.0, 0.0), (2.0, 0.6, 0.0), (4.0, 0.0, 0.0), (6.0, 0.6, 0.0), (8.0, 0.0, 0.0)]
    made = Rope(CableSpec(points=points), 0.0, np.zeros(3))
    grips = np.array([[x, 0.0, 0.02] for x in (0.0, 4.0, 8.0)])
    laid = 2.0 * np.hypot(2.0, 0.6)
    for vehicle, grip in enumerate(grips):
        assert made.grab(vehicle, grip) == pytest.approx(vehicle * laid, abs=0.05)
        made.forces(grips, STILL[:3])
        made.update(grips, 0.1)


def test_released_cable_falls_to_the_floor() -> None:
    made = rope(8.0, [0.0, 4.0, 8.0], floor=0.0)
    grips = np.array([[0.0, 0.0, 5.0], [3.0, 0.0, 5.0], [6.0, 0.0, 5.0]])
    made.forces(grips, STILL[:3])
    before = made.update(grips, 0.0).copy()
    made.release(2)
    heights = []
    for _ in range(60):
        made.forces(grips, STILL[:3])
        heights.append(made.update(grips, 0.02)[-1, 2])
    assert before[-1, 2] == pytest.approx(5.0)
    drops = -np.diff([5.0, *heights])
    assert drops.min() >= -1e-9
    assert drops.max() <= 9.0 * 0.02 + 1e-9, "no faster than it can fall"
    assert heights[10] > 4.0
    assert heights[-1] < 1.1, "hanging from its neighbour"


def test_downwash_adds_load_to_the_strands_below() -> None:
    made = rope(6.4, [0.0, 3.2, 6.4])
    grips = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [6.0, 0.0, 0.0]])
    before = made.forces(grips, STILL[:3])
    made.update(grips, 0.0)
    speed = np.zeros((len(made.arc), 4))
    speed[:, :3] = 20.0
    made.set_wash(speed[:, :2])
    holders = made.forces(grips, STILL[:3]) - before
    assert holders[0] == pytest.approx(np.zeros(3), abs=1e-12), "their own wash is left out"
    speed[:, :3] = 0.0
    speed[made.arc < 3.2, 3] = 6.0
    made.set_wash(speed)
    change = made.forces(grips, STILL[:3]) - before
    drag = 0.5 * 1.2 * 1.1 * 0.006 * 6.0**2 * 3.2
    assert change[:, 2].sum() == pytest.approx(-drag, rel=1e-6)
    assert change[2] == pytest.approx(np.zeros(3), abs=1e-12), "the other span is not below"


@settings(max_examples=60, deadline=None)
@given(st.floats(0.0, 0.2), st.floats(0.0, 0.2), st.floats(0.97, 1.02))
def test_the_force_of_a_straight_span_near_the_floor_is_limited_by_elasticity(
    left: float, right: float, ratio: float
) -> None:
    made = rope(3.0, [0.0, 3.0], floor=0.0)
    grips = np.array([[0.0, 0.0, left], [3.0 * ratio, 0.0, right]])
    force = made.forces(grips, STILL[:2])
    stretch = max(0.0, float(np.linalg.norm(grips[1] - grips[0])) * 1.0002 - 3.0)
    taut = made.weight * 3.0 * ratio / (2 * 0.03)
    assert np.abs(force).max() <= made.spec.stiffness / 3.0 * stretch + taut + 1.0
