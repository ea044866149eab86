"""Mission and fleet files that a user names; every failure is an :class:`InputError`."""

import os
from collections.abc import Sequence
from pathlib import Path

from swarm.errors import InputError, Problem
from swarm.files import read_text
from swarm.knots.catalog import choose_knot
from swarm.mission import Mission, mission_for_knot, parse_mission
from swarm.mission.fleet import Fleet, parse_fleet
from swarm.mission.validation import LARGEST_FILE


def load(path: str | os.PathLike[str], *overrides: str) -> Mission:
    """Read a mission file (YAML) and return the mission.

    ``overrides`` are ``"key.path=value"`` strings that replace keys of the file, for example
    ``"vehicles.tracking=0.05"``. Lengths are in metres, times in seconds, positions in ENU.

    Raises :class:`swarm.InputError` with every problem at once: a file that cannot be read, wrong
    keys and values (``path: key: expected …, got …``), a knot that does not exist.

    Source: :func:`swarm.mission.parse_mission`; `swarm schema mission` prints the format.
    """
    name = os.fspath(path)
    mission = parse_mission(read_text(path, LARGEST_FILE), name, overrides)
    _require_known_knot(mission, name)
    return mission


def load_mission(name: str, overrides: Sequence[str] = ()) -> Mission:
    """Return the mission of a file, or the default mission for a knot's name.

    ``name`` is a file if it exists, ends in .yaml or .yml, or contains a slash. Raises as
    :func:`load`.
    """
    path = Path(name)
    if path.is_file() or path.suffix in {".yaml", ".yml"} or "/" in name:
        return load(name, *overrides)
    mission = mission_for_knot(name, tuple(overrides))
    _require_known_knot(mission, name)
    return mission


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


def _require_known_knot(mission: Mission, source: str) -> None:
    """Raise :class:`InputError` with the key of a knot that does not exist."""
    if mission.knot is None:
        return
    described = mission.knot.model_dump()
    try:
        choose_knot(**described)
    except InputError as error:
        key = next(key for key, value in described.items() if value is not None)
        problems = [Problem(f"{source}: knot.{key}", str(one)) for one in error.problems]
        raise InputError(problems) from None
