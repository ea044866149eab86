"""``swarm init``: the file, its comments, and the vehicles to start from."""

import json

import pytest

from swarm import planner
from swarm.mission import Mission, mission_for_knot, parse_mission
from swarm.mission.presets import PRESETS
from tests.command import run


@pytest.fixture(params=PRESETS)
def preset(request):
    return PRESETS[request.param]


def test_every_value_of_a_preset_has_a_source_and_is_a_key_of_the_mission(preset):
    mission = mission_for_knot("overhand", preset.overrides)
    for path, (value, source) in preset.values.items():
        section, key = path.split(".")
        assert getattr(getattr(mission, section), key) == value
        assert source


def test_a_preset_keeps_other_rotors_and_cable_out_of_its_own(preset):
    mission = mission_for_knot("overhand", preset.overrides)
    vehicles, clearance = mission.vehicles, mission.clearance
    assert clearance.vehicle > 2 * vehicles.radius + 2 * vehicles.tracking
    assert clearance.vehicle_cable > vehicles.radius
    assert vehicles.payload < vehicles.mass


@pytest.mark.slow
@pytest.mark.parametrize("knot", ["overhand", pytest.param("figure-eight", marks=pytest.mark.full)])
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name == "crazyflie-like" else pytest.mark.full)
        for name in PRESETS
    ],
)
def test_every_preset_plans_and_certifies_the_first_two_knots(name, knot):
    planned = planner.plan(mission_for_knot(knot, PRESETS[name].overrides), robustness=False)
    errors = [f.message for f in planned.assessment.findings if f.severity == "error"]
    assert (errors, planned.certificate.cleared) == ([], True)
    assert planned.plan.duration < planned.plan.mission.vehicles.endurance


@pytest.mark.parametrize("knot", ["overhand", "8_18"])
def test_the_file_of_a_preset_is_its_mission_with_every_key_described(preset, knot, tmp_path):
    file = tmp_path / "mission.yaml"
    said = run("init", knot, "--vehicles", preset.name, "--output", str(file))
    assert (said.returncode, said.stderr) == (0, "")
    assert said.stdout == f"{file} — plan it with: swarm plan {file}\n"
    text = file.read_text()
    assert parse_mission(text, "m") == mission_for_knot(knot, preset.overrides)
    first, *lines = text.splitlines()
    schema = first.removeprefix("# yaml-language-server: $schema=")
    assert json.loads((tmp_path / schema).read_text())["title"] == "Mission"
    for source in (source for _, source in preset.values.values()):
        assert f" Here: {source}." in text
    for name in Mission.model_fields:
        section = getattr(mission_for_knot(knot), name)
        for key in getattr(type(section), "model_fields", {}):
            (line,) = [
                one for one in lines if one.lstrip(" #").startswith(f"{key}:") and "  # " in one
            ]
            assert len(line.split("  # ")[1]) > 10


def test_choices_and_units_stand_in_the_comments(tmp_path):
    file = tmp_path / "mission.yaml"
    run("init", "overhand", "--output", str(file))
    text = file.read_text()
    assert "(release, unfold, tighten, hold)\nfinish: release" in text
    assert "(left, right, either)" in text
    assert "Speed of the steady wind, from any direction. (a speed >= 0 and <= 40 in m/s)" in text


def test_the_help_of_init_describes_the_vehicles():
    said = " ".join(run("init", "--help").stdout.split())
    for preset in PRESETS.values():
        assert f"{preset.name}: {preset.description}" in said


def test_unknown_vehicles_are_answered_with_the_choices():
    said = run("init", "overhand", "--vehicles", "mavic")
    assert said.returncode == 2
    assert "'mavic' is not one of 'px4-500mm', 'holybro-x500', 'crazyflie-like'" in said.stderr
