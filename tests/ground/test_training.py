"""``swarm fly --scenario`` in real time: emulator process, record, verification and report."""

import hashlib
import json
from pathlib import Path

import pytest

from swarm.errors import InputError, Refused
from swarm.ground.fly import FlyOptions, fly
from swarm.ground.record_reader import recorded_training
from swarm.ground.record_verification import verify_record
from swarm.mission.fleet import emulated_fleet
from swarm.reports.flight import record_object
from swarm.simulation.training import read_training
from tests.command import run
from tests.network import small_plan

ROOT = Path(__file__).parents[2]
HOVER = str(ROOT / "missions" / "first-steps" / "hover.yaml")
SCENARIO = """\
schema: 1
faults:
  - {at: 62.0, kind: link, vehicle: 1, loss: 1.0, duration: 0.9}
spread: {failing: 0.0}
"""


@pytest.mark.slow
@pytest.mark.usefixtures("in_real_time")
def test_a_training_flight_from_command_to_report(tmp_path):
    path, folder = tmp_path / "lost.yaml", tmp_path / "flight"
    path.write_text(SCENARIO)
    said = run(
        "fly", HOVER, "--scenario", str(path), "--speed", "8", "--record", str(folder), "--json"
    )
    assert said.returncode == 0, said
    training = json.loads(said.stdout)["training"]
    assert training["digest"] == hashlib.sha256(SCENARIO.encode()).hexdigest()
    (fault,) = training["faults"]
    assert fault["detected"]["message"].startswith("silent: vehicle 1")
    assert 0.6 <= fault["detected"]["after"] <= 3.0
    assert fault["team"][0]["message"].startswith("holding")
    assert fault["operator"] is None
    assert json.loads((folder / "summary.json").read_text())["training"] == training
    events = (folder / "events.jsonl").read_text().splitlines()
    first = next(event for event in map(json.loads, events) if event["kind"] == "training")
    assert first["message"].startswith("training: lost.yaml injects faults (SHA-256 ")
    page = (folder / "report.html").read_text()
    assert "Training with emulated vehicles: lost.yaml injected faults" in page
    assert "<h2>Training</h2>" in page
    verified = verify_record(folder)
    assert record_object(verified)["training"] == training


def test_vehicles_that_are_not_emulated_are_refused_before_planning(tmp_path):
    path = tmp_path / "lost.yaml"
    path.write_text(SCENARIO)
    fleet = str(ROOT / "missions" / "fleets" / "px4_sitl.yaml")
    said = run("fly", HOVER, "--scenario", str(path), "--fleet", fleet)
    assert said.returncode == 1
    assert "are not emulated; faults are injected by the built-in emulator only" in said.stderr
    read = read_training(path)
    real = emulated_fleet(3).model_copy(update={"emulated": None})
    with pytest.raises(Refused, match="are not emulated"):
        fly(small_plan(), real, tmp_path / "r", FlyOptions(training=read.training((1, 2, 3))))
    assert not (tmp_path / "r").exists()


def test_a_fault_of_a_vehicle_that_does_not_fly_is_refused(tmp_path):
    path = tmp_path / "other.yaml"
    path.write_text("schema: 1\nfaults: [{at: 1.0, kind: freeze, vehicle: 9}]\n")
    for command in ("fly", "dry-run"):
        said = run(command, HOVER, "--scenario", str(path))
        assert said.returncode == 2
        assert "other.yaml: faults: expected vehicles 1, got 9" in said.stderr


def test_a_damaged_training_in_a_record_is_named(tmp_path):
    assert recorded_training(tmp_path) is None
    (tmp_path / "versions.json").write_text('{"training": {"scenario": 3}}')
    with pytest.raises(InputError, match="training: expected injected faults"):
        recorded_training(tmp_path)
    (tmp_path / "versions.json").write_text('{"training": null}')
    assert recorded_training(tmp_path) is None
