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
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import ClassVar


@dataclass(frozen=True)
class Problem:
    """One error of an input: its place, and the expected value."""

    place: str
    message: str

    def __str__(self) -> str:
        text = f"{self.place}: {self.message}" if self.place else self.message
        return "\n".join(printable(line) for line in text.split("\n"))


def printable(text: str) -> str:
    """Return a text of foreign origin without control characters, which a terminal would obey.

    White space becomes a space, and every other character that cannot be printed the replacement
    character.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else " " if c.isspace() else "\ufffd" for c in text)


def reason(error: BaseException) -> str:
    """Return the cause of an error as text for use after a colon; it is never empty.

    The text of a failed system call has no path, because messages begin with the path. Libraries
    put their own text into ``strerror``.
    """
    if isinstance(error, OSError):
        number = error.errno or 0  # negative ones are those of the resolver of names
        words = os.strerror(number) if number > 0 else error.strerror or ""
        if words:
            return words[:1].lower() + words[1:]
    text = str(error).strip()
    return text or f"failed without a message ({type(error).__name__})"


def shown(value: object) -> str:
    """Return a wrong value for messages, in at most 60 characters."""
    try:
        text = repr(value)
    except ValueError:  # Python writes no integer of more than 4300 digits
        text = "a number of thousands of digits"
    return text if len(text) <= 60 else text[:57] + "..."


def nearest(name: str, known: Iterable[str]) -> str:
    """Return ``: did you mean …?`` with the known name nearest to a name; empty without one.

    A name is near if few letters differ, or if one of both begins with the other.
    """
    names = list(known)
    lower = {each.lower(): each for each in names}
    wanted = name.strip().lower().replace("-", "_")
    # 0.7: "overhnad" is near "overhand" (0.88), "8_81" is not near "10_81" (0.67)
    matches = get_close_matches(wanted, lower, n=1, cutoff=0.7) or [
        each
        for each in lower
        if len(wanted) >= 3
        and len(each) >= 3
        and (each.startswith(wanted) or wanted.startswith(each))
    ]
    return f": did you mean {lower[matches[0]]}?" if matches else ""


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
