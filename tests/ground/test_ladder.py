"""The order of first tests: what a record passes, what a fleet has passed, and who is refused."""

import io
import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest
from rich.console import Console

from swarm.cli.check import _step_findings
from swarm.errors import InputError, Refused
from swarm.flight.bench_flight import hop
from swarm.ground import ladder
from swarm.ground.fly import FlyOptions, fly
from swarm.ground.hop import fly_hop
from swarm.ground.ladder import (
    STEPS,
    PassedStep,
    enter,
    list_path,
    missing_steps,
    passed_steps,
    require_steps,
    step_of,
)
from swarm.ground.record_verification import parse_observation, verify_record
from swarm.mission.fleet import emulated_fleet
from swarm.planning import KnotSummary
from swarm.reports.check import steps_table
from swarm.reports.flight import print_record, record_object
from swarm.reports.result import drawn
from tests.command import run
from tests.network import small_plan

ROOT = Path(__file__).parents[2]
CARRY = str(ROOT / "missions" / "first-steps" / "two_carry.yaml")
REAL = """\
schema: 1
name: nine
links: {radio: "udpin://127.0.0.1:14993"}
vehicles:
  - {sysid: 1, links: [radio], autopilot: px4}
  - {sysid: 2, links: [radio], autopilot: px4}
"""


@pytest.fixture(autouse=True)
def state(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


def real_fleet(vehicles=3):
    return emulated_fleet(vehicles).model_copy(update={"emulated": None, "name": "nine"})


def knotted(vehicles=3):
    plan = small_plan(vehicles=vehicles).plan
    return replace(plan, knot=KnotSummary("3_1", "right", "", ()))


def entered(fleet, *steps, vehicles=3):
    """Write the list of a fleet that has passed these steps."""
    rows = [
        PassedStep(
            fleet.identity, step, vehicles, f"/flights/{step}", "2026-05-01T10:00:00+00:00", ""
        )
        for step in steps
    ]
    ladder._write([*ladder._read(), *rows])


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """The record of a flight of emulated vehicles that skipped a step."""
    folder = tmp_path_factory.mktemp("flight") / "record"
    fly(
        small_plan("vehicles.tracking=0.25"),
        emulated_fleet(3),
        folder,
        FlyOptions(speed=5.0, skipped=("hop", "carry")),
    )
    return folder


def as_real(folder):
    """Let a record say that its vehicles were real."""
    fleet = json.loads((folder / "fleet.json").read_text())
    (folder / "fleet.json").write_text(json.dumps({**fleet, "emulated": None, "name": "nine"}))
    facts = json.loads((folder / "versions.json").read_text())
    (folder / "versions.json").write_text(json.dumps({**facts, "world_start": None}))


@pytest.mark.slow
@pytest.mark.usefixtures("in_real_time")
def test_a_record_passes_its_step_until_it_does_not_verify_any_more(flown):
    assert enter(verify_record(flown)) is None
    assert not list_path().exists()
    before = {name: (flown / name).read_text() for name in ("fleet.json", "versions.json")}
    as_real(flown)
    try:
        row = enter(verify_record(flown))
        assert (row.step, row.vehicles, row.record) == ("pass", 3, str(flown))
        assert passed_steps(real_fleet()) == [row]
        assert passed_steps(real_fleet(2)) == []
        list_path().unlink()
        assert enter(verify_record(flown)) == row
        assert enter(verify_record(flown)) == row
        assert passed_steps(real_fleet()) == [row]
        verified = verify_record(flown)
        seen = parse_observation("3_1 right by camera", datetime.now(UTC))
        assert enter(verified.observed(seen)) is None
        assert passed_steps(real_fleet()) == []
        (flown / "observations.jsonl").unlink()
        summary = (flown / "summary.json").read_text()
        (flown / "summary.json").write_text(summary.replace('"done"', '"interrupted"', 1))
        assert enter(verify_record(flown)) is None
        (flown / "summary.json").write_text(summary)
        assert enter(with_errors(verified, "fold", 2, 0.9)) is None
        assert enter(with_errors(verified, "hold", 2, 0.9)) is None
        assert enter(with_errors(verified, "hold", 2, None)) is None
        assert enter(verified) == row
        facts = json.loads((flown / "versions.json").read_text())
        (flown / "versions.json").write_text(json.dumps({**facts, "world_start": 0.0}))
        assert enter(verify_record(flown)) is None
    finally:
        for name, text in before.items():
            (flown / name).write_text(text)


def with_errors(verified, phase, vehicle, largest):
    """Replace the largest tracking error of a vehicle in a phase; None: no position was known."""
    errors = verified.verification.tracking
    (old,) = [error for error in errors if (error.phase, error.vehicle) == (phase, vehicle)]
    new = [replace(old, largest=largest)] if largest is not None else []
    others = [error for error in errors if error is not old]
    return replace(verified, verification=replace(verified.verification, tracking=(*others, *new)))


@pytest.mark.slow
@pytest.mark.usefixtures("in_real_time")
def test_a_hop_far_off_its_setpoints_is_not_passed(tmp_path):
    plan, folder = small_plan("vehicles.tracking=0.25"), tmp_path / "hop"
    fly_hop(hop(plan), plan, emulated_fleet(3), folder, speed=15.0)
    as_real(folder)
    verified = verify_record(folder)
    assert verified.adherence.largest is None
    for phase, largest in (("hold", 0.3), ("hold", None), ("land", 0.6), ("land", None)):
        assert enter(with_errors(verified, phase, 3, largest)) is None
    passed = with_errors(with_errors(verified, "land", 3, 0.4), "takeoff", 3, 1.4)
    assert enter(passed).step == "hop"


@pytest.mark.slow
@pytest.mark.usefixtures("in_real_time")
def test_skipped_steps_are_in_record_and_report(flown):
    words = "flown with --skip-step; first tests not passed: hop, carry"
    assert json.loads((flown / "summary.json").read_text())["skipped_steps"] == ["hop", "carry"]
    assert words in (flown / "events.jsonl").read_text()
    verified = verify_record(flown)
    document = record_object(verified)
    assert document["skipped_steps"] == ["hop", "carry"]
    printed = io.StringIO()
    print_record(verified, document, Console(file=printed, width=200))
    assert words.replace("flown", "Flown") in printed.getvalue()


def test_steps_follow_from_what_is_flown():
    assert step_of(small_plan().plan, "hop", cable=False) == "hop"
    assert step_of(knotted(), "certified", cable=False) == "no cable"
    assert step_of(small_plan(vehicles=2).plan, "certified", cable=True) == "carry"
    assert step_of(small_plan().plan, "certified", cable=True) == "pass"
    assert step_of(knotted(), "certified", cable=True) == "knot"


def test_each_flight_with_cable_needs_the_steps_before_it():
    fleet = real_fleet()
    assert missing_steps(fleet, small_plan(vehicles=2).plan) == ["hop", "no cable"]
    assert missing_steps(fleet, knotted()) == ["hop", "no cable", "carry", "pass"]
    entered(fleet, "hop", "no cable", "carry", vehicles=2)
    assert missing_steps(fleet, small_plan(vehicles=2).plan) == []
    # the first two must be of all vehicles of the flight, with a knot and without
    assert missing_steps(fleet, small_plan().plan) == ["hop", "no cable"]
    assert missing_steps(fleet, knotted()) == ["hop", "no cable", "pass"]
    entered(fleet, "hop", "no cable", "pass", vehicles=3)
    assert missing_steps(fleet, knotted()) == []
    other = fleet.model_copy(update={"name": "other"})
    assert missing_steps(other, small_plan(vehicles=2).plan) == ["hop", "no cable"]


def test_a_measured_fleet_is_the_same_fleet_and_other_vehicles_are_not():
    fleet = real_fleet()
    same = fleet.model_copy(update={"tracking": 0.2, "links": {"loopback": "udpin://0.0.0.0:1"}})
    assert same.identity == fleet.identity
    assert real_fleet(2).identity != fleet.identity


def test_cable_is_refused_and_may_be_skipped_only_in_words():
    plan, fleet = small_plan(), real_fleet()
    with pytest.raises(Refused) as refused:
        require_steps(plan, fleet, no_cable=False, skip=False)
    for step in ("hop", "no cable", "carry"):
        assert STEPS[step][0] in str(refused.value)
    assert f"{STEPS['hop'][0]} of all 3 vehicles (" in str(refused.value)
    assert STEPS["pass"][0] not in str(refused.value)
    skipped = require_steps(plan, fleet, no_cable=False, skip=True)
    assert skipped == ("hop", "no cable", "carry")
    assert require_steps(plan, fleet, no_cable=True, skip=False) == ()
    assert require_steps(plan, emulated_fleet(3), no_cable=False, skip=False) == ()
    entered(fleet, *skipped)
    assert require_steps(plan, fleet, no_cable=False, skip=True) == ()


def test_the_command_refuses_before_it_opens_a_link(tmp_path):
    path = tmp_path / "fleet.yaml"
    path.write_text(REAL)
    said = run("fly", CARRY, "--fleet", str(path), "--record", str(tmp_path / "record"))
    assert said.returncode == 1
    assert "fleet nine has not passed the first tests before this flight" in said.stderr
    assert "--skip-step flies all the same" in said.stderr
    assert not (tmp_path / "record").exists()
    said = run("fly", CARRY, "--skip-step")
    assert said.returncode == 2
    assert "--skip-step needs --fleet" in said.stderr


def test_the_check_lists_the_steps_with_record_and_date():
    fleet = real_fleet()
    (finding,) = _step_findings(small_plan(), fleet)
    assert finding.severity == "warning"
    assert "two vehicles carry one strand (first-steps/two_carry.yaml)" in finding.message
    # swarm fly refuses it with any gripper
    assert _step_findings(small_plan(), fleet.model_copy(update={"gripper": "none"})) == [finding]
    entered(fleet, "hop", "no cable", "carry")
    (finding,) = _step_findings(small_plan(), fleet)
    assert finding.severity == "info"
    printed = io.StringIO()
    Console(file=printed, width=120).print(drawn(steps_table(passed_steps(fleet))))
    lines = printed.getvalue().splitlines()
    assert "2026-05-01" in lines[1]
    assert lines[1].rstrip().endswith("/flights/hop")
    assert "not passed" in lines[4]
    assert "first-steps/pass_over.yaml" in lines[4]


def test_a_damaged_list_is_named():
    list_path().parent.mkdir(parents=True)
    list_path().write_text("{}\n")
    with pytest.raises(InputError, match=r"first-tests\.jsonl:1: expected a passed first test"):
        passed_steps(real_fleet())
