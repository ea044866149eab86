"""One result of one check of a plan or of a team."""

from dataclasses import dataclass
from typing import Literal

Severity = Literal["error", "warning", "info"]


@dataclass(frozen=True)
class Finding:
    """A result of a check.

    ``at_time`` is mission time in seconds, ``where`` a place in ENU metres; None where not
    applicable.
    """

    severity: Severity
    check: str
    message: str
    at_time: float | None = None
    where: tuple[float, float, float] | None = None
