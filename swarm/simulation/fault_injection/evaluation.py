"""What came of a drill, judged by the emulator's ground truth."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from swarm.certification.monitor import Monitor
from swarm.flight.policy import Response
from swarm.flight.snapshot import Event
from swarm.simulation.fault_injection.failure_cases import FailureCase
from swarm.simulation.fault_injection.stepped_simulation import SteppedSimulation

LOOK_EVERY = 0.1
AT_ONCE = 3.0
"""Seconds after the end of a fault up to which a slower clock is taken for an answer to it."""
_LOW = 0.5
"""Metres above the floor below which a vehicle's cable is no longer judged: it lies down."""


@dataclass(frozen=True)
class FaultTrial:
    """One fault at one time, and what came of it.

    ``at`` is mission time; ``noticed`` seconds until the first event that says so, None if none
    does, ``hidden`` and ``shown`` those in which there was nothing, and something, to notice where
    a row hides (``shown`` up to the end); ``response`` the words of what the team did;
    ``clearance`` the smallest distance between strands, ``apart`` the smallest level distance
    between vehicles that are not apart in height, both metres (infinite: never judged); ``chord``
    the largest chord over length. ``strikes`` of rotors on cable, ``falling`` those of them that
    came with the fault, before anybody could answer; ``lost`` vehicles, ``problems`` what is not as
    asked.
    """

    at: float
    vehicle: int
    noticed: float | None
    response: str
    clearance: float
    apart: float
    chord: float
    strikes: int
    lost: int
    end: str
    problems: tuple[str, ...]
    hidden: float = 0.0
    shown: float = 0.0
    falling: int = 0


class Judge:
    """Looks at what really is, from the fault on.

    ``hidden`` are the seconds in which a slip of ``slipping`` would not show, ``shown`` those in
    which it would, ``unseen`` whether it does not now.
    """

    def __init__(self, flight: SteppedSimulation, slipping: int | None = None) -> None:
        self._flight = flight
        self._slipping = slipping
        self.hidden, self.shown, self.unseen = 0.0, 0.0, False
        self._monitor = Monitor(flight.flight_plan.plan)
        truth = flight.emulator.truth()
        self._strikes, self._contacts = len(truth.strikes), len(truth.contacts)
        self._next = 0.0
        self._laid_down = False
        self.clearance = self.apart = np.inf
        self.chord = 0.0

    def look(self) -> None:
        """Look at this moment, ten times a second."""
        flight = self._flight
        if flight.now < self._next:
            return
        self._next = flight.now + LOOK_EVERY
        if self._slipping is not None and flight.conductor.stage == "fly":
            shows = flight.conductor.state.detectors.grip_slip.detectable(
                flight.conductor.state.streams.setpoint
            )
            aloft = flight.conductor.phase.cable == "aloft"
            self.unseen = not (aloft and bool(shows[self._slipping]))
            self.hidden += LOOK_EVERY if self.unseen else 0.0
            self.shown += 0.0 if self.unseen else LOOK_EVERY
        truth = flight.emulator.truth()
        place = truth.position
        flying = ~flight.emulator.bodies.tumbling & (place[:, 2] > _LOW)
        self._laid_down |= not bool(flying.all())
        held = bool(truth.gripped.all()) and not self._laid_down
        aloft = flight.conductor.phase.cable == "aloft" and flight.conductor.phase.name != "finish"
        if held and aloft:
            (seen,) = self._monitor.clearances(place[None], "aloft")
            if np.isfinite(seen.cable):
                self.clearance = min(self.clearance, seen.cable)
            self.chord = max(self.chord, seen.chord)
        if flying.all():
            (seen,) = self._monitor.clearances(place[None], "free")
            self.apart = min(self.apart, seen.vehicle)

    def strikes(self, until: float = np.inf) -> int:
        """Return how often a rotor struck cable, up to a time of the flight."""
        strikes = self._flight.emulator.truth().strikes[self._strikes :]
        return sum(strike["time"] <= until for strike in strikes)

    def lost(self) -> int:
        """Return how many vehicles came down hard, or struck each other."""
        contacts = self._flight.emulator.truth().contacts[self._contacts :]
        broken = {one for c in contacts for one in c["vehicles"] if c["kind"] == "crash"}
        broken |= {
            one for c in contacts if c["kind"] == "vehicles" and c["speed"] > 1.0
            for one in c["vehicles"]
        }  # fmt: skip
        return len(broken)


def judged(
    flight: SteppedSimulation,
    row: FailureCase,
    judge: Judge,
    at: float,
    victim: int,
    began: float,
    slowed: float | None,
) -> FaultTrial:
    """Return what came of a fault that ``began`` at a time of the flight, at mission time ``at``.

    ``slowed`` are the seconds until the clock ran slower, None if it did not.
    """
    events = [event for event in flight.events if event.kind in {"failure", "hold", "leave"}]
    events += [e for e in flight.events if row.station and e.kind == "operator"]
    told = [event for event in events if event.time >= began]
    late = slowed is not None and 0.0 < row.lasts < slowed - AT_ONCE
    if late or not row.slows:
        slowed = None
    moments = [event.time - began for event in told] + ([] if slowed is None else [slowed])
    noticed = min(moments, default=None)
    end = _end(flight, row)
    trial = FaultTrial(
        at=at,
        vehicle=victim + 1,
        noticed=noticed,
        response=_response(told, slowed),
        clearance=judge.clearance,
        apart=judge.apart,
        chord=judge.chord,
        strikes=judge.strikes(),
        lost=judge.lost(),
        end=end,
        problems=(),
        hidden=judge.hidden,
        shown=judge.shown,
        falling=judge.strikes(began + row.falls) if row.falls else 0,
    )
    return replace(trial, problems=_problems(flight, row, trial))


def _problems(flight: SteppedSimulation, row: FailureCase, trial: FaultTrial) -> tuple[str, ...]:
    """What is not as the row asks.

    Where neither the fault nor a fall moves what was certified, the certified worst case holds.
    """
    cable, vehicle = _certified(flight, row)
    problems = []
    if trial.end not in row.ends:
        problems.append(f"ended as {trial.end}")
    seen = None if trial.noticed is None else trial.noticed - trial.hidden
    never = seen is None and not (row.hides and trial.shown <= (row.within or 0.0))
    if row.within is not None and (never or (seen or 0.0) > row.within + 1e-6):
        after = "never" if seen is None else f"after {seen:.2f} s"
        problems.append(f"noticed {after}, not within {row.within:g} s")
    allowed = row.strikes + (row.stays and _nowhere_to_go(flight))
    if trial.strikes - trial.falling > allowed and not row.dead:
        problems.append(f"{trial.strikes - trial.falling} rotor strikes")
    if trial.lost > int(row.dead):
        problems.append(f"{trial.lost} vehicles lost")
    taken_along = row.drifts and trial.end != "released and landed"
    if not (row.moves or row.dead or taken_along):
        if trial.chord >= 1.0:
            problems.append(f"a chord of {trial.chord:.3f} of its length")
        if trial.clearance < cable:
            problems.append(f"strands {trial.clearance:.2f} m apart")
    if trial.apart < vehicle and not (row.moves or row.drifts or row.dead):
        problems.append(f"vehicles {trial.apart:.2f} m apart")
    return tuple(problems)


def _nowhere_to_go(flight: SteppedSimulation) -> bool:
    """Whether the team left the plan where all can neither land nor let go as they stand."""
    contingency = flight.conductor.state.contingency
    return contingency is not None and contingency.cornered


def _certified(flight: SteppedSimulation, row: FailureCase) -> tuple[float, float]:
    """Return the least distances between strands and between vehicles that are certified."""
    known, required = flight.flight_plan.assessment, flight.flight_plan.plan.mission.clearance
    if row.coasts and known.stream_loss is not None and known.stream_loss.worst.margin >= 0.0:
        return required.cable, required.vehicle
    cable = known.cable.distance if known.cable is not None else 0.0
    return cable, known.vehicle.distance if known.vehicle is not None else 0.0


def _end(flight: SteppedSimulation, row: FailureCase) -> str:
    conductor, truth = flight.conductor, flight.emulator.truth()
    if row.station == "killed":
        return "still flying" if truth.armed.any() else "landed by failsafe"
    outcome = conductor.finished
    if outcome is None:
        return "goes on" if conductor.stage == "fly" else "not landed"
    if outcome.word == "done":
        return "flown to the end"
    contingency = conductor.state.contingency
    if contingency is None:
        return "landed by failsafe" if not truth.armed.any() else f"given up: {outcome.explanation}"
    alive = ~flight.emulator.bodies.crashed
    if (truth.armed & alive & ~flight.emulator.bodies.tumbling).any():
        return "not landed"
    lands = contingency.response in {Response.LAND, Response.LAND_HERE}
    return "landed" if lands else "released and landed"


def _response(told: Sequence[Event], slowed: float | None) -> str:
    """What the team did, in the order in which it did it."""
    words: list[str] = ["slow"] if slowed is not None and not told else []
    for event in sorted(told, key=lambda event: event.time):
        word = event.kind
        if event.kind in {"failure", "leave"}:
            word = event.message.partition(":")[0]
        if word not in words:
            words.append(word)
    return ", ".join(words) or "none"
