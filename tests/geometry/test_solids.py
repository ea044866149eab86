"""Distances from convex solids against constrained least squares and linear programs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from swarm.geometry.solids import (
    distances,
    grown,
    half_space,
    planes_between,
    rows,
    upright_box,
    upright_cylinder,
)

# Whole and half numbers make touching, parallel and inner points common.
coordinate = st.integers(-8, 8).map(lambda k: 0.5 * k)
point = st.tuples(coordinate, coordinate, coordinate)
length = st.sampled_from([0.01, 0.5, 1.0, 3.0])
turns = st.floats(-4.0, 4.0)


def turned(turn):
    return np.array(
        [[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]]
    )


def box_distance(centre, size, turn, low, high, point):
    """Outside by least squares over the box; inside the nearest of six faces."""
    middle = np.array([*centre, 0.5 * (low + high)])
    half = 0.5 * np.array([*size, high - low])
    frame = turned(turn)
    local = frame.T @ (np.array(point) - middle)
    if np.all(np.abs(local) <= half):
        return float(np.max(np.abs(local) - half))
    found = lsq_linear(frame, np.array(point) - middle, bounds=(-half, half), method="bvls")
    return float(np.sqrt(2.0 * found.cost))


@given(st.tuples(coordinate, coordinate), length, length, turns, coordinate, length, point)
def test_points_beside_boxes(centre, wide, deep, turn, low, tall, place):
    solid = rows([upright_box(centre, (wide, deep), turn, low, low + tall)])
    expected = box_distance(centre, (wide, deep), turn, low, low + tall, place)
    assert distances(solid, np.array(place))[0] == pytest.approx(expected, abs=1e-7)


@given(st.tuples(coordinate, coordinate), length, coordinate, length, point)
def test_points_beside_cylinders(centre, radius, low, tall, place):
    """A cylinder is all of its inscribed boxes: of 4,000 the nearest, and of the walls."""
    solid = rows([upright_cylinder(centre, radius, low, low + tall)])
    angle = np.linspace(0.0, 2.0 * np.pi, 4001)
    rim = np.array(centre) + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    level = np.hypot(*(np.array(place[:2]) - centre))
    found = distances(solid, np.array(place))[0]
    if level <= radius and low <= place[2] <= low + tall:
        assert found == pytest.approx(
            max(level - radius, low - place[2], place[2] - low - tall), abs=1e-12
        )
        return
    nearest = 0.0 if level <= radius else np.linalg.norm(rim - place[:2], axis=1).min()
    above = max(low - place[2], place[2] - low - tall, 0.0)
    assert found == pytest.approx(np.hypot(nearest, above), abs=2e-5)


@given(point, point.filter(any), point)
def test_points_beside_half_spaces(on, normal, place):
    solid = rows([half_space(on, normal)])
    expected = np.dot(np.subtract(place, on), normal) / np.linalg.norm(normal)
    assert distances(solid, np.array(place))[0] == pytest.approx(expected, abs=1e-12)


def some_solids(turn, tall):
    return rows(
        [
            upright_box((0.5, -1.0), (2.0, 0.5), turn, 0.0, tall),
            upright_cylinder((-1.0, 1.0), 0.75, 0.5, 0.5 + tall),
            half_space((0.0, 0.0, -1.0), (np.cos(turn), 0.3, np.sin(turn))),
            upright_box((2.0, 2.0), (np.inf, 0.0), turn, -np.inf, np.inf),
        ]
    )


@given(turns, length, point, point)
def test_planes_beside_chords_bound_their_distance(turn, tall, near, far):
    """All of each solid is behind its plane, and the chord no nearer than the plane says.

    For chords that come near no edge inside, the plane tells the distance, too.
    """
    solids = some_solids(turn, tall)
    chords = np.tile(np.array([near, far]), (len(solids), 1, 1))
    normals, walls = planes_between(solids, chords)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)
    true = distances(solids, np.linspace(near, far, 200)[:, None]).min(axis=0)
    reach = np.einsum("mi,mki->mk", normals, chords).min(axis=1) - walls
    assert np.all(reach <= true + 1e-9)
    step = np.linalg.norm(np.subtract(far, near))
    for reached, distance in zip(reach, true, strict=True):
        if distance > 0.0:
            # the direction is off by at most the miss of the nearest point over the distance
            miss = step / 256 + step / 200
            assert reached >= distance - miss * step / max(distance, 1e-9) - 1e-9


@given(turns, length, point, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_grown_solids_are_as_far_as_cylinders(turn, tall, place, radius, height):
    solids = some_solids(turn, tall)
    found = distances(grown(solids, radius, height), np.array(place))
    rng = np.random.default_rng(0)
    angle, share = rng.uniform(0.0, 2.0 * np.pi, 3000), rng.uniform(0.0, 1.0, 3000)
    inside = np.stack([np.cos(angle), np.sin(angle)]) * radius
    body = np.array(place) + np.stack([*inside, height * share], axis=1)
    ends = [np.array(place) + np.stack([*inside, np.full(3000, h)], axis=1) for h in (0.0, height)]
    axis = np.linspace(place, np.add(place, [0.0, 0.0, height]), 50)
    nearest = distances(solids, np.concatenate([body, *ends, axis])[:, None]).min(axis=0)
    assert np.all(found <= nearest + 1e-9)
    outside = found > 0.0
    assert np.all(nearest[outside] <= found[outside] + 0.05)


def test_distances_change_by_a_metre_per_metre_at_most():
    rng = np.random.default_rng(4)
    solids = some_solids(0.4, 1.0)
    one, other = rng.uniform(-4.0, 4.0, (2, 5000, 3))
    change = np.abs(distances(solids, one[:, None]) - distances(solids, other[:, None]))
    assert np.all(change <= np.linalg.norm(one - other, axis=1)[:, None] + 1e-12)
