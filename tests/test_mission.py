"""Mission files: valid ones, and the exact messages for invalid ones."""

import math
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarm.errors import InputError
from swarm.front.files import load
from swarm.knots.catalog import choose_knot
from swarm.mission import Mission, mission_for_knot, mission_schema, parse_mission
from swarm.mission.validation import parse_yaml

MINIMAL = "{schema: 1, name: overhand, knot: {name: 3_1, chirality: left}}"


def problems(text: str, *overrides: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        parse_mission(text, "m.yaml", overrides)
    return [str(problem) for problem in caught.value.problems]


def test_defaults_are_those_of_the_design() -> None:
    mission = parse_mission(MINIMAL, "m.yaml")
    assert mission.knot.name == "3_1"
    assert mission.layout.cell == "auto"
    assert mission.clearance.cable == 0.15
    assert mission.vehicles.tracking == 0.1


def test_overrides_are_yaml_at_a_key_path() -> None:
    mission = parse_mission(
        MINIMAL, "m.yaml", ["layout.cell=1", "workspace.fence=[[0,0],[9,0],[9,9]]"]
    )
    assert mission.layout.cell == 1
    assert mission.workspace.fence == ((0, 0), (9, 0), (9, 9))


def test_a_knot_name_with_an_underscore_is_a_word() -> None:
    assert parse_yaml("{name: 8_18, number: 818}", "m.yaml") == {"name": "8_18", "number": 818}
    assert mission_for_knot("8_18", ["knot.name=4_1"]).knot.name == "4_1"


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("cable.length=-3.0", "m.yaml: cable.length: expected a length > 0 in metres, got -3.0"),
        ("cable.foo=1", "m.yaml: cable.foo: unknown key, got 1"),
        (
            "layout.cell=wide",
            "m.yaml: layout.cell: expected auto or a length > 0 and <= 200 in metres, got 'wide'",
        ),
        ("layout.cell=0", "m.yaml: layout.cell: expected auto or a length > 0 in metres, got 0"),
        (
            "vehicles.tracking=.nan",
            "m.yaml: vehicles.tracking: expected a length >= 0 and <= 5 in metres, got nan",
        ),
        (
            "vehicles.mass=.inf",
            "m.yaml: vehicles.mass: expected a number > 0 and <= 500 in kg, got inf",
        ),
        (
            "vehicles.max_speed=true",
            "m.yaml: vehicles.max_speed: expected a number > 0 and <= 100 in m/s, got True",
        ),
        (
            "fold.method=magic",
            "m.yaml: fold.method: expected certified, optimised or paper, got 'magic'",
        ),
        ("clearance=3", "m.yaml: clearance: expected a mapping of keys, got 3"),
        ("schema=2", "m.yaml: schema: expected 1, got 2"),
        ("name=", "m.yaml: name: expected text, got None"),
        (
            "vehicles.radius=250",
            "m.yaml: vehicles.radius: expected a length <= 5 in metres, got 250: did you mean 0.25?",
        ),
        (
            "vehicles.tracking=10",
            "m.yaml: vehicles.tracking: expected a length <= 5 in metres, got 10: did you mean 0.1?",
        ),
        (
            "layout.cell=1500",
            "m.yaml: layout.cell: expected auto or a length <= 200 in metres, got 1500: "
            "did you mean 1.5?",
        ),
        (
            "cable.mass_per_length=12",
            "m.yaml: cable.mass_per_length: expected a number <= 5 in kg/m, got 12: "
            "did you mean 0.012?",
        ),
        (
            "vehicles.endurance=10",
            "m.yaml: vehicles.endurance: expected a number >= 60 in s, got 10: did you mean 600?",
        ),
        ("hold_time=2", "m.yaml: hold_time: expected a number >= 4 in s, got 2"),
        (
            "vehicles.radius=25 cm",
            "m.yaml: vehicles.radius: expected a length > 0 and <= 5 in metres, got '25 cm': "
            "write 0.25",
        ),
        (
            "vehicles.endurance=10min",
            "m.yaml: vehicles.endurance: expected a number >= 60 and <= 86400 in s, got '10min': "
            "write 600",
        ),
        (
            "vehicles.max_speed=1.2.3km/h",
            "m.yaml: vehicles.max_speed: expected a number > 0 and <= 100 in m/s, got '1.2.3km/h'",
        ),
        (
            "vehicles.payload=15",
            "m.yaml: vehicles: expected payload of at most 5 times mass (1.5 kg), got 15: did you "
            "mean 0.015? For a larger vehicle give both, for example: vehicles: {mass: 15, "
            "payload: 15}",
        ),
        (
            "workspace.fence=[[0,0],[1e6,1],[2,2]]",
            "m.yaml: workspace.fence.1.0: expected a number <= 10000, got 1000000.0",
        ),
        ("cable.mass=1", "m.yaml: cable.mass: unknown key, got 1: did you mean mass_per_length?"),
        ("radius=0.2", "m.yaml: radius: unknown key, got 0.2: did you mean vehicles.radius?"),
        (
            "fold.method=certifed",
            "m.yaml: fold.method: expected certified, optimised or paper, got 'certifed': did you mean certified?",
        ),
        (
            "vehicles.count=fewst",
            "m.yaml: vehicles.count: expected auto, fewest or an integer >= 3 and <= 200, got 'fewst': did you mean fewest?",
        ),
        (
            "knot={dt: abc}",
            "m.yaml: knot.dt: expected a DT code such as \"4 6 2\", got 'abc'",
        ),
        (
            "knot={pd: 1 2 3}",
            'm.yaml: knot.pd: expected a PD code such as "X[1,5,2,4] X[3,1,4,6] X[5,3,6,2]", '
            "got '1 2 3'",
        ),
        (
            "grab=attached",
            "m.yaml: expected vehicles.breakaway in newtons with grab: attached; for example: "
            "vehicles: {breakaway: 5}",
        ),
        (
            "knot=",
            "m.yaml: expected exactly one of knot and formation, got none; for example: "
            "knot: {name: overhand}",
        ),
        (
            "workspace.fence=[[0,0],[1,a],[2,2]]",
            "m.yaml: workspace.fence.1.1: expected a valid number, got 'a'",
        ),
        (
            "workspace.fence=[[0,0],[1,1]]",
            "m.yaml: workspace: expected a fence of at least 3 corners, got 2",
        ),
        (
            "knot.gauss=1+ 1-",
            "m.yaml:1: knot: expected exactly one of name, gauss, dt, pd or grid, got name and gauss",
        ),
        (
            "vehicles.braking_acceleration=2",
            "m.yaml: vehicles: expected braking_acceleration below max_acceleration (2 m/s²), got 2",
        ),
        ("fold.delay=1.0", "m.yaml: fold: expected delay only with method: paper, got certified"),
        ("fold.swing=0", "m.yaml: fold.swing: expected auto or a length > 0 in metres, got 0"),
        (
            "fold.swing=60",
            "m.yaml: fold.swing: expected auto or a length <= 10 in metres, got 60: did you mean 0.06?",
        ),
        (
            "layout={corners: [[0,0],[1,0],[1,1]], sags: [1,1], sag_over: 1.0}",
            "m.yaml: layout: expected no sag_over together with corners",
        ),
        (
            "layout={chord_margin: 0.5, sag_over: 1.0}",
            "m.yaml: layout: expected no chord_margin together with sag_over, which decides it",
        ),
        (
            "layout={corners: [[0,0],[1,0],[1,1]], sags: [1,1], chord_margin: 1.0}",
            "m.yaml: layout: expected no chord_margin together with corners",
        ),
        (
            "layout.chord_margin=-0.1",
            "m.yaml: layout.chord_margin: expected auto or a length >= 0 in metres, got -0.1",
        ),
        ("layout.sags=[1]", "m.yaml: layout: expected sags only together with corners"),
        ("layout.cell", "--set: expected key.path=value, got 'layout.cell'"),
        (
            "layout.cell=[1",
            "--set layout.cell:1:3: not valid YAML: expected ',' or ']', but got '<stream end>'",
        ),
    ],
)
def test_invalid_values_are_reported_with_place_and_expected_value(
    override: str, message: str
) -> None:
    assert problems(MINIMAL, override) == [message]


def test_every_problem_is_reported_at_once() -> None:
    found = problems("{schema: 1, cable: {length: 0, mass: 1}, knot: {}}")
    assert found == [
        "m.yaml: name: expected this key (Name of the mission and of its flight records.), got nothing"
        "; for example: name: overhand",
        "m.yaml:1: knot: expected exactly one of name, gauss, dt, pd or grid, got none",
        "m.yaml:1: cable.length: expected a length > 0 in metres, got 0",
        "m.yaml:1: cable.mass: unknown key, got 1: did you mean mass_per_length?",
    ]


def test_problems_name_the_line_in_the_order_of_the_file() -> None:
    text = """schema: 1
name: wrong
workspace:
  fence:
    - [0, 0]
    - [1, b]
    - [2, 2]
cabel: {length: 3}
vehicles:
  mass: 0
  tracking: 100
knot: {name: 3_1}
"""
    assert problems(text, "vehicles.mass=-1") == [
        "m.yaml: vehicles.mass: expected a number > 0 in kg, got -1",
        "m.yaml:6: workspace.fence.1.1: expected a valid number, got 'b'",
        "m.yaml:8: cabel: unknown key, got {'length': 3}: did you mean cable?",
        "m.yaml:11: vehicles.tracking: expected a length <= 5 in metres, got 100: did you mean 0.1?",
    ]


OBSTACLES = """schema: 1
name: hall
knot: {name: overhand, chirality: right}
clearance: {obstacle: -1}
workspace:
  obstacles:
    - {name: table, shape: box, centre: [3, 0], size: [1.6, 0.0], top: 0.75}
    - {name: truss, shape: cylnder, centre: [3, 0], radius: 1, top: 3}
    - {name: pillar, shape: cylinder, centre: [3, 0], radius: 0, top: 3, raduis: 3}
    - {name: post, centre: [3, 0], radius: 0, top: 3}
    - 5
    - {name: net, shape: half-space, point: [0, 1, 3], normal: [0, 0, 0]}
    - {name: high, shape: box, centre: [0, 1], size: [1, 1], bottom: 3, top: 2}
    - {shape: cylinder, centre: [1e9, 1], radius: 1, top: 2}
    - {name: roof, shape: half-space, point: [0, 1, 3], normal: [1e-200, 0, 0]}
"""


def test_wrong_obstacles_are_reported_with_their_names() -> None:
    at = "workspace.obstacles"
    assert problems(OBSTACLES) == [
        "m.yaml:4: clearance.obstacle: expected a length > 0 in metres, got -1",
        f"m.yaml:7: {at}.0.size.1 (table): expected a number > 0, got 0.0",
        f"m.yaml:8: {at}.1.shape (truss): expected box, cylinder, half-space, got 'cylnder': did "
        "you mean cylinder?",
        f"m.yaml:9: {at}.2.radius (pillar): expected a length > 0 in metres, got 0",
        f"m.yaml:9: {at}.2.raduis (pillar): unknown key, got 3",
        f"m.yaml:10: {at}.3.shape (post): expected this key (Its shape.), got nothing; for example: "
        "shape: box",
        f"m.yaml:11: {at}.4: expected a mapping of keys, got 5",
        f"m.yaml:12: {at}.5.normal (net): expected a normal of length >= 1e-06, got 0, 0, 0",
        f"m.yaml:13: {at}.6 (high): expected top > bottom, got 2 and 3",
        f"m.yaml:14: {at}.7.name: expected this key (Name of the obstacle in messages and "
        "pictures.), got nothing; for example: name: table",
        f"m.yaml:14: {at}.7.centre.0: expected a number <= 10000, got 1000000000.0",
        f"m.yaml:15: {at}.8.normal (roof): expected a normal of length >= 1e-06, got 1e-200, 0, 0",
    ]


def test_obstacles_have_names_of_their_own() -> None:
    one = "{name: net, shape: half-space, point: [0, 1, 3], normal: [0, 0, 1]}"
    text = f"schema: 1\nname: a\nknot: {{name: 3_1}}\nworkspace: {{obstacles: [{one}, {one}]}}"
    assert problems(text) == [
        "m.yaml:4: workspace: expected a name of its own for each obstacle, got net twice"
    ]


def test_missions_without_obstacles_are_written_as_before() -> None:
    """Digests of plans, plan files and records have every key of a mission."""
    written = mission_for_knot("overhand").document()
    assert set(written["workspace"]) == {"ceiling", "fence"}
    assert "obstacle" not in written["clearance"]
    table = "{name: table, shape: box, centre: [3, 0], size: [1, 1], top: 1}"
    mission = mission_for_knot("overhand", (f"workspace.obstacles=[{table}]",))
    assert mission.document()["clearance"]["obstacle"] == 0.2
    assert Mission.model_validate(mission.document()) == mission


def test_an_unknown_knot_is_reported_together_with_wrong_keys(tmp_path: Path) -> None:
    file = tmp_path / "m.yaml"
    file.write_text("schema: 1\nname: x\nknot:\n  name: overhnad\ncable: {length: 0}\n")
    with pytest.raises(InputError) as caught:
        load(file)
    assert [str(problem) for problem in caught.value.problems] == [
        f"{file}:5: cable.length: expected a length > 0 in metres, got 0",
        f'{file}:4: knot.name: no knot is called "overhnad" here: did you mean overhand? '
        "`swarm knots` lists the names",
    ]


@pytest.mark.parametrize(
    "written",
    [
        "dt: 4 6 2",
        "dt: 4, 6, 2",
        "dt: [4, 6, 2]",
        "dt: {4, 6, 2}",
        "dt: 'DT: [(4, 6, 2)]'",
        "dt: 'DTCode[4, 6, 2]'",
        "gauss: 'GaussCode[-1, 2, -3, 1, -2, 3]'",
        "pd: 'PD[X[1,5,2,4],X[3,1,4,6],X[5,3,6,2]]'",
        "pd: X(1,5,2,4) X(3,1,4,6) X(5,3,6,2)",
        "pd: 1 5 2 4; 3 1 4 6; 5 3 6 2",
        "pd: [[1,5,2,4],[3,1,4,6],[5,3,6,2]]",
        "gauss: 1- 2+ 3- 1+ 2- 3+",
        "gauss: O1+U2+O3+U1+O2+U3+",
        "gauss: [-1, 2, -3, 1, -2, 3]",
        "gauss: {-1, 2, -3, 1, -2, 3}",
        "gauss: -1, 2, -3, 1, -2, 3",
        "grid: '[1,3] [2,4] [3,5] [1,4] [2,5]'",
        "grid: [[1,3],[2,4],[3,5],[1,4],[2,5]]",
    ],
)
def test_codes_are_read_as_people_write_them(written: str) -> None:
    text = f"schema: 1\nname: x\nknot:\n  {written}\n  chirality: either\n"
    described = parse_mission(text, "m.yaml").knot.model_dump()
    assert choose_knot(**described).name == "3_1"


@pytest.mark.parametrize(
    ("payload", "mass"),
    [(0.015, 0.027), (0.4, 1.5), (50.0, 40.0)],
    ids=["15 g", "default", "50 kg"],
)
def test_vehicles_from_fifteen_grams_to_fifty_kilograms_are_plausible(
    payload: float, mass: float
) -> None:
    mission = parse_mission(
        MINIMAL, "m.yaml", [f"vehicles.payload={payload}", f"vehicles.mass={mass}"]
    )
    assert mission.vehicles.payload == payload


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [1,\nb: }", "m.yaml:2:4: not valid YAML: expected the node content, but found '}'"),
        (
            "name: a\nname: b",
            'm.yaml:2:1: not valid YAML: found duplicate key "name" with value "b" (original value: "a")',
        ),
        ("", "m.yaml: expected a mapping of keys, got None"),
        ("[" * 1000, "m.yaml: nested more than 64 deep"),
        ("{a: &x [1], b: *x}", "m.yaml: YAML aliases are not supported"),
        ("x" * 1_000_001, "m.yaml: expected at most 1000000 characters"),
        ("\x00", "m.yaml: not valid YAML"),
    ],
)
def test_text_that_is_not_a_mission(text: str, message: str) -> None:
    (found,) = problems(text)
    assert found.startswith(message)


@given(st.text(max_size=200))
def test_any_text_is_a_mission_or_an_input_error(text: str) -> None:
    with suppress(InputError):
        assert isinstance(parse_mission(text, "m.yaml"), Mission)


@given(st.floats())
def test_no_number_reaches_a_mission_unless_finite_and_in_range(value: float) -> None:
    try:
        mission = parse_mission(MINIMAL, "m.yaml", [f"cable.length={value!r}"])
    except InputError:
        assert not (math.isfinite(value) and 0 < value <= 5000)
    else:
        assert mission.cable.length == value


def test_the_schema_gives_every_key_a_sentence() -> None:
    schema = mission_schema()
    for section in [schema, *schema["$defs"].values()]:
        for key, entry in section["properties"].items():
            assert entry.get("description"), key
