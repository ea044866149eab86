"""The commands of an operator, and how the record words them."""

import re
from typing import Literal, get_args

from swarm.flight.snapshot import Event

Request = Literal[
    "hold", "resume", "rewind", "land", "release", "rejoin", "abort", "kill", "interrupt", "go",
    "refuse",
]  # fmt: skip
REQUESTS: tuple[Request, ...] = get_args(Request)
ABSENCE = "the absence of screens"
"""The author of requests that are made because no screen is attached."""
_REQUESTED = re.compile(rf"({'|'.join(REQUESTS)}) by (.+?): ")


def request_words(command: Request, author: str, answer: str) -> str:
    """Return the message of the event of a request, with the answer that it got."""
    return f"{command}{f' by {author}' if author else ''}: {answer}"


def requested(event: Event) -> tuple[str, str] | None:
    """Return command and author of the event of a request; None for other events.

    Requests without an author, which only programs make, are not recognized.
    """
    match = _REQUESTED.match(event.message) if event.kind == "operator" else None
    return (match[1], match[2]) if match else None
