"""Schemas for editors: the files in missions/ are up to date, and every YAML file names its own."""

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from swarm.cli.files import KINDS, init, schema, schema_of
from swarm.mission import mission_for_knot, parse_mission
from swarm.simulation.spread import read_scenario

MISSIONS = Path(__file__).parents[1] / "missions"
FILES = sorted(MISSIONS.rglob("*.yaml"))


@pytest.mark.parametrize("kind", KINDS)
def test_the_schema_file_is_what_the_command_prints(kind):
    kept = json.loads((MISSIONS / "schemas" / f"{kind}.json").read_text())
    assert kept == schema_of(kind), "run: swarm schema --write missions/schemas"
    assert json.loads(CliRunner().invoke(schema, [kind]).output) == kept


@pytest.mark.parametrize("kind", KINDS)
def test_every_key_is_described(kind):
    bare = []

    def look(path: str, schema: dict) -> None:
        for key, field in schema.get("properties", {}).items():
            if not field.get("description"):
                bare.append(f"{path}{key}")
            look(f"{path}{key}.", field)

    found = schema_of(kind)
    look("", found)
    for name, section in found.get("$defs", {}).items():
        look(f"{name}.", section)
    assert bare == []


def test_all_schemas_are_written_into_a_folder(tmp_path):
    found = CliRunner().invoke(schema, ["--write", str(tmp_path / "new")])
    assert found.exit_code == 0
    assert sorted(path.stem for path in (tmp_path / "new").iterdir()) == sorted(KINDS)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(MISSIONS)))
def test_a_shipped_file_names_its_schema(path):
    named = re.match(r"# yaml-language-server: \$schema=(\S+)\n", path.read_text())
    assert named, "expected the first line to name the schema"
    target = (path.parent / named[1]).resolve()
    assert target.is_file()
    folder = path.relative_to(MISSIONS).parts[0]
    assert target.stem == {"fleets": "fleet", "scenarios": "scenario"}.get(folder, "mission")


@pytest.mark.parametrize("path", sorted((MISSIONS / "scenarios").iterdir()), ids=lambda p: p.name)
def test_a_shipped_scenario_can_be_used(path):
    read_scenario(path.read_text(), str(path))


@pytest.mark.parametrize("knot", ["overhand", "figure-eight", "8_18"])
def test_the_file_that_init_writes_is_the_mission_that_its_knot_alone_is(knot, tmp_path):
    file = tmp_path / "mission.yaml"
    written = CliRunner().invoke(init, [knot, "--output", str(file)], catch_exceptions=False)
    assert written.exit_code == 0
    assert parse_mission(file.read_text(), str(file)) == mission_for_knot(knot)
