"""A motion from a knot to the line: the pentagram's overhand, which no common path ties."""

import numpy as np
import pytest

from swarm.folding.layout import lay_out_corners
from swarm.folding.penalty import KEPT, TeamGeometry, missed_margins
from swarm.folding.waypoints import schedule_of_waypoints
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.distance import gauss_integral
from swarm.mission import mission_for_knot
from swarm.planning.foldings import planning_margins
from swarm.untangling.free_space import free_space
from swarm.untangling.loosening import between, loosened
from swarm.untangling.moved_vehicle import Group, missed_by, team_state, update
from swarm.untangling.search import SPACING, shortened, untangle

PENTAGRAM = np.array([[4.0, 0.0], [-3.24, -2.35], [1.24, 3.8], [1.24, -3.8], [-3.24, 2.35]])
SAGS = [3.28, 1.29, 4.26, 2.29]


def overhand() -> tuple[TeamGeometry, np.ndarray]:
    layout = lay_out_corners(PENTAGRAM, SAGS)
    return TeamGeometry(layout.lengths, planning_margins(mission_for_knot("overhand"))), (
        layout.corners
    )


def test_the_gauss_integral_of_two_linked_rings_is_one() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 61)
    ring = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    other = np.stack([1.0 + np.cos(angle), 0.0 * angle, np.sin(angle)], axis=1)
    assert abs(gauss_integral(ring, other)) == pytest.approx(1.0, abs=1e-9)
    assert gauss_integral(ring, other + np.array([5.0, 0.0, 0.0])) == pytest.approx(0.0, abs=1e-9)
    mirrored = gauss_integral(ring * [1, 1, -1], other * [1, 1, -1])
    assert mirrored == pytest.approx(-gauss_integral(ring, other))


def test_an_overhand_is_untangled_to_a_level_line_without_missed_margins() -> None:
    team, knot = overhand()
    found = untangle(team, knot, np.random.default_rng(0))
    assert found is not None
    waypoints = shortened(team, found)
    assert np.allclose(waypoints[0], knot)
    assert len(waypoints) <= len(found)
    assert missed_margins(team, waypoints).max() <= KEPT
    assert np.linalg.norm(np.diff(waypoints, axis=0), axis=2).max() <= SPACING + 1e-9
    steps = np.diff(waypoints[-1], axis=0)
    assert np.ptp(waypoints[-1][:, 2]) < 1e-9
    assert np.abs(np.cross(steps, steps[0])).max() < 1e-9
    # An oracle without the planner's margins: exact catenaries, a hundred points on each.
    for positions in waypoints:
        strands = solve_catenaries(positions[:-1], positions[1:], team.lengths)
        points = strands.points(np.linspace(0.0, 1.0, 100))
        for one, other in ((0, 2), (0, 3), (1, 3)):
            apart = points[one][:, None] - points[other][None]
            assert np.sqrt((apart**2).sum(axis=2).min()) > 0.3


def test_waypoints_become_a_motion_between_rests_that_ends_at_the_corners() -> None:
    team, knot = overhand()
    away = knot + np.array([0.0, 0.0, 3.0])
    layout = lay_out_corners(PENTAGRAM, SAGS)
    waypoints = np.concatenate([away[None], between(away, knot)])
    schedule = schedule_of_waypoints(layout, waypoints, team.margins)
    ends, slopes, bends = schedule.at(np.array([0.0, schedule.last_stage]))
    assert np.allclose(ends, [away, knot], atol=1e-9)
    assert np.allclose(slopes, 0.0, atol=1e-4)
    assert np.allclose(bends, 0.0, atol=1e-4)
    assert schedule.worst < 0.25


def test_a_team_that_misses_its_margins_has_no_free_space() -> None:
    team, knot = overhand()
    assert free_space(team, 0.2 * knot, Group(0, 1), 0.5) is None
    assert untangle(team, 0.2 * knot, np.random.default_rng(0)) is None


@pytest.mark.parametrize("group", [Group(4, 5), Group(0, 2), Group(1, 4)])
def test_free_places_are_connected_with_the_vehicles_and_keep_the_margins(group: Group) -> None:
    team, knot = overhand()
    space = free_space(team, knot, group, 0.6)
    assert space is not None
    assert np.allclose(space.offsets[0], 0.0)
    assert missed_margins(team, space.teams(np.arange(len(space.offsets)))).max() <= KEPT
    farthest = int(space.steps.argmax())
    way = space.way(farthest)
    assert np.allclose(way[0], knot)
    assert len(way) == space.steps[farthest] + 1
    moved = np.linalg.norm(np.diff(way, axis=0), axis=2)
    assert np.allclose(moved[:, group.first : group.last], 0.6)
    assert np.delete(moved, slice(*group), axis=1).max(initial=0.0) == 0.0


@pytest.mark.parametrize("group", [Group(0, 1), Group(2, 3), Group(3, 5), Group(1, 4)])
def test_what_moved_vehicles_miss_is_how_the_missed_margins_of_the_team_change(
    group: Group,
) -> None:
    team, knot = overhand()
    rng = np.random.default_rng(1)
    teams = np.repeat(knot[None], 50, axis=0)
    teams[1:, slice(*group)] += rng.normal(scale=1.5, size=(49, 1, 3))
    own = []
    for positions in teams:
        state = team_state(positions, team.lengths)
        update(state, 0, len(team.lengths), team.model)
        own.append(missed_by(state, group, np.inf, team.model))
    everything = missed_margins(team, teams)
    assert everything.max() > 1.0
    assert np.allclose(np.array(own) - own[0], everything - everything[0], rtol=1e-9, atol=1e-9)


def test_loosening_moves_the_team_apart_and_keeps_the_margins() -> None:
    team, knot = overhand()
    way = loosened(team, knot)
    assert len(way)
    assert missed_margins(team, way).max() <= KEPT
    assert np.linalg.norm(np.diff(way, axis=0, prepend=knot[None]), axis=2).max() <= 0.25 + 1e-9

    def nearest(positions: np.ndarray) -> float:
        strands = solve_catenaries(positions[:-1], positions[1:], team.lengths)
        points = strands.points(np.linspace(0.0, 1.0, 100))
        return min(
            float(((points[one][:, None] - points[other][None]) ** 2).sum(axis=2).min())
            for one, other in ((0, 2), (0, 3), (1, 3))
        )

    assert nearest(way[-1]) > nearest(knot)
