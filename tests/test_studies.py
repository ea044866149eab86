"""The Pareto front, and the table of all knots as its command prints and stores it."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from swarm.cli.knots import knots
from swarm.errors import InputError
from swarm.mission import mission_for_knot
from swarm.studies import (
    COLUMNS,
    COMPOSITE_AND_TORUS,
    FrontPoint,
    append_row,
    knots_to_plan,
    mark_dominated,
    numbers_of_vehicles,
    read_rows,
)

ROW = dict.fromkeys(COLUMNS) | {
    "knot": "3_1", "crossings": 3, "vehicles": 9, "grid_vehicles": 9, "least_vehicles": 5, "cleared": True, "cell": 2.5, "cable_length": 50.0,
    "fold_time": 99.0, "cable_clearance": 0.25, "cable_clearance_per_cell": 0.1, "planning_time": 3.0, "message": "",
}  # fmt: skip


def run(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(knots, ["--plan", *arguments], catch_exceptions=False)
    return result.exit_code, result.output


def said(*arguments: str) -> str:
    """What a command that is refused as bad usage or bad input says."""
    result = CliRunner().invoke(knots, arguments)
    if isinstance(result.exception, InputError):
        return str(result.exception)
    assert result.exit_code == 2
    return result.output


def test_all_prime_knots_to_ten_crossings_are_in_the_table() -> None:
    wanted = knots_to_plan()
    assert len(wanted) == 249 + len(COMPOSITE_AND_TORUS)
    assert {"3_1", "10_165", "granny", "torus(3,5)"} <= set(wanted)


def test_rows_in_a_file_are_printed_and_not_planned_again(tmp_path: Path) -> None:
    kept = tmp_path / "rows.jsonl"
    kept.write_text(json.dumps(ROW) + "\n" + '{"knot": "4_1", "cle')
    code, printed = run("--filter", "^3_1$", "--output", str(kept), "--csv")
    assert code == 0
    header, row = printed.strip().splitlines()[-2:]
    assert header == ",".join(COLUMNS)
    assert row.startswith("3_1,3,9,9,5,True,2.5,50.0,99.0,0.25,")
    code, printed = run("--filter", "^3_1$", "--output", str(kept), "--json")
    assert json.loads(printed[printed.index("[") :]) == [ROW]
    code, printed = run("--filter", "^3_1$", "--output", str(kept))
    assert "1 knots, 0 refused; 3 s of processor time" in printed


def test_a_refused_knot_has_a_reason_and_exit_code_1(tmp_path: Path) -> None:
    kept = tmp_path / "rows.jsonl"
    row = ROW | {"cleared": False, "cable_length": None, "message": "tried a cell of 2 m"}
    kept.write_text(json.dumps(row) + "\n")
    code, printed = run("--filter", "^3_1$", "--output", str(kept))
    assert code == 1
    assert "3_1: tried a cell of 2 m" in printed


def test_a_knot_that_cannot_be_planned_still_has_its_row(tmp_path: Path) -> None:
    kept = tmp_path / "rows.jsonl"
    code, _ = run("--filter", "^3_1$", "--output", str(kept), "--set", "layout.cell=0.5")
    assert code == 1
    row = json.loads(kept.read_text())
    assert (row["knot"], row["vehicles"], row["cleared"], row["cable_length"]) == (
        "3_1",
        9,
        False,
        None,
    )
    assert "layout.cell 0.5 m" in row["message"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--plan", "--filter", "zzz"], "--filter: no knot of the table matches 'zzz'"),
        (["--plan", "--filter", "("], "--filter: expected a regular expression, got '('"),
        (["--plan", "3_1"], "--plan is of many knots: use --filter instead of a NAME"),
        (["--csv"], "these options belong to --plan"),
    ],
)
def test_contradicting_options_are_a_usage_error(arguments: list[str], message: str) -> None:
    assert message in said(*arguments)


def test_a_row_that_an_interrupt_cut_off_is_written_anew(tmp_path: Path) -> None:
    kept = tmp_path / "rows.jsonl"
    whole = json.dumps(ROW) + "\n"
    kept.write_text(whole + whole[:40])
    assert list(read_rows(kept)) == [ROW["knot"]]
    append_row(kept, ROW | {"knot": "4_1"})
    assert list(read_rows(kept)) == [ROW["knot"], "4_1"]


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    kept = tmp_path / "rows.jsonl"
    kept.write_text("hello\n" + json.dumps(ROW) + "\n")
    message = f"{kept}: line 1: expected a row that --plan wrote"
    assert message in said("--plan", "--output", str(kept))


def point(vehicles: int, cable: float, fold: float, error: float, payload: float) -> FrontPoint:
    return FrontPoint("", vehicles, 2.0, cable, fold, error, payload)


def test_a_point_is_dominated_by_one_no_worse_in_any_figure() -> None:
    short, long = point(9, 50, 100, 0.1, 0.2), point(9, 60, 110, 0.2, 0.2)
    worse, fewer = point(9, 61, 110, 0.2, 0.2), point(5, 61, 110, 0.2, 0.2)
    lighter = point(9, 61, 110, 0.2, 0.1)
    marked = mark_dominated([short, long, worse, fewer, lighter])
    assert [one.dominated for one in marked] == [False, False, True, False, False]
    assert not any(one.dominated for one in mark_dominated([short, short]))


def test_the_front_has_every_number_of_vehicles_from_the_bound_to_the_grid() -> None:
    assert list(numbers_of_vehicles(mission_for_knot("4_1"))) == [6, 7, 8, 9, 10]
    assert not numbers_of_vehicles(mission_for_knot("4_1", ["vehicles.count=7"]))
    assert not numbers_of_vehicles(mission_for_knot("4_1", ["fold.method=paper"]))


def test_the_number_of_vehicles_can_be_given_for_a_table(tmp_path: Path) -> None:
    table = tmp_path / "table.jsonl"
    code, _ = run("--filter", "^3_1$", "--vehicles", "10", "--to", str(table))
    assert code == 1
    row = json.loads(table.read_text())
    assert (row["least_vehicles"], row["grid_vehicles"]) == (5, 9)
    assert row["message"].startswith("vehicles.count 10: at least 5 vehicles are needed")


def test_the_mean_share_of_vehicles_is_printed_where_there_are_fewer(tmp_path: Path) -> None:
    table = tmp_path / "table.jsonl"
    rows = [ROW | {"vehicles": 5}, ROW | {"knot": "4_1", "vehicles": 7, "grid_vehicles": 11}]
    table.write_text("".join(json.dumps(row) + "\n" for row in rows))
    _, printed = run("--filter", "^(3_1|4_1)$", "--to", str(table))
    assert "vehicles: 59.6% of 2N−1 in the mean" in printed
