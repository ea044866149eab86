"""Evaluation of a failure test by the emulator's ground truth."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from swarm.certification.monitor import Monitor
from swarm.flight.failures import FailureKind, Response
from swarm.flight.snapshot import Event
from swarm.simulation.fault_injection.failure_cases import FailureCase
from swarm.simulation.fault_injection.stepped_simulation import SteppedSimulation

SAMPLE_INTERVAL: Final = 0.1
"""Seconds between two samples of the ground truth."""

LATE_REACTION: Final = 3.0
"""Seconds after the end of a fault up to which a slower clock counts as a reaction to it."""

_MIN_HEIGHT: Final = 0.5
"""Metres above the floor below which a vehicle's cable is no longer evaluated: it lies down."""


@dataclass(frozen=True)
class FaultTrial:
    """One fault at one time, and the behaviour that followed.

    - ``mission_time`` of the fault, seconds; ``vehicle`` from 1.
    - ``detected_after``: seconds until the first event about the fault, None without any.
      ``hidden_time`` and ``visible_time``: seconds in which the fault had no measurable effect, and
      had one, for cases that may be hidden.
    - ``response``: the kinds of events that followed, in order.
    - ``strand_distance`` and ``vehicle_distance``: the smallest distance between strands, and the
      smallest horizontal distance between vehicles that are not apart in height; metres, infinite
      where never evaluated. ``chord_ratio``: the largest chord over length.
    - ``rotor_strikes`` on cable, ``exempt_strikes`` of them as the case's ``fall_time`` and
      ``own_strikes`` say;
      ``vehicles_lost``; ``end`` of the flight; ``problems``: the violated requirements.
    """

    mission_time: float
    vehicle: int
    detected_after: float | None
    response: str
    strand_distance: float
    vehicle_distance: float
    chord_ratio: float
    rotor_strikes: int
    vehicles_lost: int
    end: str
    problems: tuple[str, ...]
    hidden_time: float = 0.0
    visible_time: float = 0.0
    exempt_strikes: int = 0


class GroundTruthMonitor:
    """Measures distances, chords and contacts of the emulator from the fault on.

    Of a fault that ``may_be_hidden`` it also measures the seconds in which the fault has no effect
    on the ``vehicle`` that must be detected (``hidden_time``) and in which it has one
    (``visible_time``): a slip changes the pulls enough to be measured, another fault moves the
    vehicle out of its tracking radius. ``hidden_slip``: a slip had none at the last sample.
    """

    def __init__(self, flight: SteppedSimulation, case: FailureCase, vehicle: int) -> None:
        self._flight, self._case, self._vehicle = flight, case, vehicle
        self.hidden_time, self.visible_time, self.hidden_slip = 0.0, 0.0, False
        self._monitor = Monitor(flight.flight_plan.plan)
        truth = flight.emulator.truth()
        self._earlier_strikes = len(truth.strikes)
        self._earlier_contacts = len(truth.contacts)
        self._next_time = 0.0
        self._laid_down = False
        self.strand_distance = self.vehicle_distance = np.inf
        self.chord_ratio = 0.0

    def sample(self, *, detected: bool = False) -> None:
        """Take a sample, at most one every :data:`SAMPLE_INTERVAL`.

        Once the fault is ``detected``, the seconds of its effect are not counted any more.
        """
        flight = self._flight
        if flight.now < self._next_time:
            return
        self._next_time = flight.now + SAMPLE_INTERVAL
        counts = self._case.may_be_hidden and not detected
        if counts and flight.conductor.stage == "execute":
            self._sample_effect()
        truth = flight.emulator.truth()
        position = truth.position
        flying = ~flight.emulator.bodies.tumbling & (position[:, 2] > _MIN_HEIGHT)
        self._laid_down |= not bool(flying.all())
        held = bool(truth.gripped.all()) and not self._laid_down
        phase = flight.conductor.phase
        if held and phase.cable == "aloft" and phase.name != "finish":
            (clearances,) = self._monitor.clearances(position[None], "aloft")
            if np.isfinite(clearances.cable):
                self.strand_distance = min(self.strand_distance, clearances.cable)
            self.chord_ratio = max(self.chord_ratio, clearances.chord)
        if flying.all():
            (clearances,) = self._monitor.clearances(position[None], "free")
            self.vehicle_distance = min(self.vehicle_distance, clearances.vehicle)

    def _sample_effect(self) -> None:
        conductor, k = self._flight.conductor, self._vehicle
        state, fault = conductor.state, self._case.fault
        if fault is not None and fault["kind"] == "gripper_slip":
            detectable = state.detectors.grip_slip.detectable(state.streams.setpoint)
            visible = conductor.phase.cable == "aloft" and bool(detectable[k])
            self.hidden_slip = not visible
        else:
            off = self._flight.emulator.truth().position[k] - state.streams.setpoint[k]
            radius = self._flight.flight_plan.plan.mission.vehicles.tracking
            visible = float(np.linalg.norm(off)) > radius
        if visible:
            self.visible_time += SAMPLE_INTERVAL
        else:
            self.hidden_time += SAMPLE_INTERVAL

    def rotor_strikes(self, until: float = np.inf, system: int | None = None) -> int:
        """Return the number of rotor strikes on cable up to a time, of one vehicle or of all."""
        strikes = self._flight.emulator.truth().strikes[self._earlier_strikes :]
        return sum(
            strike["time"] <= until and system in {None, strike["vehicle"]} for strike in strikes
        )

    def vehicles_lost(self) -> int:
        """Return the number of vehicles that crashed or collided with another vehicle."""
        contacts = self._flight.emulator.truth().contacts[self._earlier_contacts :]
        lost: set[int] = set()
        for contact in contacts:
            collision = contact["kind"] == "vehicles" and contact["speed"] > 1.0
            if contact["kind"] == "crash" or collision:
                lost.update(contact["vehicles"])
        return len(lost)


@dataclass(frozen=True)
class Injection:
    """A fault as it was injected.

    ``time`` of the flight and ``mission_time`` in seconds, index of the ``vehicle``;
    ``slowed_after``: seconds until the mission clock slowed down, None if it did not.
    """

    case: FailureCase
    vehicle: int
    time: float
    mission_time: float
    slowed_after: float | None


def evaluate(
    flight: SteppedSimulation, injection: Injection, monitor: GroundTruthMonitor
) -> FaultTrial:
    """Return the trial of a fault whose flight has ended."""
    case, began = injection.case, injection.time
    system = flight.conductor.flyers[injection.vehicle].system
    falls = monitor.rotor_strikes(began + case.fall_time) if case.fall_time else 0
    events = [event for event in flight.events if event.kind in {"failure", "hold", "contingency"}]
    if case.station_fault:
        events += [event for event in flight.events if event.kind == "operator"]
    events = [event for event in events if event.time >= began]
    slowed_after = injection.slowed_after if case.slows_clock else None
    if slowed_after is not None and 0.0 < case.duration < slowed_after - LATE_REACTION:
        slowed_after = None
    detections = [event.time - began for event in events]
    if slowed_after is not None:
        detections.append(slowed_after)
    trial = FaultTrial(
        mission_time=injection.mission_time,
        vehicle=injection.vehicle + 1,
        detected_after=min(detections, default=None),
        response=_response(events, slowed_after),
        strand_distance=monitor.strand_distance,
        vehicle_distance=monitor.vehicle_distance,
        chord_ratio=monitor.chord_ratio,
        rotor_strikes=monitor.rotor_strikes(),
        vehicles_lost=monitor.vehicles_lost(),
        end=_end(flight, case),
        problems=(),
        hidden_time=monitor.hidden_time,
        visible_time=monitor.visible_time,
        exempt_strikes=monitor.rotor_strikes(system=system) if case.own_strikes else falls,
    )
    return replace(trial, problems=find_problems(flight, case, trial))


def find_problems(
    flight: SteppedSimulation, case: FailureCase, trial: FaultTrial
) -> tuple[str, ...]:
    """Return the requirements of a case that a trial violates.

    Where the fault moves neither vehicles nor cable beyond the certificate, and no vehicle falls,
    the certified distances are required.
    """
    problems = []
    if trial.end not in case.allowed_ends:
        problems.append(f"ended as {trial.end}")
    problems += _detection_problem(case, trial)
    strikes = trial.rotor_strikes - trial.exempt_strikes
    allowed_strikes = case.allowed_strikes + (case.cannot_follow and _cornered(flight))
    allowed_strikes += case.lands_alone and _landed_alone_outside_window(flight, case, trial)
    if strikes > allowed_strikes and not case.loses_vehicle:
        problems.append(f"{strikes} rotor strikes")
    if trial.vehicles_lost > int(case.loses_vehicle):
        problems.append(f"{trial.vehicles_lost} vehicles lost")
    strand_distance, vehicle_distance = _certified_distances(flight, case)
    moved = case.moves_certified or case.loses_vehicle
    cable_drifts = case.vehicle_drifts and trial.end != "released and landed"
    if not (moved or cable_drifts):
        if trial.chord_ratio >= 1.0:
            problems.append(f"a chord of {trial.chord_ratio:.3f} of its length")
        if trial.strand_distance < strand_distance:
            problems.append(f"strands {trial.strand_distance:.2f} m apart")
    if trial.vehicle_distance < vehicle_distance and not (moved or case.vehicle_drifts):
        problems.append(f"vehicles {trial.vehicle_distance:.2f} m apart")
    return tuple(problems)


def _detection_problem(case: FailureCase, trial: FaultTrial) -> list[str]:
    limit = case.detection_limit
    if limit is None:
        return []
    if trial.detected_after is None:
        if case.may_be_hidden and trial.visible_time <= limit:
            return []
        return [f"not detected within {limit:g} s"]
    visible_for = trial.detected_after - trial.hidden_time
    if visible_for <= limit + 1e-6:
        return []
    return [f"detected after {visible_for:.2f} s, not within {limit:g} s"]


def _cornered(flight: SteppedSimulation) -> bool:
    """Return whether the team left the plan where it can neither land nor release as it stands."""
    contingency = flight.conductor.state.contingency
    return contingency is not None and contingency.cornered


def _landed_alone_outside_window(
    flight: SteppedSimulation, case: FailureCase, trial: FaultTrial
) -> bool:
    """Return whether failsafes landed the vehicles where the plan has no window for landing.

    Without setpoints they coast as certified: the window may close meanwhile.
    """
    alone = trial.end == "landed by failsafe" or FailureKind.LANDING_ALONE.value in trial.response
    state = flight.conductor.state
    lost = state.clock.time
    coast_time = state.stream_loss.model.overrun(flight.flight_plan.plan).coast_time
    whole_team = case.whole_team or case.station_fault is not None
    stopped = lost + float(coast_time.max() if whole_team else coast_time[trial.vehicle - 1])
    can_land = state.setup.windows.can_land
    return alone and not all(can_land(time) for time in np.arange(lost, stopped, SAMPLE_INTERVAL))


def _certified_distances(flight: SteppedSimulation, case: FailureCase) -> tuple[float, float]:
    """Return the certified distances between strands and between vehicles, metres."""
    assessment = flight.flight_plan.assessment
    stream_loss = assessment.stream_loss
    if case.stream_loss and stream_loss is not None and stream_loss.worst.margin >= 0.0:
        required = flight.flight_plan.plan.mission.clearance
        return required.cable, required.vehicle
    return assessment.distances["cable"].distance, assessment.distances["vehicle"].distance


def _end(flight: SteppedSimulation, case: FailureCase) -> str:
    conductor, truth = flight.conductor, flight.emulator.truth()
    if case.station_fault == "killed":
        return "still flying" if truth.armed.any() else "landed by failsafe"
    outcome = conductor.finished
    if outcome is None:
        return "continued" if conductor.stage == "execute" else "not landed"
    if outcome.word == "done":
        return "completed"
    contingency = conductor.state.contingency
    if contingency is None:
        return "landed by failsafe" if not truth.armed.any() else f"aborted: {outcome.explanation}"
    bodies = flight.emulator.bodies
    # a pilot may still fly when no other vehicle does
    piloted = [case.pilot_lands and vehicle.in_manual_mode for vehicle in conductor.flyers]
    if (truth.armed & ~bodies.crashed & ~bodies.tumbling & ~np.array(piloted)).any():
        return "not landed"
    lands = contingency.response in {Response.LAND, Response.LAND_HERE}
    return "landed" if lands else "released and landed"


def _response(events: Sequence[Event], slowed_after: float | None) -> str:
    """Return the reactions of the team, in order."""
    words: list[str] = ["slow"] if slowed_after is not None and not events else []
    for event in sorted(events, key=lambda event: event.time):
        word = event.kind
        if event.kind in {"failure", "contingency"}:
            word = event.message.partition(":")[0]
        if word not in words:
            words.append(word)
    return ", ".join(words) or "none"
