"""Failures of a team that ties a knot beside a fence, and of one that moves apart there."""

import tarfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from swarm.certification.certificate import CertifiedPlan, certify
from swarm.certification.limits import inside_fence_by
from swarm.flight.stages import Step
from swarm.front.plans import load_plan
from swarm.simulation.failure_cases import FAILURE_CASES
from swarm.simulation.failure_tests import GroundTruthMonitor, fly_fault_trial
from swarm.simulation.loop import Fault
from swarm.simulation.stepped_simulation import SteppedSimulation, failure_test_fleet

BY_NAME = {case.name: case for case in FAILURE_CASES}
FENCE = ((4.4, -19.2), (1.5, -18.4), (-3.1, -0.7), (12.2, 21.9), (15.2, 21.1), (10.6, -1.1))
"""About 1 m outside of the area over which the plan flies; metres."""
WIDEST = 12.0
"""Seconds into the fold at which vehicles that move apart would leave the fence if they could."""


@pytest.fixture(scope="module")
def fenced(tmp_path_factory):
    """The overhand of five vehicles, of an older plan file: planning one anew takes 20 s."""
    folder = tmp_path_factory.mktemp("fenced")
    with tarfile.open(Path(__file__).parents[1] / "older" / "files.tar.xz") as archive:
        archive.extract("overhand_five.plan", folder, filter="data")
    plan = load_plan(folder / "overhand_five.plan")
    workspace = plan.mission.workspace.model_copy(update={"fence": FENCE})
    mission = plan.mission.model_copy(update={"workspace": workspace})
    plan = replace(plan, mission=mission)
    places = plan.motion.at(np.linspace(0.0, plan.duration, 1000))[0]
    assert 0.9 < inside_by(places).min() < 1.1
    return CertifiedPlan(plan, certify(plan))


def inside_by(places):
    """How far places (…, 3) are inside the fence, metres."""
    return inside_fence_by(np.stack([places, places], axis=-2), np.array(FENCE))


@pytest.fixture(scope="module")
def in_fold(fenced):
    """A flight of PX4 and ArduPilot in the fold."""
    flight = SteppedSimulation.create(fenced, failure_test_fleet(5, "mixed", 3), seed=3)
    start = fenced.plan.phase("fold").start
    while flight.conductor.clock.time < start + WIDEST or not flight.can_be_copied:
        flight.step()
    return flight


@pytest.fixture(scope="module")
def apart(in_fold):
    """The flight of a team that has released the cable on command, and moves apart."""
    flight = in_fold.copy()
    flight.conductor.request("abort")
    while not moves_apart(flight):
        flight.step()
    half = flight.now + 0.5 * flight.conductor.state.guidance.duration
    while flight.now < half or not flight.can_be_copied:
        flight.step()
    assert moves_apart(flight)
    return flight


def moves_apart(flight):
    contingency = flight.conductor.state.contingency
    return contingency is not None and contingency.step is Step.SEPARATE


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "vehicle"),
    [
        ("motor lost", 3),
        ("motor lost", 5),
        ("position lost", 2),
        ("position degraded", 4),
        ("setpoint gap of 10 s, one", 1),
        ("two-way gap of 10 s, one", 5),
        ("two-way gap of 10 s, all", 1),
        ("snag", 2),
    ],
)
def test_no_vehicle_but_a_failed_one_leaves_the_fence(in_fold, name, vehicle):
    trial = fly_fault_trial(in_fold.copy(), BY_NAME[name], vehicle - 1)
    assert trial.problems == ()
    assert trial.rotor_strikes == 0


LOST_LINK = {"kind": "link", "loss": 1.0, "duration": 60.0}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("vehicle", "fault"),
    [
        (3, {"kind": "motor_loss"}),
        (1, {"kind": "position_loss"}),
        (4, {"kind": "gps_loss"}),
        (5, LOST_LINK | {"direction": "both"}),
        (2, LOST_LINK | {"direction": "up"}),
        (3, LOST_LINK | {"direction": "down"}),
        (2, {"kind": "leave_offboard"}),
    ],
)  # fmt: skip
def test_a_failure_while_the_team_moves_apart_moves_no_other_vehicle(apart, vehicle, fault):
    """The others fly as they did before, inside the fence, and land; none touches the failed one."""
    flight = apart.copy()
    released = [event for event in flight.events if event.kind == "release"]
    flight.emulator.inject(Fault.model_validate({"at": flight.now, "vehicle": vehicle, **fault}))
    others = np.arange(1, 6) != vehicle
    while flight.conductor.finished is None:
        flight.step()
        position = flight.emulator.truth().position
        assert inside_by(position[others]).min() > 0.35
    truth = flight.emulator.truth()
    assert any(
        f"vehicle {vehicle}" in event.message for event in flight.events if event.kind == "failure"
    )
    assert [event for event in flight.events if event.kind == "release"] == released
    assert not truth.armed.any()
    assert position[others, 2].max() < 0.1
    assert not truth.strikes
    assert {tuple(contact["vehicles"]) for contact in truth.contacts} <= {(vehicle,)}


@pytest.mark.slow
def test_vehicles_outside_of_the_fence_are_told_but_not_the_failed_one(in_fold):
    flight = in_fold.copy()
    (x, y), _ = flight.emulator.truth().position[1:3, :2]
    around = [[x - 0.1, y - 0.1], [x + 0.1, y - 0.1], [x, y + 0.1]]
    plan = flight.flight_plan.plan
    workspace = plan.mission.workspace.model_copy(update={"fence": around})
    mission = plan.mission.model_copy(update={"workspace": workspace})
    flight.flight_plan = SimpleNamespace(plan=replace(plan, mission=mission))
    for name, outside in (("position lost", [3, 4, 5]), ("snag", [1, 3, 4, 5])):
        monitor = GroundTruthMonitor(flight, BY_NAME[name], 0)
        monitor.sample()
        assert list(monitor.fence_exits) == [f"vehicle {k} leaves the fence" for k in outside]
