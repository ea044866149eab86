"""From a motion capture system to VISION_POSITION_ESTIMATE, and the emulated system."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect
from scipy.spatial.transform import Rotation

from sitl.capture import DELAY, MotionCapture
from sitl.emulator import Emulator
from sitl.world import default_world
from swarm.flight.router import Team
from swarm.ground.mocap import (
    ANYWHERE,
    DatagramCapture,
    MocapBridge,
    Pose,
    estimate,
    named_poses,
    parse_frame,
    parse_url,
)
from swarm.mission.fleet import emulated_fleet

NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""ENU to NED; FLU to FRD is diag(1, −1, −1)."""
ANGLE = st.floats(-3.1, 3.1)


@given(ANGLE, st.floats(-1.5, 1.5), ANGLE)
def test_an_attitude_in_ned_and_frd_is_the_same_rotation(yaw, pitch, roll):
    attitude = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    x, y, z, w = attitude.as_quat()
    message = estimate(Pose(3, 12.5, (1.0, 2.0, 3.0), (w, x, y, z)))
    assert (message.usec, message.x, message.y, message.z) == (12_500_000, 2.0, 1.0, -3.0)
    expected = NED @ attitude.as_matrix() @ np.diag([1.0, -1.0, -1.0])
    angles = [message.yaw, message.pitch, message.roll]
    assert Rotation.from_euler("ZYX", angles).as_matrix() == pytest.approx(expected, abs=1e-6)
    assert all(math.isnan(value) for value in message.covariance)


@pytest.mark.parametrize(
    "data",
    [b"", b"[]", b"3", b'{"time": 1}', b'{"time": 1, "bodies": {"1": [1, 2]}}', b"\xff\xfe",
     b'{"time": 1, "bodies": {"x": [0, 0, 0, 1, 0, 0, 0]}}',
     b'{"time": 1, "bodies": {"1": [NaN, 0, 0, 1, 0, 0, 0]}}'],
)  # fmt: skip
def test_other_datagrams_are_no_frames(data):
    assert parse_frame(data) == []


def test_a_rigid_body_belongs_to_the_system_that_ends_its_name():
    still = SimpleNamespace(w=1.0, x=0.0, y=0.0, z=0.0)
    seen = np.array([1.0, 2.0, 3.0])
    bodies = {
        "quad12": SimpleNamespace(position=seen, rotation=still),
        "wand": SimpleNamespace(position=seen, rotation=still),
        "quad3": SimpleNamespace(position=np.full(3, np.nan), rotation=still),
    }
    assert list(named_poses(bodies, 7.0)) == [Pose(12, 7.0, (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))]


@pytest.mark.parametrize(
    "url", ["vicon", "vicon://", "udp://10.0.0.1", "http://host", "vicon://h:1"]
)
def test_other_addresses_are_refused(url):
    with pytest.raises(ValueError, match="expected udp://HOST:PORT or KIND://HOST"):
        parse_url(url)


def test_addresses_name_a_system_and_its_host():
    assert parse_url("udp://127.0.0.1:9000") == ("udp", "127.0.0.1", 9000)
    assert parse_url("vicon://10.0.0.5") == ("vicon", "10.0.0.5", 0)


def test_each_vehicle_gets_its_newest_pose_and_ardupilot_an_origin():
    team = Team(emulated_fleet(2, ("ardupilot", "px4")), lambda *_: None)
    link = next(iter(emulated_fleet(2).links))
    for system, kind in ((1, 3), (2, 12)):
        beat = dialect.MAVLink(None, srcSystem=system, srcComponent=1)
        data = beat.heartbeat_encode(2, kind, 0, 0, 3).pack(beat)
        assert team.receive(link, ("127.0.0.1", 5000 + system), data, 0.0)
    capture = DatagramCapture("127.0.0.1", 0)
    world = Emulator(default_world(3, ["px4"]))
    source = MotionCapture(world, ("127.0.0.1", capture.port), noise=0.0)
    steps = round(DELAY / 0.02) + 2
    for _ in range(steps):
        world.advance(world.time + 0.02)
        source.send()
    sent = list(MocapBridge(capture, team).packets(0.0))
    source.close()
    capture.close()
    parser = dialect.MAVLink(None)
    found = [(one.address[1] - 5000, parser.parse_buffer(one.data)[0]) for one in sent]
    assert [(system, message.get_type()) for system, message in found] == [
        (1, "VISION_POSITION_ESTIMATE"),
        (2, "VISION_POSITION_ESTIMATE"),
        (1, "SET_GPS_GLOBAL_ORIGIN"),
    ]
    first, second = found[0][1], found[1][1]
    assert first.usec == round((world.time - DELAY) * 1e6)
    east, north, up = world.bodies.position[1]
    assert (second.x, second.y, second.z) == pytest.approx((north, east, -up), abs=1e-6)
    assert found[2][1].latitude == round(ANYWHERE.latitude * 1e7)


def test_a_frame_has_the_heading_of_emulated_and_the_attitude_of_rigid_vehicles():
    world = Emulator(default_world(2, ["ardupilot"]), outside=[2])
    world.outside.state[0, 6:10] = 0.5, 0.5, -0.5, 0.5
    source = MotionCapture(world, ("127.0.0.1", 9))
    bodies = json.loads(source.frame())["bodies"]
    source.close()
    yaw = world.bodies.yaw[0]
    assert bodies["1"][3:] == pytest.approx([math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)], abs=1e-6)
    assert bodies["2"][3:] == [0.5, 0.5, -0.5, 0.5]
