"""The commented mission file that ``swarm init`` writes."""

from typing import Any, get_args

from pydantic.fields import FieldInfo

from swarm.mission import Mission, mission_for_knot
from swarm.mission.presets import Preset
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
        entry = f"  {key}: {value}" if value is not None else f"  # {key}:"
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
    found: list[Any] = []
    for argument in get_args(annotation):
        if isinstance(argument, str):
            found.append(argument)
        else:
            found += _choices(argument)
    return found
