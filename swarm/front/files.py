"""Mission and fleet files that a user names; every failure is an :class:`InputError`."""

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from swarm.errors import InputError, Problem
from swarm.files import read_text
from swarm.knots.catalog import choose_knot
from swarm.mission import Mission, mission_for_knot
from swarm.mission.fleet import Fleet, parse_fleet
from swarm.mission.mission import Knot
from swarm.mission.validation import (
    LARGEST_FILE,
    apply_overrides,
    key_lines,
    parse_yaml,
    place_of,
    validate,
)

PLAN_SUFFIX = ".plan"
_ARCHIVE = b"PK\x03\x04"
"""First bytes of a ZIP archive."""


def load(path: str | os.PathLike[str], *overrides: str) -> Mission:
    """Read a mission file (YAML) and return the mission.

    ``overrides`` are ``"key.path=value"`` strings that replace keys of the file, for example
    ``"vehicles.tracking=0.05"``. Lengths are in metres, times in seconds, positions in ENU.

    Raises :class:`swarm.InputError` with every problem at once: a file that cannot be read, wrong
    keys and values (``path: key: expected …, got …``), a knot that does not exist.

    Source: :func:`swarm.mission.parse_mission`; `swarm schema mission` prints the format.
    """
    return _mission(read_text(path, LARGEST_FILE), os.fspath(path), overrides)


def load_mission(name: str, overrides: Sequence[str] = ()) -> Mission:
    """Return the mission of a file, or the default mission for a knot's name.

    ``name`` is a file if it exists, ends in .yaml or .yml, or contains a slash. Raises as
    :func:`load`.
    """
    path = Path(name)
    if path.is_file() or path.suffix in {".yaml", ".yml"} or "/" in name:
        return load(name, *overrides)
    mission = mission_for_knot(name, tuple(overrides))
    if problems := _knot_problems(mission.knot, name):
        raise InputError(problems)
    return mission


def is_plan_file(name: str) -> bool:
    """Return whether a file is to be read as a plan file: by its name or by its first bytes."""
    path = Path(name)
    if path.suffix == PLAN_SUFFIX:
        return True
    try:
        with path.open("rb") as file:
            return file.read(len(_ARCHIVE)) == _ARCHIVE
    except OSError:
        return False


def load_fleet(path: str | os.PathLike[str]) -> Fleet:
    """Read a fleet file (YAML) and return the fleet.

    A relative path of its signing key starts at the folder of the fleet file.

    Raises :class:`swarm.InputError` with every problem at once.
    Source: :func:`swarm.mission.fleet.parse_fleet`; `swarm schema fleet` prints the format.
    """
    fleet = parse_fleet(read_text(path, LARGEST_FILE), os.fspath(path))
    if fleet.signing_key is None:
        return fleet
    return fleet.model_copy(update={"signing_key": str(Path(path).parent / fleet.signing_key)})


def _mission(text: str, source: str, overrides: Sequence[str]) -> Mission:
    """Return the mission of a file's text; a knot that does not exist is one of the problems."""
    document = apply_overrides(parse_yaml(text, source), overrides)
    wrong: tuple[Problem, ...] = ()
    mission, knot = None, None
    try:
        mission = validate(Mission, document, source, text, overrides)
        knot = mission.knot
    except InputError as error:
        wrong = error.problems
        with suppress(InputError):
            described = document.get("knot") if isinstance(document, dict) else None
            knot = validate(Knot, described, source)
    wrong += tuple(_knot_problems(knot, source, key_lines(text, overrides)))
    if mission is None or wrong:
        raise InputError(wrong)
    return mission


def _knot_problems(
    knot: Knot | None, source: str, lines: Mapping[tuple[str, ...], int] | None = None
) -> list[Problem]:
    """Return the problems of a knot that does not exist, at its key."""
    if knot is None:
        return []
    described = knot.model_dump()
    try:
        choose_knot(**described)
    except InputError as error:
        key = next(key for key, value in described.items() if value is not None)
        place = place_of(source, ("knot", key), lines or {})
        return [Problem(place, str(problem)) for problem in error.problems]
    return []
