"""Grid diagrams: validity, moves that preserve the knot, and openings."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm.knots.diagram import Diagram
from swarm.knots.gauss import KnotError
from swarm.knots.grid import (
    Grid,
    grid_of_columns,
    mirrored,
    openings,
    translated,
    transposed,
)
from swarm.knots.grid_search import GridWalk, grid_of_diagram, minimise_grid, random_grids
from swarm.knots.invariants import alexander_polynomial, identify_diagram, jones_polynomial
from swarm.knots.table import knot_table
from tests.knots.curves import of_knotinfo, random_diagram

OVERHAND = Grid(((2, 4), (3, 5), (1, 4), (2, 5), (1, 3)))


def polynomials(grid: Grid) -> tuple[dict[int, int], dict[int, int]]:
    """Invariants that detect nearly every wrong move, with chirality."""
    diagram = Diagram(grid.code)
    return jones_polynomial(diagram), alexander_polynomial(diagram)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ([[1, 2]], "a grid diagram has at least 2 columns, got 1"),
        (
            [[1, 3], [2, 2], [1, 3]],
            "column 2: expected rows (low, high) with 1 ≤ low < high ≤ 3, got (2, 2)",
        ),
        (
            [[1, 3], [1, 2], [1, 3]],
            "row 1: expected the ends of 2 columns, got 3; "
            "row 2: expected the ends of 2 columns, got 1",
        ),
        (
            [[1, 2], [1, 2], [3, 4], [3, 4]],
            "the grid is that of a link: its first component has 4 of its 8 corners; "
            "one cable has one component",
        ),
        ([[1, 2], [1]], "column 2: expected a pair of row numbers, got [1]"),
        ("1-2", "a grid is a list of row pairs, one per column, got '1-2'"),
    ],
)
def test_invalid_grids(columns: object, message: str) -> None:
    with pytest.raises(KnotError) as caught:
        grid_of_columns(columns)
    assert str(caught.value) == message


FIGURE_EIGHT = [
    *[(1, 1), (5, 1), (5, 5), (2, 5), (2, 3), (4, 3)],
    *[(4, 6), (6, 6), (6, 2), (3, 2), (3, 4), (1, 4)],
]
CARRICK_MAT = [
    *[(5, 3), (3, 3), (3, 8), (9, 8), (9, 4), (4, 4), (4, 2), (1, 2), (1, 9), (8, 9)],
    *[(8, 6), (6, 6), (6, 1), (2, 1), (2, 7), (7, 7), (7, 5), (10, 5), (10, 10), (5, 10)],
]


@pytest.mark.parametrize(("name", "corners"), [("4_1", FIGURE_EIGHT), ("8_18", CARRICK_MAT)])
def test_the_grids_behind_the_papers_tables(name: str, corners: list[tuple[int, int]]) -> None:
    columns = [[r for c, r in corners if c == k] for k in range(1, len(corners) // 2 + 1)]
    grid = grid_of_columns(columns)
    assert identify_diagram(Diagram(grid.code)).name == name
    assert any(set(opened.corners) <= set(corners) for opened in openings(grid))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), moves=st.lists(st.integers(0, 5), max_size=12))
def test_no_move_changes_the_knot(seed: int, moves: list[int]) -> None:
    walk = GridWalk(grid_of_diagram(random_diagram(seed, 9)), seed)
    before = polynomials(walk.grid())
    rng = np.random.default_rng(seed)
    for kind in moves:
        size = walk.size
        if kind == 0:
            assert walk.shrink() == (walk.size < size)
        elif kind == 1:
            walk.stabilise()
            assert walk.size == size + 1
        elif kind == 2:
            walk = GridWalk(transposed(walk.grid()), seed)
        elif kind == 3:
            right, up = rng.integers(-9, 9, 2).tolist()
            walk = GridWalk(translated(walk.grid(), right, up), seed)
        else:
            for _ in range(10):
                walk.commute()
            assert walk.size == size
    assert polynomials(walk.grid()) == before


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_destabilisation_undoes_stabilisation(seed: int) -> None:
    walk = GridWalk(OVERHAND, seed)
    assert not walk.shrink()
    walk.stabilise()
    assert walk.size == 6
    assert walk.shrink()
    assert walk.size == 5
    assert polynomials(walk.grid()) == polynomials(OVERHAND)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_mirrors_drawings_searches_and_walks(seed: int) -> None:
    diagram = random_diagram(seed, 10)
    of_jones, of_alexander = jones_polynomial(diagram), alexander_polynomial(diagram)
    grid = grid_of_diagram(diagram)
    assert polynomials(grid) == (of_jones, of_alexander)
    assert polynomials(mirrored(grid))[0] == {-power: c for power, c in of_jones.items()}
    small = minimise_grid(grid, moves=3000)
    assert small.size <= grid.size
    assert polynomials(small) == (of_jones, of_alexander)
    for other in itertools.islice(random_grids(small), 3):
        assert other.size == small.size
        assert polynomials(other) == (of_jones, of_alexander)


@pytest.mark.parametrize("name", ["3_1", "4_1", "8_18", "8_19", "10_132"])
def test_openings(name: str) -> None:
    grid = knot_table()[name].grid
    found = openings(grid)
    assert found == openings(grid)
    assert openings(grid, limit=3) == found[:3]
    assert len({opened.corners for opened in found}) == len(found)
    keys = [(len(opened.crossings), opened.length) for opened in found]
    assert keys == sorted(keys)
    size = grid.size
    for opened in found:
        column, row = opened.removed
        assert len(opened.corners) == 2 * size - 1
        assert set(opened.corners) | {opened.removed} == set(opened.grid.corners)
        ends = {opened.corners[0], opened.corners[-1]}
        assert {c for c, _ in ends} & {column}
        assert {r for _, r in ends} & {row}
        assert len(opened.crossings) == opened.grid.crossings
        for over, under in opened.crossings:
            assert opened.corners[over][0] == opened.corners[over + 1][0]
            assert opened.corners[under][1] == opened.corners[under + 1][1]
            assert abs(over - under) > 1
    target = dict(knot_table()[name].jones)
    for opened in found[:: max(1, len(found) // 20)]:
        # Nothing crosses the two edges taken out, so the ends close without new crossings.
        assert jones_polynomial(Diagram(opened.code.as_closed())) == target


def test_every_corner_can_be_opened() -> None:
    """A torus translation brings any corner to the border, where its edges are free."""
    moved_back = set()
    for opened in openings(OVERHAND):
        for right, up in itertools.product(range(5), repeat=2):
            if translated(OVERHAND, right, up) == opened.grid:
                column, row = opened.removed
                moved_back.add(((column - 1 - right) % 5 + 1, (row - 1 - up) % 5 + 1))
    assert moved_back == set(OVERHAND.corners)


@pytest.mark.parametrize("name", ["3_1", "7_7", "8_20", "9_42", "10_161"])
def test_knotinfos_grids_lift_to_their_knots(name: str) -> None:
    marks = of_knotinfo(name, "grid_notation")
    columns = [sorted(row for c, row in marks if c == column) for column, _ in marks[::2]]
    found = jones_polynomial(Diagram(grid_of_columns(columns).code))
    assert found in (
        dict(knot_table()[name].jones),
        dict(sorted((-power, c) for power, c in knot_table()[name].jones)),
    )
