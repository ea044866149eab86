"""Plan files, records and JSON of an older version: all are still read, and no key is gone."""

import json
import tarfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from swarm.front.plan_files import load_certified
from swarm.front.plans import load_plan
from swarm.ground.record_reader import recorded_events, recorded_flight, recorded_plan
from swarm.planning import digest
from swarm.version import __version__
from tests.command import run


@pytest.fixture(scope="module")
def older(tmp_path_factory):
    folder = tmp_path_factory.mktemp("older")
    with tarfile.open(Path(__file__).with_name("files.tar.xz")) as archive:
        archive.extractall(folder, filter="data")
    return folder


def printed(older, name):
    return json.loads((older / "json" / f"{name}.json").read_text())


def keys(value, path="") -> Iterator[str]:
    """Yield the paths of all keys of a JSON value; the items of a list have one path."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield f"{path}.{key}"
            yield from keys(item, f"{path}.{key}")
    elif isinstance(value, list):
        for item in value:
            yield from keys(item, f"{path}[]")


DIGESTS = {
    "two_carry": "3dd0848aaa0688a6745d902365ca33a82dabff6d6a2f54211ecc373f608ae07d",
    "pass_over": "62bef6f94b3f37f1ea665dcd55aa729d76998b96b6e1959be7f03c3daf249c81",
    "overhand_five": "5eb63eda8d9abc930e1a925270f9e703f70f57140eed13a4f409e5e67c147ad9",
}
"""Digests of the plans, as the older version printed them."""


@pytest.mark.parametrize("name", DIGESTS)
def test_an_older_plan_is_the_same_plan(name, older):
    assert digest(load_plan(older / f"{name}.plan")) == DIGESTS[name]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pass_over", "overhand_five"])
def test_an_older_plan_file_is_certified_anew(name, older):
    path = str(older / f"{name}.plan")
    planned, notice = load_certified(path)
    assert planned.certificate.cleared
    assert planned.certificate.digest == DIGESTS[name]
    first, *differences = notice.splitlines()
    assert first == (
        f"{path}: certified by another version of the program; all checks were computed again by "
        f"this one ({__version__}), and only their results count"
    )
    assert differences
    for line in differences:
        assert line == "  no figure differs" or " as computed again, " in line
    before = printed(older, "plan_of_a_knot")["knot"]
    if name == "overhand_five":
        assert planned.assessment.knot == before["type"]
        assert planned.assessment.chirality == before["chirality"]


@pytest.mark.slow
def test_an_older_record_is_verified_with_the_same_figures(older):
    said = run("verify", str(older / "record"), "--plan", str(older / "pass_over.plan"), "--json")
    now, before = json.loads(said.stdout), printed(older, "verify")
    plan = recorded_plan(older / "record")
    assert (said.returncode, said.stderr) == (1, "")  # an observed unknot is not a formation
    assert set(keys(before)) <= set(keys(now))
    for key in ("knot", "certificate", "observations"):
        assert now[key] == before[key]
    # reported positions are placed in time a little differently since then
    close = {"abs": 1e-3}
    assert now["max_chord_ratio"] == pytest.approx(before["max_chord_ratio"], **close)
    assert now["adherence"]["largest"] == pytest.approx(before["adherence"]["largest"], **close)
    for name, clearance in before["clearance"].items():
        flown = now["clearance"][name]["flown"]
        if clearance["flown"] is None:
            assert flown is None
        elif plan.phase_at(flown["time"]).name in {"fold", "hold"}:
            assert flown["between"] == clearance["flown"]["between"]
            assert flown["distance"] == pytest.approx(clearance["flown"]["distance"], **close)
        else:  # the whole flight counts now, and only these phases did
            assert flown["distance"] < clearance["flown"]["distance"]


def test_an_older_record_is_replayed(older):
    plan = recorded_plan(older / "record")
    log = recorded_flight(older / "record", plan)
    assert {"takeoff", "fold", "hold", "land"} <= set(log.trace.phase)
    assert np.isfinite(log.trace.position).any()
    assert len(list(recorded_events(older / "record"))) == 86


COMMANDS = {
    "plan": ("plan", "two_carry.plan"),
    "plan_of_a_knot": ("plan", "overhand_five.plan"),
    "dry-run": ("dry-run", "two_carry.plan"),
    "failures": (
        "failures", "two_carry.plan", "--filter", "motor", "--team", "px4", "--repeat", "1",
        "--jobs", "1", "-o", "failures.jsonl",
    ),
    "trials": ("trials", "two_carry.plan", "--count", "2", "--jobs", "1"),
    "knots": ("knots", "3_1"),
    "identify": ("identify", "curve.csv"),
    "certify": ("certify", "motion.csv", "--cable", "lengths.csv"),
    "fly": ("fly", "two_carry.plan", "--yes", "--speed", "10", "--record", "flown"),
    "check": ("check", "two_carry.plan", "--yes", "--record", "checked"),
    "rope": ("rope", "overhand_five.plan"),
}  # fmt: skip
"""Name of a JSON output → the command that printed it."""
_LONG = ("fly", "check", "rope")


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.full] * (n in _LONG)) for n in COMMANDS]
)
def test_no_public_key_is_gone(name, older, monkeypatch):
    monkeypatch.chdir(older)
    if name == "certify":
        assert run("export", "two_carry.plan", "--output", "motion.csv").returncode == 0
    now = json.loads(run(*COMMANDS[name], "--json").stdout)
    before = printed(older, name)
    assert sorted(set(keys(before)) - set(keys(now))) == []
    if name in {"failures", "knots", "identify"}:
        assert now == before  # failures: read from their file, not flown again
