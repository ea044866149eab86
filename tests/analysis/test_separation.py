"""The way apart that a plan keeps for the moment at which a vehicle falls."""

import numpy as np

from swarm.analysis.separation import MOST_SPREAD, UP, escape, escapes
from tests.network import small_plan

PLAN = small_plan(vehicles=4).plan
MISSION = PLAN.mission


def level_distances(places):
    first, second = np.triu_indices(places.shape[-2], 1)
    apart = places[..., first, :2] - places[..., second, :2]
    return np.linalg.norm(apart, axis=-1)


def test_nobody_comes_nearer_to_anybody_nor_to_the_fall():
    rng = np.random.default_rng(4)
    for _ in range(20):
        start = rng.uniform([-4.0, -4.0, 4.0], [4.0, 4.0, 12.0], (6, 3))
        motion = escape(start, start[2], 2.5, MISSION)
        times = np.linspace(motion.times[0], motion.times[-1], 40)
        apart = level_distances(motion.at(times)[0])
        assert (np.diff(apart, axis=0) >= -1e-6).all()
        assert np.allclose(motion.at(times[-1])[0][:, 2], start[:, 2] + UP)
        assert np.allclose(motion.at(times[0])[0], start)


def test_a_spread_is_known_for_every_moment_and_vehicle():
    known = escapes(PLAN)
    fold = PLAN.phase("fold")
    assert known.times[0] <= fold.start
    assert known.times[-1] >= fold.end
    assert known.spread.shape == (len(known.times), PLAN.vehicles)
    assert ((known.spread >= 1.0) & (known.spread <= MOST_SPREAD)).all()
    assert not known.under.any(), "in a level line nobody is under anybody"


def test_who_is_below_a_fall_is_known():
    motion = PLAN.motion.coefficients.copy()
    motion[:, 0, 1] = motion[:, 0, 2] - [0.0, 0.0, 3.0]
    stacked = type(PLAN)(**{**vars(PLAN), "motion": type(PLAN.motion)(PLAN.motion.times, motion)})
    known = escapes(stacked)
    assert known.under[:, 2].any()
    assert not known.under[:, 1].any()
