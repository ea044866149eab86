"""What a team misses of its margins, and the derivatives by which it is mended."""

import numpy as np
import numpy.typing as npt
import pytest

from swarm.folding.crossing_constraints import CrossingSigns, crossing_signs, segment_pairs
from swarm.folding.margins import Margins
from swarm.folding.penalty import ExtraMargins, TeamGeometry
from swarm.folding.soft_constraints import outline_strands
from swarm.folding.strand_clearance import empty_margin_cache
from swarm.geometry.catenary import solve_catenaries

Floats = npt.NDArray[np.float64]

EXACT = Margins(0.2, 1.0, 1.5, 0.3, tracking=0.0, radius=0.25, grip_offset=0.6, exempt=0.8)
ERRING = Margins(0.2, 1.0, 1.5, 0.3, tracking=0.1, radius=0.25, grip_offset=0.6, exempt=1.2)


def unsided(moments: int, segments: int) -> CrossingSigns:
    strands = np.zeros((moments, len(segment_pairs(segments)[0])), dtype=np.int8)
    return CrossingSigns(strands, np.zeros((moments, segments + 1, segments), dtype=np.int8))


def missed(crew: TeamGeometry, places: Floats) -> Floats:
    return crew.strain(places, unsided(len(places), len(crew.lengths))).missed


def line(*points: tuple[float, float, float]) -> Floats:
    return np.array([points], dtype=np.float64)


def test_neighbours_may_meet_in_the_hand_but_not_fold_together() -> None:
    crew = TeamGeometry(np.array([4.5, 4.5]), EXACT)
    straight = line((-4.0, 0.0, 0.0), (0.0, 0.0, 0.0), (4.0, 0.0, 0.0))
    folded = line((-4.0, 0.0, 0.0), (0.0, 0.0, 0.0), (-4.0, 1.2, 0.0))
    raised = line((-4.0, 0.0, 0.0), (0.0, 0.0, 0.0), (-2.5, 1.5, 3.0))
    assert missed(crew, straight)[0] == 0.0
    assert missed(crew, folded)[0] > 0.05
    assert missed(crew, raised)[0] == 0.0


@pytest.mark.parametrize(
    ("height", "clear"), [(-1.0, True), (0.3, False), (0.6, False), (0.8, False), (1.4, True)]
)
def test_a_strand_keeps_off_the_cone_of_a_vehicle(height: float, clear: bool) -> None:
    far = (0.0, 9.0, 0.0)
    held = solve_catenaries(np.array([-3.0, 0.2, height]), np.array([3.0, 0.2, height]), 6.05)
    sag = height - float(held.lowest()[2])
    places = line((-3.0, 0.2, height), (3.0, 0.2, height), far, (0.0, 0.0, -sag))
    crew = TeamGeometry(np.array([6.05, 12.0, 12.0]), EXACT)
    found = crew.strain(places, unsided(1, 3))
    assert np.any(found.slopes[0, 3]) is not clear


def test_strands_on_the_wrong_side_are_pushed_through() -> None:
    crew = TeamGeometry(np.array([4.4, 6.0, 4.4]), EXACT)
    places = line((-2.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 2.0, -0.7), (0.0, -2.0, -0.7))
    first, second = segment_pairs(3)
    assert (first.tolist(), second.tolist()) == ([0], [2])
    over = crossing_signs(crew.hung(places), 0)
    assert over.strands.tolist() == [[1]]
    under = CrossingSigns(-over.strands, -over.bodies)
    right, wrong = crew.strain(places, over), crew.strain(places, under)
    lift = np.zeros((4, 3))
    lift[:2, 2] = 1.0
    assert right.missed[0] < 0.1 < wrong.missed[0]
    # The first strand is over the second; the one that should be under is better lowered.
    assert np.sum(wrong.slopes[0] * lift) > 0.5


def test_a_crossing_keeps_the_side_that_it_ends_with() -> None:
    crew = TeamGeometry(np.array([4.4, 6.0, 4.4]), EXACT)
    begin = line((-2.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 2.0, 1.0), (0.0, -2.0, 1.0))
    end = line((-2.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 2.0, -1.0), (0.0, -2.0, -1.0))
    away = end + np.array([[[0.0, 0, 0], [0, 0, 0], [5.0, 0, 0], [5.0, 0, 0]]])
    places = np.concatenate([begin, away, begin, end, end])
    assert crossing_signs(crew.hung(places), 0).strands[:, 0].tolist() == [-1, 0, 1, 1, 1]


def led_under(height: float) -> Floats:
    """A held strand, and another led across under it, its vehicles at a height: (41, 4, 3)."""
    places = np.zeros((41, 4, 3))
    places[:, 0, 0], places[:, 1, 0] = -2.0, 2.0
    places[:, 2, 1], places[:, 3, 1] = 0.5, -3.0
    places[:, 2:, 0] = np.linspace(-0.3, 0.3, 41)[:, None]
    places[:, 2:, 1] += np.linspace(6.0, -3.0, 41)[:, None]
    places[:, 2:, 2] = height
    return places


def test_a_vehicle_passes_a_strand_on_the_side_of_what_it_leads() -> None:
    crew = TeamGeometry(np.array([4.4, 9.0, 4.4]), EXACT)
    places = led_under(-2.5)
    sides = crossing_signs(crew.hung(places), 2)
    leader, follower = sides.bodies[:, 3, 0], sides.bodies[:, 2, 0]
    assert set(leader.tolist()) == set(follower.tolist()) == {0, -1}
    assert np.argmax(leader != 0) < np.argmax(follower != 0)
    # Raised, it would pass over the strand under which it is to lead another.
    raised = crew.strain(led_under(0.5), sides)
    passing = int(np.flatnonzero(leader)[3])
    push = raised.slopes[passing, 3]
    assert push[2] > 0.5
    assert not np.any(crew.strain(places, sides).slopes[passing, 3])


def test_sides_count_a_little_longer_than_strands_cross() -> None:
    crew = TeamGeometry(np.array([4.4, 9.0, 4.4]), EXACT)
    hung = crew.hung(led_under(-2.5))
    exact, longer = (np.flatnonzero(crossing_signs(hung, n).strands[:, 0]) for n in (0, 3))
    assert longer.tolist() == list(range(exact[0] - 3, exact[-1] + 4))


def test_more_is_asked_only_of_the_moments_named() -> None:
    crew = TeamGeometry(np.array([4.5, 4.5, 4.5]), EXACT)
    points = ((-4.0, 0.0, 0.0), (0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (4.0, 4.0, 0.0))
    places = np.repeat(line(*points), 2, axis=0)
    for wanted in ("cable", "vehicle", "vehicle_cable", "chord"):
        asked = {name: np.zeros(2) for name in MORE} | {wanted: np.array([0.0, 4.5])}
        free, kept = crew.strain(places, unsided(2, 3), ExtraMargins(**asked)).missed
        assert free == 0.0 < kept


MORE = ("cable", "neighbour", "vehicle", "vehicle_cable", "rotor_disc", "chord")


@pytest.mark.parametrize("margins", [EXACT, ERRING])
def test_derivatives_are_those_of_what_is_missed(margins: Margins) -> None:
    rng = np.random.default_rng(7)
    crew = TeamGeometry(np.array([3.0, 4.0, 3.5, 5.0, 4.0]), margins)
    steps = rng.normal(0.0, 1.0, (400, 6, 3)) * np.array([2.0, 2.0, 0.7])
    places = np.cumsum(steps, axis=1)
    chord = np.linalg.norm(np.diff(places, axis=1), axis=2)
    places = places[np.all(chord < 0.93 * crew.lengths, axis=1)]
    sides = crossing_signs(crew.hung(places), 0)
    asked = ExtraMargins(*rng.uniform(0.0, 0.2, (len(MORE), len(places))))
    strain = crew.strain(places, sides, asked)
    slope = 2.0 * strain.slopes
    measured = np.zeros(places.shape)
    for vehicle, axis in np.ndindex(6, 3):
        step = np.zeros((6, 3))
        step[vehicle, axis] = 1e-4
        more, less = (crew.strain(places + s * step, sides, asked) for s in (1.0, -1.0))
        change = more.missed - less.missed
        measured[:, vehicle, axis] = change / 2e-4
    troubled = np.flatnonzero(strain.missed > 0.05)
    assert len(troubled) > 20
    # How the closest points and the cable's answer shift along is left out of the derivative.
    cosine = [
        np.sum(slope[k] * measured[k]) / (np.linalg.norm(slope[k]) * np.linalg.norm(measured[k]))
        for k in troubled
    ]
    assert np.median(cosine) > 0.97
    assert np.mean(np.array(cosine) > 0.7) > 0.9


def test_over_stretched_strands_pull_their_ends_together() -> None:
    crew = TeamGeometry(np.array([4.0]), EXACT)
    places = line((0.0, 0.0, 0.0), (3.98, 0.0, 0.0))
    strain = crew.strain(places, unsided(1, 1))
    assert outline_strands(places[:, 0], places[:, 1], 4.0).ratio[0] > 0.985
    pull = strain.slopes[0]
    assert pull[1, 0] > 0.0 > pull[0, 0]


def test_vehicles_wish_to_be_out_of_the_jets_of_others() -> None:
    crew = TeamGeometry(np.array([9.0]), EXACT)
    below = line((0.0, 0.0, 0.0), (0.3, 0.0, 4.0))
    beside = line((0.0, 0.0, 0.0), (2.0, 0.0, 4.0))
    sides = unsided(1, 1)
    blown = crew.strain(below, sides)
    assert blown.missed[0] > crew.strain(below, sides, wishes=False).missed[0] + 0.05
    assert blown.slopes[0, 1, 0] < 0.0 < blown.slopes[0, 0, 0]
    assert crew.strain(beside, sides).missed[0] == 0.0


@pytest.mark.parametrize("seed", range(8))
def test_what_is_calm_misses_nothing(seed: int) -> None:
    """Teams that wander in small steps miss the same, whether or not it is known what was calm."""
    rng = np.random.default_rng(seed)
    vehicles, moments = 7, 12
    crew = TeamGeometry(rng.uniform(2.5, 6.0, vehicles - 1), ERRING)
    heading = np.cumsum(rng.uniform(-1.6, 1.6, (moments, vehicles)), axis=1)
    step = np.stack([np.cos(heading), np.sin(heading), rng.uniform(-0.3, 0.3, heading.shape)], -1)
    places = np.cumsum(step * np.append(crew.lengths, 1.0)[:, None] * 0.7, axis=1)
    sides, calm = unsided(moments, vehicles - 1), empty_margin_cache(moments, vehicles - 1)
    rested = 0
    for _ in range(60):
        places = places + rng.normal(scale=0.01, size=places.shape)
        before = calm.places.copy()
        with_calm, plainly = crew.strain(places, sides, calm=calm), crew.strain(places, sides)
        rested += int((calm.places == before).all(axis=(2, 3)).sum())
        np.testing.assert_allclose(with_calm.missed, plainly.missed, atol=1e-9)
        np.testing.assert_allclose(with_calm.slopes, plainly.slopes, atol=1e-9)
    assert rested > 0.1 * 60 * calm.spare.size
