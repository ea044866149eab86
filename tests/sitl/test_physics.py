"""Flight dynamics: tracking, limits, wind, downwash, battery, contacts."""

import copy
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sitl import Emulator
from sitl.cable.rope import Rope
from sitl.physics.dynamics import STEP, Bodies
from sitl.physics.geodesy import GRAVITY
from sitl.world import CableSpec
from tests.sitl.client import Ground, world


def airborne(autopilot: str = "px4", count: int = 1, **keys) -> Ground:
    """Return vehicles that start at 5 m, armed, in the mode that follows setpoints."""
    ground = Ground(Emulator(world(count, autopilot=autopilot, **keys)))
    ground.run(1.0)
    stream = ground.toward({i: (3.0 * (i - 1), 0.0, 5.0) for i in ground.ids})
    ground.run(0.5, stream)
    for i in ground.ids:
        ground.command(i, 176, 1, 6 if autopilot == "px4" else 4, 0)
    ground.run(0.2, stream)
    for i in ground.ids:
        ground.command(i, 400, 1)
        if autopilot == "ardupilot":
            ground.command(i, 22, 0, 0, 0, 0, 0, 0, 5.0)
            ground.command(i, 511, 32, 1e5)
    ground.run(7.0, None if autopilot == "ardupilot" else stream)
    ground.run(3.0, stream)
    return ground


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
@pytest.mark.parametrize("speed", [1.0, 2.0])
def test_the_tracking_error_with_full_feed_forward_is_a_decimetre(
    autopilot: str, speed: float
) -> None:
    ground = airborne(autopilot, biases="default")
    radius = 3.0
    rate = speed / radius
    origin = ground.origin(1)
    start = ground.now
    errors = []

    def circle(_: int, now: float) -> tuple[float, ...]:
        turn = rate * (now - start)
        c, s = np.cos(turn), np.sin(turn)
        x, y = radius * s, radius * (1 - c)
        return (
            y - origin[1], x - origin[0], -(5.0 - origin[2]),
            speed * s, speed * c, 0.0,
            speed * rate * c, -speed * rate * s, 0.0,
        )  # fmt: skip

    while ground.now < start + 15.0:
        ground.run(0.05, circle)
        if ground.now > start + 5.0:
            turn = rate * (ground.now - start)
            wanted = np.array([radius * np.sin(turn), radius * (1 - np.cos(turn)), 5.0])
            errors.append(np.linalg.norm(ground.emulator.bodies.position[0] - wanted))
    rms = float(np.sqrt(np.mean(np.square(errors))))
    assert 0.01 < rms < 0.15


def test_position_alone_lags_by_a_second() -> None:
    ground = airborne("px4")
    origin = ground.origin(1)
    start = ground.now

    def line(_: int, now: float) -> tuple[float, ...]:
        return (-origin[1], (now - start) - origin[0], -(5.0 - origin[2]))

    ground.run(8.0, line)
    assert 8.0 - ground.emulator.bodies.position[0, 0] == pytest.approx(1.1, abs=0.3)


def test_speed_acceleration_and_tilt_stay_within_limits() -> None:
    ground = airborne("px4", max_speed=3.0, max_acceleration=2.0)
    b = ground.emulator.bodies
    speeds, accelerations, tilts = [], [], []
    before = b.velocity.copy()
    for _ in range(100):
        ground.run(0.05, ground.toward({1: (60.0, 0.0, 5.0)}))
        accelerations.append(np.linalg.norm((b.velocity - before)[0, :2]) / 0.05)
        before = b.velocity.copy()
        speeds.append(np.linalg.norm(b.velocity[0, :2]))
        tilts.append(ground.emulator.truth().tilt[0])
    assert 2.8 < max(speeds) < 3.1
    assert max(accelerations) < 2.3
    assert max(tilts) < np.arctan2(2.6, GRAVITY)


@pytest.mark.parametrize("huge", [1e6, 1e30, 3e38])
def test_far_setpoints_do_not_exceed_the_limits(huge: float) -> None:
    ground = airborne("px4")
    for values in ((huge, 0, -5), (0, 0, -5, huge, 0, 0), (0, 0, -5, 0, 0, 0, huge, -huge, huge)):
        ground.run(1.0, lambda _, __, values=values: values)
    b = ground.emulator.bodies
    assert np.isfinite(b.position).all()
    assert np.abs(b.velocity).max() < 8.0


def test_steady_wind_tilts_the_vehicle() -> None:
    ground = airborne("px4", wind="{steady: [6.0, 0, 0]}")
    ground.run(10.0, ground.toward({1: (0.0, 0.0, 5.0)}))
    b = ground.emulator.bodies
    assert np.abs(b.position[0] - (0, 0, 5.0)).max() < 0.1
    expected = np.arctan(b.drag[0] * 6.0 / GRAVITY)
    truth = ground.emulator.truth()
    assert truth.tilt[0] == pytest.approx(expected, rel=0.1)
    assert truth.position[0, 0] == pytest.approx(0.6 * np.sin(expected), abs=0.05), (
        "the dropper leans with the body: its grip point is up-wind or down-wind of the centre"
    )


def test_gusts_have_the_given_intensity() -> None:
    emulator = Emulator(world(4, wind="{steady: [5.0, 0, 0], gust: 1.5}"))
    b = emulator.bodies
    winds = []
    for _ in range(10_000):
        b.step_disturbances(0.1)
        winds.append(b.wind.copy())
    gusts = np.array(winds) - (5.0, 0.0, 0.0)
    assert gusts[..., 0].std() == pytest.approx(1.5, rel=0.25)
    together = np.corrcoef(gusts[:, 0, 0], gusts[:, 1, 0])[0, 1]
    assert together == pytest.approx(0.64, abs=0.1)


def test_downwash_pushes_a_lower_vehicle_down() -> None:
    ground = airborne("px4", 2)
    b = ground.emulator.bodies
    ground.run(2.0, ground.toward({1: (0.0, 0.0, 7.0), 2: (3.0, 0.0, 5.0)}))
    level = b.position[1, 2]
    b.position[1, :2] = b.position[0, :2]
    ground.run(0.6, ground.toward({1: (0.0, 0.0, 7.0), 2: (0.0, 0.0, 5.0)}))
    assert b.downwash[1, 2] < -5.0
    assert b.downwash[0, 2] == 0.0
    assert b.position[1, 2] < level - 0.1


def test_the_battery_discharges_with_load_within_its_endurance() -> None:
    ground = airborne("px4", endurance=100.0)
    before, start = ground.emulator.truth().charge[0], ground.now
    ground.run(20.0, ground.toward({1: (0.0, 0.0, 5.0)}))
    used = before - ground.emulator.truth().charge[0]
    assert used * 100.0 == pytest.approx(ground.now - start, rel=0.03)


def test_collisions_are_recorded_and_hard_ones_stop_the_motors() -> None:
    ground = airborne("px4", 2)
    ground.run(6.0, ground.toward({1: (3.0, 0.0, 5.0), 2: (0.0, 0.0, 5.0)}))
    (contact, *_) = ground.emulator.truth().contacts
    assert contact["kind"] == "vehicles"
    assert contact["vehicles"] == [1, 2]
    assert contact["speed"] > 1.0
    assert ground.emulator.truth().position[:, 2].max() < 1.0


def test_a_rotor_in_the_cable_is_a_strike() -> None:
    cable = "{points: [[0, 0, 0], [3.3, 0, 0]], attached: [0, 3.3]}"
    ground = Ground(Emulator(world(2, cable, gripper="attached")))
    ground.px4_offboard({1: (0.0, 0.0, 3.0), 2: (3.0, 0.0, 3.0)}, 8.0)
    assert not ground.emulator.truth().strikes
    ground.run(4.0, ground.toward({1: (1.4, 0.0, 2.0), 2: (2.4, 0.0, 3.4)}))
    ground.run(6.0, ground.toward({1: (2.4, 0.1, 1.0), 2: (2.4, 0.1, 3.6)}))
    strikes = ground.emulator.truth().strikes
    assert strikes
    assert strikes[0]["vehicle"] == 1


def test_standing_and_hard_landings() -> None:
    emulator = Emulator(world(1))
    b = emulator.bodies
    for _ in range(100):
        b.step()
    assert b.position[0].tolist() == [0.0, 0.0, 0.6]
    b.position[0, 2] = 3.0
    hits = [b.step() for _ in range(int(2.0 / STEP))]
    assert [hit.tolist() for hit in hits if hit is not None] == [[True]]
    assert b.health[0] == 0.0


def stepped_with_arrays(b: Bodies) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return position, velocity and integral after one step of the cascade, with arrays."""
    goal = b.position_gain * b.position_axes * (b.goal_position - b.estimated()) + b.goal_velocity
    speed = np.linalg.norm(goal[:, :2], axis=1)
    goal[:, :2] *= np.minimum(1.0, b.speed_limit / np.maximum(speed, 1e-12))[:, None]
    goal[:, 2] = np.clip(goal[:, 2], -b.descend_limit, b.climb_limit)
    miss = goal - b.velocity
    wanted = b.velocity_gain * b.velocity_axes * miss + b.goal_acceleration + b.integral
    reach = np.linalg.norm(wanted[:, :2], axis=1)
    wanted[:, :2] *= np.minimum(1.0, b.max_acceleration / np.maximum(reach, 1e-12))[:, None]
    miss[reach > b.max_acceleration, :2] = 0.0
    ceiling = b.thrust_share * b.thrust_limit
    wanted[:, 2] = np.clip(wanted[:, 2] + GRAVITY, np.minimum(0.08 * GRAVITY, ceiling), ceiling)
    reach, most = np.linalg.norm(wanted[:, :2], axis=1), b.tilt_limit * wanted[:, 2]
    wanted[:, :2] *= np.minimum(1.0, (most + 1e-9) / np.maximum(reach, 1e-12))[:, None]
    kept = np.where((b.thrust_share < 1.0)[:, None], 0.0, b.integral)
    integral = kept + STEP * b.integral_gain * b.velocity_axes * miss
    missing = wanted * b.health[:, None] - b.thrust
    rate = b.thrust_rate + STEP * (14.0**2 * missing - 2 * 0.9 * 14.0 * b.thrust_rate)
    air = b.drag[:, None] * (b.wind + b.downwash - b.velocity) - [0.0, 0.0, GRAVITY]
    velocity = b.velocity + STEP * (b.thrust + STEP * rate + air + b._external)
    return b.position + STEP * velocity, velocity, integral


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), wild=st.sampled_from([0.1, 1.0, 10.0]))
def test_a_step_equals_the_cascade_of_both_autopilots(seed: int, wild: float) -> None:
    """In flight, inside the limits, at them and far beyond."""
    rng = np.random.default_rng(seed)
    b = Emulator(world(4, wind="{steady: [2, 1, 0], gust: 0.5}", biases="default")).bodies
    b.position[:] = [0.0, 0.0, 50.0] + wild * rng.normal(size=(4, 3))
    b.thrust[:] = [0.0, 0.0, GRAVITY] + wild * rng.normal(size=(4, 3))
    for some in (b.velocity, b.thrust_rate, b.integral, b.bias):
        some[:] = wild * rng.normal(size=(4, 3))
    for i in range(4):
        b.set_goal(i, (0.0, 0.0, 50.0, *(wild * rng.normal(size=6))))
    b.position_gain[:], b.velocity_gain[:], b.integral_gain[:] = 0.9, 3.0, 0.4
    b.health[:], b.thrust_share[:] = [1.0, 0.7, 1.0, 0.2], [1.0, 1.0, 0.4, 0.0]
    b.downwash[0, 2] = -3.0
    b.refresh()
    b.set_external_force(wild * rng.normal(size=(4, 3)))
    position, velocity, integral = stepped_with_arrays(b)
    assert b.step() is None
    assert np.abs(b.position - position).max() < 1e-9
    assert np.abs(b.velocity - velocity).max() < 1e-9
    assert np.abs(b.integral - integral).max() < 1e-9


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_a_vehicle_that_descends_level_keeps_no_thrust_against_an_earlier_pull(
    autopilot: str,
) -> None:
    ground = airborne(autopilot)
    vehicle, b = ground.emulator.vehicles[0], ground.emulator.bodies
    b.integral[0] = (0.8, -0.5, 0.3)
    vehicle.descend(0.6, steer=False)
    assert b.integral[0].tolist() == [0.0, 0.0, 0.3]
    b.velocity[:] = 0.0
    for _ in range(int(5.0 / STEP)):
        b.step()
    assert np.abs(b.velocity[0, :2]).max() < 0.05
    assert b.velocity[0, 2] == pytest.approx(-0.6, abs=0.1)


def test_a_copy_in_flight_continues_independently() -> None:
    ground = Ground(Emulator(world(2)))
    b = ground.emulator.bodies
    b.armed[:] = b.may_lift[:] = True
    for i in range(2):
        b.set_goal(i, (3.0 * i, 0.0, 5.0, *[0.0] * 6))
    for step in range(400):
        b.step()
        if step % 2 == 0:
            b.supervise(0.04)
    other = copy.deepcopy(b)
    for one in (b, other):
        one.set_goal_values(1, (3.0, 1.0, 5.0, *[0.0] * 6))
        one.step()
    assert (b.position == other.position).all()
    other.set_goal_values(1, (3.0, 9.0, 5.0, *[0.0] * 6))
    other.armed[0] = False
    other.step()
    assert b.goal_position[1, 1] == 1.0
    assert b.armed.all()


places = arrays(float, (3, 3), elements=st.floats(0.0, 4.0))


@settings(max_examples=100, deadline=None)
@given(
    places,
    arrays(float, (2, 3), elements=st.floats(0.0, 4.0)),
    st.sampled_from([(0.0, 4.5, 9.0), (0.8, 4.5, 7.5)]),
    st.sampled_from([(0.0, 0.0, 0.0), (0.4, -0.3, 0.0), (0.0, 8.0, 0.0)]),
)
def test_the_broad_phase_misses_no_contact(
    grips: Any, others: Any, arcs: tuple[float, float, float], wind: tuple[float, float, float]
) -> None:
    """The broad phase is conservative: compared with every sample of the cable."""
    spec = CableSpec(points=[(0, 0, 0), (9, 0, 0)])
    rope = Rope(spec, 0.0, np.array(wind))
    for i, arc in enumerate(arcs):
        rope.attach(i, arc)
    rope.forces(grips, np.zeros((3, 3)))
    cable = rope.update(grips, 100.0)
    centres = np.vstack([grips + np.array([0.0, 0.0, 0.6]), others])
    away = cable[:, None] - centres[None]
    touching = (np.abs(away[..., 2]) < 0.06) & (np.hypot(away[..., 0], away[..., 1]) < 0.25)
    assert rope.within_reach(centres, np.full(5, 0.25)) or not touching.any()
