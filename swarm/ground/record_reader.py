"""Reading of a flight record, the folder that a flight leaves: plan, certificate, fleet, log.

Every function raises :class:`InputError` for a file that is missing, too large or damaged.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from swarm.certification.assessment import Assessment
from swarm.errors import InputError, Problem, reason
from swarm.files import parse_json, read_bytes
from swarm.flight.archive import read_certificate
from swarm.flight.flight_plan import Basis
from swarm.flight.snapshot import Event
from swarm.flight.tlog import KnownFrames, Replayed, read_frames, replay
from swarm.flight.trace import Trace
from swarm.flight.training import Training
from swarm.mission.fleet import Fleet
from swarm.mission.validation import LARGEST_FILE
from swarm.planning import Plan, digest
from swarm.planning.archive import read_plan

LARGEST_PLAN = 64 << 20
"""Bytes of a record's plan, motion or certificate."""
_EVENT, _TRAINING = TypeAdapter(Event), TypeAdapter(Training | None)
_FACTS = "versions.json"
LATEST_EVENT = 1e9
"""Seconds of an event's clock, which begins with the flight or with the computer: 30 years."""
LARGEST_LOG = 4 << 30
"""Bytes of a record's packets."""


def recorded_plan(record: Path) -> Plan:
    """Return the plan of a record."""
    _require(record, "plan.json", "motion.npz")
    document = _json(record / "plan.json", LARGEST_PLAN)
    return read_plan(document, read_bytes(record / "motion.npz", LARGEST_PLAN))


def recorded_certificate(record: Path) -> tuple[Basis, Assessment]:
    """Return the basis of a record's flight, and the results of the checks before it."""
    _require(record, "certificate.json")
    return read_certificate(_json(record / "certificate.json", LARGEST_PLAN))


def recorded_basis(record: Path, plan: Plan) -> Basis | None:
    """Return the basis of a record's flight; None for a record from before certificates.

    Raises :class:`InputError` where the certificate belongs to another plan.
    """
    if not (record / "certificate.json").exists():
        return None
    basis, _ = recorded_certificate(record)
    if basis.digest != digest(plan):
        message = "not the plan that certificate.json belongs to: its digest differs"
        raise InputError([Problem(str(record / "plan.json"), message)])
    return basis


def recorded_fleet(record: Path, *, flown: bool = True) -> Fleet:
    """Return the fleet of a record; that of a check on the ground was not ``flown``."""
    _require(record, "fleet.json", *(["flight.tlog"] if flown else []))
    path = record / "fleet.json"
    try:
        return Fleet.model_validate_json(read_bytes(path, LARGEST_FILE))
    except ValidationError:
        raise InputError([Problem(str(path), "expected the fleet of a flight")]) from None


def recorded_log(record: Path, largest: int = LARGEST_LOG) -> bytes:
    """Return the packets of a record, as its .tlog stores them; at most ``largest`` bytes."""
    _require(record, "fleet.json", "flight.tlog")
    path = record / "flight.tlog"
    try:
        if path.stat().st_size > largest:
            raise InputError([Problem(str(path), "too large for a flight")])
        return path.read_bytes()
    except OSError as error:
        raise InputError([Problem(str(path), reason(error))]) from None


def recorded_flight(record: Path, plan: Plan) -> Replayed:
    """Return positions, setpoints and link statistics of a record, from its .tlog."""
    fleet = recorded_fleet(record)
    return replay(recorded_log(record), plan, fleet, recorded_frames(record, plan))


def recorded_events(record: Path) -> Iterator[Event]:
    """Yield the events of a record; a last line that was cut off is left out."""
    path = record / "events.jsonl"
    lines = read_bytes(path, LARGEST_PLAN).decode("utf-8", "replace").splitlines()
    for number, line in enumerate(lines, start=1):
        try:
            event = _EVENT.validate_json(line)
            if not abs(event.time) <= LATEST_EVENT:
                raise ValueError
            yield event
        except ValueError:
            if number < len(lines):
                raise InputError([Problem(f"{path}:{number}", "expected an event")]) from None


def recorded_training(record: Path) -> Training | None:
    """Return the faults that were injected into a record's flight; None where none were."""
    try:
        return _TRAINING.validate_python(recorded_facts(record).get("training"))
    except ValidationError:
        message = "expected injected faults"
        raise InputError([Problem(f"{record / _FACTS}: training", message)]) from None


def recorded_skipped(record: Path) -> tuple[str, ...]:
    """Return the first tests that a record's flight skipped."""
    skipped = recorded_facts(record).get("skipped_steps") or []
    if not isinstance(skipped, list):
        raise InputError([Problem(f"{record / _FACTS}: skipped_steps", "expected a list")])
    return tuple(map(str, skipped))


def recorded_outcome(record: Path) -> str:
    """Return how a record's flight ended, in a word; "" where it did not end as it should."""
    return str(recorded_summary(record).get("outcome", ""))


def recorded_summary(record: Path) -> dict[str, Any]:
    """Return the summary of a record; empty where it has none."""
    path = record / "summary.json"
    summary = _json(path, LARGEST_FILE) if path.exists() else {}
    return summary if isinstance(summary, dict) else {}


def recorded_facts(record: Path) -> dict[str, Any]:
    """Return what a record says of its flight beside plan and fleet; empty for an old record."""
    path = record / _FACTS
    facts = _json(path, LARGEST_FILE) if path.exists() else {}
    if not isinstance(facts, dict):
        raise InputError([Problem(str(path), "expected facts by name")])
    return facts


def recorded_frames(record: Path, plan: Plan) -> KnownFrames | None:
    """Return the frames in the record of a resumed flight; None in other records."""
    path = record / "frames.json"
    return read_frames(_json(path, LARGEST_FILE), plan) if path.exists() else None


def _require(record: Path, *names: str) -> None:
    """Raise :class:`InputError` for a folder without these files."""
    if not all((record / name).is_file() for name in names):
        message = f"expected a flight record with {' and '.join(names)} in it"
        raise InputError([Problem(str(record), message)])


def _json(path: Path, largest: int) -> Any:
    return parse_json(read_bytes(path, largest), str(path))


TRUTH = "truth.jsonl"
"""Name of the file in a record; the emulator writes it, `swarm fly --firmware` asks it to."""
LARGEST_TRUTH = 1 << 30
"""Bytes of that file."""


def true_trace(record: Path, flown: Replayed) -> Trace:
    """Return the trace of a flight with true grip points (ENU, metres) for the reported ones.

    Flight time is the world's, from the moment in the record on. Moments without truth are NaN.
    Raises :class:`InputError` for a record without truth of its vehicles.
    """
    path = record / TRUTH
    moments = [moment for moment in _lines(path) if "position" in moment]
    if len(moments) < 2:
        raise InputError([Problem(str(path), "expected the ground truth of an emulated flight")])
    ids = list(moments[0]["ids"])
    missing = [system for system in flown.known.systems if system not in ids]
    if missing:
        message = (
            f"expected vehicles {', '.join(map(str, missing))}, got {', '.join(map(str, ids))}"
        )
        raise InputError([Problem(str(path), message)])
    rows = [ids.index(system) for system in flown.known.systems]
    start, world_start = _clock(record)
    time = np.array([moment["time"] for moment in moments])
    at = time - world_start + start - flown.started
    places = np.array([moment["position"] for moment in moments])[:, rows]
    trace = flown.trace
    true = np.full(trace.position.shape, np.nan)
    known = (trace.time >= at[0]) & (trace.time <= at[-1])
    for k in range(len(rows)):
        for axis in range(3):
            true[known, k, axis] = np.interp(trace.time[known], at, places[:, k, axis])
    return replace(trace, position=true)


def _lines(path: Path) -> list[dict[str, Any]]:
    """Return the objects of the file; a last line that was cut off is left out."""
    lines = read_bytes(path, LARGEST_TRUTH).splitlines()
    objects = []
    for number, line in enumerate(lines, start=1):
        try:
            objects.append(parse_json(line, str(path)))
        except InputError:
            if number < len(lines):
                raise InputError([Problem(f"{path}:{number}", "expected ground truth")]) from None
    return objects


def _clock(record: Path) -> tuple[float, float]:
    """Return the wall clock's and the world's time at which flight time was zero, seconds."""
    path = record / "versions.json"
    try:
        facts = parse_json(read_bytes(path, LARGEST_FILE), str(path))
        return float(facts["start_time"]), float(facts["world_start"])
    except (ValueError, KeyError, TypeError):
        raise InputError([Problem(str(path), "expected start_time and world_start")]) from None
