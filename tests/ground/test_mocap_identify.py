"""Swapped, mirrored, turned, frozen, lost and flipping bodies of emulated vehicles are found."""

import json
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from sitl import Emulator
from sitl.faults import parse_scenario
from sitl.server import MotionCapture
from sitl.world import default_world
from swarm.flight.identification import Identification, Identified
from swarm.flight.router import Team
from swarm.flight.world import bare_world
from swarm.ground.commissioning.identify import moved_words
from swarm.ground.mocap import MocapBridge, parse_frame
from swarm.mission.fleet import emulated_fleet, parse_fleet
from tests.command import run
from tests.ground.test_mocap_bridge import fleet_text
from tests.ports import free_port
from tests.sitl.client import Ground

SWARM = Path(sys.executable).with_name("swarm")
SET_MESSAGE_INTERVAL = 511
ASK = "vehicle {}: lift it, lean it to its right, lift its nose, turn it by a quarter, and put it back"
GOOD = "vehicle {0} moves body {0}: attitude, heading and height agree"


class Frames:
    """The newest poses of an emulated laboratory, without a socket."""

    def __init__(self, source):
        self.source, self.port = source, None

    def latest(self):
        return parse_frame(self.source.frame())

    def close(self):
        self.source.close()


def hands(vehicle, at):
    return f"{{at: {at}, kind: handled, vehicle: {vehicle}, duration: 6}}"


def identified(*faults, autopilot="px4"):
    """Return what is said while three vehicles are moved in an emulated laboratory."""
    moves = [hands(1, 4.0), hands(2, 14.0), hands(3, 24.0)]
    scenario = parse_scenario(f"{{schema: 1, faults: [{', '.join([*moves, *faults])}]}}")
    described = default_world(3, [autopilot]).model_copy(update={"indoor": True})
    world = Emulator(described, scenario)
    ground = Ground(world)
    source = MotionCapture(world, ("127.0.0.1", 9))
    bridge = MocapBridge(Frames(source), Team(emulated_fleet(3), lambda *_: None))
    identification, said = Identification((1, 2, 3)), []
    for k in (1, 2, 3):
        ground.command(k, SET_MESSAGE_INTERVAL, 30, 50_000)
    while world.time < 34.0:
        ground.run(0.04)
        list(bridge.packets(world.time))
        attitudes = {
            k: (m.roll, m.pitch, m.yaw)
            for k in (1, 2, 3)
            if (m := ground.last.get((k, "ATTITUDE"))) is not None
        }
        said += identification.step(world.time, attitudes, bridge.bodies(world.time))
    source.close()
    assert identification.done, said
    return said, [finding.message for finding in identification.findings()]


def capture(error, vehicle=2, more=""):
    return f"{{at: 0.5, kind: capture, vehicle: {vehicle}, error: {error}{more}}}"


@pytest.mark.slow
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_every_vehicle_has_its_own_body(autopilot):
    said, found = identified(autopilot=autopilot)
    assert said == [text.format(k) for k in (1, 2, 3) for text in (ASK, GOOD)]
    assert found == [GOOD.format(k) for k in (1, 2, 3)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("error", "words"),
    [
        ("mirrored", "body 2 on vehicle 2 is mirrored: pitch and heading go the other way"),
        ("turned", "body 2 on vehicle 2 is turned by 90 degrees about the vertical: define its axes "
         "anew in the motion capture system, x forwards, y to the left"),
        ("flipping", "body 2 flips: its attitude jumps while vehicle 2 turns smoothly"),
        ("frozen", "body 2 is frozen: no digit of its pose changes while vehicle 2 moves"),
        ("lost", "body 2 is lost while vehicle 2 moves"),
    ],
)  # fmt: skip
def test_an_error_of_the_system_is_named(error, words):
    said, found = identified(capture(error))
    assert found == [GOOD.format(1), words, GOOD.format(3)]
    assert said == [ASK.format(1), GOOD.format(1), ASK.format(2), words, ASK.format(3),
                    GOOD.format(3)]  # fmt: skip


def test_swapped_bodies_are_named_and_what_is_wrong_with_each():
    said, found = identified(capture("swapped", 2, ", body: 3"), capture("turned", 1))
    assert "vehicle 2 moves body 3, not body 2" in said
    assert found[1:] == ["vehicle 2 moves body 3: bodies 2 and 3 are swapped"]
    assert found[0].startswith("body 1 on vehicle 1 is turned by 90 degrees")


def test_screens_name_the_vehicle_to_move_and_what_was_seen_of_the_others():
    seen = {1: Identified(1, 1), 2: Identified(2, 4), 3: Identified(3, None)}
    assert moved_words(Identification((1, 2, 3, 4, 5), 4, seen)) == {
        1: "moves its body",
        2: "moves body 4",
        3: "its body is wrong",
        4: "move this one now",
        5: "leave it on the ground",
    }


@pytest.mark.slow
@pytest.mark.usefixtures("in_real_time")
def test_the_command_guides_and_records(tmp_path):
    """Two vehicles in a world of their own, which somebody moves in turn, over UDP."""
    port, frames = free_port(), free_port()
    text = fleet_text(port).replace("links: [net]}", "links: [net], autopilot: px4}")
    (tmp_path / "lab.yaml").write_text(text)
    (tmp_path / "world.json").write_text(json.dumps(bare_world(parse_fleet(text, "lab.yaml"))))
    moves = [
        f"{{at: {8 + 7 * k}, kind: handled, vehicle: {k % 2 + 1}, duration: 5}}" for k in range(40)
    ]
    faults = [capture("swapped", 1, ", body: 2"), *moves]
    (tmp_path / "faults.yaml").write_text(f"{{schema: 1, faults: [{', '.join(faults)}]}}")
    sitl = [SWARM, "sitl", "--world", tmp_path / "world.json", "--target", f"127.0.0.1:{port}"]
    sitl += ["--mocap", f"127.0.0.1:{frames}", "--scenario", tmp_path / "faults.yaml"]
    with ExitStack() as stack:
        emulator = stack.enter_context(
            subprocess.Popen(sitl, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL)
        )
        stack.callback(emulator.terminate)
        assert emulator.stdout.readline()
        record = tmp_path / "record"
        done = run(
            "mocap", f"udp://127.0.0.1:{frames}", "--fleet", str(tmp_path / "lab.yaml"),
            "--identify", "--record", str(record), "--json",
        )  # fmt: skip
    assert done.returncode == 1, done.stderr
    shown, kept = json.loads(done.stdout), json.loads((record / "bodies.json").read_text())
    assert shown["passed"] is False
    assert shown["vehicles"] == [{"system": 1, "body": 2}, {"system": 2, "body": 1}]
    (finding,) = shown["findings"]
    assert finding["message"] == "vehicle 1 moves body 2: bodies 1 and 2 are swapped"
    assert kept["fleet"] == "lab"
    assert {key: kept[key] for key in ("passed", "vehicles", "findings")} == {
        key: shown[key] for key in ("passed", "vehicles", "findings")
    }
    assert "Propellers off." in done.stderr
    assert "vehicle 2 moves body 1, not body 2" in done.stderr


def test_without_a_bridge_it_needs_a_source(tmp_path):
    file = tmp_path / "lab.yaml"
    file.write_text(fleet_text(free_port()))
    done = run("mocap", "--fleet", str(file), "--identify", "--record", str(tmp_path / "new"))
    assert done.returncode == 1
    assert "no bridge of motion capture runs for this fleet: give a SOURCE" in done.stderr
    done = run("mocap", "--fleet", str(file))
    assert (done.returncode, "Missing argument 'SOURCE'" in done.stderr) == (2, True)
    done = run("mocap", "vrpn://x", "--fleet", str(file), "--record", str(tmp_path))
    assert (done.returncode, done.stderr.strip()) == (2, "--record needs --identify")
