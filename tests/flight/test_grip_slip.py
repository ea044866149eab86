"""Detection of a grip slip from leans alone, with the emulator's cable and vehicles."""

import numpy as np
import pytest

from swarm.flight import grip_slip
from swarm.flight.failures import Latch
from swarm.flight.grip_slip import GripSlipDetector, lean, score_needed
from swarm.geometry.catenary import STANDARD_GRAVITY
from swarm.mission.fleet import emulated_fleet
from swarm.simulation.loop import Fault
from swarm.simulation.stepped_simulation import (
    SteppedSimulation,
    failure_test_fleet,
)
from tests.network import Network, small_plan

PLAN = small_plan(vehicles=5)


@pytest.fixture(scope="module")
def folding():
    flight = SteppedSimulation.create(PLAN, failure_test_fleet(5, "mixed"), seed=4)
    start = PLAN.plan.phase("fold").start
    while flight.conductor.clock.time < start + 3.0 or not flight.can_be_copied:
        flight.step()
    return flight


def flown_on(flight, seconds, *faults):
    flight = flight.copy()
    flight.events.clear()
    began = flight.now
    for values in faults:
        flight.emulator.inject(Fault.model_validate({"at": began, **values}))
    while flight.now < began + seconds:
        flight.step()
    return [(e.time - began, e.vehicle) for e in flight.events if "grip slip" in e.message]


@pytest.mark.slow
@pytest.mark.parametrize("slipped", [0, 2])
def test_a_gripper_that_loses_the_cable_is_detected_and_named(folding, slipped):
    system = folding.conductor.flyers[slipped].system
    ((after, vehicle),) = flown_on(folding, 2.5, {"kind": "gripper_slip", "vehicle": system})
    assert vehicle == slipped + 1
    assert after < 2.0


@pytest.mark.slow
def test_neither_the_fold_nor_a_gale_nor_lost_packets_look_like_it(folding):
    assert not flown_on(folding, 6.0)
    assert not flown_on(folding, 4.0, {"kind": "wind", "steady": [5.0, 3.0, 0.0], "gust": 0.5})
    assert not flown_on(folding, 4.0, {"kind": "link", "loss": 0.3, "vehicle": "all"})


def test_a_flight_without_cable_has_none_to_lose(monkeypatch):
    """Grips are simulated then, and nobody leans as the model says."""
    monkeypatch.setattr(GripSlipDetector, "evaluate", lambda *_: 0)
    flight = Network(PLAN, emulated_fleet(5), no_cable=True).in_fold(2.0)
    assert all(vehicle.gripped for vehicle in flight.conductor.flyers)
    assert not [words for words in flight.words() if "slip" in words]


def test_leaning_is_where_the_thrust_points():
    """Nose down flies where the nose points; the right side down flies to the right."""
    angle, east, north = 0.1, np.pi / 2, 0.0
    attitudes = [(0.0, -angle, east), (0.0, -angle, north), (angle, 0.0, north)]
    leaning = np.array([lean(*attitude) for attitude in attitudes])
    assert leaning == pytest.approx(np.tan(angle) * np.array([[1, 0], [0, 1], [1, 0]]), abs=1e-12)


def test_what_is_always_off_is_usual():
    """A compass that is off and a wind from the first look on are no news."""
    rng = np.random.default_rng(2)
    grips = np.array([[3.0 * k, 0.0, 5.0] for k in range(5)])
    detector = GripSlipDetector(PLAN.plan, Latch(), enabled=True)
    attitude = np.column_stack([rng.normal(0.0, 0.03, (5, 2)), rng.uniform(-3, 3, 5)])
    for k in range(80):
        now = 0.25 * k
        assert detector.evaluate(np.full(5, now), attitude, np.zeros((5, 3)), grips) is None


@pytest.mark.parametrize("measured", [True, False])
def test_delays_that_grow_are_no_pull(measured: bool) -> None:
    """Two vehicles speed up towards each other; for 0.3 s nothing new is read of the team.

    As of the time of reading, they speed up too little for their leans.
    """
    grips = np.array([[3.3 * k, 0.0, 5.0] for k in range(5)])
    detector = GripSlipDetector(PLAN.plan, Latch(), enabled=True)
    inwards, seen = np.array([1.0, -1.0, 0.0, 0.0, 0.0]), set()
    for now in 0.25 * np.arange(20):
        at = np.full(5, min(now, max(3.0, now - 0.3)))
        velocity, attitude = np.zeros((2, 5, 3))
        moving = max(0.0, at[0] - 1.0)
        velocity[:, 0] = inwards * (moving**2 / 3.0 if moving < 1.5 else moving - 0.75)
        attitude[:, 2] = np.pi / 2.0  # heading east
        attitude[:, 1] = -np.arctan(inwards * min(moving / 1.5, 1.0) / STANDARD_GRAVITY)
        times = at if measured else np.full(5, now)
        seen.add(detector.evaluate(times, attitude, velocity, grips))
    assert seen == ({None} if measured else {None, 0})


@pytest.mark.parametrize("gap", [0.25, 0.75])
def test_what_a_gap_hides_is_no_pull(gap: float) -> None:
    """Two vehicles speed up away from each other within 0.75 s, in which nothing may be read."""
    grips = np.array([[3.3 * k, 0.0, 5.0] for k in range(5)])
    detector = GripSlipDetector(PLAN.plan, Latch(), enabled=True)
    outwards = np.array([-1.0, 1.0, 0.0, 0.0, 0.0])
    for now in 0.25 * np.arange(28):
        at = 3.0 if 3.0 <= now < 3.0 + gap else now
        velocity, attitude = np.zeros((2, 5, 3))
        phase = np.pi * np.clip(at - 3.0, 0.0, 0.75) / 0.75
        velocity[:, 0] = outwards * 0.8 * (1.0 - np.cos(phase)) * 0.75 / np.pi
        attitude[:, 2] = np.pi / 2.0  # heading east
        attitude[:, 1] = -np.arctan(outwards * 0.8 * np.sin(phase) / STANDARD_GRAVITY)
        assert detector.evaluate(np.full(5, at), attitude, velocity, grips) is None


def test_a_clock_that_slows_and_speeds_up_needs_a_longer_match():
    """Its changes excite the cable, and a swing matches a slip for half a period at most."""
    varied = [0.33, 0.08, 0.0, 0.04, 0.12, 0.21, 0.29, 0.32, 0.07, 0.0, 0.06, 0.14]
    assert score_needed(varied) == 8
    assert score_needed(varied[:3]) == 4  # three samples old: a slip may have slowed it
    assert score_needed([1.0] * 9 + [0.6, 0.3, 0.0]) == 4
    assert score_needed([1.0] * 8 + [0.6, 0.3, 0.0, 0.0]) == 4
    assert score_needed([1.0] * 7 + [0.6, 0.3, 0.0, 0.0, 0.0]) == 8
    assert score_needed([0.0] * 15) == 4
    assert score_needed([0.73, 0.95, 0.8, 0.9, 0.74, 0.95]) == 4
    assert score_needed([]) == 4


WRONG = 0.05
"""Newtons along an axis that the model has wrong of every vehicle, here."""


def told(pulled, patterns, count=400):
    """How often whose pattern is seen in what is pulled (n, 2) and what the model has wrong."""
    rng = np.random.default_rng(3)
    found = []
    for _ in range(count):
        left = pulled + rng.normal(0.0, WRONG, pulled.shape)
        found.append(grip_slip.match(left, left - left.mean(axis=0), patterns)[0])
    return [found.count(k) / count for k in (None, *range(len(pulled)))]


def test_a_faint_slip_near_the_cables_end_is_not_taken_for_a_force_from_outside():
    """0.25 N, as an overhand has it, among errors that look like a force on three together."""
    patterns = np.zeros((9, 9, 2))
    change = np.array([[-0.02, -0.09], [0.11, 0.16], [-0.09, -0.07]])
    for k in range(1, 8):
        patterns[k, k - 1 : k + 2] = change
    wrong = np.zeros((9, 2))
    wrong[:3] = [0.05, 0.06]
    _, *whose = told(patterns[1] + wrong, patterns)
    assert whose[1] > 0.75
    assert sum(whose) - whose[1] < 0.02
    # a strand that is caught pulls both of its vehicles the same way, and is no slip
    for force in (0.2, 0.5, 2.0):
        caught = np.zeros((9, 2))
        caught[3:5] = [0.6 * force, 0.8 * force]
        nobody, *_ = told(caught, patterns)
        assert nobody > 0.97
