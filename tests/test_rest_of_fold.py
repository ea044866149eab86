"""The rest of a fold from where its vehicles are: what it keeps of the plan, and what is refused."""

import numpy as np
import pytest

from swarm import planner
from swarm.certification.certificate import certify
from swarm.certification.clearances import certified
from swarm.errors import Refused
from swarm.planning import Plan
from swarm.planning.assembly import begins_aloft
from tests.network import small_plan
from tests.test_shortening import as_optimised

CORNERS = 1e-6
"""Metres to which the knot stays where it was."""


def places_at(plan: Plan, time: float) -> np.ndarray:
    return plan.motion.at(np.array([time]))[0][0]


@pytest.mark.slow
@pytest.mark.parametrize(("share", "vehicle"), [(0.05, 0), (0.4, 2), (0.8, 4)])
def test_the_rest_begins_at_rest_where_vehicles_are_and_ties_the_same_knot(
    share: float, vehicle: int
) -> None:
    plan = as_optimised().plan
    fold = plan.phase("fold")
    time = fold.start + share * fold.duration
    rng = np.random.default_rng(vehicle)
    places = places_at(plan, time) + rng.uniform(-0.05, 0.05, (plan.vehicles, 3))
    places[vehicle] += [0.1, -0.1, 0.4]
    result = planner.rest_of_fold(plan, time, places)
    rest = result.certified().plan
    assert begins_aloft(rest)
    assert certify(rest).cleared
    assert certified(rest, tracking=plan.mission.vehicles.tracking)
    place, velocity, acceleration = (each[0] for each in rest.motion.at(np.zeros(1))[:3])
    assert np.array_equal(place, places)
    assert not velocity.any()
    assert not acceleration.any()
    assert rest.phase("fold").duration < fold.duration + 5.0
    assert [phase.name for phase in rest.phases] == ["fold", "hold", "finish", "land"]
    later = np.linspace(0.0, plan.duration - fold.end, 50)
    np.testing.assert_allclose(
        rest.motion.at(rest.phase("fold").end + later)[0],
        plan.motion.at(fold.end + later)[0],
        atol=CORNERS,
    )
    gates = [(gate.time - fold.end, gate.condition) for gate in plan.gates if gate.time >= fold.end]
    kept = [(gate.time - rest.phase("fold").end, gate.condition) for gate in rest.gates]
    assert [name for _, name in kept] == [name for _, name in gates]
    np.testing.assert_allclose([at for at, _ in kept], [at for at, _ in gates], atol=1e-6)
    assert result.plan.notes[0].startswith("the rest of the fold from ")


def test_outside_the_fold_nothing_is_planned() -> None:
    plan = small_plan().plan
    with pytest.raises(
        Refused, match=r"^the rest of a fold: expected a time in the fold, got 1\.0 s$"
    ):
        planner.rest_of_fold(plan, 1.0, places_at(plan, 1.0))


def test_places_that_keep_no_distance_are_refused_with_every_pair() -> None:
    plan = small_plan(vehicles=4).plan
    time = plan.phase("fold").start + 2.0
    places = places_at(plan, time)
    places[0] += [1.9, 0.0, 0.0]
    places[3] -= [1.9, 0.0, 0.0]
    with pytest.raises(Refused) as refused:
        planner.rest_of_fold(plan, time, places)
    words = "0.900 m certified between {} for tracking errors up to 0.1 m; 1 m required"
    first, second = str(refused.value).splitlines()
    assert first.startswith(f"vehicle clearance: {words.format('vehicle 1 and vehicle 2')} (at ")
    assert second.startswith(f"vehicle clearance: {words.format('vehicle 3 and vehicle 4')} (at ")


def test_strands_that_may_have_passed_each_other_are_refused() -> None:
    """A team that was turned about its middle: its first and its last strand met there."""
    plan = small_plan(vehicles=4).plan
    time = plan.phase("fold").start + 2.0
    places = places_at(plan, time)[::-1]
    with pytest.raises(Refused) as refused:
        planner.rest_of_fold(plan, time, places)
    way = "on the straight way from their places in the plan to where they are, 0.15 m required"
    assert str(refused.value).splitlines() == [
        f"segment {pair} come within {near} m of each other {way}: either may have passed the other"
        for pair, near in (("1 and segment 3", "0.04"), ("2 and segment 3", "0.00"))
    ]
