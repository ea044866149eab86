"""Everything that can go wrong and that a user is told about, with its exit code.

::

    SwarmError                1
    ├── Refused               1   the plan or the pre-flight says no
    ├── InputError            2   a file, a code or an option is wrong (all problems at once)
    ├── VehicleError          3   a link or a vehicle failed
    └── Interrupted         130   stopped by the user, after a controlled stop

Only :mod:`swarm.cli` turns these into text and exit codes. Anything else that reaches a user is
a bug of ours.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong with an input: where it is, and what was expected there."""

    place: str
    message: str

    def __str__(self) -> str:
        return f"{self.place}: {self.message}" if self.place else self.message


def reason(error: BaseException) -> str:
    """Return what went wrong in words that are never empty, as they stand after a colon.

    What the system says of a failed call is without its path, for messages begin with that;
    libraries put theirs into ``strerror``.
    """
    if isinstance(error, OSError):
        words = os.strerror(error.errno) if error.errno else error.strerror or ""
        if words:
            return words[:1].lower() + words[1:]
    said = str(error).strip()
    return said or f"failed without saying why ({type(error).__name__})"


class SwarmError(Exception):
    """Root of the errors that are meant for the user."""

    exit_code: ClassVar[int] = 1


class Refused(SwarmError):  # noqa: N818 - it is an answer, not a malfunction
    """The plan or the pre-flight checks say no, and why."""


class InputError(SwarmError):
    """A file, a code or an option is wrong; carries every problem found in it."""

    exit_code = 2

    def __init__(self, problems: str | Sequence[Problem]) -> None:
        if isinstance(problems, str):
            problems = (Problem("", problems),)
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))


class VehicleError(SwarmError):
    """A link or a vehicle failed."""

    exit_code = 3


class Interrupted(SwarmError):  # noqa: N818 - the user's wish, not a malfunction
    """Stopped by the user, after a controlled stop."""

    exit_code = 130
