"""The separation that a plan prepares for the failure of a vehicle in the air."""

import json

import numpy as np
import pytest

from swarm.flight.separation import AWAY, MOST_SPREAD, UP, separation_motion, separations
from tests.network import sideways, small_plan

PLAN = small_plan(vehicles=4).plan
MISSION = PLAN.mission


def horizontal_distances(positions):
    first, second = np.triu_indices(positions.shape[-2], 1)
    step = positions[..., first, :2] - positions[..., second, :2]
    return np.linalg.norm(step, axis=-1)


def test_no_distance_decreases_during_a_separation():
    rng = np.random.default_rng(4)
    for _ in range(20):
        start = rng.uniform([-4.0, -4.0, 4.0], [4.0, 4.0, 12.0], (6, 3))
        motion = separation_motion(start, start[2], 1.5, 2.5, MISSION, np.ones(6, bool))
        times = np.linspace(motion.times[0], motion.times[-1], 40)
        distances = horizontal_distances(motion.at(times)[0])
        assert (np.diff(distances, axis=0) >= -1e-6).all()
        assert np.allclose(motion.at(times[-1])[0][:, 2], start[:, 2] + UP)
        assert np.allclose(motion.at(times[0])[0], start)


def test_all_move_away_from_a_failed_vehicle_first_and_as_fast_as_they_can():
    start = np.array([[0.0, 0, 5], [0.5, 0, 4], [0, 8, 6], [-3, -4, 5]])
    motion = separation_motion(start, start[0], AWAY, 2.0, MISSION, np.arange(4) > 0)
    distances = np.linalg.norm(motion.at(motion.times)[0][..., :2] - start[0, :2], axis=2)
    aside = [0.0, 0.5 + AWAY, 8.0 + AWAY, 5.0 + AWAY]
    (k,) = np.flatnonzero(np.isclose(distances, aside).all(axis=1))
    vehicles = MISSION.vehicles
    thrust = vehicles.max_acceleration - vehicles.braking_acceleration
    assert motion.times[k] <= np.sqrt(5.8 * AWAY / thrust) * 1.01
    assert distances[-1] == pytest.approx([0.0, 1.0 + AWAY, 16.0 + AWAY, 10.0 + AWAY])


@pytest.mark.parametrize("away", [0.0, AWAY])
@pytest.mark.parametrize("room", [1.6, 0.3])
@pytest.mark.parametrize(("spread", "pillars"), [(3.0, []), (1.0, [[-2, 3]])])
def test_a_separation_stays_inside_the_fence(spread, pillars, room, away):
    """A vehicle that is nearer than planned comes no nearer; over a pillar, a wider one is tried."""
    start = np.array([[0.0, 0, 5], [3, 0, 5], [-2, 3, 5], [-2, room - 4.0, 5]])
    pillar = {"name": "pillar", "shape": "cylinder", "radius": 0.5, "top": 1.0}
    obstacles = json.dumps([pillar | {"centre": centre} for centre in pillars])
    free = f"workspace.obstacles={obstacles}"
    fenced = "workspace.fence=[[-4, -4], [4, -4], [4, 4], [-4, 4]]"
    reached = []
    for settings in ((free,), (free, fenced)):
        mission = sideways(*settings).mission
        motion = separation_motion(start, start[0], away, spread, mission, np.arange(4) > 0)
        end = motion.at(motion.times[-1])[0]
        assert end[:, 2] == pytest.approx([5.0, 5.0 + UP, 5.0 + UP, 5.0 + UP])
        reached.append(np.abs(end[:, :2]).max(axis=1))
    assert reached[0].max() > 4.0
    needed = mission.vehicles.radius + mission.vehicles.tracking
    assert (4.0 - reached[1] >= np.minimum(needed, [4.0, 1.0, 1.0, room]) - 1e-9).all()


def test_a_spread_is_computed_for_every_moment_and_vehicle():
    found = separations(PLAN)
    fold = PLAN.phase("fold")
    assert found.times[0] <= fold.start
    assert found.times[-1] >= fold.end
    assert found.spread.shape == (len(found.times), PLAN.vehicles)
    assert ((found.spread >= 1.0) & (found.spread <= MOST_SPREAD)).all()
    assert not found.below.any(), "a level line has no vehicle below another"


def test_vehicles_below_a_fall_are_reported():
    motion = PLAN.motion.coefficients.copy()
    motion[:, 0, 1] = motion[:, 0, 2] - [0.0, 0.0, 3.0]
    stacked = type(PLAN)(**{**vars(PLAN), "motion": type(PLAN.motion)(PLAN.motion.times, motion)})
    found = separations(stacked)
    assert found.below[:, 2].any()
    assert not found.below[:, 1].any()
