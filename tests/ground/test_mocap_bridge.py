"""The bridge of motion capture in a process of its own: who sends poses, who has the links."""

import json
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect
from rich.console import Console

from swarm.cli.mocap import Screen
from swarm.errors import Refused, VehicleError
from swarm.flight.bodies import Body, Pose, PoseRow, pose_rows
from swarm.flight.router import Outgoing, Team
from swarm.flight.world import bare_world
from swarm.ground import mocap_bridge
from swarm.ground.commissioning.check import CheckOptions, check
from swarm.ground.mocap import MocapBridge
from swarm.ground.mocap_bridge import Bridge, BridgeState, claimed, links_of, running_bridge
from swarm.ground.sockets import open_links
from swarm.mavlink.packets import Encoder
from swarm.mavlink.vehicle import Vehicle
from swarm.mission.fleet import emulated_fleet, parse_fleet
from swarm.reports.check import check_object, print_check
from swarm.reports.mocap import bridge_object, bridge_words, poses_object, poses_table
from tests.command import run
from tests.ports import free_port

SWARM = Path(sys.executable).with_name("swarm")
LIMIT = 60.0
"""Seconds within which a program on a busy machine must have done what is waited for."""


def fleet_text(port, vehicles=2, frame="shared"):
    listed = "".join(f"  - {{sysid: {k + 1}, links: [net]}}\n" for k in range(vehicles))
    return (
        f'schema: 1\nname: lab\nlinks: {{net: "udpin://127.0.0.1:{port}"}}\nframe: {frame}\n'
        f"vehicles:\n{listed}"
    )


def fleet_on(port, **given):
    return parse_fleet(fleet_text(port, **given), "lab.yaml")


class Aloft:
    """A vehicle on one UDP socket, and what has come to it."""

    def __init__(self, system, port):
        self.system, self.to = system, ("127.0.0.1", port)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.address = self.socket.getsockname()
        self.mav, self.parser = dialect.MAVLink(None, system, 1), dialect.MAVLink(None)
        self.messages, self.peers = [], set()

    def beat(self, armed=False):
        base = dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
        self.socket.sendto(self.mav.heartbeat_encode(2, 12, base, 0, 3).pack(self.mav), self.to)

    def receive(self):
        try:
            while True:
                data, peer = self.socket.recvfrom(4096)
                self.peers.add(peer)
                self.messages += self.parser.parse_buffer(data) or []
        except BlockingIOError:
            pass

    def got(self, name):
        return [m for m in self.messages if m.get_type() == name]


class Laboratory:
    """A bridge in a process of its own, its source of poses, and two vehicles."""

    def __init__(self, tmp_path, *options):
        self.port, self.frames = free_port(), free_port()
        self.file = tmp_path / "lab.yaml"
        self.file.write_text(fleet_text(self.port))
        self.source = f"udp://127.0.0.1:{self.frames}"
        self.said = tmp_path / "said"
        with self.said.open("w") as said:
            self.bridge = subprocess.Popen(
                [SWARM, "mocap", self.source, "--fleet", self.file, *options],
                stdout=said, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
            )  # fmt: skip
        self.vehicles = [Aloft(1, self.port), Aloft(2, self.port)]
        self.camera = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.began, self.armed = time.monotonic(), False

    def until(self, condition):
        """Let the laboratory go on until a condition holds."""
        latest = time.monotonic() + LIMIT
        while not condition():
            assert time.monotonic() < latest, (self.said.read_text(), self.bridge.poll())
            at = time.monotonic() - self.began
            bodies = {"1": [1, 2, 3, 1, 0, 0, at * 1e-6], "2": [4, 5, 6, 1, 0, 0, at * 1e-6]}
            frame = json.dumps({"time": at, "bodies": bodies}).encode()
            self.camera.sendto(frame, ("127.0.0.1", self.frames))
            for vehicle in self.vehicles:
                vehicle.beat(self.armed)
                vehicle.receive()
            time.sleep(0.01)

    def poses_come(self):
        """Wait for three more poses of each vehicle."""
        for vehicle in self.vehicles:
            vehicle.messages.clear()
        self.until(lambda: all(len(v.got(VISION)) >= 3 for v in self.vehicles))

    def says(self, words):
        self.until(lambda: words in self.said.read_text())

    def close(self):
        self.bridge.kill()
        self.bridge.wait()
        self.camera.close()
        for vehicle in self.vehicles:
            vehicle.socket.close()


VISION = "VISION_POSITION_ESTIMATE"
OUR_BEAT = Encoder().encode(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))


@pytest.fixture
def laboratory(tmp_path):
    made = Laboratory(tmp_path)
    yield made
    made.close()


@pytest.mark.slow
def test_poses_outlive_ground_stations_that_borrow_the_links(laboratory):
    first, second = laboratory.vehicles
    laboratory.poses_come()
    newest = first.got(VISION)[-1]
    assert (newest.x, newest.y, newest.z) == (2.0, 1.0, -3.0)
    assert (newest.get_srcSystem(), newest.get_srcComponent()) == (254, 197)
    laboratory.until(lambda: first.got("HEARTBEAT") and second.got("HEARTBEAT"))
    beats = first.got("HEARTBEAT") + second.got("HEARTBEAT")
    assert all(beat.type == dialect.MAV_TYPE_ONBOARD_CONTROLLER for beat in beats)
    fleet = fleet_on(laboratory.port)
    with links_of(fleet, None) as (links, borrowed):
        laboratory.says(f"process {os.getpid()} uses the links")
        laboratory.poses_come()
        # what the ground station sends comes from the bridge's port, and it receives now
        links.send([Outgoing("net", first.address, OUR_BEAT)])
        heard = {address[1] for _ in range(50) for _, address, _ in links.wait(0.01)}
        assert heard == {vehicle.address[1] for vehicle in laboratory.vehicles}
        laboratory.until(lambda: 255 in {m.get_srcSystem() for m in first.messages})
        assert first.peers == {("127.0.0.1", laboratory.port)}
        assert borrowed.change(0.0) == (
            "motion capture",
            f"the bridge in process {laboratory.bridge.pid} sends the poses ({laboratory.source})",
        )
        assert borrowed.change(0.1) is None
        borrowed.packets(1.0)
        bodies = borrowed.bodies(1.5)
        assert sorted(bodies) == [1, 2]
        assert bodies[1].pose.position == (1, 2, 3)
        assert bodies[2].age >= 0.5
        with pytest.raises(Refused) as other, links_of(fleet, laboratory.source):
            pass
        assert str(other.value).startswith(f"process {os.getpid()} uses the links of the bridge")
        # an armed vehicle is known to the bridge by the copies that are passed on
        laboratory.armed = True
        laboratory.until(lambda: passed_on(links, borrowed))
        laboratory.bridge.send_signal(signal.SIGINT)
        laboratory.says("NOT ended: system 1, 2 is armed, and without poses loses its position.")
    laboratory.says(f"process {os.getpid()} has ended, or returned the links; poses go on")
    laboratory.poses_come()
    laboratory.armed = False
    laboratory.poses_come()
    laboratory.bridge.send_signal(signal.SIGHUP)
    laboratory.until(lambda: laboratory.bridge.poll() is not None)
    assert laboratory.bridge.returncode == 130
    assert "the bridge has ended: no vehicle gets poses" in laboratory.said.read_text()


def passed_on(links, borrowed):
    """Pass on what vehicles have sent; return whether both armed ones are among it."""
    armed = set()
    for link, address, data in links.wait(0.2):
        borrowed.from_vehicles(link, address, data)
        (message,) = dialect.MAVLink(None).parse_buffer(data)
        if message.base_mode:
            armed.add(message.get_srcSystem())
    return armed == {1, 2}


def test_a_flight_keeps_its_links_where_the_bridge_is_killed(laboratory):
    laboratory.poses_come()
    with links_of(fleet_on(laboratory.port), None) as (links, borrowed):
        laboratory.bridge.send_signal(signal.SIGKILL)
        laboratory.bridge.wait()
        borrowed.packets(1.0)
        borrowed.packets(1.1)
        (first, _) = laboratory.vehicles
        assert borrowed.change(1.1) == (
            "motion capture",
            f"the bridge in process {laboratory.bridge.pid} has ended: no vehicle gets poses",
        )
        borrowed.from_vehicles("net", None, b"nobody reads this")
        first.beat()
        assert [data[0] for _, _, data in links.wait(5.0)]
        links.send([Outgoing("net", first.address, OUR_BEAT)])
        latest = time.monotonic() + LIMIT
        while 255 not in {message.get_srcSystem() for message in first.messages}:
            assert time.monotonic() < latest
            first.receive()
    # its claim ended with it
    assert running_bridge(fleet_on(laboratory.port), None) is None


def test_no_second_bridge_sends_poses_to_the_same_vehicles(laboratory):
    laboratory.poses_come()
    who = f"the bridge of motion capture in process {laboratory.bridge.pid} ({laboratory.source})"
    link = f"udpin://127.0.0.1:{laboratory.port}"
    done = run("mocap", f"udp://127.0.0.1:{free_port()}", "--fleet", str(laboratory.file))
    assert (done.returncode, done.stderr.strip()) == (1, f"{who} already sends poses on {link}")
    fleet, same = fleet_on(laboratory.port), laboratory.source
    assert running_bridge(fleet, same).process == laboratory.bridge.pid
    with pytest.raises(Refused) as refused:
        running_bridge(fleet, "vicon://10.0.0.5")
    assert str(refused.value) == (
        f"--mocap vicon://10.0.0.5: {who} sends the poses: leave --mocap out, or end it"
    )
    with pytest.raises(Refused) as refused:
        running_bridge(fleet_on(laboratory.port, vehicles=3), None)
    assert str(refused.value) == (
        f"{who} sends poses to another fleet (lab) on {link}: end it, or use its fleet file"
    )
    assert running_bridge(fleet_on(free_port()), None) is None


def test_a_flight_that_sends_poses_itself_claims_the_links():
    fleet = fleet_on(free_port())
    with claimed(fleet, "vicon://10.0.0.5"):
        expected = f"the flight in process {os.getpid()} (vicon://10.0.0.5) already sends poses on "
        expected += fleet.links["net"]
        for second in (lambda: running_bridge(fleet, None), lambda: enter(claimed(fleet, "x"))):
            with pytest.raises(Refused) as refused:
                second()
            assert str(refused.value) == expected
    assert running_bridge(fleet, None) is None
    # the built-in emulator has links of its own in each process
    assert running_bridge(emulated_fleet(2), None) is None


def enter(context):
    with ExitStack() as stack:
        stack.enter_context(context)


def test_a_bridge_that_does_not_answer_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(mocap_bridge, "_ANSWERS", 0.1)
    fleet = fleet_on(free_port())
    path = tmp_path / "deaf.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as deaf:
        deaf.bind(str(path))
        deaf.listen()
        with (
            claimed(fleet, "vrpn://here", str(path)),
            pytest.raises(VehicleError) as error,
            links_of(fleet, None),
        ):
            pass
    assert str(error.value) == (
        f"the bridge of motion capture in process {os.getpid()} (vrpn://here) does not answer"
    )


def test_fleets_that_get_no_poses_are_refused(tmp_path):
    file = tmp_path / "lab.yaml"
    file.write_text(fleet_text(14550, frame="gps"))
    done = run("mocap", "vicon://10.0.0.5", "--fleet", str(file))
    assert done.returncode == 2
    assert done.stderr.strip() == f"{file}: frame: expected shared for motion capture, got gps"
    done = run("mocap", "vicon://10.0.0.5", "--fleet", "missions/fleets/emulator.yaml")
    assert done.returncode == 2


def body(system, age=0.01, rate=20.0, unchanged=0.0, at=(1.0, 2.0, 3.0)):
    return Body(Pose(system, 5.0, at, (1.0, 0.0, 0.0, 0.0)), rate, age, unchanged)


def standing(system=1, at=(1.0, 2.0, 3.0)):
    vehicle = Vehicle(system)
    vehicle.heartbeat_at = vehicle.position_at = 9.9
    vehicle.position = (at[1], at[0], -at[2])
    return vehicle


SILENT = Vehicle(1)


@pytest.mark.parametrize(
    ("vehicle", "seen", "words", "severity"),
    [
        (standing(), body(1), "20 poses/s, the newest 0.01 s old, 0.00 m from its estimate", "info"),
        (standing(), None, "no pose", "error"),
        (standing(), body(1, age=0.7), "20 poses/s, the newest 0.70 s old, 0.00 m from its estimate; "
         "no pose for 0.7 s", "error"),
        (standing(at=(1.0, 2.0, 3.3)), body(1), "20 poses/s, the newest 0.01 s old, 0.30 m from its "
         "estimate; its autopilot does not use them: its estimate and its pose must agree to 0.2 m "
         "on the ground", "error"),
        (SILENT, body(1), "20 poses/s, the newest 0.01 s old; the vehicle is not received: nothing "
         "is sent to it", "error"),
        (standing(), body(1, unchanged=4.0), "20 poses/s, the newest 0.01 s old, 0.00 m from its "
         "estimate; no digit of its pose has changed for 4 s: is it frozen?", "warning"),
        (standing(), body(1, rate=7.0), "7 poses/s, the newest 0.01 s old, 0.00 m from its estimate; "
         "fewer than 10 a second", "warning"),
    ],
)  # fmt: skip
def test_what_a_vehicle_gets_is_a_row_with_its_finding(vehicle, seen, words, severity):
    bodies = {} if seen is None else {1: seen}
    (row,) = pose_rows([vehicle], bodies, 10.0, positions=True)
    finding = row.finding()
    assert (finding.message, finding.severity) == (f"system 1: {words}", severity)


def test_an_old_position_is_no_position():
    (row,) = pose_rows([standing()], {1: body(1)}, 13.0, positions=True)
    assert (row.problem, row.distance) == ("its autopilot reports no position", None)
    # the bridge alone asks for none
    (row,) = pose_rows([standing()], {1: body(1)}, 13.0, positions=False)
    assert row.severity == "info"


STATE = BridgeState(
    (PoseRow(1, 20.0, 0.01, 0.03), PoseRow(2, 0.0, None, None, "error", "no pose")), (7,), (1,), 123
)


def test_a_state_is_a_table_a_line_and_an_object():
    table = poses_table(STATE.rows)
    assert table.rows[0][:4] == ("1", "20", "0.01", "0.03")
    assert table.rows[1][:4] == ("2", "0", "never", "")
    assert bridge_words(STATE) == (
        "the ground station in process 123 uses the links; armed: 1; bodies of no vehicle: 7"
    )
    assert bridge_object(STATE)["ground_station"] == 123
    assert json.loads(json.dumps(bridge_object(STATE)))["vehicles"][1] == {
        "system": 2, "rate": 0.0, "age": None, "distance": None, "severity": "error",
        "problem": "no pose",
    }  # fmt: skip


class StandingStill:
    """A console whose terminal takes nothing."""

    is_terminal = False

    def __init__(self):
        self.asked, self.goes_on = 0, threading.Event()

    def print(self, *_words, **_options):
        self.asked += 1
        self.goes_on.wait(LIMIT)


def test_a_terminal_that_stands_still_stops_nothing():
    console = StandingStill()
    screen = Screen(console, as_json=False)
    began = time.monotonic()
    with screen.running():
        for _ in range(1000):
            screen.say("words")
            screen.show(STATE)
        assert time.monotonic() - began < 5.0
    assert console.asked == 1
    console.goes_on.set()


class Faulty:
    """A capture that fails at first."""

    port, fails = None, True

    def latest(self):
        if self.fails:
            self.fails = False
            raise ValueError("what nobody thought of")
        return [Pose(1, time.monotonic(), (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))]


def test_poses_go_on_after_an_error_of_the_program():
    fleet = fleet_on(free_port())
    states, said = queue.Queue(), []
    with ExitStack() as stack:
        links = open_links(fleet.links)
        stack.callback(links.close)
        listening = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
        listening.bind("")
        listening.listen()
        listening.setblocking(False)
        poses = MocapBridge(Faulty(), Team(fleet, lambda *_: None))
        bridge = Bridge(poses, links, listening, "vrpn://x", 50.0, states.put, said.append)
        running = threading.Thread(target=bridge.run)
        running.start()
        state = states.get(timeout=LIMIT)
        bridge.ask(signal.SIGTERM)
        running.join(LIMIT)
    assert state.rows[0].rate > 10.0
    assert len(said) == 1, said
    assert said[0].startswith("swarm has a bug: ValueError: what nobody thought of (latest, line ")
    assert said[0].endswith("; poses go on")


def test_in_a_pipe_what_is_wrong_is_said_once_and_that_it_is_right_again(capsys):
    screen = Screen(Console(), as_json=False)
    good, bad = (
        PoseRow(1, 20.0, 0.01, 0.03),
        PoseRow(1, 20.0, 0.8, 0.03, "error", "no pose for 0.8 s"),
    )
    for row in (good, good, bad, bad, good):
        # one at a time: states that a terminal is too slow for are left out
        with screen.running():
            screen.show(BridgeState((row,), (), (), None))
    said = capsys.readouterr().out.splitlines()
    assert said == [
        "system 1: 20 poses/s, the newest 0.01 s old, 0.03 m from its estimate",
        "system 1: 20 poses/s, the newest 0.80 s old, 0.03 m from its estimate; no pose for 0.8 s",
        "system 1: 20 poses/s, the newest 0.01 s old, 0.03 m from its estimate",
    ]


def test_a_script_gets_a_line_a_second(capsys):
    screen = Screen(Console(), as_json=True)
    for _ in range(3):
        with screen.running():
            screen.show(STATE)
    with screen.running():
        screen.say("words")
    first, second, words = map(json.loads, capsys.readouterr().out.splitlines())
    assert first == second == bridge_object(STATE)
    assert words == {"event": "words"}


@pytest.mark.slow
@pytest.mark.usefixtures("in_real_time")
def test_a_check_says_what_each_vehicle_gets(tmp_path, capsys):
    """Two emulated vehicles in a world of its own; the body of the second one is frozen."""
    port, frames = free_port(), free_port()
    file = tmp_path / "lab.yaml"
    text = fleet_text(port).replace("links: [net]}", "links: [net], autopilot: ardupilot}")
    file.write_text(text)
    fleet = parse_fleet(text, "lab.yaml")
    world = bare_world(fleet) | {"biases": "default"}
    (tmp_path / "world.json").write_text(json.dumps(world))
    (tmp_path / "faults.yaml").write_text(
        "{schema: 1, faults: [{at: 0, kind: capture, vehicle: 2, error: frozen}]}"
    )
    sitl = [SWARM, "sitl", "--world", tmp_path / "world.json", "--target", f"127.0.0.1:{port}"]
    sitl += ["--mocap", f"127.0.0.1:{frames}", "--scenario", tmp_path / "faults.yaml"]
    with ExitStack() as stack:
        emulator = stack.enter_context(
            subprocess.Popen(sitl, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL)
        )
        stack.callback(emulator.terminate)
        assert emulator.stdout.readline()
        options = CheckOptions(mocap=f"udp://127.0.0.1:{frames}")
        report = check(fleet, tmp_path / "check", options=options)
    good, frozen = report.poses
    assert (good.system, good.problem, frozen.system) == (1, "", 2)
    assert good.rate > 10.0
    assert good.distance < 0.2
    # ArduPilot flies without a compass here, and MAVSDK calls that one unhealthy
    assert [f.message for f in report.findings if f.check == "health"] == [
        "system 1: healthy and armable", "system 2: healthy and armable",
    ]  # fmt: skip
    assert frozen.problem.startswith("no digit of its pose has changed for ")
    (line,) = [item for item in report.checklist() if item.check == "poses"]
    assert (line.go, line.subject) == (True, "poses of motion capture")
    assert line.message.startswith("warning: system 2: ")
    shown = check_object(report, None, tmp_path)["poses"]
    assert [row["system"] for row in shown] == [1, 2]
    assert shown == poses_object(report.poses)
    print_check(report, Console())
    printed = capsys.readouterr().out
    assert "no digit of its pose has changed" in printed
    assert f"this check sends the poses (udp://127.0.0.1:{frames}): they end with it" in printed
