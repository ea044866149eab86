"""The order of first tests, and which of them a fleet has passed.

A list in the user's state folder names the records of the flights that passed. It is derived from
records alone: each flight of vehicles that are not emulated is verified as it ends, and ``swarm
verify`` enters a record again, or removes one that does not pass any more.
"""

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, Literal

from pydantic import TypeAdapter, ValidationError

from swarm.errors import InputError, Problem, Refused, reason
from swarm.files import read_text, write_text
from swarm.flight.flight_plan import CableFreeFlight, FlightPlan, Kind
from swarm.flight.setup import LOOSE_ERROR
from swarm.ground.record_reader import recorded_facts, recorded_fleet, recorded_outcome
from swarm.ground.record_verification import VerifiedRecord
from swarm.mission.fleet import Fleet
from swarm.mission.validation import LARGEST_FILE
from swarm.planning import PhaseName, Plan

Step = Literal["hop", "no cable", "carry", "pass", "knot"]

STEPS: Final[Mapping[Step, tuple[str, str]]] = {
    "hop": ("a hop", "swarm check MISSION --hop"),
    "no cable": ("a flight without cable", "first-steps/hover.yaml, or --no-cable"),
    "carry": ("two vehicles carry one strand", "first-steps/two_carry.yaml"),
    "pass": ("strands pass each other, without a knot", "first-steps/pass_over.yaml"),
    "knot": ("a knot", ""),
}
"""The first tests in their order: in words, and what flies them."""

_WHOLE_TEAM: Final = frozenset({"hop", "no cable"})
"""Steps that count for a flight only where as many vehicles flew them."""
_COUNTED: Final[frozenset[Kind]] = frozenset({"certified", "hop", "raised"})
"""Kinds of flights that may pass a step: whole ones of checked plans."""
_AS_CERTIFIED: Final[frozenset[PhaseName]] = frozenset({"fold", "hold"})
"""Phases in which vehicles must follow as certified, without cable too."""


@dataclass(frozen=True)
class PassedStep:
    """A step that a fleet has passed with so many vehicles.

    ``fleet`` is :attr:`swarm.mission.fleet.Fleet.identity`, ``record`` the path of the record,
    ``date`` that of the flight (ISO 8601, UTC), ``digest`` of its plan.
    """

    fleet: str
    step: Step
    vehicles: int
    record: str
    date: str
    digest: str


_LINE = TypeAdapter(PassedStep)


def list_path() -> Path:
    """Return the path of the list, one JSON object a line, in the user's state folder."""
    state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    return state / "swarm" / "first-tests.jsonl"


def step_of(plan: Plan, kind: Kind, *, cable: bool) -> Step:
    """Return the step that a flight of a plan is."""
    if kind == "hop":
        return "hop"
    if not cable:
        return "no cable"
    if _ties_knot(plan):
        return "knot"
    return "carry" if len(plan.layout.lengths) == 1 else "pass"


def _ties_knot(plan: Plan) -> bool:
    return plan.knot.type not in {"", "0_1"}


def carries_cable(flight_plan: FlightPlan, *, no_cable: bool) -> bool:
    """Return whether a flight would carry cable."""
    cable_free = no_cable or isinstance(flight_plan, CableFreeFlight)
    return not cable_free and len(flight_plan.plan.layout.lengths) > 0


def passed_steps(fleet: Fleet) -> list[PassedStep]:
    """Return what a fleet has passed, in the order of entry.

    Raises :class:`InputError` where the list is damaged.
    """
    return [row for row in _read() if row.fleet == fleet.identity]


def missing_steps(fleet: Fleet, plan: Plan) -> list[Step]:
    """Return the steps before that of a flight of the plan with cable that a fleet has not passed.

    Raises :class:`InputError` where the list is damaged.
    """
    passed = passed_steps(fleet)
    step = step_of(plan, "certified", cable=True)
    steps = list(STEPS)
    return [
        earlier
        for earlier in steps[: steps.index(step)]
        if not any(row.step == earlier and _suffices(row, plan) for row in passed)
    ]


def _suffices(row: PassedStep, plan: Plan) -> bool:
    return row.vehicles >= plan.vehicles or row.step not in _WHOLE_TEAM


def require_steps(
    flight_plan: FlightPlan, fleet: Fleet, *, no_cable: bool, skip: bool
) -> tuple[Step, ...]:
    """Return the first tests that a flight with cable skips; none without cable, or if emulated.

    Raises :class:`Refused` where there are any, unless ``skip`` says that they may be skipped.
    """
    plan = flight_plan.plan
    if fleet.emulated is not None or not carries_cable(flight_plan, no_cable=no_cable):
        return ()
    missing = missing_steps(fleet, plan)
    if missing and not skip:
        lines = [f"  {words_of(step, plan)}" for step in missing]
        raise Refused(
            "\n".join(
                [
                    f"fleet {fleet.name} has not passed the first tests before this flight with "
                    "cable:",
                    *lines,
                    "swarm check lists what it has passed; --skip-step flies all the same, and "
                    "the record says so",
                ]
            )
        )
    return tuple(missing)


def words_of(step: Step, plan: Plan | None = None) -> str:
    """Return a step in words, with what flies it, and the vehicles that a plan needs in it."""
    what, how = STEPS[step]
    if plan is not None and step in _WHOLE_TEAM:
        what += f" of all {plan.vehicles} vehicles"
    return f"{what} ({how})" if how else what


def enter(verified: VerifiedRecord) -> PassedStep | None:
    """Enter a verified record in the list, or remove it; return the step that it passes.

    Flights of emulated vehicles, and of those that another process simulates, are not listed.
    Raises :class:`InputError` where the list cannot be read or written.
    """
    if recorded_fleet(verified.record).emulated is not None:
        return None
    folder, passes = str(verified.record.resolve()), _passes(verified)
    before = _read()
    rows = [row for row in before if row.record != folder]
    basis = verified.basis
    entered = None
    if passes and basis is not None:
        start = datetime.fromtimestamp(float(recorded_facts(verified.record)["start_time"]), UTC)
        entered = PassedStep(
            fleet=recorded_fleet(verified.record).identity,
            step=step_of(verified.plan, basis.kind, cable=basis.cable),
            vehicles=verified.plan.vehicles,
            record=folder,
            date=start.isoformat(timespec="seconds"),
            digest=basis.digest,
        )
        rows.append(entered)
    if rows != before:
        _write(rows)
    return entered


def _passes(verified: VerifiedRecord) -> bool:
    """Return whether real vehicles landed as planned, by the record and by its verification."""
    record, basis = verified.record, verified.basis
    if basis is None or basis.kind not in _COUNTED:
        return False
    facts = recorded_facts(record)
    real = facts.get("world_start") is None and isinstance(facts.get("start_time"), int | float)
    return real and recorded_outcome(record) == "done" and verified.passed and _followed(verified)


def _followed(verified: VerifiedRecord) -> bool:
    """Return whether all vehicles are known to have followed their setpoints.

    In fold and hold as certified, without cable too; without cable in all other phases after
    take-off to LOOSE_ERROR, or to the planned tracking error where that is larger.
    """
    adherence, basis, plan = verified.adherence, verified.basis, verified.plan
    if basis is None or adherence is None or adherence.certified is None or not adherence.within:
        return False
    loose = max(adherence.planned, LOOSE_ERROR)
    allowed: dict[str, float] = {
        phase.name: adherence.certified if phase.name in _AS_CERTIFIED else loose
        for phase in plan.phases
        if phase.name in _AS_CERTIFIED or not (basis.cable or phase.name == "takeoff")
    }
    largest = {
        (error.phase, error.vehicle): error.largest for error in verified.verification.tracking
    }
    return all(
        largest.get((phase, vehicle), math.inf) <= limit
        for phase, limit in allowed.items()
        for vehicle in range(1, plan.vehicles + 1)
    )


def _read() -> list[PassedStep]:
    path = list_path()
    if not path.exists():
        return []
    rows = []
    for number, line in enumerate(read_text(path, LARGEST_FILE).splitlines(), 1):
        try:
            rows.append(_LINE.validate_json(line))
        except ValidationError:
            message = "expected a passed first test; without this file, swarm verify RECORD makes "
            message += "it again"
            raise InputError([Problem(f"{path}:{number}", message)]) from None
    return rows


def _write(rows: Sequence[PassedStep]) -> None:
    path = list_path()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError([Problem(str(path.parent), reason(error))]) from None
    write_text(path, "".join(json.dumps(asdict(row)) + "\n" for row in rows))
