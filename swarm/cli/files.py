"""``swarm init`` and ``swarm schema``: files to start from, and what editors check them with."""

from pathlib import Path

import click

from swarm.borders import Section
from swarm.cli.inputs import print_json, write_text
from swarm.errors import InputError, Problem
from swarm.knots.catalog import choose
from swarm.mission import Mission, mission_for_knot, mission_schema


@click.command()
@click.argument("knot")
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Where to write it; the default is KNOT.yaml here.",
)
def init(knot: str, output: Path | None) -> None:
    """Write a commented mission file for KNOT (a name such as overhand or 8_18)."""
    choose(name=knot, chirality="either")
    path = output or Path(f"{knot}.yaml")
    if path.exists():
        raise InputError([Problem(str(path), "exists already and is left as it is")])
    write_text(path, commented_mission(knot))
    click.echo(f"{path} — plan it with: swarm plan {path}")


@click.command()
def schema() -> None:
    """Print the JSON schema of mission files."""
    print_json(mission_schema())


def commented_mission(knot: str) -> str:
    """Return a mission file with every key at its default and a sentence about each."""
    mission = mission_for_knot(knot)
    lines = ["# A mission for `swarm`: metres, seconds, kilograms; x east, y north, z up."]
    for key, field in Mission.model_fields.items():
        value = getattr(mission, key)
        lines.append(f"\n# {field.description}")
        if isinstance(value, Section):
            lines.append(f"{key}:")
            lines.extend(_section_lines(value))
        else:
            lines.append(f"{field.alias or key}: {value}")
    return "\n".join(lines) + "\n"


def _section_lines(section: Section) -> list[str]:
    width = max(len(key) for key in type(section).model_fields) + 12
    lines = []
    for key, field in type(section).model_fields.items():
        value = getattr(section, key)
        entry = f"  {key}: {value}" if value is not None else f"  # {key}:"
        lines.append(f"{entry:<{width}}  # {field.description}")
    return lines
