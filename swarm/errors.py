"""The errors that are reported to the user, with their exit codes.

::

    SwarmError                1
    ├── Refused               1   the plan or the pre-flight checks have errors
    ├── InputError            2   a file, a code or an option is wrong (all problems at once)
    ├── VehicleError          3   a link or a vehicle failed
    └── Interrupted         130   stopped by the user, after a controlled end

Only :mod:`swarm.cli` turns these into text and exit codes. Another exception that reaches the
user is a bug.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True)
class Problem:
    """One error of an input: its place, and the expected value."""

    place: str
    message: str

    def __str__(self) -> str:
        return f"{self.place}: {self.message}" if self.place else self.message


def reason(error: BaseException) -> str:
    """Return the cause of an error as text for use after a colon; it is never empty.

    The text of a failed system call has no path, because messages begin with the path. Libraries
    put their own text into ``strerror``.
    """
    if isinstance(error, OSError):
        words = os.strerror(error.errno) if error.errno else error.strerror or ""
        if words:
            return words[:1].lower() + words[1:]
    text = str(error).strip()
    return text or f"failed without a message ({type(error).__name__})"


class SwarmError(Exception):
    """Base class of the errors that are reported to the user."""

    exit_code: ClassVar[int] = 1


class Refused(SwarmError):  # noqa: N818 - a result, not a malfunction
    """The plan or the pre-flight checks have errors; the message has the reasons."""


class InputError(SwarmError):
    """A file, a code or an option is wrong; ``problems`` has every problem in it."""

    exit_code = 2

    def __init__(self, problems: str | Sequence[Problem]) -> None:
        if isinstance(problems, str):
            problems = (Problem("", problems),)
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))


class VehicleError(SwarmError):
    """A link or a vehicle failed."""

    exit_code = 3


class Interrupted(SwarmError):  # noqa: N818 - a request, not a malfunction
    """Stopped by the user, after a controlled end."""

    exit_code = 130
