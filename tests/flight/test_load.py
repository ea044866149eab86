"""The pull of the cable that setpoints feed forward: supported weight, and lateral pulls that cancel."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm.flight.load import PlannedPull, cable_pull, end_forces
from swarm.geometry.catenary import rest_on_floor
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


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.5, 4.0, 12.0]), st.sampled_from([0.0, 1.5]))
def test_forces_in_flight_are_those_of_strands_that_may_rest_on_the_floor(seed, height, apart):
    rng = np.random.default_rng(seed)
    start = rng.uniform(0.0, 1.0, (9, 3)) * [4.0, 4.0, height]
    end = start + rng.normal(0.0, 1.0, (9, 3)) * [apart, apart, 1.0]
    end[:, 2] = np.maximum(end[:, 2], 0.0)
    lengths = np.linalg.norm(end - start, axis=1) * rng.uniform(1.01, 2.5, 9)
    exact = rest_on_floor(start, end, lengths).end_forces(0.012)
    for found, wanted in zip(end_forces(start, end, lengths, 0.012), exact, strict=True):
        assert found == pytest.approx(wanted, abs=1e-9)


def test_moments_in_a_batch_are_moments_alone():
    plan = small_plan().plan
    times = np.array([30.0, 33.0, 40.0])
    grips = plan.motion.at(times)[0]
    weight = plan.mission.cable.mass_per_length
    batch = cable_pull(grips, plan.layout.lengths, weight)
    for k in range(len(times)):
        assert batch[k] == pytest.approx(cable_pull(grips[k], plan.layout.lengths, weight))
