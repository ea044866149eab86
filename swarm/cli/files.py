"""``swarm init`` and ``swarm schema``: commented mission files to start from, and JSON schemas."""

import json
from pathlib import Path
from typing import Any, get_args

import click
from pydantic.fields import FieldInfo

from swarm.cli.inputs import FOLDER, OUTPUT, print_json
from swarm.errors import InputError, Problem, reason
from swarm.files import write_text
from swarm.knots.catalog import choose_knot
from swarm.mission import Mission, mission_for_knot, mission_schema
from swarm.mission.fleet import fleet_schema
from swarm.mission.presets import PRESETS, Preset
from swarm.mission.validation import Section

SCHEMA_FILE = "mission.schema.json"
"""File beside the mission that its first line names, for editors."""


def commented_mission(knot: str, preset: Preset | None = None) -> str:
    """Return a mission file with every key: its value, unit or choices, meaning and source.

    Without a preset the values are the defaults.
    """
    mission = mission_for_knot(knot, preset.overrides if preset else ())
    lines = [
        f"# yaml-language-server: $schema={SCHEMA_FILE}",
        f"# A mission for swarm: {knot}. Vehicles: {_vehicles(preset)}.",
        "# Lengths in metres, times in seconds, masses in kilograms; x east, y north, z up.",
        *(f"# {line}" for line in (preset.advice if preset else ())),
    ]
    for key, field in Mission.model_fields.items():
        value = getattr(mission, key)
        lines.append(f"\n# {field.description}{_expected(field)}")
        if isinstance(value, Section):
            lines.append(f"{key}:")
            lines.extend(_section_lines(key, value, preset))
        elif value is None:
            lines.append(f"# {key}:")
        else:
            lines.append(f"{field.alias or key}: {value}")
    return "\n".join(lines) + "\n"


def _vehicles(preset: Preset | None) -> str:
    return preset.description if preset else "the defaults; swarm init --help lists others"


def _section_lines(name: str, section: Section, preset: Preset | None) -> list[str]:
    width = max(len(key) for key in type(section).model_fields) + 12
    lines = []
    for key, field in type(section).model_fields.items():
        value = getattr(section, key)
        given = value is not None and value != ()
        entry = f"  {key}: {value}" if given else f"  # {key}:"
        comment = f"{field.description}{_expected(field)}"
        source = preset.values.get(f"{name}.{key}") if preset else None
        if source is not None:
            comment += f" Here: {source[1]}."
        lines.append(f"{entry:<{width}}  # {comment}")
    return lines


def _expected(field: FieldInfo) -> str:
    """Return what a key takes, in brackets: its unit and range, or its choices."""
    extra = field.json_schema_extra
    if isinstance(extra, dict) and "expected" in extra:
        return f" ({extra['expected']})"
    choices = [str(choice) for choice in _choices(field.annotation)]
    return f" ({', '.join(choices)})" if len(choices) > 1 else ""


def _choices(annotation: Any) -> list[Any]:
    """Return the values of a Literal, bare or optional; empty for another type."""
    values: list[Any] = []
    for argument in get_args(annotation):
        if isinstance(argument, str):
            values.append(argument)
        else:
            values += _choices(argument)
    return values


KINDS = ("mission", "fleet", "world", "scenario")


@click.command()
@click.argument("knot")
@click.option(
    "-o",
    "--output",
    type=OUTPUT,
    help="Output file. Default: KNOT.yaml in the current folder.",
)
@click.option(
    "--vehicles",
    type=click.Choice(list(PRESETS)),
    help="Write the values of these vehicles, with their sources, instead of the defaults.",
)
def init(knot: str, output: Path | None, vehicles: str | None) -> None:
    """Write a commented mission file for KNOT (a name such as overhand or 8_18).

    Every key has its value, unit or choices and meaning in a comment. The schema, with which
    editors complete and check the file, is written beside it.

    Vehicles: {PRESETS}.

    Example: swarm init figure-eight --vehicles px4-500mm --output mission.yaml
    """
    choose_knot(name=knot, chirality="either")
    path = output or Path(f"{knot}.yaml")
    if path.exists():
        raise InputError([Problem(str(path), "exists already; it is not changed")])
    write_text(path, commented_mission(knot, PRESETS[vehicles] if vehicles else None))
    write_text(path.parent / SCHEMA_FILE, json.dumps(mission_schema(), indent=2) + "\n")
    click.echo(f"{path} — plan it with: swarm plan {path}")


init.help = (init.help or "").format(
    PRESETS="; ".join(f"{name}: {preset.description}" for name, preset in PRESETS.items())
)


@click.command()
@click.argument("kind", type=click.Choice(KINDS), default="mission")
@click.option(
    "--write",
    type=FOLDER,
    metavar="FOLDER",
    help="Write the schemas of all kinds of files to this folder.",
)
def schema(kind: str, write: Path | None) -> None:
    """Print the JSON schema of mission, fleet, world or scenario files.

    Editors complete and check a YAML file with its schema in a comment, as in missions/:
    yaml-language-server: $schema=FILE.

    Example: swarm schema mission
    """
    if write is None:
        print_json(schema_of(kind))
        return
    try:
        write.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError([Problem(str(write), reason(error))]) from None
    for name in KINDS:
        path = write / f"{name}.json"
        write_text(path, json.dumps(schema_of(name), indent=2) + "\n")
        click.echo(f"{path}")


def schema_of(kind: str) -> dict[str, Any]:
    """Return the JSON schema of a kind of file: mission, fleet, world or scenario."""
    if kind == "mission":
        return mission_schema()
    if kind == "fleet":
        return fleet_schema()
    if kind == "world":
        from swarm.simulation.loop import world_schema  # noqa: PLC0415 - slow to import

        return world_schema()
    from swarm.simulation.spread import trial_scenario_schema  # noqa: PLC0415 - slow to import

    return trial_scenario_schema()
