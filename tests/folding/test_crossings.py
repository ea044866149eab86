"""Signs of crossings that move along the cable."""

import numpy as np
import numpy.typing as npt
import pytest

from swarm.folding.crossing_constraints import crossing_signs, segment_pairs
from swarm.folding.crossings import find_crossings, required_signs
from swarm.folding.margins import Margins
from swarm.folding.penalty import TeamGeometry

Floats = npt.NDArray[np.float64]

MARGINS = Margins(0.2, 1.0, 1.5, 0.3, tracking=0.0, radius=0.25, grip_offset=0.6, exempt=0.8)
TEAM = TeamGeometry(np.array([4.4, 9.0, 4.4, 4.4]), MARGINS)


def led_across(height: Floats | float) -> Floats:
    """A strand at rest along x, and two joined strands led across it along y, positions (121, 5, 3).

    Vehicles 4 and 3 move across the strand, one after another, 2 (the third) does not; ``height``
    is the height of the moving vehicles.
    """
    along = np.linspace(-1.0, 5.4, 121)
    positions = np.zeros((121, 5, 3))
    positions[:, 0, 0], positions[:, 1, 0] = -2.0, 2.0
    for k, behind in ((4, 0.0), (3, 4.0), (2, 8.0)):
        positions[:, k, 1] = along - behind
        positions[:, k, 2] = height
    return positions


def signs_by_pair(positions: Floats) -> dict[tuple[int, int], list[int]]:
    found = find_crossings(TEAM.outlines(positions), *segment_pairs(4))
    signs: dict[tuple[int, int], list[int]] = {}
    for crossing, sign in zip(found, required_signs(found, 4), strict=True):
        signs.setdefault((crossing.first, crossing.second), []).append(sign)
    return signs


@pytest.mark.parametrize(("height", "sign"), [(2.5, -1), (-2.5, 1)])
def test_a_crossing_that_moves_past_a_vehicle_keeps_its_sign(height: float, sign: int) -> None:
    positions = led_across(height)
    found = find_crossings(TEAM.outlines(positions), *segment_pairs(4))
    assert [(crossing.first, crossing.second, crossing.lasts) for crossing in found] == [
        (0, 2, True),
        (0, 3, False),
    ]
    leader, joint = found[1].passings
    assert (leader.vehicle, leader.strand, joint.vehicle, joint.strand) == (4, 0, 3, 0)
    assert np.sign(leader.height) == np.sign(joint.height) == -sign
    assert signs_by_pair(positions) == {(0, 2): [sign], (0, 3): [sign]}


def test_a_thread_has_the_sign_of_its_end() -> None:
    # The leader passes over the strand, but at the end its strand is under it.
    height = np.where(np.arange(121) < 90, 2.5, -2.5)
    positions = led_across(height)
    assert signs_by_pair(positions) == {(0, 2): [1], (0, 3): [1]}
    vehicles = crossing_signs(TEAM.outlines(positions), 4).vehicles
    assert set(vehicles[:, 4, 0].tolist()) == set(vehicles[:, 3, 0].tolist()) == {0, -1}


def test_crossings_that_begin_and_end_together_have_one_sign() -> None:
    """A joint is led across the strand and back: the vehicle counts, not the loops beside it."""
    aside = 1.2 * np.sin(np.linspace(0.0, np.pi, 121)) - 0.6
    for height, sign in ((2.5, -1), (-2.5, 1)):
        positions = np.zeros((121, 5, 3))
        positions[:, 0, 0], positions[:, 1, 0] = -2.0, 2.0
        positions[:, 2] = [1.0, -3.0, height]
        positions[:, 3] = [0.0, 0.0, height]
        positions[:, 3, 1] = aside
        positions[:, 4] = [-1.0, -3.0, height]
        assert signs_by_pair(positions) == {(0, 2): [sign], (0, 3): [sign]}
