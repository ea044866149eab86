"""Missions that were planned before: hits, misses, corrupt entries and several processes."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from swarm.front import plan_cache
from swarm.front.files import load_mission
from swarm.planner import PlanningResult, plan
from swarm.planning import digest
from tests.command import run
from tests.test_certified_plan_files import forged, reviewed

HOVER = str(Path(__file__).parents[1] / "missions" / "first-steps" / "hover.yaml")
_BEFORE = r"Planned before \(\d{4}-\d\d-\d\d \d\d:\d\d\); --replan plans again\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(plan_cache.VARIABLE, str(tmp_path / "plans"))
    return tmp_path / "plans"


def entries(folder: Path) -> list[Path]:
    return sorted(folder.iterdir())


def test_a_mission_is_planned_once(folder):
    first = run("plan", HOVER, "--json")
    assert (first.returncode, first.stderr) == (0, "")
    (entry,) = entries(folder)
    written = entry.stat().st_mtime_ns
    again = run("plan", HOVER, "--json")
    assert (again.returncode, again.stdout) == (0, first.stdout)
    assert re.fullmatch(_BEFORE, again.stderr)
    assert entry.stat().st_mtime_ns == written
    replanned = run("plan", HOVER, "--json", "--replan")
    assert (replanned.stdout, replanned.stderr) == (first.stdout, "")
    assert entry.stat().st_mtime_ns > written


def test_another_mission_is_another_entry(folder):
    one, other = load_mission(HOVER), load_mission(HOVER, ["vehicles.tracking=0.05"])
    plan_cache.store(one, plan(one))
    assert plan_cache.find(other) is None
    plan_cache.store(other, plan(other))
    assert len(entries(folder)) == 2
    found = plan_cache.find(one)
    assert found is not None
    assert digest(found[0].plan) == digest(plan(one).plan)


def test_other_sources_of_the_planner_plan_again(folder, monkeypatch):
    mission = load_mission(HOVER)
    plan_cache.store(mission, plan(mission))
    monkeypatch.setattr(plan_cache, "checks", lambda: "another version")
    assert plan_cache.find(mission) is None
    assert len(entries(folder)) == 1


@pytest.mark.parametrize("damage", ["truncated", "changed", "empty", "of another mission"])
def test_a_corrupt_entry_is_removed_and_planned_again(folder, damage):
    mission, other = load_mission(HOVER), load_mission(HOVER, ["hold_time=12"])
    planned = plan(mission)
    plan_cache.store(mission, planned)
    (entry,) = entries(folder)
    data = entry.read_bytes()
    if damage == "of another mission":
        plan_cache.store(other, plan(other))
        (foreign,) = set(entries(folder)) - {entry}
        foreign.rename(entry)
    else:
        half = len(data) // 2
        changed = data[:half] + bytes([data[half] ^ 0xFF]) + data[half + 1 :]
        entry.write_bytes({"truncated": data[:half], "changed": changed, "empty": b""}[damage])
    assert plan_cache.find(mission) is None
    assert entries(folder) == []
    plan_cache.store(mission, planned)
    assert entry.read_bytes() == data


def test_nothing_is_certified_because_an_entry_says_so(folder):
    certified = reviewed()
    mission = certified.plan.mission
    plan_cache.store(mission, PlanningResult(certified.plan, certified.certificate))
    assert plan_cache.find(mission)[0].assessment.robustness == certified.assessment.robustness
    (entry,) = entries(folder)

    def change(document) -> None:
        document["robustness"]["tracking"] = document["max_tracking_error"] = 0.9

    entry.write_bytes(forged("certificate.json", change))
    assert plan_cache.find(mission) is None
    assert entries(folder) == []


def test_refused_plans_are_not_kept(folder):
    assert run("plan", HOVER, "--set", "workspace.ceiling=3.5", "--json").returncode == 1
    assert not folder.exists()


def test_old_entries_are_not_read_and_many_are_bounded(folder, monkeypatch):
    mission = load_mission(HOVER)
    planned = plan(mission)
    plan_cache.store(mission, planned)
    (entry,) = entries(folder)
    old = time.time() - plan_cache.KEPT - 60.0
    os.utime(entry, (old, old))
    assert plan_cache.find(mission) is None
    stale = folder / "older.plan"
    stale.write_bytes(b"")
    os.utime(stale, (old, old))
    plan_cache.store(mission, planned)
    assert entries(folder) == [entry]
    recent = folder / "recent.plan"
    recent.write_bytes(b"0" * 100)
    past = time.time() - 60.0
    os.utime(recent, (past, past))
    monkeypatch.setattr(plan_cache, "MOST_BYTES", entry.stat().st_size + 50)
    plan_cache.store(mission, planned)
    assert entries(folder) == [entry]


def test_without_a_folder_nothing_is_kept(folder, monkeypatch):
    mission = load_mission(HOVER)
    planned = plan(mission)
    folder.parent.joinpath("file").write_text("")
    monkeypatch.setenv(plan_cache.VARIABLE, str(folder.parent / "file" / "plans"))
    plan_cache.store(mission, planned)
    assert plan_cache.find(mission) is None
    monkeypatch.setenv(plan_cache.VARIABLE, "")
    plan_cache.store(mission, planned)
    assert plan_cache.find(mission) is None


_STORE_AND_FIND = """
import sys
from swarm.front import plan_cache
from swarm.front.files import load_mission
from swarm.planner import PlanningResult, plan
mission = load_mission(sys.argv[1])
planned = plan(mission)
for _ in range(20):
    plan_cache.store(mission, planned)
    assert plan_cache.find(mission) is not None, "an incomplete entry was read"
"""


@pytest.mark.slow
def test_processes_write_and_read_the_same_entry(folder):
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", _STORE_AND_FIND, HOVER],
            stderr=subprocess.PIPE, text=True, cwd=Path(__file__).parents[1],
        )
        for _ in range(2)
    ]  # fmt: skip
    for process in processes:
        _, errors = process.communicate(timeout=120)
        assert (process.returncode, errors) == (0, "")
    assert len(entries(folder)) == 1
