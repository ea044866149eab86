"""The emulator's cable with inertia against statics, oscillations, free fall and the planner's."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl.cable.grips import FreeMotion
from sitl.cable.rope import Rope
from sitl.cable.swinging import SwingingRope
from sitl.emulator import Emulator
from sitl.physics.dynamics import STEP
from sitl.physics.geodesy import GRAVITY
from sitl.world import CableSpec
from swarm.flight.conductor import Conductor
from swarm.geometry.catenary import length_for_sag
from swarm.geometry.lumped_mass import SwingModel
from swarm.mission.fleet import emulated_fleet
from swarm.simulation.loop import Callbacks, simulate_flight
from tests.geometry.swinging import swing
from tests.network import small_plan

STILL_AIR = np.zeros(3)


def rope(length: float, ties: list[float], floor: float = -100.0, **spec: float) -> SwingingRope:
    made = SwingingRope(CableSpec(points=[(0, 0, 0), (length, 0, 0)], **spec), floor, STILL_AIR)
    for vehicle, arc in enumerate(ties):
        made.attach(vehicle, arc)
    return made


def settle(made: SwingingRope, grips: np.ndarray, seconds: float) -> np.ndarray:
    """Draw the grip points in smoothly from where they are, wait, and return the last forces."""
    begin = np.array([made.position_at(arc) for arc, _ in made.grips])
    for k in range(round(seconds / STEP)):
        share = min(1.0, k * STEP / (0.3 * seconds))
        share = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        force = made.forces(begin + share * (grips - begin), np.zeros_like(grips))
    return force


@settings(max_examples=8, deadline=None)
@given(st.floats(0.8, 3.5), st.floats(-1.5, 1.5), st.floats(1.1, 1.8))
def test_at_rest_it_hangs_and_pulls_as_the_static_cable(x: float, z: float, ratio: float) -> None:
    length = ratio * math.hypot(x, z)
    made = rope(length, [0.0, length], diameter=0.03)  # thick: the air soon takes its oscillation
    grips = np.array([[0.0, 0.0, 10.0], [x, 0.0, 10.0 + z]])
    force = settle(made, grips, 30.0)
    static = Rope(made.spec, -100.0, STILL_AIR)
    for vehicle, arc in enumerate((0.0, length)):
        static.attach(vehicle, arc)
    weight = made.spec.mass_per_length * GRAVITY * length
    assert force == pytest.approx(static.forces(grips, np.zeros_like(grips)), abs=0.03 * weight)
    gap = np.abs(made.update(grips, 0.0) - static.update(grips, 0.0)).max()
    assert gap < 0.02 * length


def test_it_swings_as_the_planners_lumped_masses() -> None:
    # two codes and two time steps: positions of the middle while the ends move to and fro
    length, model = 4.0, SwingModel(16, 0.0025, 0.5 * 1.2 * 1.1 * 0.006 / 0.012)
    time = np.arange(0.0, 12.0, STEP)
    start, step = np.array([[0.0, 0.0, 9.0], [2.5, 0.0, 9.0]]), np.array([0.0, 0.3, 0.0])

    def ends(at: np.ndarray) -> np.ndarray:
        ramp = np.clip(at / 2.0, 0.0, 1.0)[:, None, None] ** 3
        return start + ramp * np.sin(2.0 * math.pi * 0.4 * at)[:, None, None] * step

    fine = ends(np.arange(0.0, 12.0, model.step))
    expected = swing(fine, np.array([length]), model, every=8)[:, 0, 8]
    made = rope(length, [0.0, length])
    settle(made, start, 60.0)
    found = []
    for grips in ends(time):
        made.forces(grips, np.zeros_like(grips))
        found.append(made.position_at(2.0))
    gap = np.linalg.norm(np.array(found) - expected[: len(time)], axis=1)
    assert np.ptp(expected[:, 1]) > 0.5, "it swings"
    assert gap.max() < 0.03


def test_free_fall_and_coming_to_rest_on_the_floor() -> None:
    made = rope(3.0, [0.0, 3.0], floor=0.0)
    settle(made, np.array([[0.0, 0.0, 5.0], [2.0, 0.0, 5.0]]), 30.0)
    high = made.update(np.zeros((2, 3)), 0.0)[:, 2].copy()
    assert made.release(0)
    assert made.release(1)
    assert not made.release(1)
    for _ in range(round(0.4 / STEP)):
        made.forces(np.zeros((2, 3)), np.zeros((2, 3)))
    fallen = (high - made.update(np.zeros((2, 3)), 0.0)[:, 2]).mean()
    assert fallen == pytest.approx(0.5 * GRAVITY * 0.4**2, rel=0.1), "air takes a little"
    for _ in range(round(5.0 / STEP)):
        made.forces(np.zeros((2, 3)), np.zeros((2, 3)))
    shape = made.update(np.zeros((2, 3)), 0.0).copy()
    assert shape[:, 2] == pytest.approx(0.003, abs=1e-9)
    for _ in range(50):
        made.forces(np.zeros((2, 3)), np.zeros((2, 3)))
    assert np.abs(made.update(np.zeros((2, 3)), 0.0) - shape).max() < 1e-3, "friction holds it"


@pytest.mark.parametrize(
    ("wind", "wash", "stays"), [(2.0, 0.0, True), (2.0, 8.0, True), (4.0, 0.0, False)]
)
def test_wind_across_moves_cable_on_the_floor_by_more_than_its_friction(
    wind: float, wash: float, stays: bool
) -> None:
    """A jet makes the wind's drag larger, and presses the cable to the floor by more than that."""
    made = rope(6.0, [0.0], floor=0.0)
    made.set_wind(np.array([0.0, wind, 0.0]))
    speed = np.zeros((len(made.arc), 2))
    speed[:, 1] = wash
    made.set_wash(speed)
    for _ in range(round(5.0 / STEP)):
        made.forces(np.zeros((2, 3)), np.zeros((2, 3)))
    aside = float(np.abs(made.update(np.zeros((2, 3)), 0.0)[:, 1]).max())
    assert aside < 1e-3 if stays else aside > 0.3


def test_a_taut_cable_stretches_by_its_stiffness_and_breaks_at_its_load() -> None:
    made = rope(2.0, [0.0, 2.0], stiffness=1500.0, breaking_load=40.0)
    force = settle(made, np.array([[0.0, 0.0, 9.0], [2.02, 0.0, 9.0]]), 20.0)
    assert -force[1, 0] == pytest.approx(1500.0 * 0.01, rel=0.02)
    assert not made.breaks
    settle(made, np.array([[0.0, 0.0, 9.0], [2.08, 0.0, 9.0]]), 3.0)
    assert len(made.breaks) == 1
    assert len(made.solved.tension) == 0
    assert (
        np.abs(settle(made, np.array([[0.0, 0.0, 9.0], [2.08, 0.0, 9.0]]), 20.0)[:, 0]).max() < 0.1
    )


def test_a_gripper_catches_what_is_in_reach_and_slides() -> None:
    made = rope(6.0, [0.0], floor=0.0)
    assert made.grab(1, np.array([3.03, 0.0, 0.5])) is None
    assert made.grab(1, np.array([3.03, 0.1, 0.05])) == pytest.approx(3.03)
    assert made.position_at(3.03) == pytest.approx([3.03, 0.0, 0.003], abs=1e-6), "no jump"
    for _ in range(100):
        made.forces(np.array([[0.0, 0.0, 0.0], [3.03, 0.1, 0.05]]), np.zeros((2, 3)))
    assert made.position_at(3.03) == pytest.approx([3.03, 0.1, 0.05], abs=1e-3)
    made.slide(1, 0.4)
    assert made.grips[1] == (pytest.approx(3.43), 1)
    made.slide(1, 9.0)
    assert made.grips[1][0] < 6.0
    assert min(abs(made.nearest_free(3.0) - arc) for arc, _ in made.grips) >= 0.1 - 1e-9


def test_wash_presses_down_all_but_the_holders_own_spans() -> None:
    made = rope(8.0, [0.0, 4.0, 8.0])
    grips = np.array([[0.0, 0.0, 9.0], [3.0, 0.0, 9.0], [6.0, 0.0, 9.0]])
    before = settle(made, grips, 60.0)
    speed = np.zeros((len(made.arc), 3))
    speed[:, 0] = 8.0
    made.set_wash(speed)
    for _ in range(round(40.0 / STEP)):
        after = made.forces(grips, np.zeros_like(grips))
    assert after[2, 2] < 1.1 * before[2, 2]
    assert after[0] == pytest.approx(before[0], abs=0.02)


@pytest.mark.slow
def test_a_team_ties_a_knot_in_it() -> None:
    plan = small_plan()
    fleet = emulated_fleet(plan.plan.vehicles, cable="swinging")
    largest = 0.0

    def look(conductor: Conductor, emulator: Emulator, now: float) -> None:
        nonlocal largest
        del now
        assert isinstance(emulator.rope, SwingingRope)
        if conductor.phase.name == "fold":
            largest = max(largest, float(emulator.truth().tension.max()))

    result = simulate_flight(plan, fleet=fleet, callbacks=Callbacks(on_step=look))
    assert result.outcome.word == "done"
    assert result.adherence.within
    assert 0.1 < largest < 3.0, "newtons: the weight of a segment or two"


@settings(max_examples=5, deadline=None)
@given(
    st.floats(0.0, 2.0 * math.pi), st.floats(2.0, 10.0), st.sampled_from([(1.0, 1.0), (0.4, 3.0)])
)
def test_a_jerk_passes_on_momentum_and_makes_no_energy(
    heading: float, speed: float, share: tuple[float, float]
) -> None:
    # three bodies on six metres of cable, the middle one thrown until the cable is taut, and on
    made = rope(6.0, [0.0, 3.0, 6.0], diameter=1e-4, breaking_load=1e6)
    grips = np.array([[0.0, 0.0, 0.0], [2.5, 0.0, 0.0], [5.0, 0.0, 0.0]])
    settle(made, grips, 20.0)
    body = 1.5 * np.array([1.0, *share])
    velocity = np.zeros((3, 3))
    velocity[1] = [0.3 * speed, speed * math.cos(heading), speed * math.sin(heading)]
    free = FreeMotion(np.zeros((3, 3)), 1.0 / body)
    inner = ~made._chain.held

    def momentum() -> np.ndarray:
        cable = made._chain.mass[inner, None] * made._chain.velocity[inner]
        return (body[:, None] * velocity).sum(axis=0) + cable.sum(axis=0)

    thrown, energy = momentum(), 0.5 * (body[:, None] * velocity**2).sum()
    weight = made.spec.mass_per_length * GRAVITY * 6.0
    most = 0.0
    for step in range(1, 101):
        force = made.forces(grips, velocity, free)
        velocity = velocity + STEP * force / body[:, None]
        grips = grips + STEP * velocity
        most = max(most, float(made.solved.tension.max()))
        fallen = weight * step * STEP * np.array([0.0, 0.0, -1.0])
        assert momentum() == pytest.approx(thrown + fallen, abs=0.02 * body[1] * speed)
        assert 0.5 * (body[:, None] * velocity**2).sum() < 1.02 * energy + weight * 2.0
    assert most > 3.0 * speed, "it was taut, N"


@pytest.mark.parametrize("sag", [0.3, 0.6])
def test_it_swings_sideways_as_irvine_says(sag: float) -> None:
    # Irvine, Cable Structures (1981), chapter 3: ω = (π/l)·√(H/m) with H = m·g·l² / 8d
    span = 4.0
    length = float(length_for_sag(span, sag))
    made = rope(length, [0.0, length])
    grips = np.array([[0.0, 0.0, 9.0], [span, 0.0, 9.0]])
    settle(made, grips, 40.0)
    aside = []
    for step in range(round(12.0 / STEP)):
        shift = 0.01 * min(1.0, step * STEP / 0.2) * np.array([0.0, 1.0, 0.0])
        made.forces(grips + shift, np.zeros_like(grips))
        aside.append(made.position_at(0.5 * length)[1] - 0.01)
    swung = np.array(aside[round(0.5 / STEP) :])
    crossings = np.flatnonzero((swung[:-1] < 0.0) & (swung[1:] >= 0.0))
    period = float(np.diff(crossings).mean()) * STEP
    assert period == pytest.approx(2.0 / math.sqrt(GRAVITY / (8.0 * sag)), rel=0.03)


def test_it_sways_in_its_plane_as_irvine_says() -> None:
    # the same chapter: the first antisymmetric mode in plane has twice the lateral frequency
    span, sag = 4.0, 0.3
    length = float(length_for_sag(span, sag))
    made = rope(length, [0.0, length])
    grips = np.array([[0.0, 0.0, 9.0], [span, 0.0, 9.0]])
    settle(made, grips, 40.0)
    apart = []
    for step in range(round(8.0 / STEP)):
        shift = 0.01 * min(1.0, step * STEP / 0.2) * np.array([1.0, 0.0, 0.0])
        made.forces(grips + shift, np.zeros_like(grips))
        apart.append(made.position_at(0.25 * length)[2] - made.position_at(0.75 * length)[2])
    swung = np.array(apart[round(0.5 / STEP) :])
    crossings = np.flatnonzero((swung[:-1] < 0.0) & (swung[1:] >= 0.0))
    period = float(np.diff(crossings).mean()) * STEP
    assert period == pytest.approx(1.0 / math.sqrt(GRAVITY / (8.0 * sag)), rel=0.04)


def test_wind_leans_a_strand_and_a_loose_end_by_their_drag() -> None:
    speed = 4.0
    made = SwingingRope(CableSpec(points=[(0, 0, 9), (6, 0, 9)]), 0.0, np.array([0.0, speed, 0.0]))
    made.attach(0, 0.0)
    made.attach(1, 4.0)
    force = settle(made, np.array([[0.0, 0.0, 9.0], [3.0, 0.0, 9.0]]), 60.0)
    # a strand across the wind: drag ½ρ·C·d·v² over weight; a loose end hangs where the normal
    # component of the wind, v·cos θ, pushes as hard as that of gravity: tan θ = ratio·cos θ
    ratio = 0.5 * 1.2 * 1.1 * 0.006 * speed**2 / (0.012 * GRAVITY)
    end = made.position_at(6.0) - made.position_at(4.0)
    lean = math.atan2(end[1], -end[2])
    assert math.tan(lean) == pytest.approx(ratio * math.cos(lean), rel=0.05)
    assert end[0] == pytest.approx(0.0, abs=0.02)
    weight = 6.0 * 0.012 * GRAVITY
    assert -weight < force[:, 2].sum() < -0.8 * weight, "drag across a leaning cable lifts it"
    assert 0.5 * ratio * weight < force[:, 1].sum() < ratio * weight
    assert made.release(1)
    assert made.release(0)
    for _ in range(round(6.0 / STEP)):
        made.forces(np.zeros((2, 3)), np.zeros((2, 3)))
    shape = made.update(np.zeros((2, 3)), 0.0)
    assert shape[:, 2].max() < 0.01, "on the floor"
    assert shape[:, 1].mean() > 1.0, "carried by the wind"
