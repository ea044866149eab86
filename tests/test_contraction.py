"""The contraction on the floor: beyond the line and back, so that both sides have slack."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarm.mission import mission_for_knot
from swarm.planning.contraction import contraction

MISSION = mission_for_knot("overhand")
LINE = 0.79
"""Distance of neighbours on the line over the cable between them, as of a fold's first formation."""


def on_a_line(gaps: np.ndarray) -> np.ndarray:
    """Return places (n, 3) on the x axis with these gaps, the middle of all at 0."""
    x = np.concatenate([[0.0], np.cumsum(gaps)])
    return np.column_stack([x - 0.5 * x[-1], 0.0 * x, 0.0 * x + 0.1])


def contracted(lengths: np.ndarray) -> tuple:
    laid, line = on_a_line(0.99 * lengths), on_a_line(LINE * lengths)
    return contraction(MISSION, lengths, laid, line, relaxed=True)


def test_vehicles_go_beyond_the_line_by_a_share_of_the_largest_slack_and_back() -> None:
    lengths = np.array([10.0, 12.0, 10.0, 10.0])
    forth, back, rest = contracted(lengths)
    line = on_a_line(LINE * lengths)
    farthest = forth.at(forth.times[-1:])[0][0]
    inwards = np.sign(line[:, 0] - on_a_line(0.99 * lengths)[:, 0])
    assert (farthest - line)[[0, 1, 3, 4], 0] == pytest.approx(
        0.4 * (1.0 - LINE) * 12.0 * inwards[[0, 1, 3, 4]]
    )
    assert np.allclose(back.at(back.times[-1:])[0][0], line)
    assert np.allclose(rest.at(rest.times[[0, -1]])[0], line)
    assert rest.times[-1] == 3.0


@given(st.lists(st.floats(1.5, 20.0), min_size=2, max_size=12))
def test_no_slack_on_the_floor_reaches_a_neighbour(lengths: list[float]) -> None:
    """Half of a segment's slack lies beyond its grip; on the line it may do so already."""
    cable = np.array(lengths)
    forth = contracted(cable)[0]
    farthest, line = forth.at(forth.times[-1:])[0][0], on_a_line(LINE * cable)
    distance = np.diff(farthest[:, 0])
    if not np.allclose(farthest, line):
        beyond = 0.5 * (cable - distance)
        assert (distance >= MISSION.clearance.vehicle).all()
        assert (distance[1:] >= beyond[:-1] + MISSION.clearance.vehicle_cable).all()
        assert (distance[:-1] >= beyond[1:] + MISSION.clearance.vehicle_cable).all()
        assert (distance[1:-1] >= beyond[:-2] + beyond[2:] + MISSION.clearance.cable).all()


def test_without_room_vehicles_stop_on_the_line() -> None:
    lengths = np.array([18.0, 2.0, 18.0])
    forth = contracted(lengths)[0]
    assert np.allclose(forth.at(forth.times[-1:])[0][0], on_a_line(LINE * lengths))
