"""World files: all errors, with their keys."""

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl import Emulator, WorldError, default_world, load_world, parse_world
from sitl.autopilots.telemetry import local_ned
from sitl.world import World, schema
from swarm.flight.parameters import Requirements, required_values

GOOD = """
schema: 1
seed: 3
origin: {latitude: 47.0, longitude: 8.0, altitude: 400.0}
floor: 0.0
wind: {steady: [1.0, 0.0, 0.0], gust: 0.5}
vehicles:
  - {id: 1, autopilot: px4, pad: [0, 0, 0], heading: 0.0, mass: 1.5, payload: 0.4, radius: 0.25,
     grip_offset: 0.6, max_speed: 5.0, max_acceleration: 4.0, gripper: mavlink}
  - {id: 2, autopilot: ardupilot, pad: [3, 0, 0]}
cable: {mass_per_length: 0.012, diameter: 0.006, points: [[0, 0, 0], [3.5, 0, 0]]}
"""


def test_a_valid_file_is_read() -> None:
    world = parse_world(GOOD)
    assert [vehicle.autopilot for vehicle in world.vehicles] == ["px4", "ardupilot"]
    truth = Emulator(world).truth()
    assert truth.position.tolist() == [[0, 0, 0], [3, 0, 0]], "grip points touch the floor"
    assert truth.cable[-1] == pytest.approx([3.5, 0.0, 0.003]), "its axis, half its diameter above"


def test_all_errors_are_reported_with_their_keys() -> None:
    bad = GOOD.replace("seed: 3", "seed: -3").replace("autopilot: px4", "autopilot: betaflight")
    bad = bad.replace("payload: 0.4", "payload: .nan").replace("floor: 0.0", "flor: 0.0")
    with pytest.raises(WorldError) as error:
        parse_world(bad, "w.yaml")
    lines = str(error.value).splitlines()
    assert lines == [
        "w.yaml: seed: expected greater than or equal to 0, got -3",
        "w.yaml: vehicles.0.autopilot: expected 'px4' or 'ardupilot', got 'betaflight'",
        "w.yaml: vehicles.0.payload: expected a finite number, got nan",
        "w.yaml: flor: expected a known key, got an unknown one",
    ]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("id: 2", "id: 1"), "w: vehicles: expected every id once, got [1] more than once"),
        (
            ("gripper: mavlink", "gripper: attached"),
            "w: cable.attached: expected one arc length for each of 1 vehicles whose gripper is "
            "'attached', got 0",
        ),
        (("schema: 1", "schema: 2"), "w: schema: expected 1, got 2"),
        (("[3, 0, 0]", "[3, 0]"), "w: vehicles.1.pad.2: expected a value, got none"),
        (("seed: 3", "seed: [3"), "w:4:7: expected YAML, got expected ',' or ']', but got ':'"),
        (("seed: 3", "seed: !!python/object:os.system 3"), None),
    ],
)
def test_exact_messages(change: tuple[str, str], message: str | None) -> None:
    with pytest.raises(WorldError) as error:
        parse_world(GOOD.replace(*change), "w")
    if message is not None:
        assert str(error.value) == message


@pytest.mark.parametrize("text", ["", "[]", "3", "\x00", "a: &a [*a]", "{" * 5000, "- " * 3000])
def test_random_text_is_refused(text: str) -> None:
    with pytest.raises(WorldError):
        parse_world(text)


def test_missing_and_binary_files(tmp_path: Path) -> None:
    with pytest.raises(WorldError, match="expected a readable file, got No such file"):
        load_world(tmp_path / "none.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(WorldError, match="expected UTF-8 text"):
        load_world(tmp_path / "binary.yaml")


def test_schema_and_default_world() -> None:
    assert schema()["properties"]["schema"]["const"] == 1
    assert len(default_world(90).vehicles) == 90
    assert default_world(2, ["px4", "ardupilot"]).vehicles[1].autopilot == "ardupilot"


def test_default_vehicles_start_at_local_zero() -> None:
    emulator = Emulator(default_world(4, ["px4", "ardupilot"]))
    for step in range(40):
        emulator.step(0.05 * step)
    for vehicle in emulator.vehicles:
        assert max(map(abs, local_ned(vehicle)[:3])) < 0.15
    anywhere = default_world(4).model_copy(update={"local_origin": "anywhere"})
    assert any(abs(local_ned(vehicle)[2]) > 1.0 for vehicle in Emulator(anywhere).vehicles)


def given_parameters(px4: dict[str, float], ardupilot: dict[str, float]) -> World:
    world = default_world(2, ["px4", "ardupilot"])
    vehicles = [
        vehicle.model_copy(update={"parameters": given})
        for vehicle, given in zip(world.vehicles, (px4, ardupilot), strict=True)
    ]
    return world.model_copy(update={"vehicles": vehicles})


@pytest.mark.parametrize("kind", [0, 1])
def test_emulated_vehicles_start_with_all_parameters_that_a_flight_requires(kind: int) -> None:
    flight = Requirements(2.0, 1.5, 1.0, 3.0, 60.0, 0.5, 5.0, global_position=True)
    wanted = [required_values(name, flight) for name in ("px4", "ardupilot")]
    emulator = Emulator(given_parameters(*wanted))
    table = emulator.vehicles[kind].parameters
    assert wanted[kind]
    assert {name: table[name] for name in wanted[kind]} == wanted[kind]
    assert emulator.vehicles[0].parameters.integer("COM_OBL_RC_ACT") == 5
    # a parameter of real firmware is its own affair
    assert Emulator(given_parameters({"ANY": 1.0}, {}), outside=[1]).vehicles[0].frozen


def test_given_gains_are_those_of_the_controller() -> None:
    usual, given = (
        Emulator(given_parameters(px4, {})).bodies.position_gain for px4 in ({}, {"MPC_XY_P": 1.5})
    )
    assert given[0, 0] == 1.5 != usual[0, 0]


def test_parameters_that_an_emulated_autopilot_has_not_are_all_reported() -> None:
    with pytest.raises(WorldError) as error:
        Emulator(given_parameters({"MPC_XY": 1.0, "COM_OBL_RC_ACT": 4.5}, {"MPC_XY_P": 1.0}))
    assert str(error.value).splitlines() == [
        "vehicle 1: parameters.MPC_XY: expected a parameter of the emulated px4, got an unknown "
        "one",
        "vehicle 1: parameters.COM_OBL_RC_ACT: expected an integer, got 4.5",
        "vehicle 2: parameters.MPC_XY_P: expected a parameter of the emulated ardupilot, got an "
        "unknown one",
    ]


VALUES = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=12),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4)
    ),
    max_leaves=10,
)
WORLD = default_world(2).model_dump(mode="json", by_alias=True)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(key=st.sampled_from(sorted(WORLD)), value=VALUES)
def test_random_worlds_are_read_or_refused_with_a_message(key: str, value: object) -> None:
    try:
        parse_world(json.dumps({**WORLD, key: value}))
    except WorldError:
        return
