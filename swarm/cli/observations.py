"""What a person or a camera saw, entered into a flight's record beside what is computed."""

import json
import re
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from swarm.errors import InputError, Problem, reason
from swarm.knots.catalog import choose
from swarm.planning import KnotSummary

_WORDS = re.compile(r"(?P<knot>.+?)(?:,?\s+(?P<hand>left|right)(?:-handed)?)?\s+by\s+(?P<who>.+)")
_MOST = 1000


@dataclass(frozen=True)
class Observation:
    """A knot that somebody saw: KnotInfo's name, hand ("" where none was said), who, when."""

    knot: str
    chirality: str
    by: str
    at: str

    def agrees(self, asked: KnotSummary) -> bool:
        """Whether this is the knot that was asked for, as far as it was said."""
        hand = asked.chirality if self.chirality == "" else self.chirality
        return (self.knot, hand) == (asked.type, asked.chirality)


def observation(words: str, at: datetime) -> Observation:
    """Turn words such as "3_1 right by camera" into an observation; "unknot" is a knot, too."""
    found = _WORDS.fullmatch(words.strip())
    if found is None:
        wrong = f'expected words such as "3_1 right by camera", got {words!r}'
        raise InputError([Problem("--observed", wrong)])
    name = found["knot"].strip()
    if name.lower() in {"0_1", "unknot", "nothing"}:
        knot = "0_1"
    else:
        try:
            knot = choose(name=name, chirality="either").name
        except InputError as error:
            raise InputError([Problem("--observed", str(error))]) from None
    seen = at.astimezone(UTC).isoformat(timespec="seconds")
    return Observation(knot, found["hand"] or "", found["who"].strip(), seen)


def enter(record: Path, seen: Observation) -> None:
    """Append an observation to a record."""
    path = record / "observations.jsonl"
    try:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(seen), ensure_ascii=False) + "\n")
    except OSError as error:
        raise InputError([Problem(str(path), reason(error))]) from None


def observations(record: Path) -> list[Observation]:
    """Return what was entered, oldest first."""
    path = record / "observations.jsonl"
    if not path.exists():
        return []
    try:
        lines = path.read_text(encoding="utf-8").splitlines()[-_MOST:]
        return [Observation(**json.loads(line)) for line in lines]
    except (OSError, ValueError, TypeError, RecursionError):
        raise InputError([Problem(str(path), "expected one observation per line")]) from None
