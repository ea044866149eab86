"""Reading and writing the files that a user names; every failure is an :class:`InputError`."""

import os
from pathlib import Path

from swarm.errors import InputError, Problem, reason
from swarm.knots.catalog import choose
from swarm.mission import Mission, parse_mission
from swarm.mission.validation import LARGEST_FILE


def load(path: str | os.PathLike[str], *overrides: str) -> Mission:
    """Read a mission file (YAML) and return the mission.

    ``overrides`` are ``"key.path=value"`` strings that replace keys of the file, for example
    ``"vehicles.tracking=0.05"``. Lengths are in metres, times in seconds, places in ENU.

    Raises :class:`swarm.InputError` with every problem at once: a file that cannot be read, keys
    and values that are wrong (``path: key: expected …, got …``), a knot that does not exist.

    Source: :func:`swarm.mission.parse_mission`; `swarm schema mission` prints the format.
    """
    name = os.fspath(path)
    mission = parse_mission(read_text(path), name, overrides)
    refuse_unknown_knot(mission, name)
    return mission


def refuse_unknown_knot(mission: Mission, source: str) -> None:
    """Say where in the file a knot is described that does not exist; missions know no topology."""
    if mission.knot is None:
        return
    described = mission.knot.model_dump()
    try:
        choose(**described)
    except InputError as error:
        key = next(key for key, value in described.items() if value is not None)
        problems = [Problem(f"{source}: knot.{key}", str(one)) for one in error.problems]
        raise InputError(problems) from None


def read_text(path: str | os.PathLike[str], largest: int = LARGEST_FILE) -> str:
    """Read UTF-8 text of at most ``largest`` bytes; raises :class:`InputError` otherwise."""
    data = read_bytes(path, largest)
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        raise InputError([Problem(os.fspath(path), "expected UTF-8 text")]) from None


def read_bytes(path: str | os.PathLike[str], largest: int) -> bytes:
    """Read a file of at most ``largest`` bytes; raises :class:`InputError` otherwise."""
    try:
        with Path(path).open("rb") as file:
            data = file.read(largest + 1)
    except OSError as error:
        raise InputError([Problem(os.fspath(path), reason(error))]) from None
    if len(data) > largest:
        raise InputError([Problem(os.fspath(path), f"expected at most {largest:,} bytes")])
    return data


def write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file; raises :class:`InputError` where that fails."""
    try:
        Path(path).write_bytes(data)
    except OSError as error:
        raise InputError([Problem(os.fspath(path), reason(error))]) from None
