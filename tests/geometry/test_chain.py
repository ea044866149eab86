"""Chains of catenaries against the tables and conditions of the paper, and brute force."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq, minimize

from swarm.errors import Refused
from swarm.geometry.catenary import length_for_sag, sag_for_drop, solve_catenaries
from swarm.geometry.chain import (
    crossing_fractions,
    crossing_gaps,
    minimum_sags,
    plan_crossings,
    polyline,
    segment_lengths,
)
from swarm.knots.catalog import choose_knot
from swarm.knots.grid import grid_of_columns
from swarm.knots.invariants import identify_curve
from swarm.mission import parse_mission

MISSIONS = Path(__file__).parents[2] / "missions" / "paper"

# Lengths as printed; our gaps at the tightest crossings, of which the paper gives none.
PAPER = {
    "figure_eight": (
        [5.23, 5.98, 4.49, 4.74, 3.84, 5.32, 3.84, 5.98, 4.49, 4.74, 3.84],
        52.48,
        [0.211, 0.469, 0.500],
        "4_1",
    ),
    "carrick_mat": (
        [
            *(4.74, 6.05, 7.51, 5.23, 6.72, 3.84, 5.32, 7.79, 8.34),
            *(4.49, 4.74, 6.05, 5.98, 6.90, 6.72, 3.84, 5.32, 6.05),
        ],
        105.63,
        [-0.196, 0.355, 0.486],
        "8_18",
    ),
}


def paper_layout(knot: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners in space, sags, and crossings (over, under) of a mission; columns pass over."""
    path = MISSIONS / f"{knot}.yaml"
    layout = parse_mission(path.read_text("utf-8"), path.name).layout
    plan = np.array(layout.corners)
    corners = np.column_stack([plan, np.full(len(plan), 10.0)])
    over = np.diff(plan[:, 0]) == 0.0
    pairs = plan_crossings(corners).segments
    crossings = np.where(over[pairs[:, :1]], pairs, pairs[:, ::-1])
    assert np.all(over[crossings[:, 0]] & ~over[crossings[:, 1]])
    return corners, np.array(layout.sags), crossings


@pytest.mark.parametrize("knot", PAPER)
def test_the_papers_tables(knot: str) -> None:
    table, total, tightest, _ = PAPER[knot]
    corners, sags, crossings = paper_layout(knot)
    lengths = segment_lengths(corners, sags)
    np.testing.assert_allclose(lengths, table, atol=0.01)
    assert lengths.sum() == pytest.approx(total, abs=0.01)
    gaps = np.sort(crossing_gaps(corners, lengths, crossings))
    np.testing.assert_allclose(gaps[:3], tightest, atol=0.001)


@pytest.mark.parametrize("knot", PAPER)
def test_the_papers_missions_follow_the_grid_of_their_knot(knot: str) -> None:
    path = MISSIONS / f"{knot}.yaml"
    mission = parse_mission(path.read_text("utf-8"), path.name)
    choice = choose_knot(grid=mission.knot.grid)
    assert choice.name == PAPER[knot][3]
    corners = [(int(x), int(y)) for x, y in mission.layout.corners]
    closed = grid_of_columns(mission.knot.grid).corners
    ring = [*closed, *closed]
    assert any(
        way[k : k + len(corners)] == corners
        for way in (ring, ring[::-1])
        for k in range(len(closed))
    )


def test_the_carrick_table_fails_at_one_crossing() -> None:
    corners, sags, crossings = paper_layout("carrick_mat")
    gaps = crossing_gaps(corners, segment_lengths(corners, sags), crossings)
    # Numbered from 1 as in the paper: segment 10 passes over segment 3, and lies below it.
    assert (crossings[gaps < 0.0] + 1).tolist() == [[10, 3]]


def test_the_knots_of_the_papers_tables() -> None:
    """The figure-eight's cable is one; the Carrick mat's, with its one wrong crossing, is not."""
    found = {}
    for knot in PAPER:
        corners, sags, _ = paper_layout(knot)
        found[knot] = identify_curve(polyline(corners, segment_lengths(corners, sags), 40)).name
    assert found == {"figure_eight": "4_1", "carrick_mat": "3_1"}


def test_the_under_sag_that_the_carrick_mat_needs() -> None:
    corners, sags, crossings = paper_layout("carrick_mat")
    for under, ties in ((2.30, False), (2.31, True)):
        lengths = segment_lengths(corners, np.where(sags == 1.5, 1.5, under))
        assert (crossing_gaps(corners, lengths, crossings).min() > 0.0) == ties


def test_the_overhands_table_is_of_an_unknot() -> None:
    """The one grid with these spans: all signs of the turns, rows and columns used once each."""
    table = [2.59, 2.44, 1.73, 2.87, 2.59, 2.44, 1.73, 2.44]
    spans = np.array([3, 2, 1, 3, 3, 2, 1, 2])
    grids = []
    for signs in itertools.product((1, -1), repeat=8):
        steps = np.zeros((8, 2), dtype=int)
        steps[0::2, 0], steps[1::2, 1] = (spans * signs)[0::2], (spans * signs)[1::2]
        ring = np.concatenate([[[0, 0]], np.cumsum(steps, axis=0)])
        ring = np.concatenate([ring, [[ring[0, 0], ring[8, 1]]]])
        ring += 1 - ring.min(axis=0)
        columns = {
            int(a[0]): (int(a[1]), int(b[1])) for a, b in zip(ring[1:8:2], ring[2::2], strict=True)
        }
        columns[int(ring[9, 0])] = (int(ring[9, 1]), int(ring[0, 1]))
        rows = sorted(ring[0::2, 1].tolist())
        if sorted(columns) == rows == [1, 2, 3, 4, 5]:
            grids.append(ring)
            assert choose_knot(grid=[columns[k] for k in range(1, 6)]).name == "0_1"
    assert len(grids) == 4  # one, and its mirror images
    corners = np.column_stack([0.654 * grids[0][:9], np.full(9, 10.0)])
    sags = np.where(np.arange(8) % 2 == 0, 0.751, 0.941)
    np.testing.assert_allclose(segment_lengths(corners, sags), table, atol=0.005)


def minimum_under_sag(size: int, cell: float, sag_over: float) -> float:
    """The least h_max that separates every crossing of any N×N grid.

    Proposition 1 of the paper, corrected:
    h_max > h_min + ā·cosh((L − 3d)/2ā) − ā, with L = N·d and ā of a catenary with sag h_max and
    span L − d. Both sides hold h_max: the root is where the widest under strand has dropped h_min
    within one cell from its end. (The print adds ā, and its proof has L − d for L − 3d.)
    """
    return float(sag_for_drop((size - 1.0) * cell, sag_over, 1.0 / (size - 1.0)))


@pytest.mark.parametrize(
    ("size", "over", "under"),
    [(5, 1.34, 1.7178), (6, 1.55, 2.2783), (6, 1.5, 2.2101), (10, 1.5, 3.4962), (10, 2.89, 6.2011)],
)
def test_corrected_proposition_1(size: int, over: float, under: float) -> None:
    found = minimum_under_sag(size, 1.0, over)
    assert found == pytest.approx(under, abs=5e-5)
    assert minimum_under_sag(size, 2.0, 2.0 * over) == pytest.approx(2.0 * found)


@given(st.integers(3, 12), st.floats(0.2, 3.0), st.floats(0.1, 5.0))
def test_proposition_1_is_an_equality_at_its_root(size: int, cell: float, over: float) -> None:
    """Both strands as catenaries: at the worst crossing of the grid they just touch."""
    under = minimum_under_sag(size, cell, over)
    span = (size - 1) * cell
    corners = np.array(
        [[0, -cell, 0], [0, cell, 0], [5 * span, 5 * span, 0], [-cell, 0, 0], [span - cell, 0, 0]]
    )
    lengths = [
        float(length_for_sag(2 * cell, over)),
        30 * span,
        30 * span,
        float(length_for_sag(span, under)),
    ]
    gap = float(crossing_gaps(corners, lengths, [(0, 3)])[0])
    assert gap == pytest.approx(0.0, abs=1e-6 * (over + cell))


def test_gaps_are_heights_of_sampled_curves() -> None:
    """Against a search along both curves, with corners at different heights and no right angles."""
    corners = np.array([[0, 0, 5], [4, 1, 6], [3, 4, 4], [1, -2, 5.5], [-1, 3, 5]], dtype=float)
    lengths = segment_lengths(corners, [0.8, 1.0, 1.4, 0.5])
    found = plan_crossings(corners)
    assert found.segments.tolist() == [[0, 2], [0, 3]]
    gaps = crossing_gaps(corners, lengths, found.segments)
    for (i, j), gap in zip(found.segments, gaps, strict=True):
        first, second = (
            solve_catenaries(corners[k], corners[k + 1], lengths[k]).points(np.linspace(0, 1, 4001))
            for k in (i, j)
        )
        apart = np.linalg.norm(first[:, None, :2][::8] - second[None, ::8, :2], axis=-1)
        a, b = np.unravel_index(apart.argmin(), apart.shape)
        assert first[::8][a, 2] - second[::8][b, 2] == pytest.approx(gap, abs=0.02)


def test_crossings_are_found_with_their_fractions() -> None:
    corners = np.array([[0.0, 0], [4, 0], [4, 2], [1, 2], [1, -1]])
    found = plan_crossings(corners)
    assert found.segments.tolist() == [[0, 3]]
    np.testing.assert_allclose(found.fractions, [[0.25, 2.0 / 3.0]])
    placed = np.column_stack([corners, np.zeros(5)])
    np.testing.assert_allclose(crossing_fractions(placed, [(3, 0)]), [[2.0 / 3.0, 0.25]])
    with pytest.raises(ValueError, match=r"do not cross in plan view: \[\[0, 2\]\]"):
        crossing_fractions(placed, [(0, 3), (0, 2)])


def test_overlapping_segments_are_refused() -> None:
    corners = np.array([[0.0, 0], [4, 0], [4, 2], [5, 0], [1, 0]])
    with pytest.raises(Refused, match="segments overlap on one line in plan view: 0 and 3"):
        plan_crossings(corners)
    beside = np.array([[0.0, 0], [4, 0], [4, 2], [9, 0], [5, 0]])
    assert len(plan_crossings(beside).segments) == 0


def test_the_chain_is_sampled_through_its_corners() -> None:
    placed, sags, _ = paper_layout("figure_eight")
    lengths = segment_lengths(placed, sags)
    chain = polyline(placed, lengths, 40)
    assert chain.shape == (11 * 40 + 1, 3)
    np.testing.assert_array_equal(chain[::40], placed)
    arcs = np.linalg.norm(np.diff(chain, axis=0), axis=1).reshape(11, 40).sum(axis=1)
    np.testing.assert_allclose(arcs, lengths, rtol=1e-3)
    moving = polyline(np.stack([placed, placed + 1.0]), lengths, 40)
    np.testing.assert_allclose(moving[1], chain + 1.0, atol=1e-12)


def test_the_chain_of_the_paper_runs_through_every_sag() -> None:
    """Paper eq. 3 (one catenary, placed) and eq. 4 (the chain)."""
    placed, sags, _ = paper_layout("figure_eight")
    strands = solve_catenaries(placed[:-1], placed[1:], segment_lengths(placed, sags))
    np.testing.assert_allclose(strands.at_span(0.5)[:, 2], 10.0 - sags, atol=1e-12)
    # Paper eq. 1 for the first catenary, with a from eq. 2.
    a = brentq(lambda a: 1.5 / a - np.cosh(2.0 / a) + 1.0, 0.5, 10.0, xtol=1e-14)
    quarter = strands.at_span(0.25)[0, 2]
    assert quarter == pytest.approx(10.0 - 1.5 + a * (np.cosh(1.0 / a) - 1.0), abs=1e-9)


@pytest.mark.parametrize("knot", PAPER)
@pytest.mark.parametrize("one_each", [False, True])
def test_minimum_sags_keep_exactly_the_clearance(knot: str, one_each: bool) -> None:
    placed, given_sags, crossings = paper_layout(knot)
    over = given_sags == 1.5
    sags = minimum_sags(placed, crossings, 0.2, minimum_sag=0.5, one_each=one_each)
    gaps = crossing_gaps(placed, segment_lengths(placed, sags), crossings)
    assert gaps.min() == pytest.approx(0.2, abs=1e-9)
    assert np.all(sags >= 0.5)
    assert len(np.unique(sags)) == 2 or one_each
    assert np.all(sags[over] == 0.5)
    for i in np.flatnonzero(sags > 0.5):
        shallower = sags.copy()
        chosen = [i] if one_each else ~over
        shallower[chosen] = np.maximum(sags[chosen] - 0.01, 0.5)
        lengths = segment_lengths(placed, shallower)
        assert crossing_gaps(placed, lengths, crossings).min() < 0.2


def test_one_sag_each_needs_less_cable_than_two() -> None:
    placed, _, crossings = paper_layout("carrick_mat")
    totals = [
        segment_lengths(
            placed, minimum_sags(placed, crossings, 0.2, minimum_sag=0.5, one_each=one_each)
        ).sum()
        for one_each in (False, True)
    ]
    assert totals[1] < totals[0] - 1.0


PENTAGRAM = np.array(
    [
        [*(4.0 * np.array([np.cos(k * 0.8 * np.pi), np.sin(k * 0.8 * np.pi)])), 10.0]
        for k in range(5)
    ]
)
# Levels 2nd > 4th > 1st > 3rd: the overhand of five vehicles.
PENTAGRAM_CROSSINGS = [(1, 3), (3, 0), (0, 2)]


def test_a_pentagram_has_several_levels_of_sag() -> None:
    found = {tuple(sorted(pair)) for pair in plan_crossings(PENTAGRAM).segments.tolist()}
    assert found == {tuple(sorted(pair)) for pair in PENTAGRAM_CROSSINGS}
    sags = minimum_sags(PENTAGRAM, PENTAGRAM_CROSSINGS, 0.2, minimum_sag=0.5, one_each=True)
    assert sags[1] < sags[3] < sags[0] < sags[2]
    lengths = segment_lengths(PENTAGRAM, sags)
    np.testing.assert_allclose(crossing_gaps(PENTAGRAM, lengths, PENTAGRAM_CROSSINGS), 0.2)

    def cable(candidate: np.ndarray) -> float:
        return float(segment_lengths(PENTAGRAM, candidate).sum())

    def spare(candidate: np.ndarray) -> np.ndarray:
        trial = segment_lengths(PENTAGRAM, candidate)
        return crossing_gaps(PENTAGRAM, trial, PENTAGRAM_CROSSINGS) - 0.2

    best = minimize(
        cable,
        sags + 0.3,
        bounds=[(0.5, 5.0)] * 4,
        constraints={"type": "ineq", "fun": spare},
        method="SLSQP",
    )
    assert cable(sags) <= best.fun + 1e-4


def test_two_sags_are_not_enough_for_several_levels() -> None:
    with pytest.raises(
        Refused, match="two sags are not enough for segments that pass over and under: 0, 3"
    ):
        minimum_sags(PENTAGRAM, PENTAGRAM_CROSSINGS, 0.2, minimum_sag=0.5)


def test_a_circle_of_strands_is_refused_with_its_members() -> None:
    corners = np.array([[0, 0], [6, 0.5], [5, -1], [2, 5], [3.5, 4.5], [0.5, -1], [0.5, -3]])
    corners = np.column_stack([corners, np.full(7, 9.0)])
    assert plan_crossings(corners).segments.tolist() == [[0, 2], [0, 4], [2, 4]]
    minimum_sags(corners, [(0, 2), (0, 4), (2, 4)], 0.2, minimum_sag=0.5, one_each=True)
    with pytest.raises(Refused, match="no sags exist: segments 0, 2, 4"):
        minimum_sags(corners, [(0, 2), (4, 0), (2, 4)], 0.2, minimum_sag=0.5, one_each=True)


def test_a_crossing_over_a_corner_is_refused() -> None:
    corners = np.array([[0, 0, 5], [4, 0, 5], [4, 2, 5], [2, 2, 5], [2, 0, 5.0]])
    with pytest.raises(Refused, match="corner of another"):
        minimum_sags(corners, [(0, 3)], 0.2, minimum_sag=0.5, one_each=True)
