"""Drills as lines of text, so that a run that was interrupted goes on where it was.

The first line says which plan and seed they belong to, each other one what came of one row with one
team at some random times.
"""

import hashlib
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from swarm.errors import InputError, Problem, reason
from swarm.planning import Plan
from swarm.simulation.fault_injection.evaluation import FaultTrial
from swarm.simulation.fault_injection.stepped_simulation import TeamAutopilots
from swarm.version import __version__

_LARGEST_FILE = 256 * 1024 * 1024
_NEVER_JUDGED = ("clearance", "apart")
"""What is infinite where there was nothing to judge, and null in JSON."""


@dataclass(frozen=True)
class CaseTrials:
    """The trials of a row with a team at random times that are drawn together from ``seeds``."""

    row: str
    personality: TeamAutopilots
    seeds: tuple[int, int, int]
    trials: tuple[FaultTrial, ...]

    @property
    def key(self) -> tuple[str, TeamAutopilots, tuple[int, int, int], int]:
        """What the same drills have in common, whenever they are flown."""
        return self.row, self.personality, self.seeds, len(self.trials)


@dataclass(frozen=True)
class ResultsHeader:
    """What drills belong to."""

    mission: str
    plan: str
    seed: int
    swarm: str = __version__


_HEADING, _FLOWN = TypeAdapter(ResultsHeader), TypeAdapter(CaseTrials)


def results_header(plan: Plan, seed: int) -> ResultsHeader:
    """Return what the drills of a plan belong to; another motion has another digest."""
    digest = hashlib.sha256(plan.motion.times.tobytes() + plan.motion.coefficients.tobytes())
    return ResultsHeader(plan.mission.name, digest.hexdigest()[:16], seed)


def line(what: ResultsHeader | CaseTrials) -> str:
    """Return a heading or drills as one line of JSON, with its end."""
    if isinstance(what, ResultsHeader):
        return _HEADING.dump_json(what).decode() + "\n"
    document = asdict(what)
    for trial in document["trials"]:
        _swap(trial, math.inf, None)
    return _FLOWN.dump_json(document, warnings=False).decode() + "\n"  # type: ignore[arg-type]


def read_results(lines: Iterable[str], wanted: ResultsHeader) -> list[CaseTrials]:
    """Return the drills that lines hold, each without its end; raises :class:`InputError` where
    they belong to something else, or are none."""
    found: list[CaseTrials] = []
    for number, text in enumerate(lines, 1):
        try:
            if number == 1:
                known = _HEADING.validate_json(text)
                if known != wanted:
                    raise InputError(
                        f"it holds drills of {known.mission} with seed {known.seed}, plan "
                        f"{known.plan} and swarm {known.swarm}; these are of {wanted.mission} with "
                        f"seed {wanted.seed}, plan {wanted.plan} and swarm {wanted.swarm}"
                    )
                continue
            found.append(_flown(text))
        except (ValidationError, ValueError):
            raise InputError(f"line {number} is not a line of drills") from None
    return found


def open_results(path: Path, header: ResultsHeader) -> list[CaseTrials]:
    """Return the trials that a results file holds; a file that does not exist is created.

    A last line without an end, which an interrupt cut off, is removed: its trials are flown again.
    Raises :class:`InputError` for another kind of file, and for results of another plan or seed.
    """
    try:
        with path.open("a+b") as file:
            file.seek(0)
            complete, end, _ = file.read(_LARGEST_FILE).rpartition(b"\n")
            known = read_results(complete.decode().splitlines(), header)
            file.truncate(len(complete + end))
            if not complete:
                file.write(line(header).encode())
        return known
    except OSError as error:
        problem = reason(error)
    except UnicodeDecodeError:
        problem = "line 1 is not a line of drills"
    except InputError as error:
        problem = str(error)
    raise InputError([Problem(str(path), problem)])


def append_results(path: Path, trials: CaseTrials) -> None:
    """Append the trials of a case to a results file."""
    try:
        with path.open("a", encoding="utf-8", newline="\n") as file:
            file.write(line(trials))
    except OSError as error:
        raise InputError([Problem(str(path), reason(error))]) from None


def _flown(text: str) -> CaseTrials:
    document = TypeAdapter(dict[str, Any]).validate_json(text)
    for trial in document.get("trials", ()):
        _swap(trial, None, math.inf)
    return _FLOWN.validate_python(document)


def _swap(trial: dict[str, Any], before: float | None, after: float | None) -> None:
    for name in _NEVER_JUDGED:
        if trial.get(name, 0.0) == before:
            trial[name] = after
