"""Boxes that are called far apart, against sampled catenaries at random moments and displacements."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from swarm.certification import clearances
from swarm.certification.air import wind_tilt
from swarm.certification.clearances import families
from swarm.geometry.catenary import solve_catenaries


def a_ball(rng, count, radius):
    direction = rng.normal(size=(count, 3))
    return radius * direction / np.linalg.norm(direction, axis=1)[:, None]


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.0, 3.0])
@pytest.mark.parametrize("check", ["cable clearance", "vehicle-cable clearance"])
def test_far_pairs_keep_their_distance_for_every_displacement(overhand, check, speed):
    rng, tracking = np.random.default_rng(5), overhand.mission.vehicles.tracking
    tilt = wind_tilt(overhand, speed)
    family = next(one for one in families(overhand, tracking, tilt) if one.check == check)
    roots = family.roots()
    far = family.far(roots)
    assert 0.5 < far.mean() < 1.0
    pairs, lengths = family.far.pairs, overhand.layout.lengths

    def strand(grips, segment, down):
        one = solve_catenaries(grips[segment], grips[segment + 1], lengths[segment], down=down)
        return one.points(np.linspace(0.0, 1.0, 41))

    nearest = np.inf
    for box in rng.choice(np.flatnonzero(far), 1500):
        time = roots.middle[box, 0] + rng.uniform(-1.0, 1.0) * roots.half[box, 0]
        grips = overhand.motion.at(time)[0] + a_ball(rng, overhand.vehicles, tracking)
        first, second = pairs[roots.group[box]]
        heading, share = rng.uniform(0.0, 2.0 * np.pi), tilt * rng.uniform()
        down = np.array([share * np.cos(heading), share * np.sin(heading), -1.0])
        if check == "cable clearance":
            one = strand(grips, first, down)
        else:
            angle = np.linspace(0.0, 2.0 * np.pi, 25)
            rim = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
            disc = family.far.radius * rim + [0.0, 0.0, family.far.height]
            one = grips[first] + np.concatenate([disc, np.zeros((1, 3))])
        apart = cdist(one, strand(grips, second, down)).min()
        assert apart >= family.far.distance
        nearest = min(nearest, apart)
    # In wind a box extends to all sides by which a strand may lean, half a metre for each of two.
    assert nearest < family.far.distance + (4.0 if speed else 3.0)


def test_a_search_without_far_pairs_finds_the_same_moments(overhand):
    """Wider clearances than the plan keeps: failing moments, with and without the boxes."""
    wide = overhand.mission.model_copy(
        update={
            "clearance": overhand.mission.clearance.model_copy(
                update={"cable": 0.7, "vehicle_cable": 0.6}
            )
        }
    )
    plan, checks = replace(overhand, mission=wide), {"cable clearance", "vehicle-cable clearance"}
    found = [moment for moment in clearances.violations(plan) if moment.check in checks]
    assert len(found) > 3
    every = [one for one in families(plan, wide.vehicles.tracking) if one.check in checks]
    without = [moment for one in every for moment in clearances._violations(replace(one, far=None))]
    assert found == without
