"""A day at the field, from the box of vehicles to the debrief, as a user does it.

In the morning three emulated vehicles in a process of their own, on a link, so that the programs
take them for real ones; in the afternoon the nine of the built-in emulator. Everything is in real
time, and takes minutes.
"""

import getpass
import json
import os
import re
import subprocess
import time
from contextlib import ExitStack, contextmanager

import pytest

from swarm.flight.world import emulated_world
from swarm.front.plan_files import certified_plan_file
from swarm.mission.fleet import parse_fleet
from tests.command import run
from tests.console.test_server import Client
from tests.ground.test_corrections import rtcm
from tests.ground.test_mocap_bridge import SWARM
from tests.ground.test_screens import Terminal
from tests.network import small_plan
from tests.ports import free_port
from tests.view.test_foxglove_sink import decoded

pytestmark = [pytest.mark.full, pytest.mark.usefixtures("in_real_time")]

LOOSE = "vehicles.tracking=0.25"
"""These plans are not shaped: their cable pulls harder than those of missions."""
FENCED = "workspace.fence=[[-40, -40], [40, -40], [40, 40], [-40, 40]]"
INDOORS = "frame: shared\nrates: {setpoint: 50}\n"
OUTDOORS = "origin: {latitude: 47.397742, longitude: 8.545594, altitude: 488.0}\n"
PATIENCE = 300.0


class Field:
    """A folder with fleet and plan files, and the worlds in which the vehicles stand."""

    def __init__(self, folder, place):
        self.folder, self.port, self.frames = folder, free_port(), free_port()
        vehicles = "".join(f"  - {{sysid: {k}, links: [net], autopilot: px4}}\n" for k in (1, 2, 3))
        link = f'"udpin://127.0.0.1:{self.port}"'
        text = f"schema: 1\nname: lab\nlinks: {{net: {link}}}\nvehicles:\n{vehicles}{place}"
        self.file = str(folder / "fleet.yaml")
        (folder / "fleet.yaml").write_text(text)
        self.fleet = parse_fleet(text, "fleet.yaml")
        self.parameters = {}

    def plan_file(self, name, certified):
        (self.folder / name).write_bytes(certified_plan_file(certified))
        return str(self.folder / name)

    @contextmanager
    def world(self, certified, *faults, cable=True):
        """The vehicles on the pads of a plan, with the parameters that were set, and the bridge."""
        world = emulated_world(certified.plan, self.fleet, with_cable=cable, seed=1)
        for vehicle in world["vehicles"]:
            vehicle["parameters"] = self.parameters.get(vehicle["id"], {})
        (self.folder / "world.json").write_text(json.dumps(world))
        (self.folder / "faults.yaml").write_text(json.dumps({"schema": 1, "faults": faults}))
        sitl = [SWARM, "sitl", "--world", self.folder / "world.json", "--target"]
        sitl += [f"127.0.0.1:{self.port}", "--scenario", self.folder / "faults.yaml"]
        bridge = [SWARM, "mocap", f"udp://127.0.0.1:{self.frames}", "--fleet", self.file]
        with ExitStack() as stack:
            if world["indoor"]:
                sitl += ["--mocap", f"127.0.0.1:{self.frames}"]
                self._process(stack, bridge, "bridge.txt")
                until(lambda: "lab: poses from " in (self.folder / "bridge.txt").read_text())
            self._process(stack, sitl, "sitl.txt")
            yield

    def _process(self, stack, command, said):
        out = stack.enter_context((self.folder / said).open("w"))
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=out, stderr=out)
        stack.callback(process.wait)
        stack.callback(process.kill)

    def keep_parameters(self, record):
        """Let the vehicles have the parameters that a check saved, from now on."""
        self.parameters = {
            k: json.loads((self.folder / record / "parameters" / f"{k}.json").read_text())
            for k in (1, 2, 3)
        }

    def check(self, record, *more):
        """Return the code and the object of a check, and what is a no-go in its list."""
        done = run("check", *more, "--fleet", self.file, "--json", "--record",
                   str(self.folder / record))  # fmt: skip
        report = json.loads(done.stdout)
        no_go = {row["check"]: row["message"] for row in report["checklist"] if not row["go"]}
        return done.returncode, report, no_go


def passed(report):
    return [row["step"] for row in report["first_tests"] if row["passed"]]


@pytest.fixture
def state(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("state")
def test_indoors_from_the_first_pose_to_one_strand(tmp_path):
    field = Field(tmp_path, INDOORS)
    pair, three = small_plan(LOOSE, vehicles=2), small_plan(LOOSE)
    carry, passing = field.plan_file("carry.plan", pair), field.plan_file("pass.plan", three)

    # bodies that are swapped are found on the ground, with the poses of the bridge
    swapped = {"at": 0.5, "kind": "capture", "vehicle": 1, "error": "swapped", "body": 2}
    moves = [
        {"at": 15 + 7 * k, "kind": "handled", "vehicle": k % 3 + 1, "duration": 5}
        for k in range(40)
    ]
    with field.world(three, swapped, *moves):
        done = run("mocap", "--fleet", field.file, "--identify", "--record", "bodies", "--json")
        assert done.returncode == 1, done.stderr
        assert [finding["message"] for finding in json.loads(done.stdout)["findings"]] == [
            "vehicle 1 moves body 2: bodies 1 and 2 are swapped",
            "vehicle 3 moves body 3: attitude, heading and height agree",
        ]

    with field.world(three):
        # parameters of the box are a no-go; poses are seen; a fence has no place here
        code, report, no_go = field.check("first", passing, "--fence")
        assert code == 1
        assert set(no_go) == {"parameters", "fence"}
        assert [row["severity"] for row in report["poses"]] == ["info"] * 3
        code, report, no_go = field.check("fixed", passing, "--fix", "--yes")
        assert (code, no_go) == (0, {})
        assert passed(report) == []
        done = run("fly", passing, "--fleet", field.file, "--yes", "--record", "refused")
        assert done.returncode == 1
        assert "a hop of all 3 vehicles (swarm check MISSION --hop)" in done.stderr
        code, report, no_go = field.check("hop", passing, "--hop", "--yes")
        assert (code, passed(report)) == (0, ["hop"])
        field.keep_parameters("hop")

    flights = (("bare", passing, three, False), ("carry", carry, pair, True))
    for record, mission, certified, cable in flights:
        with field.world(certified, cable=cable):
            more = () if cable else ("--no-cable",)
            done = run("fly", mission, "--fleet", field.file, "--yes", "--record", record, *more)
            assert done.returncode == 0, done.stdout
            assert done.stderr.startswith("First test passed: ")


def until(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.1)


@pytest.mark.usefixtures("state")
def test_outdoors_corrections_and_the_fence(tmp_path):
    field, plan = Field(tmp_path, OUTDOORS), small_plan(FENCED)
    mission = field.plan_file("fenced.plan", plan)
    second = rtcm(1005, 25) + rtcm(1077, 360) + rtcm(1230, 20)
    (tmp_path / "base.rtcm").write_bytes(300 * second)
    corrections = ("--rtcm", f"file:{tmp_path / 'base.rtcm'}")
    with field.world(plan):
        code, report, no_go = field.check("first", mission, "--fix", "--yes", *corrections)
        assert (code, no_go) == (0, {})
        assert messages(report, "position") == [
            f"system {k}: 18 satellites, level to 0.01 m" for k in (1, 2, 3)
        ]
        assert "1005, 1077, 1230" in messages(report, "corrections")[0]
        code, report, no_go = field.check("fenced", mission, "--fence")
        assert messages(report, "fence") == [
            f"system {k}: has the mission's fence" for k in (1, 2, 3)
        ]
        code, report, no_go = field.check("restored", mission, "--restore", "first")
        assert "system 3: fence cleared" in report["parameters_set"]
        has_none = "has no fence; swarm check MISSION --fence uploads the mission's"
        assert messages(report, "fence") == [f"system {k}: {has_none}" for k in (1, 2, 3)]


def messages(report, check):
    return [row["message"] for row in report["findings"] if row["check"] == check]


@pytest.mark.usefixtures("state")
def test_the_afternoon_from_the_console_with_its_terminal_closed(tmp_path):
    record = str(tmp_path / "flight")
    console = ("--console", "127.0.0.1:0")
    with ExitStack() as stack:
        first = Terminal(tmp_path, "fly", "overhand", "--speed", "2", "--record", record, *console)
        first.until("starting: ", PATIENCE)
        anna = Client(stack, re.search(r"Console: (http://\S+)", first.text)[1])
        anna.join()
        anna.say(do="name", name="Anna")
        anna.say(do="take")

        def command(name, shows):
            anna.say(do="command", command=name)
            return anna.next("answer"), anna.next("state", shows)

        anna.next("state", lambda state: state["phase"] == "fold" and state["rate"] > 0.0)
        first.close()
        command("hold", lambda state: state["wait"] and state["rate"] == 0.0)
        _, held = command("resume", lambda state: state["rate"] > 0.0)
        assert len(held["rows"]) == 9
        command("rewind", lambda state: state["rate"] < 0.0)
        command("resume", lambda state: state["rate"] > 0.0)
        second = Terminal(tmp_path, "attach", record)
        second.until("resume by Anna")
        os.write(second.master, b"h")
        anna.next("state", lambda state: state["wait"] and state["rate"] == 0.0)
        command("resume", lambda state: state["rate"] > 0.0)
        command("abort", lambda state: state["phase"] == "contingency")
        anna.next("ended")
        second.until("Record: ")
        second.close()
    events = (tmp_path / "flight" / "events.jsonl").read_text()
    assert f"hold by {getpass.getuser()} at an attached terminal: " in events
    assert "the last screen is gone" not in events
    verified = run("verify", record, "--json")
    report = json.loads(verified.stdout)
    assert (verified.returncode, report["knot"]["as_planned"]) == (1, False)
    assert report["adherence"]["within"]
    for kind, row in report["clearance"].items():
        assert row["flown"] is None or row["flown"]["distance"] >= row["flown"]["required"], kind
    debrief = tmp_path / "flight.mcap"
    assert run("export", record, "--output", str(debrief)).returncode == 0
    shown = [event.message for _, event in decoded(debrief)["/events"]]
    for word in ("hold", "resume", "rewind", "abort"):
        asked = f"{word} by Anna (console 1): "
        assert asked in events
        assert any(asked in message for message in shown), shown
