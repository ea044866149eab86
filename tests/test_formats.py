"""Plans and flights in the files of other programs, read by readers that are not ours."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from swarm.flight.snapshot import Event
from swarm.flight.trace import Trace
from swarm.formats.mcap_log import write_log
from swarm.formats.samples import sampled_flight, sampled_plan
from swarm.formats.table import write_table
from swarm.ground.record import Record
from swarm.ground.record_reader import recorded_flight, recorded_plan
from swarm.planning.cable_shape import cable_shape
from tests import command
from tests.flight.test_resuming import BEGAN, Recorded
from tests.network import small_plan
from tests.reports.synthetic import trefoil_plan

TREFOIL = trefoil_plan()


def decoded(path: Path, topic: str) -> list[tuple[float, object]]:
    """Times in seconds and messages of a topic, by Foxglove's reader and schemas."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        return [
            (message.log_time * 1e-9, content)
            for _, _, message, content in reader.iter_decoded_messages(topics=[topic])
        ]


def figures(path: Path, topic: str) -> list[tuple[float, dict]]:
    """Times in seconds and objects of a JSON topic."""
    with path.open("rb") as file:
        found = make_reader(file).iter_messages(topics=[topic])
        return [(message.log_time * 1e-9, json.loads(message.data)) for _, _, message in found]


def xyz(point) -> list[float]:
    return [point.x, point.y, point.z]


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The record of a flight that was cut off in its fold."""
    folder = tmp_path_factory.mktemp("flights") / "sideways"
    flight = Recorded(small_plan())
    flight.until_phase("fold", 2.0)
    kept = Record(folder, BEGAN)
    kept.before(flight.flight_plan, flight.conductor.basis, flight.fleet, {})
    for event in flight.events:
        kept.event(event)
    kept.close()
    (folder / "flight.tlog").write_bytes(flight.tlog)
    return folder


def test_a_flight_is_an_mcap_log_with_vehicles_cable_frames_figures_and_events(
    record: Path, tmp_path: Path
) -> None:
    path = tmp_path / "flight.mcap"
    said = command.run("export", str(record), "--output", str(path))
    assert (said.returncode, said.stdout) == (0, f"{path}\n")
    plan = recorded_plan(record)
    flown = recorded_flight(record, plan)

    states = [figures(path, f"/vehicle_{k}/state") for k in (1, 2, 3)]
    clock = figures(path, "/mission")
    assert [time for time, _ in clock] == pytest.approx(flown.started + flown.trace.time, abs=2e-6)
    time, last = states[1][-1]
    assert time - BEGAN < 400.0
    assert list(last["position"].values()) == flown.trace.position[-1, 1].tolist()
    assert clock[-1][1]["phase"] == "fold"
    # the fold carries the line aside: reports are near the plan at the mission time that is logged
    planned = plan.motion.at(clock[-1][1]["mission_time"])[0]
    assert last["tracking_error"] < 0.2
    assert np.linalg.norm(planned[1] - list(last["position"].values())) < 0.2

    _, frames = decoded(path, "/tf")[-1]
    assert [one.child_frame_id for one in frames.transforms] == [f"vehicle_{k}" for k in (1, 2, 3)]
    above = np.array(xyz(frames.transforms[1].translation)) - flown.trace.position[-1, 1]
    assert above == pytest.approx([0.0, 0.0, plan.mission.vehicles.grip_offset])

    _, drawn = decoded(path, "/scene")[-1]
    vehicles, cable = drawn.entities
    assert [text.text for text in vehicles.texts] == ["1", "2", "3"]
    assert len(vehicles.cylinders) == 3
    assert len(cable.lines) == 2
    ends = [[xyz(line.points[0]), xyz(line.points[-1])] for line in cable.lines]
    assert np.array(ends) == pytest.approx(flown.trace.position[-1][[[0, 1], [1, 2]]], abs=1e-6)

    # events have a clock of their own in the record, which begins before the first packet
    lines = [json.loads(line) for line in (record / "events.jsonl").read_text().splitlines()]
    shown = decoded(path, "/events")
    assert [one.message for _, one in shown] == [f"{e['kind']}: {e['message']}" for e in lines]
    assert [at for at, _ in shown] == pytest.approx([BEGAN + e["time"] for e in lines], abs=2e-3)


def test_a_flight_is_a_parquet_table_with_a_column_per_figure(record: Path, tmp_path: Path) -> None:
    path = tmp_path / "flight.parquet"
    assert command.run("export", str(record), "--output", str(path)).returncode == 0
    plan = recorded_plan(record)
    flown = recorded_flight(record, plan)
    table = pq.read_table(path)
    assert table.column_names[:6] == [
        "time", "mission_time", "phase",
        "vehicle_1/position/x", "vehicle_1/position/y", "vehicle_1/position/z",
    ]  # fmt: skip
    assert table.num_columns == 3 + 3 * 7
    x = table["vehicle_3/setpoint/x"].to_numpy()
    assert np.array_equal(x, flown.trace.setpoint[:, 2, 0], equal_nan=True)
    assert float(table.schema.metadata[b"started"]) == flown.started
    assert json.loads(table.schema.metadata[b"mission"]) == plan.mission.document()


def test_unknown_positions_are_left_out_and_are_null(tmp_path: Path) -> None:
    plan = TREFOIL
    samples = sampled_plan(plan, 5.0)
    samples.vectors["position"][3, 4] = np.nan
    write_log(samples, tmp_path / "plan.mcap")
    write_table(samples, tmp_path / "plan.parquet")
    _, state = figures(tmp_path / "plan.mcap", "/vehicle_5/state")[3]
    assert "position" not in state
    assert "velocity" in state
    assert len(decoded(tmp_path / "plan.mcap", "/tf")[3][1].transforms) == 8
    column = pq.read_table(tmp_path / "plan.parquet")["vehicle_5/position/x"]
    assert column.null_count == 1
    assert column[3].as_py() is None


def test_the_cable_of_an_exported_plan_is_the_cable_of_the_plan(tmp_path: Path) -> None:
    write_log(sampled_plan(TREFOIL, 5.0), tmp_path / "plan.mcap")
    fold = TREFOIL.phase("fold")
    compared = 0
    for time, drawn in decoded(tmp_path / "plan.mcap", "/scene"):
        if fold.start <= time <= fold.end:
            lines = np.array([[xyz(p) for p in line.points] for line in drawn.entities[1].lines])
            # both are points of a segment's catenary, with the same shares of its length
            assert lines == pytest.approx(cable_shape(TREFOIL, time, lines.shape[1]), abs=0.02)
            compared += 1
    assert compared > 3


def test_events_of_the_team_and_of_a_vehicle_are_told_apart(tmp_path: Path) -> None:
    events = (Event(1.0, "held", "wind"), Event(2.0, "mode", "mode hold", 2))
    samples = sampled_plan(TREFOIL, 10.0)
    position = samples.vectors["position"]
    trace = Trace(samples.time, samples.mission_time, position, position, samples.phase)
    flown = sampled_flight(TREFOIL, trace, 1e9, events)
    write_log(flown, tmp_path / "flight.mcap")
    shown = decoded(tmp_path / "flight.mcap", "/events")
    assert [(round(at - 1e9, 3), one.name) for at, one in shown] == [
        (1.0, "team"),
        (2.0, "vehicle 2"),
    ]


@pytest.mark.parametrize(
    ("source", "name", "message"),
    [
        ("record", "flight.csv", "expected a name that ends in .mcap or .parquet"),
        ("record", "flight", "expected a name that ends in .mcap or .parquet"),
        ("overhand", "plan.bag", "expected a name that ends in .csv, .mcap or .parquet"),
    ],
)
def test_a_name_that_ends_otherwise_is_refused_at_once(
    record: Path, source: str, name: str, message: str
) -> None:
    given = str(record) if source == "record" else source
    said = command.run("export", given, "--output", name)
    assert (said.returncode, said.stderr) == (2, f"{name}: {message}\n")


def test_plan_refuses_such_a_name_before_it_plans() -> None:
    said = command.run("plan", "overhand", "--export", "motion.txt")
    message = "motion.txt: expected a name that ends in .csv, .mcap or .parquet\n"
    assert (said.returncode, said.stderr) == (2, message)


def test_a_record_is_not_planned_again_and_a_damaged_one_is_refused(record: Path) -> None:
    said = command.run("export", str(record), "-o", "a.mcap", "--replan", "--set", "a=1")
    assert said.returncode == 2
    assert said.stderr == (
        f"--set: {record} is a flight record, which is not planned again\n"
        f"--replan: {record} is a flight record, which is not planned again\n"
    )
    said = command.run("export", str(record.parent), "-o", "a.mcap")
    words = "expected a flight record with plan.json and motion.npz in it"
    assert (said.returncode, said.stderr) == (2, f"{record.parent}: {words}\n")
    said = command.run("export", str(record), "-o", str(record / "none" / "a.mcap"))
    assert said.returncode == 2
    assert said.stderr == f"{record / 'none' / 'a.mcap'}: no such file or directory\n"
