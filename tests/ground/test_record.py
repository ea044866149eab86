"""The flight record: complete, readable by other programs, and without delay for the flight."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common

from swarm.certification.findings import Finding
from swarm.errors import InputError
from swarm.flight.archive import certificate_document, read_certificate
from swarm.flight.flight_plan import basis_of
from swarm.flight.snapshot import Event
from swarm.ground.record import Record
from swarm.ground.record_reader import recorded_basis, recorded_certificate
from swarm.mavlink.packets import Encoder
from swarm.mission import parse_mission
from swarm.mission.fleet import emulated_fleet
from swarm.planning import digest
from swarm.planning.archive import plan_document, plan_motion, read_plan
from tests.network import small_plan

FLIGHT_PLAN = small_plan()


def test_a_plan_is_read_from_its_record_unchanged():
    plan = FLIGHT_PLAN.plan
    document = json.loads(json.dumps(plan_document(plan)))
    again = read_plan(document, plan_motion(plan))
    assert again.mission == plan.mission
    assert again.phases == plan.phases
    assert again.gates == plan.gates
    assert again.knot == plan.knot
    assert np.array_equal(again.motion.coefficients, plan.motion.coefficients)
    assert np.array_equal(again.layout.lengths, plan.layout.lengths)


MISSIONS = sorted((Path(__file__).parents[2] / "missions").glob("**/*.yaml"))


@pytest.mark.parametrize(
    "path",
    [path for path in MISSIONS if "knot:" in path.read_text() or "formation:" in path.read_text()],
    ids=lambda path: path.stem,
)
def test_every_mission_is_read_from_its_record_unchanged(path):
    """A formation has keys that are not allowed in its file; its record was not readable."""
    mission = parse_mission(path.read_text(), str(path))
    plan = replace(FLIGHT_PLAN.plan, mission=mission)
    document = json.loads(json.dumps(plan_document(plan)))
    again = read_plan(document, plan_motion(plan))
    assert again.mission == mission
    assert digest(again) == digest(plan)


@pytest.mark.parametrize(
    "break_it",
    [
        lambda document, motion: ({**document, "gates": 3}, motion),
        lambda document, motion: ({**document, "layout": {}}, motion),
        lambda document, _motion: (document, b"not an archive"),
        lambda document, motion: (document, motion[: len(motion) // 2]),
        lambda document, motion: ({k: v for k, v in document.items() if k != "knot"}, motion),
    ],
)
def test_a_broken_plan_is_an_input_error(break_it):
    document = json.loads(json.dumps(plan_document(FLIGHT_PLAN.plan)))
    with pytest.raises(InputError, match="the record's plan cannot be read"):
        read_plan(*break_it(document, plan_motion(FLIGHT_PLAN.plan)))


def test_pymavlink_reads_the_packets(tmp_path):
    record = Record(tmp_path / "new", start_time=1_700_000_000.0)
    encoder = Encoder(3, 1)
    for k in range(5):
        message = common.MAVLink_attitude_message(k, 0.1 * k, 0, 0, 0, 0, 0)
        record.packet(encoder.encode(message), 0.5 * k)
    record.close()
    log = mavutil.mavlink_connection(str(tmp_path / "new" / "flight.tlog"))
    messages = [log.recv_match(type="ATTITUDE") for _ in range(5)]
    log.close()
    assert [message.time_boot_ms for message in messages] == list(range(5))
    assert messages[4]._timestamp == pytest.approx(1_700_000_002.0)


def test_events_are_lines_of_json(tmp_path):
    record = Record(tmp_path, start_time=0.0)
    record.event(Event(1.5, "text", "Łódź", 3))
    record.close()
    (line,) = (tmp_path / "events.jsonl").read_text().splitlines()
    assert json.loads(line) == {"time": 1.5, "kind": "text", "message": "Łódź", "vehicle": 3}


def test_plan_and_certificate_are_written_before_the_flight(tmp_path):
    record = Record(tmp_path, start_time=0.0)
    basis = basis_of(FLIGHT_PLAN, cable=False)
    record.before(FLIGHT_PLAN, basis, emulated_fleet(3), {"speed": 2.0})
    record.close()
    document = json.loads((tmp_path / "plan.json").read_text())
    assert read_plan(document, (tmp_path / "motion.npz").read_bytes()).vehicles == 3
    assert json.loads((tmp_path / "versions.json").read_text())["speed"] == 2.0
    again, found = recorded_certificate(tmp_path)
    assert again == basis
    assert not again.cable
    kept = FLIGHT_PLAN.assessment
    assert (found.findings, found.robustness) == (kept.findings, kept.robustness)
    assert found.distances == kept.distances
    assert recorded_basis(tmp_path, FLIGHT_PLAN.plan) == basis
    other = small_plan(height=6.0).plan
    with pytest.raises(
        InputError, match=r"plan\.json: not the plan that certificate\.json belongs"
    ):
        recorded_basis(tmp_path, other)


@pytest.mark.parametrize(
    "wrong",
    [{}, {"cable": "yes"}, {"kind": "believed"}, {"clearance": {}}, {"findings": [3]}],
    ids=str,
)
def test_a_broken_certificate_is_an_input_error(wrong):
    document = certificate_document(basis_of(FLIGHT_PLAN, cable=True), FLIGHT_PLAN.assessment)
    broken = {**document, **wrong} if wrong else {}
    with pytest.raises(InputError, match="the record's certificate cannot be read"):
        read_certificate(json.loads(json.dumps(broken)))


def test_a_certificate_with_the_keys_of_older_records_is_read():
    finding = Finding("warning", "floor", "near the floor", 3.0, (1.0, 2.0, 3.0))
    found = replace(FLIGHT_PLAN.assessment, findings=(finding,))
    document = certificate_document(basis_of(FLIGHT_PLAN, cable=True), found)
    (written,) = document["findings"]
    written["at_time"], written["where"] = written.pop("time"), written.pop("position")
    _, again = read_certificate(json.loads(json.dumps(document)))
    assert again.findings == (finding,)


def test_a_full_disk_damages_the_record_only(tmp_path):
    record = Record(tmp_path, start_time=0.0)
    record._packets.close()
    record._packets = open("/dev/full", "wb", buffering=0)  # noqa: SIM115
    encoder = Encoder(1, 1)
    for k in range(100):
        record.packet(encoder.encode(common.MAVLink_heartbeat_message(2, 3, 0, 0, 0, 3)), float(k))
    record.event(Event(0.0, "text", "still here"))
    record.close()
    assert record.problem == "no space left on device"
    assert record.dropped == 100
    assert "still here" in (tmp_path / "events.jsonl").read_text()


def test_a_flight_does_not_overwrite_another(tmp_path):
    Record(tmp_path, start_time=0.0).close()
    with pytest.raises(InputError, match="holds the record of a flight"):
        Record(tmp_path, start_time=0.0)


def test_a_folder_that_cannot_be_used_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file"):
        Record(tmp_path / "file" / "record", start_time=0.0)
