"""Open polygons with few edges: the knot stays, by an identification that shares no code."""

import numpy as np
import pytest

from swarm.knots.catalog import lookup_knot
from swarm.knots.grid import openings
from swarm.knots.invariants import identify_curve
from swarm.knots.sticks import fewest_edges, reduced_polygon


@pytest.mark.parametrize(("name", "vertices"), [("3_1", 6), ("m3_1", 6), ("4_1", 7), ("5_2", 8)])
def test_a_reduced_polygon_has_the_knot_of_the_grid_and_the_wanted_vertices(
    name: str, vertices: int
) -> None:
    knot = lookup_knot(name)
    polygon = reduced_polygon(openings(knot.grid)[0], vertices, np.random.default_rng(2))
    assert polygon is not None
    assert polygon.shape == (vertices, 3)
    found = identify_curve(polygon)
    assert (found.name, found.chirality) == (knot.name, knot.chirality)


def test_three_edges_in_plan_view_hold_no_overhand() -> None:
    opened = openings(lookup_knot("3_1").grid)[0]
    assert reduced_polygon(opened, 4, np.random.default_rng(1)) is None


@pytest.mark.parametrize(("crossings", "edges"), [(0, 1), (1, 3), (3, 4), (4, 5), (8, 6), (10, 6)])
def test_the_least_number_of_edges_has_as_many_pairs_that_may_cross(
    crossings: int, edges: int
) -> None:
    assert fewest_edges(crossings) == edges
    pairs = [(i, j) for i in range(edges) for j in range(i + 2, edges)]
    assert len(pairs) >= crossings
