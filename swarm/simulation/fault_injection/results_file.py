"""Results of failure tests as lines of JSON, so that an interrupted run can be continued.

The first line identifies plan and seed; each further line has the trials of one case with one team.
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

_MAX_FILE_SIZE = 256 * 1024 * 1024
"""Bytes of a results file that are read."""

_DISTANCES = ("strand_distance", "vehicle_distance")
"""Fields that are infinite where never evaluated, and null in JSON."""


@dataclass(frozen=True)
class CaseTrials:
    """The trials of a case with a team, at random times that are drawn from ``seeds``."""

    case: str
    autopilots: TeamAutopilots
    seeds: tuple[int, int, int]
    trials: tuple[FaultTrial, ...]

    @property
    def key(self) -> tuple[str, TeamAutopilots, tuple[int, int, int], int]:
        """The key of these trials, the same in every run."""
        return self.case, self.autopilots, self.seeds, len(self.trials)


@dataclass(frozen=True)
class ResultsHeader:
    """The plan (digest of its motion), seed and version of the results."""

    mission: str
    plan: str
    seed: int
    swarm: str = __version__


_HEADER, _TRIALS = TypeAdapter(ResultsHeader), TypeAdapter(CaseTrials)


def results_header(plan: Plan, seed: int) -> ResultsHeader:
    """Return the header of a plan's results."""
    digest = hashlib.sha256(plan.motion.times.tobytes() + plan.motion.coefficients.tobytes())
    return ResultsHeader(plan.mission.name, digest.hexdigest()[:16], seed)


def line(content: ResultsHeader | CaseTrials) -> str:
    """Return a header or trials as one line of JSON, with its line end."""
    if isinstance(content, ResultsHeader):
        return _HEADER.dump_json(content).decode() + "\n"
    document = asdict(content)
    for trial in document["trials"]:
        _swap(trial, math.inf, None)
    return _TRIALS.dump_json(document, warnings=False).decode() + "\n"  # type: ignore[arg-type]


def read_results(lines: Iterable[str], expected: ResultsHeader) -> list[CaseTrials]:
    """Return the trials of lines without line ends.

    Raises :class:`InputError` where a line has no results or the header is not the expected one.
    """
    found: list[CaseTrials] = []
    for number, text in enumerate(lines, 1):
        try:
            if number == 1:
                header = _HEADER.validate_json(text)
                if header != expected:
                    raise InputError(
                        f"expected results of {_described(expected)}, got {_described(header)}"
                    )
                continue
            found.append(_trials(text))
        except (ValidationError, ValueError):
            raise InputError(f"line {number}: expected results of failure tests") from None
    return found


def open_results(path: Path, header: ResultsHeader) -> list[CaseTrials]:
    """Return the trials that a results file holds; a file that does not exist is created.

    A last line without an end, which an interrupt cut off, is removed: its trials are flown again.
    Raises :class:`InputError` for another kind of file, and for results of another plan or seed.
    """
    try:
        with path.open("a+b") as file:
            file.seek(0)
            complete, end, _ = file.read(_MAX_FILE_SIZE).rpartition(b"\n")
            trials = read_results(complete.decode().splitlines(), header)
            file.truncate(len(complete + end))
            if not complete:
                file.write(line(header).encode())
        return trials
    except OSError as error:
        problem = reason(error)
    except UnicodeDecodeError:
        problem = "line 1: expected results of failure tests"
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


def _described(header: ResultsHeader) -> str:
    return f"{header.mission} with seed {header.seed}, plan {header.plan} and swarm {header.swarm}"


def _trials(text: str) -> CaseTrials:
    document = TypeAdapter(dict[str, Any]).validate_json(text)
    for trial in document.get("trials", ()):
        _swap(trial, None, math.inf)
    return _TRIALS.validate_python(document)


def _swap(trial: dict[str, Any], before: float | None, after: float | None) -> None:
    for name in _DISTANCES:
        if trial.get(name, 0.0) == before:
            trial[name] = after
