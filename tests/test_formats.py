"""Plans and flights in the files of other programs, read by readers that are not ours."""

import io
import json
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from mcap_ros2.decoder import DecoderFactory as RosDecoderFactory
from ruamel.yaml import YAML

from swarm.certification.certificate import CertifiedPlan
from swarm.cli.exporting import export_plan
from swarm.flight.snapshot import Event
from swarm.flight.trace import Trace
from swarm.formats.crazyswarm import trajectory_files
from swarm.formats.foxglove import write_log
from swarm.formats.samples import sampled_flight, sampled_plan
from swarm.formats.skybrush import fitted, show_file
from swarm.formats.table import write_table
from swarm.front.plan_files import certified_plan_file
from swarm.geometry.motion import through_states
from swarm.ground.record_reader import recorded_flight, recorded_plan
from swarm.planner import PlanningResult
from swarm.planning.cable_shape import cable_shape
from tests import command
from tests.certification.conftest import certified_overhand
from tests.flight.test_resuming import BEGAN, cut_off_record
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
def cleared() -> CertifiedPlan:
    """A cleared plan of an overhand, of 100 pieces and more."""
    return certified_overhand()


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The record of a flight that was cut off in its fold."""
    return cut_off_record(tmp_path_factory.mktemp("flights") / "sideways")


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


def test_a_flight_is_a_ros_bag_that_another_reader_reads(record: Path, tmp_path: Path) -> None:
    bag = tmp_path / "flight.rosbag"
    assert command.run("export", str(record), "--output", str(bag)).returncode == 0
    plan = recorded_plan(record)
    flown = recorded_flight(record, plan)
    metadata = YAML(typ="safe").load((bag / "metadata.yaml").read_text())
    information = metadata["rosbag2_bagfile_information"]
    assert information["storage_identifier"] == "mcap"
    (name,) = information["relative_file_paths"]
    read: dict[str, list[Any]] = {}
    with (bag / name).open("rb") as file:
        reader = make_reader(file, decoder_factories=[RosDecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            read.setdefault(channel.topic, []).append(message)
    known = [k for k in range(len(flown.trace.time)) if np.isfinite(flown.trace.position[k, 1, 0])]
    poses = [xyz(one.pose.position) for one in read["/vehicle_2/position"]]
    assert poses == flown.trace.position[known, 1].tolist()
    assert {one.header.frame_id for one in read["/vehicle_2/setpoint"]} == {"map"}
    last = read["/vehicle_2/position"][-1].header.stamp
    began = flown.started + flown.trace.time[-1]
    assert last.sec + last.nanosec * 1e-9 == pytest.approx(began, abs=2e-6)
    assert read["/phase"][-1].data == "fold"
    frames = read["/tf"][-1].transforms
    assert [one.child_frame_id for one in frames] == ["vehicle_1", "vehicle_2", "vehicle_3"]
    cable = read["/cable"][-1].points
    assert xyz(cable[0]) == pytest.approx(flown.trace.position[-1, 0], abs=1e-6)
    assert xyz(cable[-1]) == pytest.approx(flown.trace.position[-1, 2], abs=1e-6)
    said = command.run("export", str(record), "--output", str(bag))
    assert (said.returncode, said.stderr) == (2, f"{bag}: file exists\n")


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
        ("record", "flight.csv", "expected a name that ends in .mcap, .parquet or .rosbag"),
        ("record", "flight", "expected a name that ends in .mcap, .parquet or .rosbag"),
        (
            "overhand",
            "plan.bag",
            "expected a name that ends in .crazyswarm, .csv, .mcap, .parquet, .rosbag or .skyc",
        ),
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
    message = "motion.txt: expected a name that ends in .crazyswarm, .csv, .mcap, .parquet, .rosbag or .skyc\n"
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
    assert f"{record / 'none' / 'a.mcap'}: no such folder: {record / 'none'}" in said.stderr


@pytest.mark.slow
def test_crazyswarm_trajectories_are_the_polynomials_of_the_plan(
    cleared: CertifiedPlan,
) -> None:
    overhand = cleared.plan
    texts = trajectory_files(cleared)
    assert list(texts) == [f"vehicle_{k}.csv" for k in range(1, overhand.vehicles + 1)]
    times = np.arange(0.0, overhand.duration, 0.01)
    planned = overhand.motion.at(times)[0]
    for vehicle, text in enumerate(texts.values()):
        # as crazyflie_py reads such a file: 33 columns after one line, lowest power first
        rows = np.loadtxt(text.splitlines(), delimiter=",", skiprows=1, usecols=range(33))
        starts = np.concatenate([[0.0], np.cumsum(rows[:, 0])])
        piece = np.searchsorted(starts[1:-1], times, side="right")
        since = times - starts[piece]
        read = [
            sum(rows[piece, 1 + 8 * axis + power] * since**power for power in range(8))
            for axis in range(4)
        ]
        assert np.abs(np.column_stack(read[:3]) - planned[:, vehicle]).max() < 1e-9
        assert not np.any(read[3])
        assert starts[-1] == pytest.approx(overhand.duration)


@pytest.mark.slow
def test_a_skybrush_show_is_within_a_millimetre_of_the_plan(cleared: CertifiedPlan) -> None:
    overhand = cleared.plan
    data, error = show_file(cleared)
    assert error <= 0.0006
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert archive.namelist() == ["show.json"]
        show = json.loads(archive.read("show.json"))
    assert show["version"] == 1
    assert show["environment"]["type"] == "outdoor"
    drones = show["swarm"]["drones"]
    assert [drone["settings"]["name"] for drone in drones] == list("123456789")
    times = np.arange(0.0, overhand.duration, 0.01)
    planned = overhand.motion.at(times)[0]
    for vehicle, drone in enumerate(drones):
        trajectory = drone["settings"]["trajectory"]
        assert (trajectory["version"], trajectory["takeoffTime"]) == (1, 0)
        moments, places, control = zip(*trajectory["points"], strict=True)
        assert control[0] == []
        steps = np.diff(moments)
        assert np.abs(steps * 1000 - np.round(steps * 1000)).max() < 1e-6
        assert steps.min() > 0.0005
        flown = np.array([bezier(moments, places, control, time) for time in times[:: 1 + vehicle]])
        apart = np.linalg.norm(flown - planned[:: 1 + vehicle, vehicle], axis=1)
        assert apart.max() < min(1.02 * error, 0.001)
        assert drone["settings"]["home"] == places[0]


def bezier(moments, places, control, time: float):
    """The place at a time by de Casteljau's construction."""
    k = min(int(np.searchsorted(moments, time, side="right")), len(moments) - 1)
    share = (time - moments[k - 1]) / (moments[k] - moments[k - 1])
    points = np.array([places[k - 1], *control[k], places[k]])
    assert len(points) == 4
    while len(points) > 1:
        points = (1 - share) * points[:-1] + share * points[1:]
    return points[0]


@given(
    steps=st.lists(st.floats(0.02, 3.0), min_size=1, max_size=4),
    seed=st.integers(0, 2**32 - 1),
)
def test_cubics_keep_their_tolerance_between_milliseconds(steps: list[float], seed: int) -> None:
    rng = np.random.default_rng(seed)
    times = np.concatenate([[0.0], np.cumsum(steps)])
    states = rng.normal(size=(3, len(times), 2, 3))
    states[1:, [0, -1]] = 0.0  # from rest to rest
    motion = through_states(times, *states)
    cubics = fitted(motion, 0.001)
    assert cubics.error <= 0.001
    moments = np.linspace(0.0, times[-1], 301)
    k = np.clip(np.searchsorted(cubics.times, moments * 1000, side="right") - 1, 0, None)
    k = np.minimum(k, len(cubics.points) - 1)
    share = (moments * 1000 - cubics.times[k]) / np.diff(cubics.times)[k]
    for place, points, s in zip(motion.at(moments)[0], cubics.points[k], share, strict=True):
        curve = points
        while len(curve) > 1:
            curve = (1 - s) * curve[:-1] + s * curve[1:]
        # the error was looked for at seven moments of each cubic: between them it is little larger
        assert np.linalg.norm(curve[0] - place, axis=1).max() < 0.0012


def test_a_plan_is_exported_for_programs_that_fly(tmp_path: Path) -> None:
    saved = tmp_path / "sideways.plan"
    saved.write_bytes(certified_plan_file(small_plan()))
    show = tmp_path / "sideways.skyc"
    said = command.run("export", str(saved), "-o", str(show))
    assert (said.returncode, said.stdout) == (0, f"{show}\n")
    without = "without waits at gates, grips, yaw and cable"
    assert re.search(rf"sideways\.skyc: at most 0\.\d mm from the plan; {without}\n", said.stderr)
    folder = tmp_path / "sideways.crazyswarm"
    said = command.run("export", str(saved), "-o", str(folder))
    assert said.returncode == 0
    pieces = len(small_plan().plan.motion.coefficients)
    assert f"{folder}: {pieces} pieces; {without}\n" in said.stderr
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["vehicle_1.csv", "vehicle_2.csv", "vehicle_3.csv"]
    said = command.run("export", str(saved), "-o", str(folder))
    assert said.returncode == 2
    assert f"{folder}: file exists\n" in said.stderr


@pytest.mark.slow
def test_more_pieces_than_a_crazyflie_holds_are_announced(
    cleared: CertifiedPlan, tmp_path: Path
) -> None:
    planned = PlanningResult(cleared.plan, cleared.certificate)
    pieces = len(cleared.plan.motion.coefficients)
    assert export_plan(planned, tmp_path / "overhand.crazyswarm") == (
        f"{pieces} pieces, more than the 31 that a Crazyflie's memory holds: stream them; "
        "without waits at gates, grips, yaw and cable"
    )


def test_a_refused_plan_is_not_exported_for_programs_that_fly(tmp_path: Path) -> None:
    paper = ("overhand", "--set", "fold.method=paper")
    show = tmp_path / "paper.skyc"
    said = command.run("plan", *paper, "--export", str(show))
    assert said.returncode == 1
    assert f"{show}: not written: the plan is refused\n" in said.stderr
    assert not show.exists()
