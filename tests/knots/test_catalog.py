"""Names and codes → the knot to tie; the table against KnotInfo."""

import pytest

from swarm.knot_table import check_knot
from swarm.knot_table.tabulation import AMPHICHIRAL, diagram_of_conway, table_line, tabulate_knot
from swarm.knots.catalog import choose_knot, lookup_knot, table_names
from swarm.knots.diagram import Diagram
from swarm.knots.gauss import KnotError
from swarm.knots.grid import Grid, mirrored, openings
from swarm.knots.grid_search import GridWalk
from swarm.knots.invariants import chirality_sign, identify_diagram, jones_polynomial
from swarm.knots.table import knot_table, read_line
from tests.knots.curves import knotinfo, of_knotinfo

OVERHAND = "1- 2+ 3- 1+ 2- 3+"


@pytest.mark.parametrize(
    ("name", "knot"),
    [
        ("figure8", "4_1"),
        ("figure-8", "4_1"),
        ("figure_eight", "4_1"),
        ("Figure of eight knot", "4_1"),
        ("overhand knot", "3_1"),
        ("overhand-knot", "3_1"),
        ("carrickmat", "8_18"),
        ("true lovers' knot", "8_19"),
    ],
)
def test_common_names_are_known_however_their_words_are_joined(name, knot):
    assert lookup_knot(name).name == knot


@pytest.mark.slow
def test_the_table_is_all_of_knotinfos_to_ten_crossings() -> None:
    assert list(table_names()) == [
        name for name, row in knotinfo().items() if int(row["crossing_number"]) <= 10
    ]
    assert len(table_names()) == 249


def test_arc_index_determinant_and_symmetry_agree_with_knotinfo() -> None:
    for name, knot in knot_table().items():
        row = knotinfo()[name]
        assert knot.arc_index == int(row["arc_index"])
        assert knot.crossings == int(row["crossing_number"]) == knot.diagram.crossings
        assert knot.diagram.alternating == (row["alternating"] == "Y")
        determinant = abs(sum(c * (-1) ** power for power, c in knot.alexander))
        assert determinant == int(row["determinant"])
        assert knot.chiral == ("amphicheiral" not in row["symmetry_type"])
    assert {name for name, knot in knot_table().items() if not knot.chiral} == AMPHICHIRAL


def test_the_convention_of_chirality_holds_for_the_table() -> None:
    for knot in knot_table().values():
        assert jones_polynomial(knot.diagram) == dict(knot.jones)
        hand = chirality_sign(dict(knot.jones))
        assert hand == 0 if not knot.chiral else hand >= 0


@pytest.mark.slow
def test_every_grid_of_the_table_is_its_knot_and_can_be_opened() -> None:
    for knot in knot_table().values():
        known = identify_diagram(Diagram(knot.grid.code))
        assert (known.name, known.chirality) == (knot.name, "right" if knot.chiral else "none")
        opened = openings(knot.grid, limit=1)[0]
        assert len(opened.corners) == 2 * knot.arc_index - 1


@pytest.mark.parametrize("name", ["3_1", "4_1", "7_6", "8_19", "9_40", "10_165"])
def test_the_table_is_the_output_of_the_script(name: str) -> None:
    stored = knot_table()[name]
    notation = {"3_1": "3", "4_1": "22", "7_6": "2212", "8_19": "3,3,2-"} | {
        "9_40": "9*",
        "10_165": "8*2:.-20",
    }
    made = tabulate_knot(name, notation[name], moves=20_000, starts=0, steps=2)
    assert (made.dt, made.first_sign, made.jones) == (stored.dt, stored.first_sign, stored.jones)
    assert made.arc_index == stored.arc_index
    assert read_line(table_line(made)) == made
    assert identify_diagram(diagram_of_conway(notation[name])).name == name


@pytest.mark.parametrize("name", ["3_1", "8_18", "8_20", "9_42", "10_45", "10_132", "10_161"])
def test_small_grids_are_found_without_the_catalogue(name: str) -> None:
    row = check_knot(knot_table()[name])
    assert row.right
    assert row.found == int(knotinfo()[name]["arc_index"])


@pytest.mark.parametrize(
    "description",
    [
        {"name": "overhand"},
        {"name": "Trefoil knot"},
        {"name": "3_1"},
        {"name": "torus(2,3)"},
        {"gauss": OVERHAND},
        {"gauss": "7+ 5- 9+ 7- 5+ 9-"},
        {"gauss": "2+ 3- 1+ 2- 3+ 1-"},
        {"gauss": "3+ 2- 1+ 3- 2+ 1-"},
        {"gauss": "1- 2+ 3- 1+ 2- 4+ 4- 3+"},
        {"gauss": "-1, 2, -3, 1, -2, 3"},
        {"dt": [4, 6, 2]},
        {"dt": (-4, -6, -2)},
        {"pd": [[1, 4, 2, 5], [3, 6, 4, 1], [5, 2, 6, 3]]},
        {"gauss": "U1- O2- U3- O1- U2- O3-"},
        {"grid": [[2, 4], [3, 5], [1, 4], [2, 5], [1, 3]]},
        {"grid": Grid(((1, 3), (2, 5), (1, 4), (3, 5), (2, 4)))},
    ],
)
@pytest.mark.parametrize("chirality", ["left", "right"])
def test_every_description_of_the_overhand(description: dict[str, object], chirality: str) -> None:
    choice = choose_knot(**description, chirality=chirality)  # type: ignore[arg-type]
    assert (choice.name, choice.chirality) == ("3_1", chirality)
    assert (choice.grid.size, choice.vehicles, choice.crossings) == (5, 9, 3)
    fixed = "pd" in description or "grid" in description or "U" in str(description)
    assert fixed or choice.warnings == ()
    sign = 1 if chirality == "right" else -1
    for diagram in (choice.diagram, Diagram(choice.grid.code)):
        assert jones_polynomial(diagram) == dict(
            sorted({sign: 1, 3 * sign: 1, 4 * sign: -1}.items())
        )
    assert choice.gauss == choice.diagram.code.text()
    assert len(choice.opening.crossings) == 3


@pytest.mark.parametrize("step", [12, pytest.param(1, marks=pytest.mark.full)])
def test_knotinfos_gauss_dt_and_pd_codes_are_identified_alike(step: int) -> None:
    for name in table_names()[::step]:
        row = knotinfo()[name]
        codes = {"gauss": row["gauss_notation"]} | {
            key: of_knotinfo(name, f"{key}_notation") for key in ("dt", "pd")
        }
        for key, code in codes.items():
            choice = choose_knot(**{key: code}, chirality="either")  # type: ignore[arg-type]
            assert choice.name == name
            assert choice.grid.size == int(row["arc_index"])


def test_codes_are_kept_as_they_were_written() -> None:
    assert choose_knot(gauss=OVERHAND, chirality="left").gauss == OVERHAND


def test_chirality_of_descriptions() -> None:
    assert choose_knot(gauss="U1- O2- U3- O1- U2- O3-").chirality == "left"
    assert choose_knot(pd=[[1, 5, 2, 4], [3, 1, 4, 6], [5, 3, 6, 2]]).chirality == "right"
    assert choose_knot(name="m3_1").chirality == "left"
    assert choose_knot(name="left trefoil").chirality == "left"
    assert choose_knot(name="torus(-2,3)").chirality == "left"
    assert choose_knot(name="4_1").chirality == "none"
    assert choose_knot(name="4_1", chirality="left").chirality == "none"
    assert choose_knot(name="square").chirality == "none"
    assert choose_knot(name="m3_1", chirality="either").chirality == "left"
    assert choose_knot(name="3_1", chirality="either").chirality == "right"
    assert choose_knot(gauss=OVERHAND, chirality="either").chirality == "right"
    for description in ({"name": "overhand"}, {"gauss": OVERHAND}, {"dt": [4, 6, 2]}):
        with pytest.raises(KnotError) as caught:
            choose_knot(**description)  # type: ignore[arg-type]
        assert str(caught.value) == (
            "3_1 is chiral and the description fits both mirror images: "
            "set chirality: left, right or either"
        )


def test_a_grid_of_the_opposite_chirality_is_mirrored() -> None:
    left = mirrored(knot_table()["5_2"].grid)
    choice = choose_knot(grid=left, chirality="right")
    assert choice.warnings == (
        "the given knot is left-handed: its mirror image is tied, as required",
    )
    assert choose_knot(grid=left, chirality="either").chirality == "left"
    assert identify_diagram(Diagram(choice.grid.code)).candidates == ("5_2",)
    assert choose_knot(grid=left).grid == left


def test_a_given_grid_is_kept() -> None:
    walk = GridWalk(knot_table()["4_1"].grid, seed=1)
    walk.stabilise()
    larger = walk.grid()
    choice = choose_knot(grid=larger)
    assert (choice.name, choice.grid) == ("4_1", larger)
    assert choice.warnings == (
        "the grid given is kept; this knot has one of size 6, for 11 vehicles instead of 13",
    )


@pytest.mark.parametrize(
    ("description", "message"),
    [
        ({}, "expected one of name, gauss, dt, pd or grid, got none"),
        (
            {"name": "3_1", "dt": [4, 6, 2]},
            "expected one of name, gauss, dt, pd or grid, got name and dt",
        ),
        (
            {"name": "3_1", "chirality": "up"},
            'chirality: expected left, right or either, got "up"',
        ),
        (
            {"name": "bowline"},
            'no knot is called "bowline" here; `swarm knots` lists the names',
        ),
        ({"name": "8_22"}, 'no knot is called "8_22" here; `swarm knots` lists the names'),
        (
            {"name": "GaussCode[1]"},
            'no knot is called "GaussCode[1]" here; a code stands in a mission file, as knot: '
            "{dt: …} or {gauss: …}; `swarm knots` lists the names",
        ),
        (
            {"name": "m3_1", "chirality": "right"},
            '"m3_1" is left-handed, but chirality says right',
        ),
        ({"name": "torus(2,4)"}, "torus(2,4) is a link of 2 components, not a knot"),
        (
            {"gauss": OVERHAND + " 4- 5+ 6- 4+ 5- 6+", "chirality": "right"},
            "the code can mean any of 3_1#3_1, 3_1#m3_1: give crossing signs or a name",
        ),
    ],
)
def test_descriptions_that_are_refused(description: dict[str, str], message: str) -> None:
    with pytest.raises(KnotError) as caught:
        choose_knot(**description)  # type: ignore[arg-type]
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("name", "table_name", "chirality", "size"),
    [
        ("figure-eight", "4_1", "none", 6),
        ("Figure Eight Knot", "4_1", "none", 6),
        ("carrick mat", "8_18", "none", 10),
        ("Carrick-Mat", "8_18", "none", 10),
        ("cinquefoil", "5_1", "right", 7),
        ("stevedore", "6_1", "right", 8),
        ("true lover's knot", "8_19", "right", 7),
        ("granny knot", "3_1#3_1", "right", 8),
        ("reef knot", "3_1#m3_1", "none", 8),
        ("m8_19", "8_19", "left", 7),
        ("M3_1#m3_1", "3_1#3_1", "left", 8),
        ("3_1 # 4_1", "3_1#4_1", "right", 9),
        ("trefoil#figure-eight", "3_1#4_1", "right", 9),
        ("torus(2,9)", "9_1", "right", 11),
        ("T(3,5)", "10_124", "right", 8),
        ("torus(3,7)", "unknown", "right", 10),
        ("torus(7,-3)", "unknown", "left", 10),
        ("unknot", "0_1", "none", 2),
    ],
)
def test_names(name: str, table_name: str, chirality: str, size: int) -> None:
    choice = lookup_knot(name)
    assert (choice.name, choice.chirality, choice.grid.size) == (table_name, chirality, size)
    assert jones_polynomial(Diagram(choice.grid.code)) == jones_polynomial(choice.diagram)
    assert choice.title == ("torus(3,7)" if table_name == "unknown" else "")
    assert choice.vehicles == 2 * size - 1
    assert len(choice.opening.corners) == choice.vehicles


def test_an_unknot_has_a_warning() -> None:
    for description in ({"name": "unknot"}, {"gauss": "1+ 1-"}, {"gauss": "1+ 2+ 2- 1-"}):
        choice = choose_knot(**description)  # type: ignore[arg-type]
        assert (choice.name, choice.grid.size) == ("0_1", 2)
        assert choice.warnings == ("this is the unknot: the cable will not be knotted",)


def test_a_knot_outside_the_table_is_tied_from_its_own_code() -> None:
    row = knotinfo()["11n_38"]
    gauss = row["gauss_notation"]
    choice = choose_knot(gauss=gauss, chirality="left")
    assert choice.name == "unknown"
    assert choice.chirality == "left"
    assert chirality_sign(jones_polynomial(choice.diagram)) == -1
    assert jones_polynomial(Diagram(choice.grid.code)) == jones_polynomial(choice.diagram)
    assert choice.grid.size == int(row["arc_index"])
    assert choice.warnings == (
        "this knot is not in the table of knots to ten crossings (at most 11 crossings, "
        f"determinant {row['determinant']})",
    )
