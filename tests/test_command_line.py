"""The command line: exit codes, messages, JSON and files."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from swarm import verify
from swarm.cli.main import COMMANDS, report_bug
from swarm.errors import reason
from swarm.files import write_bytes
from swarm.front.plan_files import certified_plan_file, load_certified
from swarm.mission.fleet import with_tracking
from tests.command import run
from tests.overhand import OVERHAND as OVERHAND_FILE
from tests.overhand import planned_overhand

ROOT = Path(__file__).parent.parent
SWARM = Path(sys.executable).parent / "swarm"
OVERHAND = str(OVERHAND_FILE)
FLEET = str(ROOT / "missions" / "fleets" / "px4_sitl.yaml")
HOVER = str(ROOT / "missions" / "first-steps" / "hover.yaml")


def swarm(*arguments: str, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [SWARM, *arguments], capture_output=True, text=True, check=False, cwd=cwd, timeout=280
    )


def test_a_plan_for_a_fleet_has_its_measured_tracking_error(tmp_path: Path) -> None:
    fleet = tmp_path / "measured.yaml"
    fleet.write_text(with_tracking((ROOT / "missions/fleets/emulator.yaml").read_text(), 0.13))
    said = run("plan", HOVER, "--fleet", str(fleet), "--json", "--save", str(tmp_path / "a.plan"))
    assert said.returncode == 0, said.stderr
    assert said.stderr.startswith(
        "Planned for a tracking error of 0.13 m, as measured for fleet emulator; hover has 0.1 m"
    )
    assert load_certified(str(tmp_path / "a.plan"))[0].plan.mission.vehicles.tracking == 0.13
    again = run("plan", str(tmp_path / "a.plan"), "--fleet", str(fleet))
    assert again.returncode == 2
    assert f"--fleet: {tmp_path / 'a.plan'} is a plan file, which is not planned again" in (
        again.stderr.replace("\n", "")
    )


@pytest.mark.slow
def test_a_fleet_with_larger_errors_than_certified_is_refused(tmp_path: Path) -> None:
    fleet, plan = tmp_path / "measured.yaml", tmp_path / "carry.plan"
    fleet.write_text(with_tracking((ROOT / "missions/fleets/emulator.yaml").read_text(), 0.9))
    carry = str(ROOT / "missions" / "first-steps" / "two_carry.yaml")
    assert run("plan", carry, "--save", str(plan)).returncode == 0
    refused = run("fly", str(plan), "--fleet", str(fleet), "--record", str(tmp_path / "record"))
    assert refused.returncode == 1
    assert "vehicles were measured with a tracking error of 0.9 m" in refused.stderr
    assert not (tmp_path / "record" / "flight.tlog").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["plan", "nosuch.yaml"], "nosuch.yaml: no such file or directory"),
        (
            ["plan", OVERHAND.replace("overhand", "ovrhand")],
            "ovrhand.yaml: no such file or directory: did you mean overhand.yaml?",
        ),
        (
            ["plan", OVERHAND.replace("missions", "mision")],
            "mision: did you mean missions?",
        ),
        (["plan", OVERHAND, "--save", "nosuch/x.plan"], "nosuch/x.plan: no such folder: nosuch"),
        (["trials", OVERHAND, "--report", "nosuch/x.html"], "x.html: no such folder: nosuch"),
        (["plan", "nosuch"], 'nosuch: knot.name: no knot is called "nosuch" here'),
        (
            ["plan", "3_1", "--set", "cable.length=-3.0"],
            "3_1: cable.length: expected a length > 0 in metres, got -3.0",
        ),
        (
            ["plan", OVERHAND, "--set", "knot.gauss=1- 2+ 3- 1+ 2-"],
            "knot.gauss: crossing 3 is passed once (expected twice)",
        ),
        (["fly", "3_1", "--fleet", "nosuch.yaml"], "nosuch.yaml: no such file or directory"),
        (["check", "3_1", "--clock", "clock.bin", "--hop"], "--clock: expected --fleet and --hop"),
        (
            ["check", "3_1", "--fleet", FLEET, "--clock", "nosuch.bin", "--hop"],
            "nosuch.bin: expected the clock of a world that runs",
        ),
        (["plan", "3_1", "--colour"], "--colour"),
        (["nonsense"], "No such command 'nonsense'."),
        (["plam", "3_1"], "No such command 'plam': did you mean plan?"),
        (
            ["verify", "nosuch"],
            "nosuch: expected a flight record with plan.json and motion.npz in it",
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value[:2]),
)
def test_bad_input_exits_with_2_and_names_the_place(arguments: list[str], words: str) -> None:
    result = run(*arguments)
    assert result.returncode == 2
    assert result.stdout == ""
    assert words in result.stderr
    assert "Traceback" not in result.stderr


_WITHOUT_THE_PLANNER = """
import json, sys
from swarm.cli.main import main
sys.argv = ["swarm", *sys.argv[1:]]
try:
    main()
finally:
    sys.stderr.write(json.dumps(sorted({"numba", "scipy", "mavsdk"} & set(sys.modules))))
"""


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["plan", "nosuch.yaml", "--verbose"], "nosuch.yaml: no such file or directory"),
        (["trials", "overhandd"], "did you mean overhand?"),
        (["dry-run", "3_1", "--set", "vehicles.radius=250"], "got 250: did you mean 0.25?"),
        (["plan", "3_1", "--vehicles=-2"], "3_1: vehicles.count: "),
        (["fly", OVERHAND, "--fleet", "nosuch.yaml"], "nosuch.yaml: no such file or directory"),
    ],
)
def test_a_wrong_file_is_refused_before_the_planner_is_imported(
    arguments: list[str], words: str
) -> None:
    command = [sys.executable, "-c", _WITHOUT_THE_PLANNER, *arguments]
    result = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert result.returncode == 2
    message, libraries = result.stderr.split("[")
    assert words in message
    assert libraries == "]"


def test_the_installed_program_lists_its_commands_and_ends_with_its_codes() -> None:
    listed = swarm("--help")
    assert (listed.returncode, listed.stderr) == (0, "")
    named = listed.stdout[listed.stdout.index("Plan and simulate:") :]
    assert re.findall(r"^  ([a-z-]+)  ", named, re.MULTILINE) == list(COMMANDS)
    bad = swarm("plan", "nosuch.yaml")
    assert (bad.returncode, bad.stdout) == (2, "")
    assert bad.stderr == "nosuch.yaml: no such file or directory\n"


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(command: str) -> None:
    # The emulator takes this process's place.
    result = swarm(command, "--help") if command == "sitl" else run(command, "--help")
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.lower().startswith("usage: ")


def test_a_cleared_plan_exits_with_0() -> None:
    result = run("plan", HOVER, "--json")
    plan = json.loads(result.stdout)
    assert (result.returncode, plan["cleared"], plan["vehicles"]) == (0, True, 1)


@pytest.mark.slow
def test_the_papers_own_trajectory_is_shown_and_refused_because_strands_meet(
    tmp_path: Path,
) -> None:
    motion, picture = tmp_path / "motion.csv", tmp_path / "plan.png"
    result = run(
        "plan", OVERHAND, "--set", "fold.swing=auto", "--set", "fold.method=paper",
        "--json", "--export", str(motion), "--plot", str(picture),
    )  # fmt: skip
    plan = json.loads(result.stdout)
    assert result.returncode == 1
    assert plan["cleared"] is False
    assert "strands meet" in {f["check"] for f in plan["findings"] if f["severity"] == "error"}
    assert (plan["knot"]["type"], plan["knot"]["chirality"]) == ("3_1", "right")
    assert (plan["grid"]["size"], plan["vehicles"]) == (5, 9)
    assert sum(plan["cable"]["segments"]) == pytest.approx(plan["cable"]["total"])
    assert len(plan["cable"]["segments"]) == 8
    assert picture.read_bytes().startswith(b"\x89PNG")

    with motion.open() as file:
        rows = list(csv.DictReader(file))
    assert [row["vehicle"] for row in rows[:9]] == [str(vehicle) for vehicle in range(1, 10)]
    assert float(rows[9]["time"]) == 0.05
    assert float(rows[-1]["time"]) == pytest.approx(plan["duration"]["total"], abs=1e-6)
    phases = list(dict.fromkeys(row["phase"] for row in rows))
    assert phases == ["takeoff", "grab", "contract", "lift", "fold", "hold", "finish", "land"]


@pytest.mark.slow
@pytest.mark.usefixtures("in_real_time")
def test_the_overhand_flies_over_udp_and_leaves_its_record(tmp_path: Path) -> None:
    write_bytes(tmp_path / "overhand.plan", certified_plan_file(planned_overhand().certified()))
    result = swarm(
        "fly", "overhand.plan", "--speed", "20", "--record", "flight", "--json", cwd=tmp_path
    )
    assert result.returncode == 0, result.stderr
    flown = json.loads(result.stdout)
    assert flown["adherence"]["within"] is True
    assert flown["outcome"] == "done"
    assert flown["knot"]["as_planned"] is True
    assert (flown["knot"]["type"], flown["knot"]["chirality"]) == ("3_1", "right")
    assert {"cable", "floor", "rotor_disc"} <= set(flown["clearance"])
    assert not {"vehicle_fence", "cable_obstacle"} & set(flown["clearance"]), "there is none"
    for clearance in flown["clearance"].values():
        assert clearance["certified"]["distance"] >= clearance["certified"]["required"]
        assert clearance["flown"]["distance"] >= clearance["certified"]["required"]
    kept = {path.name for path in (tmp_path / "flight").iterdir()}
    wanted = {"mission.json", "plan.json", "flight.tlog", "events.jsonl", "flight.rrd"}
    assert wanted | {"summary.json", "report.html"} <= kept

    verified = run(
        "verify", str(tmp_path / "flight"), "--plan", str(tmp_path / "overhand.plan"), "--json"
    )
    assert verified.returncode == 0, verified.stderr
    assert json.loads(verified.stdout)["knot"] == flown["knot"]
    assert verify(tmp_path / "flight").passed

    other = str(tmp_path / "other.plan")
    assert run("plan", HOVER, "--save", other, "--json").returncode == 0
    refused = run("verify", str(tmp_path / "flight"), "--plan", other)
    assert (refused.returncode, refused.stdout) == (1, "")
    assert f"another plan than {other}: expected digest" in refused.stderr


@pytest.mark.slow
@pytest.mark.usefixtures("in_real_time")
def test_a_killed_emulator_is_explained_and_exits_with_3(tmp_path: Path) -> None:
    flight = subprocess.Popen(
        [SWARM, "fly", HOVER, "--speed", "20", "--record", "flight"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path,
    )  # fmt: skip
    assert flight.stdout is not None
    for line in flight.stdout:
        if "phase takeoff" in line:
            break
    listed = subprocess.run(
        ["ps", "-ww", "-o", "pid=,ppid=,args=", "-e"], capture_output=True, text=True, check=True
    ).stdout
    rows = [row.split(maxsplit=2) for row in listed.splitlines()]
    (pilot,) = [
        pid for pid, parent, args in rows if int(parent) == flight.pid and "flight_process" in args
    ]
    (emulator,) = [int(pid) for pid, parent, args in rows if parent == pilot and "sitl" in args]
    os.kill(emulator, signal.SIGKILL)
    _, errors = flight.communicate(timeout=120)
    assert flight.returncode == 3
    assert "the emulator ended (signal 9)" in errors
    assert "Traceback" not in errors


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "total", "knot"),
    [
        ("figure_eight", 52.48, "4_1"),
        pytest.param("carrick_mat", 105.63, "8_18", marks=pytest.mark.full),
    ],
)
def test_the_papers_tables_are_reproduced_and_refused(name: str, total: float, knot: str) -> None:
    result = run("plan", str(ROOT / "missions" / "paper" / f"{name}.yaml"), "--json")
    plan = json.loads(result.stdout)
    assert result.returncode == 1
    assert plan["knot"]["type"] == knot
    assert plan["cable"]["total"] == pytest.approx(total, abs=0.01)
    assert plan["sag"] == {"over": 1.5, "under": 2.0}
    wrong = [f["message"] for f in plan["findings"] if f["check"] == "crossing condition"]
    assert wrong == (
        ["segment 10 should pass over segment 3, but hangs 0.196 m below it where they cross"]
        if name == "carrick_mat"
        else []
    )


def test_a_start_that_is_not_planned_is_refused() -> None:
    result = run("plan", "3_1", "--set", "start=serpentine")
    assert result.returncode == 1
    assert result.stderr.strip() == (
        "start: serpentine is not planned: the fold begins on a straight line that takes most of "
        "the cable's length, so a bent lay line would save no space"
    )


def test_a_bug_is_reported_without_a_file_for_its_traceback(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "missing"))
    assert report_bug(ZeroDivisionError()) == 70
    assert capsys.readouterr().err == (
        "swarm has a bug: ZeroDivisionError: failed without a message (ZeroDivisionError)\n"
        "The traceback cannot be written: no such file or directory\n"
    )


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (ConnectionError(), "failed without a message (ConnectionError)"),
        (OSError("no words from the system"), "no words from the system"),
        (PermissionError(13, "Permission denied", "/a/path"), "permission denied"),
        (ValueError("  "), "failed without a message (ValueError)"),
    ],
)
def test_a_reason_is_never_empty(error, words):
    assert reason(error) == words


def test_a_reader_of_a_plan_that_leaves_early_is_no_error() -> None:
    """``swarm plan … | head -1`` ends with exit code 0, without a traceback."""
    with subprocess.Popen(
        [SWARM, "plan", HOVER], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as plan:
        assert plan.stdout is not None
        assert plan.stderr is not None
        plan.stdout.close()
        errors = plan.stderr.read()
    assert (plan.returncode, "Traceback" in errors) == (0, False), errors
