"""Mission files: valid ones, and the exact messages for invalid ones."""

import math
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarm.errors import InputError
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
            "m.yaml: layout.cell: expected auto or a length > 0 in metres, got 'wide'",
        ),
        ("layout.cell=0", "m.yaml: layout.cell: expected auto or a length > 0 in metres, got 0"),
        (
            "vehicles.tracking=.nan",
            "m.yaml: vehicles.tracking: expected a length >= 0 in metres, got nan",
        ),
        ("vehicles.mass=.inf", "m.yaml: vehicles.mass: expected a number > 0 in kg, got inf"),
        (
            "vehicles.max_speed=true",
            "m.yaml: vehicles.max_speed: expected a number > 0 in m/s, got True",
        ),
        ("fold.method=magic", "m.yaml: fold.method: expected certified or paper, got 'magic'"),
        ("clearance=3", "m.yaml: clearance: expected a mapping of keys, got 3"),
        ("schema=2", "m.yaml: schema: expected 1, got 2"),
        ("name=", "m.yaml: name: expected text, got None"),
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
            "m.yaml: knot: expected exactly one of name, gauss, dt, pd or grid, got name and gauss",
        ),
        (
            "vehicles.braking_acceleration=2",
            "m.yaml: vehicles: expected braking_acceleration below max_acceleration (2 m/s²), got 2",
        ),
        ("fold.delay=1.0", "m.yaml: fold: expected delay only with method: paper, got certified"),
        ("fold.swing=0", "m.yaml: fold.swing: expected a length > 0 in metres, got 0"),
        (
            "layout={corners: [[0,0],[1,0],[1,1]], sags: [1,1], sag_over: 1.0}",
            "m.yaml: layout: expected no sag_over together with corners",
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
        "m.yaml: name: expected this key (Name of the mission and of its flight records.), got nothing",
        "m.yaml: knot: expected exactly one of name, gauss, dt, pd or grid, got none",
        "m.yaml: cable.length: expected a length > 0 in metres, got 0",
        "m.yaml: cable.mass: unknown key, got 1",
    ]


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
        assert not (math.isfinite(value) and value > 0)
    else:
        assert mission.cable.length == value


def test_the_schema_gives_every_key_a_sentence() -> None:
    schema = mission_schema()
    for section in [schema, *schema["$defs"].values()]:
        for key, entry in section["properties"].items():
            assert entry.get("description"), key
