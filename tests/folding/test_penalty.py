"""Missed margins of a team, and their derivatives."""

import os

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from swarm.folding.crossing_constraints import CrossingSigns, crossing_signs, segment_pairs
from swarm.folding.margins import Margins, Penalty
from swarm.folding.neighbour_clearance import empty_margin_cache
from swarm.folding.outlines import outline_strands
from swarm.folding.penalty import ExtraMargins, TeamGeometry
from swarm.geometry.catenary import solve_catenaries

Floats = npt.NDArray[np.float64]

EXACT = Margins(0.2, 1.0, 1.5, 0.3, tracking=0.0, radius=0.25, grip_offset=0.6, exempt=0.8)
ERRING = Margins(0.2, 1.0, 1.5, 0.3, tracking=0.1, radius=0.25, grip_offset=0.6, exempt=1.2)


def free_signs(moments: int, segments: int) -> CrossingSigns:
    strands = np.zeros((moments, len(segment_pairs(segments)[0])), dtype=np.int8)
    return CrossingSigns(strands, np.zeros((moments, segments + 1, segments), dtype=np.int8))


def missed(team: TeamGeometry, positions: Floats) -> Floats:
    return team.penalty(positions, free_signs(len(positions), len(team.lengths))).missed


def line(*points: tuple[float, float, float]) -> Floats:
    return np.array([points], dtype=np.float64)


def test_neighbours_may_touch_within_the_exempt_length_only() -> None:
    team = TeamGeometry(np.array([4.5, 4.5]), EXACT)
    straight = line((-4.0, 0.0, 0.0), (0.0, 0.0, 0.0), (4.0, 0.0, 0.0))
    folded = line((-4.0, 0.0, 0.0), (0.0, 0.0, 0.0), (-4.0, 1.2, 0.0))
    raised = line((-4.0, 0.0, 0.0), (0.0, 0.0, 0.0), (-2.5, 1.5, 3.0))
    assert missed(team, straight)[0] == 0.0
    assert missed(team, folded)[0] > 0.05
    assert missed(team, raised)[0] == 0.0


@pytest.mark.parametrize(
    ("height", "clear"), [(-1.0, True), (0.3, False), (0.6, False), (0.8, False), (1.4, True)]
)
def test_a_strand_near_the_cone_of_a_vehicle_misses_a_margin(height: float, clear: bool) -> None:
    far = (0.0, 9.0, 0.0)
    held = solve_catenaries(np.array([-3.0, 0.2, height]), np.array([3.0, 0.2, height]), 6.05)
    sag = height - float(held.lowest()[2])
    positions = line((-3.0, 0.2, height), (3.0, 0.2, height), far, (0.0, 0.0, -sag))
    team = TeamGeometry(np.array([6.05, 12.0, 12.0]), EXACT)
    found = team.penalty(positions, free_signs(1, 3))
    assert np.any(found.gradient[0, 3]) is not clear


def test_strands_on_the_wrong_side_have_a_derivative_to_the_right_one() -> None:
    team = TeamGeometry(np.array([4.4, 6.0, 4.4]), EXACT)
    positions = line((-2.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 2.0, -0.7), (0.0, -2.0, -0.7))
    first, second = segment_pairs(3)
    assert (first.tolist(), second.tolist()) == ([0], [2])
    over = crossing_signs(team.outlines(positions), 0)
    assert over.strands.tolist() == [[1]]
    under = CrossingSigns(-over.strands, -over.vehicles)
    right, wrong = team.penalty(positions, over), team.penalty(positions, under)
    lift = np.zeros((4, 3))
    lift[:2, 2] = 1.0
    assert right.missed[0] < 0.1 < wrong.missed[0]
    # The first strand is over the second and should be under it: lowering it helps.
    assert np.sum(wrong.gradient[0] * lift) > 0.5


def test_a_crossing_has_the_sign_of_its_end() -> None:
    team = TeamGeometry(np.array([4.4, 6.0, 4.4]), EXACT)
    begin = line((-2.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 2.0, 1.0), (0.0, -2.0, 1.0))
    end = line((-2.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 2.0, -1.0), (0.0, -2.0, -1.0))
    away = end + np.array([[[0.0, 0, 0], [0, 0, 0], [5.0, 0, 0], [5.0, 0, 0]]])
    positions = np.concatenate([begin, away, begin, end, end])
    assert crossing_signs(team.outlines(positions), 0).strands[:, 0].tolist() == [-1, 0, 1, 1, 1]


def led_under(height: float) -> Floats:
    """A strand at rest, and another led across under it by vehicles at a height: (41, 4, 3)."""
    positions = np.zeros((41, 4, 3))
    positions[:, 0, 0], positions[:, 1, 0] = -2.0, 2.0
    positions[:, 2, 1], positions[:, 3, 1] = 0.5, -3.0
    positions[:, 2:, 0] = np.linspace(-0.3, 0.3, 41)[:, None]
    positions[:, 2:, 1] += np.linspace(6.0, -3.0, 41)[:, None]
    positions[:, 2:, 2] = height
    return positions


def test_a_vehicle_passes_a_strand_on_the_side_of_its_own_strand() -> None:
    team = TeamGeometry(np.array([4.4, 9.0, 4.4]), EXACT)
    positions = led_under(-2.5)
    signs = crossing_signs(team.outlines(positions), 2)
    leader, follower = signs.vehicles[:, 3, 0], signs.vehicles[:, 2, 0]
    assert set(leader.tolist()) == set(follower.tolist()) == {0, -1}
    assert np.argmax(leader != 0) < np.argmax(follower != 0)
    # At a greater height it passes over the strand under which its own strand must pass.
    raised = team.penalty(led_under(0.5), signs)
    passing = int(np.flatnonzero(leader)[3])
    push = raised.gradient[passing, 3]
    assert push[2] > 0.5
    assert not np.any(team.penalty(positions, signs).gradient[passing, 3])


def test_signs_hold_somewhat_longer_than_strands_cross() -> None:
    team = TeamGeometry(np.array([4.4, 9.0, 4.4]), EXACT)
    strands = team.outlines(led_under(-2.5))
    exact, longer = (np.flatnonzero(crossing_signs(strands, n).strands[:, 0]) for n in (0, 3))
    assert longer.tolist() == list(range(exact[0] - 3, exact[-1] + 4))


def test_extra_margins_apply_to_their_moments_only() -> None:
    team = TeamGeometry(np.array([4.5, 4.5, 4.5]), EXACT)
    points = ((-4.0, 0.0, 0.0), (0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (4.0, 4.0, 0.0))
    positions = np.repeat(line(*points), 2, axis=0)
    for wanted in ("cable", "vehicle", "vehicle_cable", "chord"):
        extra = {name: np.zeros(2) for name in FIELDS} | {wanted: np.array([0.0, 4.5])}
        free, kept = team.penalty(positions, free_signs(2, 3), ExtraMargins(**extra)).missed
        assert free == 0.0 < kept


FIELDS = ("cable", "neighbour", "vehicle", "vehicle_cable", "rotor_disc", "chord", "jet")


@pytest.mark.parametrize("margins", [EXACT, ERRING])
def test_gradients_are_derivatives_of_missed_margins(margins: Margins) -> None:
    rng = np.random.default_rng(7)
    team = TeamGeometry(np.array([3.0, 4.0, 3.5, 5.0, 4.0]), margins)
    steps = rng.normal(0.0, 1.0, (400, 6, 3)) * np.array([2.0, 2.0, 0.7])
    positions = np.cumsum(steps, axis=1)
    chord = np.linalg.norm(np.diff(positions, axis=1), axis=2)
    positions = positions[np.all(chord < 0.93 * team.lengths, axis=1)]
    signs = crossing_signs(team.outlines(positions), 0)
    extra = ExtraMargins(*rng.uniform(0.0, 0.2, (len(FIELDS), len(positions))))
    penalty = team.penalty(positions, signs, extra)
    slope = 2.0 * penalty.gradient
    measured = np.zeros(positions.shape)
    for vehicle, axis in np.ndindex(6, 3):
        step = np.zeros((6, 3))
        step[vehicle, axis] = 1e-4
        above, below = (team.penalty(positions + s * step, signs, extra) for s in (1.0, -1.0))
        change = above.missed - below.missed
        measured[:, vehicle, axis] = change / 2e-4
    missing = np.flatnonzero(penalty.missed > 0.05)
    assert len(missing) > 20
    # The derivative omits that the closest points and the cable's response change.
    cosine = [
        np.sum(slope[k] * measured[k]) / (np.linalg.norm(slope[k]) * np.linalg.norm(measured[k]))
        for k in missing
    ]
    assert np.median(cosine) > 0.97
    assert np.mean(np.array(cosine) > 0.7) > 0.9


def test_over_stretched_strands_pull_their_ends_together() -> None:
    team = TeamGeometry(np.array([4.0]), EXACT)
    positions = line((0.0, 0.0, 0.0), (3.98, 0.0, 0.0))
    penalty = team.penalty(positions, free_signs(1, 1))
    assert outline_strands(positions[:, 0], positions[:, 1], 4.0).ratio[0] > 0.985
    push = penalty.gradient[0]
    assert push[1, 0] > 0.0 > push[0, 0]


def test_positions_in_the_jets_of_others_have_a_cost() -> None:
    team = TeamGeometry(np.array([9.0]), EXACT)
    below = line((0.0, 0.0, 0.0), (0.3, 0.0, 4.0))
    beside = line((0.0, 0.0, 0.0), (2.0, 0.0, 4.0))
    signs = free_signs(1, 1)
    blown = team.penalty(below, signs)
    assert blown.missed[0] > team.penalty(below, signs, preferences=False).missed[0] + 0.05
    assert blown.gradient[0, 1, 0] < 0.0 < blown.gradient[0, 0, 0]
    assert team.penalty(beside, signs).missed[0] == 0.0


def in_a_jet(below: float, level: float, wider: float, *, preferences: bool = True) -> Penalty:
    """Of two vehicles, one ``below`` the other and ``level`` from the axis of its jet."""
    team = TeamGeometry(np.array([30.0]), EXACT)
    extra = {name: np.zeros(1) for name in FIELDS} | {"jet": np.array([wider])}
    place = line((0.0, 0.0, below), (level, 0.0, 0.0))
    return team.penalty(place, free_signs(1, 1), ExtraMargins(**extra), preferences=preferences)


def edge_of_jet(below: float) -> float:
    """2.2 half-widths, 0.7 of the radius and a tenth of the distance below."""
    return 2.2 * (0.7 * EXACT.radius + 0.1 * below)


@given(below=st.floats(1.8, 12.0), wider=st.floats(0.01, 0.4), share=st.floats(0.02, 0.98))
def test_a_repaired_jet_is_avoided_as_far_as_it_is_wider(
    below: float, wider: float, share: float
) -> None:
    level = edge_of_jet(below) + share * wider
    assert in_a_jet(below, level, 0.0).missed[0] == 0.0
    repaired = in_a_jet(below, level, wider)
    assert repaired.missed[0] > 0.0
    assert repaired.gradient[0, 1, 0] < 0.0


@given(below=st.floats(1.8, 12.0), wider=st.floats(0.05, 2.0), share=st.floats(0.05, 0.95))
@example(below=10.546875, wider=1.0, share=0.05)
def test_a_repaired_jet_pushes_more_wherever_a_vehicle_is_in_it(
    below: float, wider: float, share: float
) -> None:
    level = share * edge_of_jet(below)
    # Without the push of a cable that hangs nearly straight down beside the lower vehicle.
    others = float(in_a_jet(below, level, 0.0, preferences=False).gradient[0, 0, 0])
    pushes = [
        float(in_a_jet(below, level, metres).gradient[0, 0, 0]) - others
        for metres in (0.0, 0.5 * wider, wider)
    ]
    assert 0.0 < pushes[0] < pushes[1] < pushes[2]


@pytest.mark.parametrize("seed", range(8))
def test_cached_pairs_miss_no_margin(seed: int) -> None:
    """Teams that move in small steps miss the same margins with and without a cache."""
    rng = np.random.default_rng(seed)
    vehicles, moments = 7, 12
    team = TeamGeometry(rng.uniform(2.5, 6.0, vehicles - 1), ERRING)
    heading = np.cumsum(rng.uniform(-1.6, 1.6, (moments, vehicles)), axis=1)
    step = np.stack([np.cos(heading), np.sin(heading), rng.uniform(-0.3, 0.3, heading.shape)], -1)
    positions = np.cumsum(step * np.append(team.lengths, 1.0)[:, None] * 0.7, axis=1)
    signs, cache = free_signs(moments, vehicles - 1), empty_margin_cache(moments, vehicles - 1)
    skipped = 0
    for _ in range(60):
        positions = positions + rng.normal(scale=0.01, size=positions.shape)
        before = cache.positions.copy()
        cached, plain = team.penalty(positions, signs, cache=cache), team.penalty(positions, signs)
        skipped += int((cache.positions == before).all(axis=(2, 3)).sum())
        np.testing.assert_allclose(cached.missed, plain.missed, atol=1e-9)
        np.testing.assert_allclose(cached.gradient, plain.gradient, atol=1e-9)
    assert skipped > 0.1 * 60 * cache.spare.size


def test_moments_that_are_computed_side_by_side_have_the_penalties_of_each_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2}, raising=False)
    rng = np.random.default_rng(5)
    team = TeamGeometry(np.array([4.4, 6.0, 4.4]), ERRING)
    positions = rng.uniform(-3.0, 3.0, (230, 4, 3))
    extra = ExtraMargins(*rng.uniform(0.0, 0.2, (7, 230)))
    signs, cache = free_signs(230, 3), empty_margin_cache(230, 3)
    together = team.penalty(positions, signs, extra, cache=cache)
    assert (together.missed > 0.0).sum() > 100
    for k in range(len(positions)):
        one, alone = slice(k, k + 1), empty_margin_cache(1, 3)
        found = team.penalty(positions[one], signs[one], extra[one], cache=alone)
        np.testing.assert_array_equal(found.missed, together.missed[one])
        np.testing.assert_array_equal(found.gradient, together.gradient[one])
        np.testing.assert_array_equal(alone.spare, cache.spare[one])
