"""The planner's own costs, against distances found in another way."""

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.distance import cdist

from swarm.folding.margins import Margins
from swarm.folding.outlines import PIECES, Outlines, crossing_heights, outline_strands
from swarm.folding.soft_constraints import margin_costs, strand_costs, vehicle_cost
from swarm.geometry.catenary import solve_catenaries

Floats = npt.NDArray[np.float64]

EXACT = Margins(0.2, 1.0, 1.5, 0.3, tracking=0.0, radius=0.25, grip_offset=0.6, exempt=0.8)
ERRING = Margins(0.2, 1.0, 1.5, 0.3, tracking=0.1, radius=0.25, grip_offset=0.6, exempt=1.2)


def pairs(count: int, seed: int) -> tuple[Floats, Floats, Floats, Floats]:
    rng = np.random.default_rng(seed)
    a, b, c, d = rng.uniform(-2.0, 2.0, (4, count, 3))
    return a, b, c, d


def test_strand_costs_grow_as_strands_come_closer() -> None:
    a, b, c, d = pairs(200, 3)
    one, other = outline_strands(a, b, 6.5), outline_strands(c, d, 6.8)
    cost = strand_costs(one, other, EXACT)
    fine = np.linspace(0.0, 1.0, 400)
    dense = [
        solve_catenaries(*ends, length).points(fine)
        for ends, length in (((a, b), 6.5), ((c, d), 6.8))
    ]
    distance = np.array([cdist(x, y).min() for x, y in zip(*dense, strict=True)])
    expected = margin_costs((distance - EXACT.cable) / EXACT.cable)
    bow = 7.7 / PIECES**2  # of strands as slack as these
    assert np.all(cost >= margin_costs((distance + bow - EXACT.cable) / EXACT.cable) - 1e-9)
    assert np.all(cost <= margin_costs((distance - bow - EXACT.cable) / EXACT.cable) + 1e-9)
    assert np.corrcoef(cost, expected)[0, 1] > 0.9


def test_tracking_errors_raise_the_cost() -> None:
    a, b, c, d = pairs(200, 4)
    one, other = outline_strands(a, b, 6.5), outline_strands(c, d, 6.8)
    plain, careful = strand_costs(one, other, EXACT), strand_costs(one, other, ERRING)
    touching = plain > 0.02
    assert touching.any()
    assert np.all(careful[touching] > 0.0)


def steepness(batch: Outlines, k: int) -> float:
    step = np.diff(batch.points[k], axis=0)
    return float(np.abs(step[:, 2] / np.hypot(step[:, 0], step[:, 1])).max())


def test_crossing_heights_are_those_of_the_curves() -> None:
    a, b, c, d = pairs(400, 5)
    one, other = outline_strands(a, b, 7.5), outline_strands(c, d, 7.5)
    found, back = np.empty((2, 400))
    crossing_heights(one.points, other.points, found)
    crossing_heights(other.points, one.points, back)
    assert found.min() < 0.0 < found.max()
    assert np.any(found == 0.0)
    np.testing.assert_allclose(back, -found, atol=1e-9)
    fine = np.linspace(0.0, 1.0, 2000)
    dense = [solve_catenaries(*ends, 7.5).points(fine) for ends in ((a, b), (c, d))]
    for k in np.flatnonzero(found)[:60]:
        apart = cdist(dense[0][k][:, :2], dense[1][k][:, :2])
        i, j = np.unravel_index(apart.argmin(), apart.shape)
        gap = dense[0][k][i, 2] - dense[1][k][j, 2]
        steepest = max(steepness(one, k), steepness(other, k))
        assert gap == pytest.approx(found[k], abs=0.1 + 0.1 * steepest)


def test_vehicles_keep_a_horizontal_or_a_vertical_distance() -> None:
    there = np.array([[1.2, 0.0, 0.0], [0.0, 0.0, 1.8], [0.5, 0.0, 0.5]])
    cost = [vehicle_cost(np.zeros(3), place, EXACT) for place in there]
    assert cost[0] < 0.01
    assert cost[1] < 0.01
    assert cost[2] > 1.0
