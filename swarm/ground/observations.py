"""Observations of a flown knot, by a person or a camera, in the record of its flight."""

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from swarm.errors import InputError, Problem, reason
from swarm.files import parse_json, read_text
from swarm.knots.catalog import choose_knot
from swarm.mission.validation import LARGEST_FILE
from swarm.planning import KnotSummary

_SENTENCE = re.compile(
    r"(?P<knot>.+?)(?:,?\s+(?P<hand>left|right)(?:-handed)?)?\s+by\s+(?P<observer>.+)"
)
_LARGEST_COUNT = 1000
_FILE = "observations.jsonl"
_OLD_KEYS = {"by": "observer", "at": "time"}
"""Keys of older records, and their names now."""


@dataclass(frozen=True)
class Observation:
    """An observed knot.

    ``knot`` is KnotInfo's name, ``chirality`` "left", "right" or "" (not stated), ``observer`` a
    person or a camera, ``time`` ISO 8601 in UTC.
    """

    knot: str
    chirality: str
    observer: str
    time: str

    def agrees(self, planned: KnotSummary) -> bool:
        """Return whether this is the planned knot; a chirality that is not stated agrees."""
        chirality = planned.chirality if self.chirality == "" else self.chirality
        return (self.knot, chirality) == (planned.type, planned.chirality)


def parse_observation(sentence: str, time: datetime) -> Observation:
    """Return the observation in a sentence such as "3_1 right by camera" or "unknot by Ann"."""
    found = _SENTENCE.fullmatch(sentence.strip())
    if found is None:
        message = f'expected words such as "3_1 right by camera", got {sentence!r}'
        raise InputError([Problem("--observed", message)])
    name = found["knot"].strip()
    if name.lower() in {"0_1", "unknot", "nothing"}:
        knot = "0_1"
    else:
        try:
            knot = choose_knot(name=name, chirality="either").name
        except InputError as error:
            raise InputError([Problem("--observed", str(error))]) from None
    seconds = time.astimezone(UTC).isoformat(timespec="seconds")
    return Observation(knot, found["hand"] or "", found["observer"].strip(), seconds)


def append_observation(record: Path, observation: Observation) -> None:
    """Append an observation to a record."""
    path = record / _FILE
    try:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(observation), ensure_ascii=False) + "\n")
    except OSError as error:
        raise InputError([Problem(str(path), reason(error))]) from None


def recorded_observations(record: Path) -> list[Observation]:
    """Return the observations of a record, oldest first."""
    path = record / _FILE
    if not path.exists():
        return []
    try:
        lines = read_text(path, LARGEST_FILE).splitlines()[-_LARGEST_COUNT:]
        return [_read(parse_json(line, str(path))) for line in lines]
    except (TypeError, AttributeError):
        raise InputError([Problem(str(path), "expected one observation per line")]) from None


def _read(document: Mapping[str, Any]) -> Observation:
    return Observation(**{_OLD_KEYS.get(key, key): value for key, value in document.items()})
