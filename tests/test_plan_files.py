"""Plan files: the same plan is read, and all other files are refused."""

import io
import json
import zipfile
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from swarm.errors import InputError
from swarm.geometry.motion import Motion
from swarm.mission import parse_mission
from swarm.planning import digest
from swarm.planning.archive import plan_file, read_plan_file
from swarm.planning.candidates import make_plan
from tests.network import sideways
from tests.reports.synthetic import trefoil_plan

HOVER = "{schema: 1, name: hover, formation: {places: [[[0, 0, 3]], [[2, 0, 3]]]}}"


def hover():
    return make_plan(parse_mission(HOVER, "hover.yaml"))


@cache
def written():
    return plan_file(sideways())


def members(data=None):
    with zipfile.ZipFile(io.BytesIO(written() if data is None else data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def packed(parts):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in parts.items():
            archive.writestr(name, data)
    return buffer.getvalue()


def with_manifest(**changes):
    parts = members()
    parts["manifest.json"] = json.dumps(json.loads(parts["manifest.json"]) | changes).encode()
    return packed(parts)


def refusal(data):
    with pytest.raises(InputError) as error:
        read_plan_file(data, "a.plan")
    return str(error.value)


def without_path():
    return replace(sideways(), path=np.empty((0, 3)))


@pytest.mark.parametrize("make", [sideways, hover, trefoil_plan, without_path])
def test_a_plan_is_read_from_its_file_bit_by_bit(make):
    plan = replace(make(), notes=("said by the planner",))
    data = plan_file(plan)
    again = read_plan_file(data, "a.plan").plan
    assert digest(again) == digest(plan)
    assert again.notes == plan.notes
    assert again.path.shape == plan.path.shape
    assert again.path.tobytes() == plan.path.tobytes()
    assert plan_file(again) == data


def test_times_places_and_lengths_out_of_range_are_all_named():
    plan = sideways()
    times, coefficients = plan.motion.times - 2.0**40, plan.motion.coefficients.copy()
    times[1] = times[0] + 2.0**-12
    coefficients[0, 0, 1, 2] = -3e4
    far = replace(
        plan, motion=Motion(times, coefficients), path=np.full((2, 3), 1e300),
        layout=replace(plan.layout, lengths=np.full(len(plan.layout.lengths), 2e4)),
    )  # fmt: skip
    said = refusal(plan_file(far))
    place = "a.plan: the plan"
    for expected in (
        f"{place}: motion: times: expected times within ±1e+06 s, got -1.09951e+12 s",
        f"{place}: motion: vehicle 2: expected at most ±10000 m, got 30000 m",
        f"{place}: layout.lengths: segment 1: expected a length > 0 and <= 10000 in metres",
        f"{place}: path: expected coordinates within ±10000 m, got 1e+300 m",
        f"{place}: gates: expected -1.09951e+12 to",
    ):
        assert expected in said
    short = times + 2.0**40
    short[1] = short[0] + 2.0**-14
    said = refusal(plan_file(replace(plan, motion=Motion(short, plan.motion.coefficients))))
    assert said.startswith(f"{place}: motion: times: expected 0.0001 s or more between times")


def test_truncated_and_changed_files_are_refused():
    data = written()
    for length in (0, 1, len(data) // 2, len(data) - 1):
        assert refusal(data[:length]).startswith(
            "a.plan: expected a plan file, got another or incomplete"
        )
    for position in range(40, len(data), len(data) // 60):
        changed = bytearray(data)
        changed[position] ^= 0x10
        try:
            same = read_plan_file(bytes(changed), "a.plan").plan
        except InputError:
            continue
        assert digest(same) == digest(sideways())  # a bit of ZIP's own bookkeeping


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"time,vehicle,x,y,z", "a.plan: expected a plan file, got another or incomplete file"),
        (packed({"motion.npz": b""}), "got an archive without"),
        (packed({**members(), "manifest.json": b"[]"}), "a.plan: manifest.json: cannot be read"),
        (with_manifest(format="plan"), "a.plan: format: expected swarm plan, got plan"),
        (
            with_manifest(schema=3, swarm="9.9"),
            "a.plan: schema: expected 2, got 3: made by swarm 9.9, whose plan files differ",
        ),
        (
            packed({"manifest.json": b'{"format": "swarm plan", "schema": 1}'}),
            "a.plan: schema: expected 2, got 1: made by another version of swarm, whose plan files",
        ),
        (with_manifest(sha256=[]), "a.plan: manifest.json: cannot be read"),
        (with_manifest(digest="0" * 64), "a.plan: digest: expected 000"),
        (packed({**members(), "plan.json": b"{}"}), "a.plan: SHA-256 of plan.json: expected"),
        (
            packed({**members(), "motion.npz": members(plan_file(sideways(height=6.0)))["motion.npz"]}),
            "a.plan: SHA-256 of motion.npz: expected",
        ),
    ],
)  # fmt: skip
def test_every_other_file_is_refused_with_its_reason(data, said):
    assert said in refusal(data)
