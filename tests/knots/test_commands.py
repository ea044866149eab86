"""``swarm knots`` and ``swarm identify`` in the terminal and in scripts."""

import json
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from swarm.cli.knots import identify, knots
from swarm.cli.main import cli
from swarm.errors import InputError
from swarm.knots.catalog import lookup_knot
from swarm.knots.diagram import Diagram
from swarm.knots.grid import grid_of_columns
from swarm.knots.invariants import identify_diagram
from tests.knots.curves import hung, knotinfo, lifted


def run(*arguments: str) -> Result:
    """Run a command; errors for the user are raised unchanged."""
    return CliRunner().invoke(cli, list(arguments), catch_exceptions=False, standalone_mode=False)


def test_a_knot_as_json() -> None:
    found = json.loads(run("knots", "8_18", "--json").output)
    assert list(found) == [
        "name",
        "crossings",
        "arc_index",
        "vehicles",
        "gauss",
        "dt",
        "chirality",
        "grid",
    ]
    assert (found["name"], found["crossings"], found["arc_index"]) == ("8_18", 8, 10)
    assert (found["vehicles"], found["chirality"], found["grid"]["size"]) == (19, "none", 10)
    grid = grid_of_columns(found["grid"]["columns"])
    assert identify_diagram(Diagram(grid.code)).name == "8_18"


def test_the_list_as_json() -> None:
    found = json.loads(run("knots", "--json").output)
    assert len(found) == 249
    assert [one["name"] for one in found[:3]] == ["3_1", "4_1", "5_1"]
    assert found[0] == json.loads(run("knots", "overhand", "--json").output)


def test_the_list_names_common_names() -> None:
    output = run("knots").output
    assert "overhand" in output
    assert "249 prime knots to ten crossings" in output


def test_a_knot_in_the_terminal_and_as_png(tmp_path: Path) -> None:
    picture = tmp_path / "knot.png"
    output = run("knots", "m3_1", "--plot", str(picture)).output
    assert "3_1, left-handed; its mirror image is another knot" in output
    assert "9, with 8 segments of cable" in output
    choice = lookup_knot("m3_1")
    drawing = output[output.index("  5  ") :]
    # Of the two marks of an edge each, one end of the cable and the removed corner show.
    assert drawing.count("●") == 2
    assert drawing.count("×") == 1
    assert sum(drawing.count(bend) for bend in "┌┐└┘") == 2 * choice.grid.size - 3
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.full
def test_the_table_of_all_knots_is_found_again_without_the_catalogue() -> None:
    found = json.loads(run("knots", "--table", "--json").output)
    assert [row for row in found if not row["right"]] == []
    for row in found:
        known = knotinfo()[row["name"]]
        assert row["found"] == row["arc_index"] == int(known["arc_index"])
        assert row["identified"] == row["name"]
        assert (row["chirality"] == "none") == ("amphicheiral" in known["symmetry_type"])
    assert len(found) == 249


def test_incompatible_options() -> None:
    assert CliRunner().invoke(knots, ["--plot", "x.png"]).exit_code == 2
    assert CliRunner().invoke(knots, ["3_1", "--table"]).exit_code == 2
    with pytest.raises(InputError, match='no knot is called "9_50" here'):
        run("knots", "9_50")


def write(path: Path, text: str) -> str:
    path.write_text(text, encoding="utf-8")
    return str(path)


def rows(points: np.ndarray, separator: str = ",") -> str:
    return "\n".join(separator.join(map(repr, point)) for point in points.tolist())


def test_curves_are_named(tmp_path: Path) -> None:
    cable = hung(lookup_knot("10_132").opening)
    file = write(tmp_path / "open.csv", "# a cable\n" + rows(cable))
    found = json.loads(run("identify", file, "--json").output)
    assert list(found) == ["name", "chirality", "crossings", "candidates", "invariants"]
    assert (found["name"], found["chirality"], found["crossings"]) == ("10_132", "right", 10)
    assert found["invariants"]["determinant"] == 5
    other = write(tmp_path / "closed.txt", rows(lifted(cable) * [1, -1, 1], " "))
    output = run("identify", other, "--closed").output
    assert "10_132, left-handed" in output
    assert "Jones polynomial" in output


def test_columns_may_be_named_and_more(tmp_path: Path) -> None:
    cable = hung(lookup_knot("4_1").opening, samples=5)
    lines = ["time;Z;y;X"] + [f"{k};{z};{y};{x}" for k, (x, y, z) in enumerate(cable.tolist())]
    file = write(tmp_path / "named.csv", "\ufeff" + "\r\n".join(lines) + "\r\n")
    assert json.loads(run("identify", file, "--json").output)["name"] == "4_1"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected at least 3 points, got 0"),
        ("0,0,0\n", "expected at least 3 points, got 1"),
        ("0,0,0\n1,0,0\n", "expected at least 3 points, got 2"),
        ("1 1 1\n" * 9, "expected at least 3 different points, got 1"),
        ("# x y z\n0 0 0\n1 0 0\n\n.5 0 0\n1 1 0\n", "line 3: the curve goes back along itself"),
        (
            "0 0 0\n2 0 0\n2 0 0\n2 1 0\n1 1 0\n1 -1 0\n",
            "lines 1 and 5: the segments of the curve that begin here meet",
        ),
        ("0 0 0\n1e308 0 0\n-1e308 1 0\n", "expected a curve of 1e-100 to 1e+100 in size, got inf"),
        (
            "0 0 0\n1 0 0\n1 0 1\n0 0 1\n0 0 2\n1 0 2\n",
            "the curve, closed straight up from its ends, is degenerate from every side: two strands",
        ),
        ("0,0,0\n1,0\n", "line 2: expected as many columns as line 1 has (3), got 2"),
        ("0,0,0\n1,nan,0\n", "line 2, column 2: expected a finite number, got 'nan'"),
        ("0,0,0\n1,one,0\n", "line 2, column 2: expected a number, got 'one'"),
        ("a,b,c\n1,2,3\n", "line 1: expected the columns x, y, z, got 'a, b, c'"),
        ("0 0 0\n1 0 x\n2\n", "line 2, column 3: expected a number, got 'x'"),
        (
            "0,0,0\n" + "7" * 200_000 + ",1,2\n",
            "line 2: not a table: field larger than field limit (131072)",
        ),
    ],
)
def test_invalid_files(tmp_path: Path, text: str, message: str) -> None:
    file = write(tmp_path / "wrong.csv", text)
    with pytest.raises(InputError) as caught:
        run("identify", file)
    assert message in str(caught.value)
    assert str(caught.value).startswith(file)
    assert CliRunner().invoke(identify, [str(tmp_path / "absent.csv")]).exit_code != 0


def test_a_curve_that_is_closed_onto_itself_is_refused(tmp_path: Path) -> None:
    file = write(tmp_path / "line.csv", "0 0 0\n1 0 0\n2 0 0\n")
    assert "0_1" in run("identify", file).output
    with pytest.raises(InputError, match=r"line.csv: line 1: the curve goes back along itself"):
        run("identify", file, "--closed")


def test_the_largest_torus_knots_are_not_searched_in_the_table() -> None:
    began = time.process_time()
    assert json.loads(run("knots", "torus(30,31)", "--json").output)["crossings"] == 899
    assert time.process_time() - began < 10.0  # it took 45 s


def test_a_tangle_is_refused_that_would_take_hours(tmp_path: Path) -> None:
    points = np.random.default_rng(1).normal(size=(200, 3))
    with pytest.raises(InputError, match="3563 crossings are left after the simple moves; at most"):
        run("identify", write(tmp_path / "tangle.csv", rows(points)))


def test_a_torus_knot_that_no_team_can_fly_is_refused_at_once() -> None:
    with pytest.raises(InputError) as caught:
        run("knots", "torus(1000001,3)")
    assert str(caught.value) == "torus(1000001,3) needs 2000007 vehicles; there are at most 249"
