"""From a motion capture system to VISION_POSITION_ESTIMATE, and the emulated system."""

import json
import math
import os
import signal
import socket
import time
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect
from scipy.spatial.transform import Rotation

from sitl.emulator import Emulator
from sitl.server import MotionCapture
from sitl.world import Capture, World, default_world
from swarm.errors import VehicleError
from swarm.flight.router import Team
from swarm.flight.world import emulated_world
from swarm.ground.mocap import (
    ANYWHERE,
    UNSEEN,
    DatagramCapture,
    LaboratoryCapture,
    MocapBridge,
    Pose,
    estimate,
    open_capture,
    parse_frame,
    parse_url,
)
from swarm.ground.mocap_child import named_bodies
from swarm.mission import fleet as fleets
from swarm.mission.fleet import emulated_fleet
from tests.children import children
from tests.network import small_plan

NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""ENU to NED; FLU to FRD is diag(1, −1, −1)."""
ANGLE = st.floats(-3.1, 3.1)


@given(ANGLE, st.floats(-1.5, 1.5), ANGLE)
def test_an_attitude_in_ned_and_frd_is_the_same_rotation(yaw, pitch, roll):
    attitude = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    x, y, z, w = attitude.as_quat()
    message = estimate(Pose(3, 12.5, (1.0, 2.0, 3.0), (w, x, y, z)), 12.5)
    assert (message.usec, message.x, message.y, message.z) == (12_500_000, 2.0, 1.0, -3.0)
    expected = NED @ attitude.as_matrix() @ np.diag([1.0, -1.0, -1.0])
    angles = [message.yaw, message.pitch, message.roll]
    assert Rotation.from_euler("ZYX", angles).as_matrix() == pytest.approx(expected, abs=1e-6)
    assert all(math.isnan(value) for value in message.covariance)


@pytest.mark.parametrize(
    "data",
    [b"", b"[]", b"3", b'{"time": 1}', b'{"time": 1, "bodies": {"1": [1, 2]}}', b"\xff\xfe",
     b'{"time": 1, "bodies": {"x": [0, 0, 0, 1, 0, 0, 0]}}'],
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
    assert list(named_bodies(bodies, 7.0)) == [(12, 7.0, (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))]


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        ("vicon", "no answer within 1.5 s"),
        ("qualisys", "Error connecting QTM on address: 127.0.0.1:22222"),
        ("nokov", "Unknown motion capture type!"),
    ],
)
def test_a_system_that_is_not_there_is_an_error(kind, reason):
    # libmotioncapture itself, which keeps its interpreter locked while it waits for Vicon
    with pytest.raises(VehicleError) as error:
        LaboratoryCapture(kind, "127.0.0.1", timeout=1.5)
    assert str(error.value) == f"motion capture: {kind} at 127.0.0.1: {reason}"


STAND_IN = """
import os
from types import SimpleNamespace

class System:
    def waitForNextFrame(self):
        pass
    @property
    def rigidBodies(self):
        still = SimpleNamespace(w=1.0, x=0.0, y=0.0, z=0.0)
        return {"quad2": SimpleNamespace(position=(os.getpid(), 2.0, 3.0), rotation=still)}

def connect(kind, options):
    return System()
"""


def test_the_process_of_a_system_is_started_again_when_it_ends(tmp_path, monkeypatch):
    (tmp_path / "motioncapture.py").write_text(STAND_IN)
    monkeypatch.syspath_prepend(tmp_path)
    capture = open_capture("vrpn://127.0.0.1")
    first = next_pose(capture)
    (process,) = children("mocap_child")
    assert first == Pose(2, first.time, (process, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))
    os.kill(process, signal.SIGKILL)
    while (second := next_pose(capture)).position == first.position:
        pass  # frames that were on their way
    assert second.system == 2
    capture.close()
    assert children("mocap_child") == []


def next_pose(capture):
    deadline = time.monotonic() + 30.0
    while time.monotonic() < deadline:
        for pose in capture.latest():
            return pose
    raise AssertionError("no pose within 30 s")


def test_missing_poses_are_reported_and_their_return():
    team = Team(emulated_fleet(2, ("px4",)), lambda *_: None)
    capture = DatagramCapture("127.0.0.1", 0)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def see(*systems):
        bodies = {str(one): [0, 0, 0, 1, 0, 0, 0] for one in systems}
        frame = json.dumps({"time": 1.0, "bodies": bodies}).encode()
        sender.sendto(frame, ("127.0.0.1", capture.port))

    bridge = MocapBridge(capture, team)
    see(1, 2, 9)
    assert list(bridge.packets(10.0)) == []
    assert bridge.unseen(10.0 + UNSEEN) == ()
    see(2)
    list(bridge.packets(10.2))
    assert bridge.unseen(10.1 + UNSEEN) == (1,)
    see(1)
    list(bridge.packets(10.4 + UNSEEN))
    assert bridge.unseen(10.5 + UNSEEN) == (2,)
    capture.close()
    sender.close()


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
    laboratory = Capture(delay=0.04, noise=0.0)
    described = default_world(3, ["px4"]).model_copy(update={"capture": laboratory})
    world = Emulator(described)
    source = MotionCapture(world, ("127.0.0.1", capture.port))
    for _ in range(4):
        world.advance(world.time + 0.02)
        source.send()
    bridge = MocapBridge(capture, team)
    parser = dialect.MAVLink(None)

    def sent(now):
        return [
            (one.address[1] - 5000, parser.parse_buffer(one.data)[0]) for one in bridge.packets(now)
        ]

    found = sent(5.0)
    # an ArduCopter that got its origin later would be wrong in height
    assert [(system, message.get_type()) for system, message in found] == [
        (2, "VISION_POSITION_ESTIMATE"),
        (1, "SET_GPS_GLOBAL_ORIGIN"),
    ]
    origin = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    data = origin.gps_global_origin_encode(473977420, 85455940, 488000).pack(origin)
    assert team.receive(link, ("127.0.0.1", 5001), data, 5.05)
    world.advance(world.time + 0.02)
    source.send()
    late = sent(5.07)  # 0.05 s later than the one before
    source.close()
    capture.close()
    assert [(system, message.get_type()) for system, message in late] == [
        (1, "VISION_POSITION_ESTIMATE"),
        (2, "VISION_POSITION_ESTIMATE"),
    ]
    second = found[0][1]
    assert second.usec == 5_000_000
    # the time of the least delayed pose, and the capture's own clock from there
    assert late[0][1].usec == 5_020_000
    east, north, up = world.bodies.position[1]
    assert (second.x, second.y, second.z) == pytest.approx((north, east, -up), abs=1e-6)
    assert found[1][1].latitude == round(ANYWHERE.latitude * 1e7)


def test_the_world_of_an_emulated_fleet_has_its_motion_capture():
    fleet = emulated_fleet(3)
    settings = fleet.emulated.model_copy(
        update={"capture": fleets.Capture(delay=0.01, noise=0.002)}
    )
    fleet = fleet.model_copy(update={"emulated": settings})
    world = emulated_world(small_plan().plan, fleet, with_cable=False, seed=1)
    assert World.model_validate(world).capture == Capture(delay=0.01, noise=0.002)


def test_frames_are_as_late_and_as_noisy_as_the_world_says():
    laboratory = Capture(delay=0.06, noise=0.01)
    described = default_world(100, ["px4"]).model_copy(update={"capture": laboratory})
    world = Emulator(described)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        source = MotionCapture(world, receiver.getsockname())
        for _ in range(5):
            world.advance(world.time + 0.02)
            source.send()
        source.close()
        frames = [json.loads(receiver.recv(65535)) for _ in range(2)]
        receiver.setblocking(False)
        with pytest.raises(BlockingIOError):
            receiver.recv(65535)
    assert [frame["time"] for frame in frames] == pytest.approx([0.02, 0.04])
    captured = np.array([frames[0]["bodies"][str(k)][:3] for k in range(1, 101)])
    assert (captured - world.bodies.position).std() == pytest.approx(0.01, rel=0.2)


def test_a_frame_has_the_heading_of_emulated_and_the_attitude_of_rigid_vehicles():
    world = Emulator(default_world(2, ["ardupilot"]), outside=[2])
    world.outside.state[0, 6:10] = 0.5, 0.5, -0.5, 0.5
    source = MotionCapture(world, ("127.0.0.1", 9))
    bodies = json.loads(source.frame())["bodies"]
    source.close()
    yaw = world.bodies.yaw[0]
    assert bodies["1"][3:] == pytest.approx([math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)], abs=1e-6)
    assert bodies["2"][3:] == [0.5, 0.5, -0.5, 0.5]


class Replayed:
    """Poses that a test gives, as a capture."""

    port = None

    def __init__(self):
        self.poses = []

    def latest(self):
        poses, self.poses = self.poses, []
        return poses

    def close(self):
        pass


def heard(vehicles):
    """Return a team of PX4 vehicles that have been received."""
    fleet = emulated_fleet(vehicles)
    team = Team(fleet, lambda *_: None)
    for system in fleet.systems:
        beat = dialect.MAVLink(None, system, 1)
        data = beat.heartbeat_encode(2, 12, 0, 0, 3).pack(beat)
        assert team.receive(next(iter(fleet.links)), ("127.0.0.1", 9000 + system), data, 0.0)
    return team


LEVEL = (1.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("moment", "position", "attitude"),
    [
        (1.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
        (1.0, (0.0, 0.0, 0.0), (3.0, 4.0, 0.0, 0.0)),
        (1.0, (0.0, 0.0, 0.0), (1.0, 0.0, math.nan, 0.0)),
        (1.0, (0.0, 0.0, 0.0), (1.0, 0.0, math.inf, 0.0)),
        (1.0, (1e300, 0.0, 0.0), LEVEL),
        (1.0, (0.0, math.nan, 0.0), LEVEL),
        (math.inf, (0.0, 0.0, 0.0), LEVEL),
        (math.nan, (0.0, 0.0, 0.0), LEVEL),
    ],
)
def test_a_pose_that_no_body_can_have_is_left_out_alone(moment, position, attitude):
    capture = Replayed()
    bridge = MocapBridge(capture, heard(3))
    good = [Pose(system, 1.0, (1.0, 2.0, 3.0), LEVEL) for system in (1, 3)]
    for now in (1.0, 1.05):
        capture.poses = [good[0], Pose(2, moment, position, attitude), good[1]]
        assert [packet.address[1] - 9000 for packet in bridge.packets(now)] == [1, 3]
    assert set(bridge.bodies(1.05)) == {1, 3}
    capture.poses = [Pose(2, 1.1, (0.0, 0.0, 0.0), LEVEL)]
    assert len(list(bridge.packets(1.1))) == 1
    capture.poses = [good[0], Pose(2, moment, position, attitude)]
    list(bridge.packets(1.2 + UNSEEN))
    assert 2 in bridge.unseen(1.2 + UNSEEN)


def test_a_quaternion_that_is_nearly_of_norm_one_is_the_same_attitude():
    turned = (math.cos(0.6), 0.0, 0.0, math.sin(0.6))
    rounded = tuple(1.04 * value for value in turned)
    messages = [estimate(Pose(1, 1.0, (0.0, 0.0, 0.0), q), 1.0) for q in (turned, rounded)]
    assert messages[0].yaw == pytest.approx(messages[1].yaw, abs=1e-12)


def stamps(clock, times):
    """Return the time in each message less that of sending; the capture's clock by ``clock``."""
    team = heard(1)
    capture, parser, found = Replayed(), dialect.MAVLink(None), []
    bridge = MocapBridge(capture, team)
    for now in times:
        capture.poses = [Pose(1, clock(now), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))]
        sent = [parser.parse_buffer(packet.data)[0] for packet in bridge.packets(now)]
        (message,) = [one for one in sent if one.get_type() == "VISION_POSITION_ESTIMATE"]
        found.append(1e-6 * message.usec - now)
    return np.array(found)


def test_a_capture_that_begins_anew_is_followed_and_stops_nothing():
    times = np.arange(1.0, 30.0, 0.05)
    late = stamps(lambda now: now + 5000.0 if now < 10.0 else now - 9.9, times)
    assert np.abs(late).max() < 1e-3
    forwards = stamps(lambda now: now if now < 10.0 else now + 5000.0, times)
    assert np.abs(forwards).max() < 1e-3


@pytest.mark.slow
def test_clocks_that_part_for_hours_leave_stamps_as_they_are():
    """A capture whose clock is 50 ppm slow, over eight hours, with a delay of up to 20 ms."""
    rng = np.random.default_rng(1)
    times = np.arange(0.0, 8 * 3600.0, 0.5)
    delays = iter(rng.uniform(0.0, 0.02, len(times)))
    late = stamps(lambda now: (now - next(delays)) * (1.0 - 50e-6), times)
    assert late.min() > -0.03
    assert late.max() < 0.005


def test_a_clock_that_is_set_is_followed_after_a_moment():
    times = np.arange(1.0, 130.0, 0.02)
    for step in (-0.5, -1.5, 0.5):
        late = stamps(lambda now, step=step: now + 7.0 + (step if now >= 30.0 else 0.0), times)
        assert np.abs(late[times < 29.99]).max() < 1e-3
        assert np.abs(late[times > 30.35]).max() < 1e-3
        assert late.max() < 1e-3


def test_single_frames_ahead_or_behind_move_no_clock():
    times = np.arange(1.0, 130.0, 0.02)
    for off in (0.8, -1.5):
        late = stamps(lambda now, off=off: now + (off if 30.0 <= now < 30.01 else 0.0), times)
        moved = (times >= 30.0) & (times < 30.01)
        assert np.abs(late[~moved]).max() < 1e-3
        assert late[moved] == pytest.approx(min(0.0, off), abs=1e-3)


def test_poses_that_are_delayed_in_their_order_keep_the_times_of_their_capture():
    """For a second, the network passes on each frame 1.5 s late."""
    times = np.arange(1.0, 60.0, 0.02)
    times = times[(times < 30.0) | (times > 31.5)]
    slow = (times > 31.5) & (times < 32.5)
    late = stamps(lambda now: now - 1.5 if 31.5 < now < 32.5 else now, times)
    assert late[slow] == pytest.approx(-1.5, abs=1e-3)
    assert np.abs(late[~slow]).max() < 1e-3
