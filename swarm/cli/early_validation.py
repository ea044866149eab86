"""Validation of mission and fleet files before the module of a command is imported.

The planner and its libraries take a second to import. A wrong file is refused without them.
"""

from collections.abc import Iterator, Sequence
from itertools import zip_longest

_WITH_MISSION = frozenset({"plan", "dry-run", "trials", "failures", "rope", "check", "fly"})
"""Commands whose argument is a mission, a plan file or the name of a knot."""


def validate_files(arguments: Sequence[str]) -> None:
    """Raise :class:`swarm.errors.InputError` for a wrong mission or fleet file of a command.

    ``arguments`` begin with the command. A mission is found right after the command only; what is
    not found here is validated by the command itself.
    """
    command, *rest = arguments or ("",)
    if command not in _WITH_MISSION or {"-h", "--help"} & set(rest):
        return
    from swarm.front.files import is_plan_file, load_fleet, load_mission  # noqa: PLC0415 - slow

    if rest and not rest[0].startswith("-") and not is_plan_file(rest[0]):
        counts = [f"vehicles.count={count}" for count in _values("--vehicles", rest)]
        load_mission(rest[0], (*_values("--set", rest), *counts))
    for fleet in _values("--fleet", rest):
        load_fleet(fleet)


def _values(option: str, arguments: Sequence[str]) -> Iterator[str]:
    """Yield the values of an option that can be repeated."""
    for argument, following in zip_longest(arguments, arguments[1:]):
        name, equals, value = argument.partition("=")
        if name == option and equals:
            yield value
        elif name == option and following is not None:
            yield following
