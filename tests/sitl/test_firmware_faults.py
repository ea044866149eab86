"""Faults that the world causes in vehicles with real firmware."""

import socket
import struct

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as dialect
from scipy.spatial.transform import Rotation

from sitl.emulator import Emulator
from sitl.faults import Fault
from sitl.firmware import ardupilot, px4
from sitl.firmware.ardupilot import ArduPilotPort
from sitl.firmware.px4 import Px4Port
from sitl.firmware.sensors import SensorFaults
from sitl.firmware.team import Exchange
from sitl.physics.dynamics import STEP
from sitl.physics.geodesy import GRAVITY, Geodesy
from sitl.physics.rigid_bodies import SUBSTEPS
from sitl.world import WorldError, default_world

INSTANCE = 57
"""An instance whose ports no simulator uses."""
GEODESY = Geodesy.at(47.4, 8.5, 488.0)
FULL = np.ones((1, 4))


def outside(kind, faults=()):
    """Return the emulator of one vehicle that is moved from outside."""
    return Emulator(default_world(1, [kind]), faults, outside=[1])


@pytest.mark.parametrize(
    ("kind", "fault", "known"),
    [
        ("ardupilot", "gps_loss", "capture, "),
        ("px4", "freeze", "barometer_drift, capture, gps_jump, gps_loss, "),
    ],
)
def test_faults_that_the_world_cannot_cause_in_real_firmware_are_refused(kind, fault, known):
    with pytest.raises(WorldError) as caught:
        outside(kind, [Fault(at=1.0, kind=fault, vehicle=1)])
    assert str(caught.value) == (
        f"faults: expected one of {known}gripper_slip, gripper_stuck_open, gripper_stuck_shut, "
        f"handled, motor_loss, snag, weak_thrust, wind for vehicle 1 with firmware ({kind}), got {fault}"
    )


def advance(emulator, seconds):
    for _ in range(round(seconds / STEP)):
        for k in range(SUBSTEPS):
            emulator.advance_outside(FULL, k * STEP / SUBSTEPS)
        emulator.advance(emulator.time + STEP)


def test_without_a_motor_three_give_their_thrust_until_the_fault_ends():
    emulator = outside("px4", [Fault(at=0.1, kind="motor_loss", vehicle=1, duration=0.4)])
    advance(emulator, 0.4)
    thrusts = emulator.outside.state[0, 13:17]
    full = emulator.outside.frame.motor[0]
    assert thrusts[0] < 0.01 * full
    np.testing.assert_allclose(thrusts[1:], full, rtol=1e-4)
    advance(emulator, 0.4)
    np.testing.assert_allclose(emulator.outside.state[0, 13:17], full, rtol=1e-4)


def test_hands_move_a_rigid_body_and_its_sensors_measure_it():
    hands = Fault(at=0.1, kind="handled", vehicle=1, duration=4.0, height=0.5, lean=0.5, turn=0.9)
    emulator = outside("ardupilot", [hands])
    body, still = emulator.outside, np.zeros((1, 4))
    measured, poses = [], [body.state[0].copy()]
    while emulator.time < 4.2:
        for k in range(SUBSTEPS):
            emulator.advance_outside(still, k * STEP / SUBSTEPS)
            measured.append(np.hstack([body.measured[0], body.state[0, 10:13]]))
            poses.append(body.state[0].copy())
        emulator.advance(emulator.time + STEP)
    poses = np.array(poses)
    turned = Rotation.from_quat(poses[:, 6:10], scalar_first=True)
    yaw, pitch, roll = turned.as_euler("ZYX").T
    assert np.ptp(poses[:, 2]) == pytest.approx(0.5, abs=0.005)
    assert roll.max() == pytest.approx(0.5, abs=0.01), "to its right"
    assert pitch.min() == pytest.approx(-0.5, abs=0.01), "nose up"
    assert np.ptp(np.unwrap(yaw)) == pytest.approx(0.9, abs=0.03)
    np.testing.assert_allclose(poses[-1, :10], poses[0, :10], atol=0.005)
    assert emulator.bodies.landed.all()
    # an ideal inertial navigation finds its way back from what the sensors measured
    place, speed, attitude = poses[0, :3].copy(), np.zeros(3), turned[0]
    for row, pose in zip(measured, poses[1:], strict=True):
        attitude *= Rotation.from_rotvec(row[3:] * STEP / SUBSTEPS)
        speed += (attitude.apply(row[:3]) - (0.0, 0.0, GRAVITY)) * STEP / SUBSTEPS
        place += speed * STEP / SUBSTEPS
        assert (
            attitude.inv() * Rotation.from_quat(pose[6:10], scalar_first=True)
        ).magnitude() < 2e-3
        np.testing.assert_allclose(place, pose[:3], atol=0.01)


def test_a_process_that_has_ended_stops_the_motors():
    emulator = outside("ardupilot")
    number = ardupilot.PORT + ardupilot.PORT_STEP * INSTANCE
    port = ArduPilotPort(0, number, (1.0, 1.0))
    gone = []
    exchange = Exchange(emulator, emulator.outside, [port], lambda: gone)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot:
        packet = struct.pack("<HHI16H", 18458, 400, 1, *([2000] * 16))
        autopilot.sendto(packet, ("127.0.0.1", number))
        port.receive()
        np.testing.assert_array_equal(port.command, np.ones(4))
        gone.append(0)
        exchange.advance(STEP)
    exchange.close()
    np.testing.assert_array_equal(port.command, np.zeros(4))
    assert port.grip() is None


def measured(faults):
    """Return HIL_GPS and HIL_SENSOR of a vehicle at rest in the origin, with faults of sensors."""
    port = Px4Port(0, INSTANCE, GEODESY, np.random.default_rng(1), lambda: faults)
    try:
        with socket.create_connection(("127.0.0.1", px4.PORT + INSTANCE)) as autopilot:
            assert port.connect(1.0)
            state = np.zeros(17)
            state[6] = 1.0
            port.answer(0.0, state, np.array([0.0, 0.0, GRAVITY]))
            found = dialect.MAVLink(None).parse_buffer(autopilot.recv(4096))
    finally:
        port.close()
    return {one.get_type(): one for one in found}


def test_a_px4s_receiver_and_barometer_show_the_worlds_faults():
    healthy = measured(SensorFaults())
    broken = measured(SensorFaults(receiver=False, offset=(0.0, 5.0, 0.0), barometer=2.0))
    assert (healthy["HIL_GPS"].fix_type, broken["HIL_GPS"].fix_type) == (6, 1)
    places = [
        GEODESY.metres(one["HIL_GPS"].lat * 1e-7, one["HIL_GPS"].lon * 1e-7)
        for one in (healthy, broken)
    ]
    np.testing.assert_allclose(np.subtract(*places[::-1]), (0.0, 5.0), atol=0.02)
    rise = broken["HIL_SENSOR"].pressure_alt - healthy["HIL_SENSOR"].pressure_alt
    assert rise == pytest.approx(2.0, abs=0.01)
