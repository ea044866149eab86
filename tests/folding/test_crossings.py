"""Which of two strands must be over, as crossings move along the cable."""

import numpy as np
import numpy.typing as npt
import pytest

from swarm.folding.crossing_constraints import crossing_signs, segment_pairs
from swarm.folding.crossings import find_crossings, required_signs
from swarm.folding.margins import Margins
from swarm.folding.penalty import TeamGeometry

Floats = npt.NDArray[np.float64]

MARGINS = Margins(0.2, 1.0, 1.5, 0.3, tracking=0.0, radius=0.25, grip_offset=0.6, exempt=0.8)
CREW = TeamGeometry(np.array([4.4, 9.0, 4.4, 4.4]), MARGINS)


def drawn_through(height: Floats | float) -> Floats:
    """A held strand along x, and two joined ones drawn across it along y, places (121, 5, 3).

    Vehicles 4 and 3 move across the strand, one after another, 2 (the third) does not; ``height``
    is that of the drawn vehicles.
    """
    along = np.linspace(-1.0, 5.4, 121)
    places = np.zeros((121, 5, 3))
    places[:, 0, 0], places[:, 1, 0] = -2.0, 2.0
    for k, behind in ((4, 0.0), (3, 4.0), (2, 8.0)):
        places[:, k, 1] = along - behind
        places[:, k, 2] = height
    return places


def sides_by_pair(places: Floats) -> dict[tuple[int, int], list[int]]:
    found = find_crossings(CREW.hung(places), *segment_pairs(4))
    sides: dict[tuple[int, int], list[int]] = {}
    for each, side in zip(found, required_signs(found, 4), strict=True):
        sides.setdefault((each.first, each.second), []).append(side)
    return sides


@pytest.mark.parametrize(("height", "side"), [(2.5, -1), (-2.5, 1)])
def test_a_crossing_that_moves_past_a_vehicle_keeps_its_side(height: float, side: int) -> None:
    places = drawn_through(height)
    found = find_crossings(CREW.hung(places), *segment_pairs(4))
    assert [(each.first, each.second, each.lasts) for each in found] == [
        (0, 2, True),
        (0, 3, False),
    ]
    leader, joint = found[1].passings
    assert (leader.vehicle, leader.strand, joint.vehicle, joint.strand) == (4, 0, 3, 0)
    assert np.sign(leader.over) == np.sign(joint.over) == -side
    assert sides_by_pair(places) == {(0, 2): [side], (0, 3): [side]}


def test_the_side_of_the_end_counts_for_the_whole_thread() -> None:
    # The leader passes over the strand, but at last what it leads is under it.
    height = np.where(np.arange(121) < 90, 2.5, -2.5)
    places = drawn_through(height)
    assert sides_by_pair(places) == {(0, 2): [1], (0, 3): [1]}
    bodies = crossing_signs(CREW.hung(places), 4).bodies
    assert set(bodies[:, 4, 0].tolist()) == set(bodies[:, 3, 0].tolist()) == {0, -1}


def test_crossings_that_come_and_go_together_have_one_side() -> None:
    """A joint is drawn across the strand and back: by its vehicle, not by where loops hang."""
    aside = 1.2 * np.sin(np.linspace(0.0, np.pi, 121)) - 0.6
    for height, side in ((2.5, -1), (-2.5, 1)):
        places = np.zeros((121, 5, 3))
        places[:, 0, 0], places[:, 1, 0] = -2.0, 2.0
        places[:, 2] = [1.0, -3.0, height]
        places[:, 3] = [0.0, 0.0, height]
        places[:, 3, 1] = aside
        places[:, 4] = [-1.0, -3.0, height]
        assert sides_by_pair(places) == {(0, 2): [side], (0, 3): [side]}
