"""External trajectories: the export format in, the same assessment out, errors with their lines."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from swarm.certification.assessment import assess
from swarm.certification.motion_file import plan_of_motion, read_lengths, read_motion
from swarm.cli.certify import certify
from swarm.errors import InputError
from swarm.exports import motion_rows
from swarm.mission import mission_for_knot
from tests.certification.synthetic import moving, plan_of

HEADER = "time,vehicle,x,y,z,vx,vy,vz,ax,ay,az,phase"


def row(time, vehicle, phase="fold", x=0.0):
    return f"{time},{vehicle},{x},0,5,0,0,0,0,0,0,{phase}"


def problems(text):
    with pytest.raises(InputError) as error:
        read_motion(text, "m.csv")
    return [str(problem) for problem in error.value.problems]


@pytest.mark.slow
def test_an_exported_plan_is_imported_as_the_same_motion(overhand, overhand_assessed):
    text = "\n".join(motion_rows(overhand))
    motion = read_motion(text, "m.csv")
    plan = plan_of_motion(motion, overhand.layout.lengths, overhand.mission)
    times = np.linspace(0.0, overhand.duration, 777)
    assert np.abs(plan.motion.at(times)[0] - overhand.motion.at(times)[0]).max() < 2e-4
    assert [phase.name for phase in plan.phases] == [phase.name for phase in overhand.phases]
    assessment = assess(plan)
    assert assessment.cleared
    assert (assessment.knot, assessment.chirality) == ("3_1", "right")
    assert assessment.distances["cable"].distance == pytest.approx(
        overhand_assessed.distances["cable"].distance, abs=0.01
    )


def test_every_error_has_its_line():
    lines = [HEADER, row(0, 1), row(0, 2, "folding", 2), row("nan", 1), row(0.1, "x")]
    assert problems("\n".join(lines)) == [
        "m.csv: line 3, column 12: phase: expected one of takeoff, grab, contract, lift, fold, hold, unfold, "
        "lower, spread, descend, tighten, finish, land, got 'folding'",
        "m.csv: line 4, column 1: time: expected a finite number, got 'nan'",
        "m.csv: line 5, column 2: vehicle: expected 1, 2, … along the cable, got 'x'",
    ]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (
            ["time,vehicle,x"],
            "m.csv: line 1: expected the columns y, z, vx, vy, vz, ax, ay, az, phase, got "
            "'time, vehicle, x'",
        ),
        ([HEADER], "m.csv: expected at least 2 times, got 0"),
        ([HEADER, row(0, 1), row(1, 1)], "m.csv: expected at least 2 vehicles, got 1"),
        (
            [HEADER, row(0, 2)],
            "m.csv: line 2: expected vehicle 1, got 2 at 0 s",
        ),
        (
            [HEADER, row(0, 1), row(0, 3)],
            "m.csv: line 3: expected vehicle 2 at 0 s or vehicle 1 later, got 3 at 0 s",
        ),
        (
            [HEADER, row(0, 1), row(0, 2), row(1, 1), row(2, 1), row(2, 2)],
            "m.csv: expected 2 vehicles at 1 s, got 1",
        ),
        (
            [HEADER, row(1, 1), row(1, 2), row(0.5, 1), row(0.5, 2)],
            "m.csv: expected times to increase, got 0.5 s after 1 s",
        ),
    ],
)  # fmt: skip
def test_a_table_of_the_wrong_shape(lines, message):
    assert problems("\n".join(lines)) == [message]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (
            [row(0, 1, x="1e300"), row(0, 2)],
            "m.csv: line 2, column 3: x: expected -10000 to 10000, got '1e300'",
        ),
        (
            [row(t, v, x=2 * v) for t in (-(2.0**53), 8 - 2.0**53) for v in (1, 2)],
            "m.csv: line 2, column 1: time: expected -1e+06 to 1e+06, got '-9007199254740992.0'",
        ),
        (
            [row(t, v, x=2 * v) for t in (0, 1e-9) for v in (1, 2)],
            "m.csv: expected 0.0001 s or more between times, got 0.0 and 1e-09",
        ),
        (
            [row(t, v, x=2 * v) for t in (0, 2e4) for v in (1, 2)],
            "m.csv: expected at most 14400 s of motion, got 20000 s",
        ),
        (
            [row(t, v, x=2 * v) for t in (1.7e9, 1.7e9 + 13.0) for v in (1, 2)],
            "m.csv: line 2, column 1: time: expected seconds from the start, got 1700000000.0: a "
            "Unix stamp in seconds",
        ),
    ],
)
def test_numbers_out_of_range(rows, message):
    assert problems("\n".join([HEADER, *rows]))[0] == message


def test_vehicles_in_one_place_are_refused_without_dividing_by_their_distance():
    places = [[[0, 0, 5.0]] * 3] * 2
    rows = [
        f"{t},{v},{','.join(str(x) for x in place)},0,0,0,0,0,0,fold"
        for t, team in zip((0, 3), places, strict=True)
        for v, place in enumerate(team, start=1)
    ]
    motion = read_motion("\n".join([HEADER, *rows]), "m.csv")
    plan = plan_of_motion(motion, np.array([3.0, 3.0]), mission_for_knot("overhand"))
    checks = {finding.check for finding in assess(plan).findings if finding.severity == "error"}
    assert {"vehicle clearance", "neighbouring segments"} <= checks


@pytest.mark.parametrize(
    "text",
    ["[1.5, 2]", '{"segments": [1.5, 2]}', '{"cable": {"segments": [1.5, 2]}}', "1.5\n2\n",
     "length\n1.5\n2", "segment,length\n1,1.5\n2,2\n"],
)  # fmt: skip
def test_lengths_as_json_or_csv(text):
    assert read_lengths(text, "c").tolist() == [1.5, 2.0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1, -2]", "c: segment 2: expected a length > 0 and <= 10000 in metres, got -2"),
        ("[1, true]", "c: segment 2: expected a length > 0 and <= 10000 in metres, got True"),
        ("", "c: expected lengths, got none"),
        ("[1,", "c: line 1, column 4: not valid JSON: Expecting value"),
        (
            '{"cable": 3}',
            "c: expected a list of lengths, or an object with segments or cable.segments",
        ),
    ],
)  # fmt: skip
def test_wrong_lengths(text, message):
    with pytest.raises(InputError) as error:
        read_lengths(text, "c")
    assert str(error.value) == message


def test_lengths_must_fit_the_vehicles_and_some_cable_must_be_aloft():
    motion = read_motion(
        "\n".join([HEADER, *(row(t, v, x=2 * v) for t in (0, 1) for v in (1, 2))]), "m"
    )
    mission = mission_for_knot("overhand")
    with pytest.raises(InputError, match="expected 1 segments for 2 vehicles, got 2"):
        plan_of_motion(motion, np.array([3.0, 3.0]), mission)
    landed = read_motion(
        "\n".join([HEADER, *(row(t, v, "takeoff", 2 * v) for t in (0, 1) for v in (1, 2))]), "m"
    )
    with pytest.raises(InputError, match="expected rows in the phase fold or hold"):
        plan_of_motion(landed, np.array([3.0]), mission)


@pytest.fixture
def files(tmp_path):
    """A motion of two vehicles that carry one strand, and its cable."""
    places = [[[0, 0, 5.0], [2.5, 0, 5.0]], [[3, 0, 5.0], [5.5, 0, 5.0]]]
    plan = plan_of(moving([0, 6], places), [3.0])
    motion, cable = tmp_path / "motion.csv", tmp_path / "cable.json"
    motion.write_text("\n".join(motion_rows(plan)))
    cable.write_text("[3.0]")
    return str(motion), "--cable", str(cable)


def test_the_command_clears_and_refuses_with_its_exit_code(files):
    cleared = CliRunner().invoke(certify, [*files, "--json"])
    assert cleared.exit_code == 0, cleared.output
    shown = json.loads(cleared.stdout)
    assert shown["cleared"] is True
    assert cleared.stderr == (
        f"{files[0]}: 2 vehicles, 121 times, 0 to 6 s\n{files[2]}: 1 segment, 3.000 m in total\n"
    )
    assert shown["knot"]["type"] == "0_1"
    assert shown["clearance"]["vehicle"]["between"] == ["vehicle 1", "vehicle 2"]
    refused = CliRunner().invoke(certify, [*files, "--json", "--clearance", "vehicle=2.6"])
    assert refused.exit_code == 1
    wrong = [f for f in json.loads(refused.stdout)["findings"] if f["severity"] == "error"]
    assert [finding["check"] for finding in wrong] == ["vehicle clearance"]


def test_the_command_writes_a_page(files, tmp_path):
    page = tmp_path / "certificate.html"
    result = CliRunner().invoke(certify, [*files, "--json", "--report", str(page)])
    assert result.exit_code == 0, result.output
    assert "motion.csv: certificate" in page.read_text()
    assert "Smallest distances" in page.read_text()


def test_the_command_reports_bad_files_and_clearances(files, tmp_path):
    for arguments, words in (
        ([*files, "--clearance", "cable=-1"], "clearance.cable: expected a length > 0"),
        ([str(tmp_path / "none.csv"), *files[1:]], "none.csv: no such file"),
    ):
        result = CliRunner().invoke(certify, arguments)
        assert isinstance(result.exception, InputError)
        assert words in str(result.exception)


def test_a_motion_with_only_a_hold_is_certified():
    rows = [row(t, v, "hold", 2.5 * v) for t in (0, 6) for v in (1, 2)]
    motion = read_motion("\n".join([HEADER, *rows]), "m.csv")
    plan = plan_of_motion(motion, np.array([3.0]), mission_for_knot("overhand"))
    assert assess(plan).cleared
