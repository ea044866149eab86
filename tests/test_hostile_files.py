"""Files of other kinds, damaged and hostile ones: every reader refuses them in words, and soon."""

import io
import json
import random
import re
import shutil
import struct
import time
import zipfile
from contextlib import suppress
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl.faults import parse_scenario
from sitl.world import WorldError, parse_world
from swarm.certification.motion_file import read_lengths, read_motion
from swarm.errors import InputError
from swarm.exports import motion_rows
from swarm.files import replaced
from swarm.flight.archive import certificate_document, read_certificate
from swarm.flight.flight_plan import basis_of
from swarm.flight.tlog import packets
from swarm.front.files import load_fleet, load_mission
from swarm.ground.record_reader import (
    recorded_certificate,
    recorded_events,
    recorded_flight,
    recorded_plan,
)
from swarm.knots.curve import parse_curve
from swarm.mission.validation import parse_yaml
from swarm.planning.archive import read_plan_file
from swarm.simulation.spread import read_scenario
from swarm.studies import read_rows
from tests.command import run
from tests.flight.test_resuming import cut_off_record
from tests.network import sideways, small_plan
from tests.test_certified_plan_files import members, repacked, written

MISSIONS = Path(__file__).parents[1] / "missions"
LONGEST = 20.0
"""Seconds for which a reader may work on a hostile file, on a busy machine."""

BOMB = "\n".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 9) if before else 'x, x'}]"
    for before, name in zip(["", *"abcdefg"], "abcdefgh", strict=True)
)
HOSTILE = {
    "list": "- 1\n- 2\n",
    "number": "5\n",
    "nothing": "",
    "words": "hello\n",
    "motion": "time,vehicle,x,y,z\n0,1,0,0,5\n",
    "polynomials": "duration,x^0,x^1\n1.0,0,0\n",
    "brackets": "a: " + "[" * 5000,
    "closed brackets": "[" * 100_000 + "]" * 100_000,
    "dashes": "- " * 50_000 + "1",
    "keys": "? " * 5000,
    "own alias": "schema: 1\nname: t\nknot: {pd: &a [*a, *a]}\n",
    "bomb": BOMB,
    "number of thousands of digits": f"schema: 1\nname: 0x{'f' * 5000}\nhold_time: 0x{'f' * 5000}\n",
    "tag": "!!python/object/apply:os.system [true]\n",
    "keys that are lists": "{[1, 2]: 3}\n",
    "date": "schema: 2001-99-99\n",
    "control character": "schema: 1\0\n",
    "key twice": '{"schema": 1, "schema": 1}',
}


def from_file(reader):
    """Return a reader of text that is in a file."""

    def read(text: str, folder: Path) -> object:
        path = folder / "file.yaml"
        path.write_text(text, encoding="utf-8")
        return reader(path)

    return read


READERS = {
    "mission": from_file(lambda path: load_mission(str(path))),
    "fleet": from_file(load_fleet),
    "rows": from_file(read_rows),
    "world": lambda text, _: parse_world(text),
    "faults": lambda text, _: parse_scenario(text),
    "scenario": lambda text, _: read_scenario(text, "s.yaml"),
    "cable": lambda text, _: read_lengths(text, "l.csv"),
    "motion": lambda text, _: read_motion(text, "m.csv"),
    "curve": lambda text, _: parse_curve(text, "c.csv"),
    "plan": lambda text, _: read_plan_file(text.encode(), "a.plan"),
}
HARMLESS = {("rows", "nothing"), ("cable", "number")}
"""Tables of no knots, and of one length, are tables."""


@pytest.mark.slow
@pytest.mark.parametrize("kind", READERS)
@pytest.mark.parametrize("hostile", HOSTILE)
def test_files_of_other_kinds_are_refused(kind, hostile, tmp_path):
    if (kind, hostile) in HARMLESS:
        return
    began = time.process_time()
    with pytest.raises((InputError, WorldError)) as error:
        READERS[kind](HOSTILE[hostile], tmp_path)
    assert time.process_time() - began < LONGEST
    assert 0 < len(str(error.value)) < 5000


@pytest.mark.slow
def test_a_mission_of_too_many_values_is_refused():
    with pytest.raises(InputError, match=r"^m: expected at most 50,000 values$"):
        parse_yaml("[" + "1," * 60_000 + "1]", "m")


def test_commands_end_with_the_code_of_a_wrong_file(tmp_path):
    path = tmp_path / "list.yaml"
    path.write_text(HOSTILE["list"])
    for command in ("plan", "dry-run", "failures", "check"):
        said = run(command, str(path))
        assert (said.returncode, said.stderr) == (
            2, f"{path}: expected a mapping of keys, got [1, 2]\n",
        )  # fmt: skip
    ground = tmp_path / "ground.plan"
    ground.write_text('{"fileType": "Plan", "version": 1, "mission": {}}')
    assert run("plan", str(ground)).stderr == (
        f"{ground}: expected a plan file of swarm plan --save, got a plan of QGroundControl\n"
    )


NUMBER = re.compile(rb"-?[0-9]+(\.[0-9]+)?")
WILD = [
    b"1" + b"0" * 400,
    b"nan", b"1e400", b"-1", b"0", b"[]", b"{}", b"null", b'""', b"9007199254740993", b"1e300",
    b"true", b"[[1]]", b"\xff", b",", b"\n", b"*a", b"&a ", b"- ", b"NaN",
]  # fmt: skip


def damaged(data: bytes, seed: int) -> bytes:
    """Return data with a few of its numbers, bytes or pieces replaced, repeated or left out."""
    rng = random.Random(seed)
    for _ in range(rng.randint(1, 3)):
        numbers = [found.span() for found in NUMBER.finditer(data)]
        start = rng.randrange(len(data) + 1)
        end = min(len(data), start + rng.choice((1, 1, 4, 30)))
        if numbers and rng.random() < 0.5:
            start, end = rng.choice(numbers)
        new = rng.choice(WILD) if rng.random() < 0.7 else data[start:end] * rng.randint(0, 2)
        data = data[:start] + new + data[end:]
    return data


def refused_or_read(read, *arguments) -> None:
    """Read; only the errors that a user is shown may be raised."""
    with suppress(InputError, WorldError):
        read(*arguments)


@cache
def valid() -> dict[str, bytes]:
    """Return a valid file of each kind that people write."""
    plan = sideways()
    world = {
        "schema": 1,
        "vehicles": [{"id": 1, "autopilot": "px4", "pad": [0, 0, 0]}],
        "wind": {"mean": [1.0, 0.0, 0.0]},
    }
    return {
        "mission": (MISSIONS / "first-steps" / "two_carry.yaml").read_bytes(),
        "fleet": (MISSIONS / "fleets" / "emulator.yaml").read_bytes(),
        "rows": (MISSIONS / "knots.jsonl").read_bytes()[:3000],
        "world": json.dumps(world).encode(),
        "faults": b"schema: 1\nfaults:\n  - {at: 20, kind: weak_thrust, vehicle: 1, fraction: 0.5}\n",
        "scenario": next((MISSIONS / "scenarios").glob("*.yaml")).read_bytes(),
        "cable": b"length;note\n4,5;a\n4,25;b\n",
        "motion": "\n".join(list(motion_rows(plan))[:40]).encode(),
        "curve": b"x,y,z\n0,0,0\n1,0,0.5\n1,1,2\n",
    }


def read_damaged(kind: str, seed: int, folder: Path) -> None:
    text = damaged(valid()[kind], seed).decode("utf-8", "replace")
    refused_or_read(READERS[kind], text, folder)


@pytest.mark.parametrize("kind", [name for name in READERS if name != "plan"])
def test_damaged_files_are_read_or_refused(kind, tmp_path):
    for seed in range(20):
        read_damaged(kind, seed, tmp_path)


def test_a_motion_that_claims_more_than_memory_is_refused():
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (10000000000000,), }"
    header += b" " * (118 - len(header) - 1) + b"\n"
    array = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("times.npy", array)
        archive.writestr("coefficients.npy", array)
    with pytest.raises(InputError, match=r"a\.plan: the plan cannot be read"):
        read_plan_file(repacked("motion.npz", buffer.getvalue()), "a.plan")


@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**32),
    member=st.sampled_from(["plan.json", "certificate.json", "motion.npz"]),
)
def test_plan_files_whose_sums_agree_with_the_damage_are_read_or_refused(seed, member):
    data = damaged(members(written())[member], seed)
    refused_or_read(lambda: read_plan_file(repacked(member, data), "a.plan"))


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32))
def test_certificates_of_damaged_records_are_read_or_refused(seed):
    plan = small_plan()
    document = certificate_document(basis_of(plan, cable=True), plan.assessment)
    data = damaged(json.dumps(document).encode(), seed)

    def read() -> None:
        read_certificate(json.loads(data))

    try:
        json.loads(data)
    except ValueError:
        return
    refused_or_read(read)


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    return cut_off_record(tmp_path_factory.mktemp("flights") / "sideways")


def flown(record):
    return recorded_flight(record, recorded_plan(record)), list(recorded_events(record))


@pytest.mark.slow
def test_records_with_one_damaged_file_are_read_or_refused(record, tmp_path):
    for name in ("plan.json", "fleet.json", "certificate.json", "events.jsonl", "flight.tlog"):
        for seed in range(6):
            copy = shutil.copytree(record, tmp_path / f"{name}-{seed}")
            path = copy / name
            path.write_bytes(damaged(path.read_bytes(), seed))
            refused_or_read(flown, copy)
            refused_or_read(recorded_certificate, copy)


def test_stamps_in_nanoseconds_are_refused_and_leave_no_file(record, tmp_path):
    copy = shutil.copytree(record, tmp_path / "copy")
    stamps = [
        (int(now * 1e6), packet) for now, packet in packets((record / "flight.tlog").read_bytes())
    ]
    data = b"".join(struct.pack(">Q", stamp * 1000) + packet for stamp, packet in stamps)
    (copy / "flight.tlog").write_bytes(data)
    for suffix in (".mcap", ".parquet", ".rosbag"):
        said = run("export", str(copy), "--output", str(tmp_path / f"flown{suffix}"))
        assert (said.returncode, said.stdout, said.stderr) == (
            2, "", "the record's flight.tlog: expected stamps in microseconds since 1970, got "
            "nanoseconds\n",
        )  # fmt: skip
    assert sorted(path.name for path in tmp_path.iterdir()) == ["copy"]


@pytest.mark.parametrize("before", [None, b"old"])
def test_a_file_is_written_whole_or_not_at_all(before, tmp_path):
    path = tmp_path / "out.mcap"
    if before is not None:
        path.write_bytes(before)
    with suppress(struct.error), replaced(path) as new:
        new.write_bytes(b"begun")
        struct.pack(">B", 300)
    assert [one.read_bytes() for one in tmp_path.iterdir()] == ([] if before is None else [before])
    with replaced(path) as new:
        new.write_bytes(b"whole")
    assert [one.read_bytes() for one in tmp_path.iterdir()] == [b"whole"]
