"""What the folder of a flight's record holds: its plan and what was flown."""

import json
from pathlib import Path

from pydantic import ValidationError

from swarm.certification.assessment import Assessment
from swarm.cli.inputs import read_record
from swarm.errors import InputError, Problem
from swarm.flight.archive import read_certificate, read_frames
from swarm.flight.flight_plan import Basis
from swarm.flight.tlog import KnownFrames, Replayed, replay
from swarm.mission.fleet import Fleet
from swarm.mission.validation import LARGEST_FILE
from swarm.planning import Plan, digest
from swarm.planning.archive import read_plan

LARGEST_PLAN = 64 << 20
"""Bytes that a record's plan or motion may have."""
_LARGEST_LOG = 4 << 30


def recorded_plan(record: Path) -> Plan:
    """Return the plan that a record's folder holds; raises :class:`InputError` without one."""
    files = record / "plan.json", record / "motion.npz"
    try:
        document = json.loads(read_record(files[0], LARGEST_PLAN))
        return read_plan(document, read_record(files[1], LARGEST_PLAN))
    except RecursionError:
        raise InputError([Problem(str(files[0]), "not valid JSON: nested too deeply")]) from None
    except ValueError as error:
        raise InputError([Problem(str(files[0]), f"not valid JSON: {error}")]) from None
    except OSError as error:
        reason = "expected a flight's record with plan.json and motion.npz in it"
        raise InputError([Problem(str(record), reason)]) from error


def recorded_certificate(record: Path) -> tuple[Basis, Assessment]:
    """Return on what a record's flight was flown, and what the checks found before it.

    Raises :class:`InputError` where the record does not say.
    """
    path = record / "certificate.json"
    try:
        return read_certificate(json.loads(read_record(path, LARGEST_PLAN)))
    except RecursionError:
        raise InputError([Problem(str(path), "not valid JSON: nested too deeply")]) from None
    except ValueError as error:
        raise InputError([Problem(str(path), f"not valid JSON: {error}")]) from None
    except OSError as error:
        reason = "expected a flight's record with certificate.json in it"
        raise InputError([Problem(str(record), reason)]) from error


def recorded_basis(record: Path, plan: Plan) -> Basis | None:
    """Return on what a record's flight was flown; None where the record is older than that.

    Raises :class:`InputError` where the recorded plan is not the one that was flown.
    """
    if not (record / "certificate.json").exists():
        return None
    basis, _ = recorded_certificate(record)
    if basis.digest != digest(plan):
        message = "not the plan that certificate.json belongs to: its digest differs"
        raise InputError([Problem(str(record / "plan.json"), message)])
    return basis


def recorded_flight(record: Path, plan: Plan) -> Replayed:
    """Replay the .tlog in a record's folder; raises :class:`InputError` where there is none."""
    path, listed = record / "flight.tlog", record / "fleet.json"
    try:
        fleet = Fleet.model_validate_json(read_record(listed, LARGEST_FILE))
        if path.stat().st_size > _LARGEST_LOG:
            raise InputError([Problem(str(path), "too large for a flight")])
        data = path.read_bytes()
    except OSError as error:
        reason = "expected a flight's record with flight.tlog and fleet.json in it"
        raise InputError([Problem(str(record), reason)]) from error
    except ValidationError:
        raise InputError([Problem(str(listed), "expected the fleet of a flight")]) from None
    return replay(data, plan, fleet, recorded_frames(record, plan))


def recorded_frames(record: Path, plan: Plan) -> KnownFrames | None:
    """Return the frames that a resumed flight's record keeps; None where it keeps none."""
    path = record / "frames.json"
    if not path.exists():
        return None
    try:
        return read_frames(json.loads(read_record(path, LARGEST_FILE)), plan)
    except ValueError as error:
        raise InputError([Problem(str(path), f"not valid JSON: {error}")]) from None
