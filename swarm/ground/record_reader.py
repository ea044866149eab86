"""Reading of a flight record, the folder that a flight leaves: plan, certificate, fleet, log.

Every function raises :class:`InputError` for a file that is missing, too large or damaged.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from swarm.certification.assessment import Assessment
from swarm.errors import InputError, Problem, reason
from swarm.files import parse_json, read_bytes
from swarm.flight.archive import read_certificate
from swarm.flight.flight_plan import Basis
from swarm.flight.snapshot import Event
from swarm.flight.tlog import KnownFrames, Replayed, read_frames, replay
from swarm.mission.fleet import Fleet
from swarm.mission.validation import LARGEST_FILE
from swarm.planning import Plan, digest
from swarm.planning.archive import read_plan

LARGEST_PLAN = 64 << 20
"""Bytes of a record's plan, motion or certificate."""
_EVENT = TypeAdapter(Event)
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


def recorded_fleet(record: Path) -> Fleet:
    """Return the fleet of a record."""
    _require(record, "fleet.json", "flight.tlog")
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
