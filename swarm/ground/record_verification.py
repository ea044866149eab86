"""Verification of a flight record: the recorded plan compared with the logged positions.

Observations of the flown knot, by a person or a camera, are kept in the record.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from swarm.certification.assessment import Assessment, assess
from swarm.errors import InputError, Problem, reason
from swarm.files import parse_json, read_text
from swarm.flight.flight_plan import Basis, confirmed_basis
from swarm.flight.result import Adherence, FlightResult, Outcome, Statistics, Word, adherence
from swarm.flight.snapshot import Event
from swarm.flight.tlog import Replayed
from swarm.flight.training import Training
from swarm.ground.record_reader import (
    recorded_basis,
    recorded_events,
    recorded_flight,
    recorded_plan,
    recorded_skipped,
    recorded_summary,
    recorded_training,
    true_trace,
)
from swarm.knots.catalog import choose_knot
from swarm.mission.validation import LARGEST_FILE
from swarm.planning import KnotSummary, Plan
from swarm.verification import Verification, verify_trace

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
    match = _SENTENCE.fullmatch(sentence.strip())
    if match is None:
        message = f'expected words such as "3_1 right by camera", got {sentence!r}'
        raise InputError([Problem("--observed", message)])
    name = match["knot"].strip()
    if name.lower() in {"0_1", "unknot", "nothing"}:
        knot = "0_1"
    else:
        try:
            knot = choose_knot(name=name, chirality="either").name
        except InputError as error:
            raise InputError([Problem("--observed", str(error))]) from None
    seconds = time.astimezone(UTC).isoformat(timespec="seconds")
    return Observation(knot, match["hand"] or "", match["observer"].strip(), seconds)


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


@dataclass(frozen=True, eq=False)
class VerifiedRecord:
    """A flight record and its verification.

    ``basis`` and ``adherence`` are None for a record from before certificates. ``log`` has the
    trace and the link statistics of the .tlog, ``truth``: with the emulator's positions.
    ``observations`` are in the order of their entry. ``training`` are the faults that were
    injected, ``events`` then those of the flight; ``skipped`` the first tests that were skipped.
    """

    record: Path
    plan: Plan
    basis: Basis | None
    assessment: Assessment
    log: Replayed
    verification: Verification
    adherence: Adherence | None
    observations: tuple[Observation, ...]
    truth: bool = False
    training: Training | None = None
    events: tuple[Event, ...] = ()
    skipped: tuple[str, ...] = ()

    @property
    def outside_certificate(self) -> bool:
        """Whether cable was carried with a tracking error that is not certified."""
        if self.basis is None or self.adherence is None:
            return False
        return self.basis.cable and not self.adherence.within

    @property
    def passed(self) -> bool:
        """Whether the positions imply the planned knot, within the certificate.

        The last observation, if there is one, must agree.
        """
        agrees = not self.observations or self.observations[-1].agrees(self.plan.knot)
        return self.verification.as_planned and agrees and not self.outside_certificate

    def observed(self, observation: Observation) -> "VerifiedRecord":
        """Append an observation to the record, and return the verification with it.

        Raises :class:`InputError` where the record cannot be written.
        """
        append_observation(self.record, observation)
        return replace(self, observations=(*self.observations, observation))


def recorded_result(verified: VerifiedRecord) -> FlightResult:
    """Return the result of a verified record's flight, as the flight itself had it.

    Raises :class:`InputError` for a record without a certificate, or that did not end.
    """
    record, basis, flown = verified.record, verified.basis, verified.adherence
    summary = recorded_summary(record)
    try:
        ending = _ENDING.validate_python(summary)
    except ValidationError:
        message = "expected the summary of a flight that has ended"
        raise InputError([Problem(str(record / "summary.json"), message)]) from None
    if basis is None or flown is None:
        raise InputError([Problem(str(record), "expected a record with a certificate")])
    return FlightResult(
        Outcome(ending.outcome, ending.explanation),
        verified.log.trace,
        tuple(recorded_events(record)),
        ending.statistics,
        basis,
        flown,
        record,
        verified.training,
        verified.skipped,
    )


@dataclass(frozen=True)
class _Ending:
    """What is read of a summary."""

    outcome: Word
    explanation: str
    statistics: Statistics


_ENDING = TypeAdapter(_Ending)


def verify_record(record: Path, *, truth: bool = False) -> VerifiedRecord:
    """Return the verification of a flight record; of the emulator's ground truth with ``truth``.

    Reads reported positions and sent setpoints from the .tlog, and checks the recorded plan again,
    with the tracking error that its certificate states.
    Raises :class:`InputError` for a folder that is not a complete record.
    """
    plan = recorded_plan(record)
    basis = recorded_basis(record, plan)
    if basis is not None:
        basis = confirmed_basis(plan, basis)
    observations = tuple(recorded_observations(record))
    training = recorded_training(record)
    log = recorded_flight(record, plan)
    if truth:
        log = replace(log, trace=true_trace(record, log))
    return VerifiedRecord(
        record=record,
        plan=plan,
        basis=basis,
        assessment=assess(plan),
        log=log,
        verification=verify_trace(plan, log.trace),
        adherence=adherence(plan, log.trace, basis) if basis else None,
        observations=observations,
        truth=truth,
        training=training,
        events=tuple(recorded_events(record)) if training is not None else (),
        skipped=recorded_skipped(record),
    )
