"""The cable's pull that setpoints carry: what hangs is held, and sideways pulls cancel."""

import numpy as np
import pytest

from swarm.flight.load import PlannedPull, cable_pull
from tests.network import small_plan

GRAVITY = 9.80665


def test_vehicles_together_carry_the_cable_and_nothing_else():
    plan = small_plan(vehicles=5).plan
    mass = plan.mission.cable.mass_per_length
    pull = cable_pull(plan.layout.corners, plan.layout.lengths, mass)
    weight = mass * GRAVITY * plan.layout.lengths.sum()
    assert pull.sum(axis=0) == pytest.approx([0.0, 0.0, -weight], abs=1e-6)


def test_the_planned_pull_is_the_pull_at_the_planned_places():
    plan = small_plan().plan
    planned = PlannedPull(plan)
    fold = plan.phase("fold")
    for time in np.linspace(fold.start, fold.end, 7):
        grips = plan.motion.at(time)[0]
        exact = cable_pull(grips, plan.layout.lengths, plan.mission.cable.mass_per_length)
        assert planned.at(float(time)) == pytest.approx(exact, abs=0.02)


def test_moments_in_a_batch_are_moments_alone():
    plan = small_plan().plan
    times = np.array([30.0, 33.0, 40.0])
    grips = plan.motion.at(times)[0]
    weight = plan.mission.cable.mass_per_length
    batch = cable_pull(grips, plan.layout.lengths, weight)
    for k in range(len(times)):
        assert batch[k] == pytest.approx(cable_pull(grips[k], plan.layout.lengths, weight))
