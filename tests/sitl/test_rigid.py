"""Rigid bodies with motors: balance, signs, and the interface of ArduPilot's simulator."""

import json
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sitl.emulator import Emulator
from sitl.firmware.ardupilot import answer, parse
from sitl.physics.geodesy import GRAVITY
from sitl.physics.rigid_bodies import COLUMNS, SAG, Frame, step
from sitl.world import default_world

FRAME = Frame(*(np.array([value]) for value in (1.5, 0.25, 0.6, 9.3, 0.2)))
STEP = 0.0025
HOVER = np.full((1, 4), 1.5 * GRAVITY / 4)
ANGLE = st.floats(-3.0, 3.0)


def flying(attitude: Rotation | None = None) -> np.ndarray:
    """Return a hovering vehicle 5 m above the floor."""
    state = np.zeros((1, COLUMNS))
    state[0, 2] = 5.0
    x, y, z, w = (attitude or Rotation.identity()).as_quat()
    state[0, 6:10] = w, x, y, z
    state[:, 13:] = HOVER
    return state


def advance(state, wanted, force=(0.0, 0.0, 0.0), steps=1):
    outside = np.array([[*force, 0.0, 0.0, 0.0]])
    for _ in range(steps):
        measured = step(state, FRAME, wanted, outside, 0.0, STEP)
    return measured[0]


def test_a_hovering_vehicle_stays_and_measures_gravity():
    state = flying()
    measured = advance(state, HOVER, steps=400)
    np.testing.assert_allclose(state[0, :3], [0.0, 0.0, 5.0], atol=1e-9)
    np.testing.assert_allclose(measured, [0.0, 0.0, GRAVITY], atol=1e-9)


@pytest.mark.parametrize(
    ("weaker", "axis", "sign"),
    [((0, 3), 0, 1), ((1, 2), 0, -1), ((0, 2), 1, -1), ((1, 3), 1, 1), ((0, 1), 2, 1)],
)
def test_each_pair_of_motors_turns_the_body_as_in_the_autopilots_quadrotor_x(weaker, axis, sign):
    # 0 front right, 1 rear left, 2 front left, 3 rear right; rates about forward, left, up
    state, wanted = flying(), HOVER.copy()
    wanted[0, list(weaker)] -= 0.5
    # less front thrust lowers the nose: a positive rate about the left axis
    expected = -sign if axis == 1 else sign
    advance(state, wanted, steps=20)
    rates = state[0, 10:13]
    assert rates[axis] * expected > 0.0
    assert np.abs(np.delete(rates, axis)).max() < 1e-9


def test_a_pull_at_the_dropper_accelerates_and_turns_the_vehicle():
    state = flying()
    advance(state, HOVER, force=(1.0, 0.0, 0.0))
    assert state[0, 3] == pytest.approx(STEP / 1.5)
    inertia = 1.5 * (0.36 * 0.25) ** 2 + 0.1 * 0.6**2
    # forward at the lower end: the nose rises, a negative rate about the left axis
    assert state[0, 11] == pytest.approx(-0.6 * STEP / inertia)


def test_a_vehicle_without_thrust_falls_measures_nothing_and_stands_up():
    state = flying()
    state[:, 13:] = 0.0
    measured = advance(state, np.zeros((1, 4)))
    np.testing.assert_allclose(measured, 0.0, atol=1e-9)
    measured = advance(state, np.zeros((1, 4)), steps=2000)
    assert state[0, 2] == pytest.approx(0.6 - SAG)
    np.testing.assert_allclose(measured, [0.0, 0.0, GRAVITY])


@settings(max_examples=30, deadline=None)
@given(st.floats(0.05, 0.8), st.floats(0.0, 0.95))
def test_accelerometers_measure_a_touchdown(speed, share):
    # an estimator that integrates them would otherwise sink on below the floor
    state = flying()
    state[0, 2], state[0, 5] = 0.65, -speed
    wanted = share * HOVER
    state[:, 13:] = wanted
    estimated, largest = -speed, 0.0
    for _ in range(400):
        up = float(advance(state, wanted)[2])
        estimated += STEP * (up - GRAVITY)
        largest = max(largest, up)
    assert 0.6 - SAG - 1e-9 <= state[0, 2] <= 0.6
    assert state[0, 5] == pytest.approx(0.0, abs=1e-6)
    assert estimated == pytest.approx(0.0, abs=1e-6)
    # most inertial sensors measure up to 16 g
    assert largest < 16.0 * GRAVITY


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(
    st.tuples(*[st.floats(-0.5, 0.5)] * 3), st.tuples(*[st.floats(-0.5, 0.5)] * 2),
    st.floats(0.0, 0.9),
)  # fmt: skip
def test_inertial_sensors_measure_how_legs_level_and_stop_a_vehicle(angles, drift, share):
    turn = Rotation.from_euler("zyx", angles)
    state = flying(turn)
    state[0, 2], state[0, 3:5] = 0.602, drift
    wanted = share * HOVER
    state[:, 13:] = wanted
    estimated, speed = turn, np.array([*drift, 0.0])
    end, fastest = state[0, :3] - 0.6 * turn.as_matrix()[:, 2], 0.0
    for _ in range(2000):
        measured = advance(state, wanted)
        speed = speed + STEP * (estimated.apply(measured) - [0.0, 0.0, GRAVITY])
        estimated = estimated * Rotation.from_rotvec(STEP * state[0, 10:13])
        w, x, y, z = state[0, 6:10]
        axis = Rotation.from_quat([x, y, z, w]).as_matrix()[:, 2]
        before, end = end, state[0, :3] - 0.6 * axis
        fastest = max(fastest, np.linalg.norm(end - before) / STEP)
    np.testing.assert_allclose(speed, state[0, 3:6], atol=0.02)
    np.testing.assert_allclose(axis, [0.0, 0.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(estimated.as_matrix()[:, 2], axis, atol=0.01)
    np.testing.assert_allclose(state[0, 3:6], 0.0, atol=1e-6)
    # the end of the dropper, which may hold cable
    assert fastest < 6.0


@pytest.mark.parametrize(("pull", "slides"), [(4.0, False), (12.0, True)])
def test_legs_hold_a_vehicle_against_the_cable_up_to_their_friction(pull, slides):
    state = flying()
    state[0, 2] = 0.6 - SAG
    state[:, 13:] = 0.0
    advance(state, np.zeros((1, 4)), force=(pull, 0.0, 0.0), steps=400)
    assert (state[0, 0] > 0.1) == slides
    if not slides:
        np.testing.assert_allclose(state[0, [0, 1, 3, 4]], 0.0, atol=1e-9)


@settings(max_examples=50, deadline=None)
@given(st.tuples(ANGLE, ANGLE, ANGLE), st.lists(st.floats(0.0, 9.0), min_size=4, max_size=4))
def test_attitudes_stay_rotations(angles, motors):
    state = flying(Rotation.from_euler("zyx", angles))
    advance(state, np.array([motors]), steps=50)
    assert np.linalg.norm(state[0, 6:10]) == pytest.approx(1.0)
    assert np.isfinite(state).all()


@settings(max_examples=50, deadline=None)
@given(st.tuples(ANGLE, ANGLE, ANGLE))
def test_answers_are_in_ned_and_frd(angles):
    turn = Rotation.from_euler("zyx", angles)
    state = flying(turn)
    state[0, :6] = 1.0, 2.0, 3.0, 4.0, 5.0, 6.0
    state[0, 10:13] = 0.1, 0.2, 0.3
    text = answer(12.5, state[0], np.array([7.0, 8.0, 9.0]), (1.5, 0.5))
    assert text[:1] == text[-1:] == b"\n"
    sent = json.loads(text)
    assert sent["timestamp"] == 12.5
    assert sent["position"] == [1.0, 1.5, -3.0]
    assert sent["velocity"] == [5.0, 4.0, -6.0]
    assert sent["imu"] == {"gyro": [0.1, -0.2, -0.3], "accel_body": [7.0, -8.0, -9.0]}
    w, x, y, z = sent["quaternion"]
    ned = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    expected = ned @ turn.as_matrix() @ np.diag([1.0, -1.0, -1.0])
    np.testing.assert_allclose(Rotation.from_quat([x, y, z, w]).as_matrix(), expected, atol=1e-6)


def test_servo_packets_are_read_and_others_are_not():
    pulses = tuple(range(1000, 1016))
    packet = struct.pack("<HHI16H", 18458, 400, 7, *pulses)
    assert parse(packet) == (7, 400, pulses)
    assert parse(struct.pack("<HHI32H", 29569, 400, 7, *pulses, *pulses)) == (
        7,
        400,
        pulses + pulses,
    )
    for wrong in (b"", packet[:-1], b"\x00" + packet[1:], packet + b"\x00"):
        assert parse(wrong) is None


def test_supervision_leaves_vehicles_alone_that_are_moved_from_outside():
    bodies = Emulator(default_world(2, ["ardupilot"]), outside=[2]).bodies
    bodies.goal_yaw += 1.0
    bodies.armed[:] = True
    bodies.position[:, 2] += 2.0
    yaw = bodies.yaw.copy()
    bodies.supervise(0.04)
    assert bodies.landed.tolist() == [False, True]
    assert bodies.yaw[1] == yaw[1]
    bodies.supervise(0.04)
    assert bodies.yaw[0] != yaw[0]
    assert bodies.yaw[1] == yaw[1]
