"""Basin hopping of teams whose strands are led through each other."""

import numpy as np
import pytest
from scipy.sparse import csr_array, eye_array

from swarm.folding.hopping import basin_hopping
from swarm.folding.optimizer import relax
from swarm.knots.catalog import choose_knot
from swarm.knots.grid import openings
from swarm.mission import mission_for_knot
from swarm.planning.foldings import (
    distinct_openings,
    fold_diagram,
    layout_sizes,
    planning_margins,
    rank_openings,
)
from tests.folding.test_optimizer import band, led_over


@pytest.mark.slow
@pytest.mark.parametrize(("knot", "rank"), [("8_20", 0), ("6_3", 2)])
def test_openings_with_a_local_minimum_fold(knot: str, rank: int) -> None:
    """Without a hop these miss 0.75 and 1.3 units of their margins."""
    mission = mission_for_knot(knot, ())
    margins = planning_margins(mission)
    shape = next(layout_sizes(mission, margins))
    best = rank_openings(
        distinct_openings(openings(choose_knot(name=knot, chirality="either").grid)),
        shape,
        margins,
        None,
    )
    opened = [diagram for diagram, _ in zip(best, range(rank + 1), strict=False)]
    folding = fold_diagram(opened[rank], shape, margins)
    assert folding.schedule.worst < 0.45
    assert np.all(folding.schedule.offsets[[0, 1, -2, -1]] == 0.0)


def test_a_team_without_a_local_minimum_does_not_move() -> None:
    team = band(led_over(1.5), csr_array(eye_array(81)))
    offsets = relax(team, np.zeros((81, 4, 3))).offsets
    assert np.all(basin_hopping(team, offsets) == offsets)
