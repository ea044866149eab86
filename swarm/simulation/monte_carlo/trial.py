"""One trial: a rehearsal in a world that is drawn for it, and how it went."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from swarm.flight.conductor import Conductor
from swarm.flight.flight_plan import FlightPlan
from swarm.flight.result import FlightResult
from swarm.flight.trace import Trace
from swarm.mission.fleet import Fleet, emulated_fleet
from swarm.planning import Plan
from swarm.simulation.loop import Emulator, Fault, simulate_flight
from swarm.simulation.monte_carlo.spread import Conditions, Spread, draw
from swarm.verification import closest_strands, verify_trace

Floats = npt.NDArray[np.float64]

SAMPLE_INTERVAL: Final = 0.4
"""Seconds of flight between the moments at which a trial's distances are taken."""

CLEARANCES: Final = ("cable", "vehicle", "vehicle_cable")
_SHARES: Final = np.linspace(0.0, 1.0, 25)
_ROUNDING: Final = 1e-6


@dataclass(frozen=True)
class Trial:
    """How one trial went; one row of the results.

    ``outcome`` and ``reason`` in words. ``cable``, ``vehicle`` and ``vehicle_cable`` are the
    smallest distances in fold and hold, metres, of what the certificate speaks of: the cable in
    the cable model between the places where the vehicles really were. ``hung`` is the smallest
    distance of strands of the emulator's own cable, with its errors, wind and sway. ``error`` is
    the largest distance of a vehicle from its place in the plan then. None where nothing is known,
    the cable never having been aloft.
    """

    number: int
    outcome: str
    reason: str
    explanation: str
    knot: str
    as_planned: bool
    cable: float | None
    vehicle: float | None
    vehicle_cable: float | None
    hung: float | None
    error: float | None
    strikes: int
    collisions: int
    crashed: int
    wind: float
    gust: float
    failing: str
    failing_at: float | None
    duration: float

    @property
    def completed(self) -> bool:
        """Whether the flight was done as planned, and implies the knot of the plan."""
        return self.outcome == "done" and self.as_planned


def rows(trials: Iterable[Trial]) -> list[dict[str, Any]]:
    """Return trials as rows of a table, in the order of their numbers."""
    return [asdict(trial) for trial in sorted(trials, key=lambda trial: trial.number)]


COLUMNS: Final = tuple(field.name for field in fields(Trial))


class _Witness:
    """Takes down what really is, while the cable is folded and held."""

    def __init__(self) -> None:
        self._next = 0.0
        self.rows: list[tuple[float, float, str, Floats, Floats | None]] = []
        self.strikes = self.collisions = self.crashed = 0
        self._told = 0
        self._fallen: set[int] = set()

    def __call__(self, flight: Conductor, emulator: Emulator, now: float) -> None:
        if now < self._next:
            return
        self._next = now + SAMPLE_INTERVAL
        self._count(emulator)
        phase = flight.phase.name if flight.stage == "fly" else ""
        if phase not in {"fold", "hold"} or _lets_go(flight):
            return
        grips, held, cable = emulator.held()
        ids = [vehicle.system for vehicle in emulator.vehicles]
        order = [ids.index(system) for system in flight.systems]
        arcs = held[order]
        hung = None
        if np.isfinite(arcs).all() and emulator.rope is not None:
            wanted = arcs[:-1, None] + _SHARES * np.diff(arcs)[:, None]
            hung = np.stack(
                [np.interp(wanted, emulator.rope.arc, cable[:, i]) for i in range(3)], -1
            )
        self.rows.append((now, flight.clock.time, phase, grips[order], hung))

    def _count(self, emulator: Emulator) -> None:
        contacts = emulator.contacts
        self.strikes = len(contacts.strikes)
        for one in contacts.contacts[self._told :]:
            if one["kind"] == "vehicles":
                self.collisions += 1
            elif one["kind"] == "crash":
                self._fallen.update(one["vehicles"])
        self._told = len(contacts.contacts)
        self.crashed = len(self._fallen)


def _lets_go(flight: Conductor) -> bool:
    """Whether the team has come to where grippers are opened, a hair before the hold's end or not.

    The clock stops within a rounding of the gate, and the gate lies within one of the hold's end.
    """
    return any(
        gate.condition == "released" and flight.clock.time >= gate.time - _ROUNDING
        for gate in flight.gates
    )


def fly_trial(
    flight_plan: FlightPlan,
    spread: Spread,
    seed: int,
    trial: int,
    *,
    fleet: Fleet | None = None,
    faults: Sequence[Fault] = (),
    **watching: Any,
) -> tuple[Trial, FlightResult]:
    """Fly one trial; ``watching`` goes to :func:`swarm.simulation.loop.simulate_flight`."""
    plan = flight_plan.plan
    fleet = fleet or emulated_fleet(plan.vehicles)
    conditions = draw(plan, fleet, spread, seed, trial, faults)
    witness = _Witness()
    result = simulate_flight(
        flight_plan,
        fleet=fleet,
        world=conditions.world,
        faults=conditions.faults,
        observer=witness,
        **watching,
    )
    return _told(plan, trial, conditions, witness, result), result


def _told(
    plan: Plan, trial: int, conditions: Conditions, witness: _Witness, result: FlightResult
) -> Trial:
    failures = [event.message for event in result.events if event.kind == "failure"]
    reason = failures[0].partition(":")[0] if failures else ""
    if not reason and result.outcome.word != "done":
        reason = result.outcome.word
    measured: dict[str, Any] = dict.fromkeys((*CLEARANCES, "hung", "error"))
    knot, as_planned = "unknown", False
    if witness.rows:
        times, mission_times, phases, places, hung = zip(*witness.rows, strict=True)
        really, when = np.array(places), np.array(mission_times)
        meant = plan.motion.at(when)[0]
        flown = verify_trace(plan, Trace(np.array(times), when, really, meant, phases))
        knot, as_planned = flown.knot, flown.as_planned
        for name in CLEARANCES:
            tightest = getattr(flown, name)
            measured[name] = None if tightest is None else tightest.distance
        measured["error"] = float(np.linalg.norm(really - meant, axis=-1).max())
        measured["hung"] = _closest(plan, [strands for strands in hung if strands is not None])
        if hung[-1] is None:
            knot, as_planned = "let go", False
    if not reason and not as_planned:
        reason = f"knot: {knot}"
    return Trial(
        number=trial,
        outcome=result.outcome.word,
        reason=reason,
        explanation=result.outcome.explanation,
        knot=knot,
        as_planned=as_planned,
        strikes=witness.strikes,
        collisions=witness.collisions,
        crashed=witness.crashed,
        wind=conditions.wind,
        gust=conditions.gust,
        failing=conditions.failing,
        failing_at=conditions.failing_at,
        duration=result.statistics.duration,
        **measured,
    )


def _closest(plan: Plan, strands: list[Floats]) -> float | None:
    """Smallest distance, surface to surface, of strands that share no vehicle; None without."""
    pairs = np.stack(np.triu_indices(plan.vehicles - 1, 2), axis=1)
    if not strands or not len(pairs):
        return None
    nearest, _, _ = closest_strands(np.array(strands), pairs)
    return max(nearest - plan.mission.cable.diameter, 0.0)
