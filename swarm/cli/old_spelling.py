"""Old spellings of commands and options: they keep working, with a note."""

from collections.abc import Mapping, Sequence

_OPTIONS: Mapping[str, Mapping[str, str]] = {
    "trials": {"--trials": "--count", "--results": "--output"},
    "failures": {"--times": "--repeat", "--row": "--filter", "--results": "--output"},
    "knots": {"--only": "--filter", "--to": "--output"},
}
"""Command → old name of an option → its name."""


def current_spelling(arguments: Sequence[str]) -> list[str]:
    """Return the arguments of ``swarm`` with every old spelling replaced.

    ``dry-run`` with ``--trials``, ``--failures`` or ``--rope`` was what ``trials``, ``failures``
    and ``rope`` are now.
    """
    if not arguments:
        return []
    command, *rest = arguments
    if command == "dry-run":
        names = [argument.partition("=")[0] for argument in rest]
        command = next(
            (one for one in ("trials", "failures", "rope") if f"--{one}" in names), command
        )
        if command in ("failures", "rope"):
            rest.remove(f"--{command}")
    renamed = _OPTIONS.get(command, {})
    return [command, *(_renamed(argument, renamed) for argument in rest)]


def _renamed(argument: str, names: Mapping[str, str]) -> str:
    name, equals, value = argument.partition("=")
    return names.get(name, name) + equals + value
