"""The rate of the mission clock: held, slowed by the largest error of the team, back, or on."""

from swarm.flight.detect.standstill import SLOW_FROM
from swarm.flight.failures import OPERATOR
from swarm.flight.holds import hold
from swarm.flight.parameters import STREAM_LOSS_TIME
from swarm.flight.progress import error_too_large, set_rewinding
from swarm.flight.state import FlightState

LONGEST_TICK = 0.1
"""Seconds of mission time that pass in one tick at most. Time in which the ground station did not
run is not flown afterwards: the setpoints would jump."""
ASLEEP = STREAM_LOSS_TIME
"""Seconds without a tick after which all vehicles have stopped: the clock begins again at rest."""


def advance_clock(flight: FlightState) -> bool:
    """Let mission time pass up to the next gate; return whether it was reached."""
    gate, elapsed = flight.gate, flight.timing.elapsed
    upper = gate.time if gate is not None else flight.setup.plan.duration
    lower = rewind_end(flight)
    if elapsed > ASLEEP:
        flight.clock.set_stopped()
    flight.clock.advance(min(elapsed, LONGEST_TICK), min(lower, flight.clock.time), upper)
    return flight.clock.time >= upper - 1e-9


def rewind_end(flight: FlightState) -> float:
    """Return how far back the clock may run, in seconds of mission time."""
    return rewind_limit(flight)[0]


def rewind_limit(flight: FlightState) -> tuple[float, str]:
    """Return how far back the clock may run, and why no farther.

    Neither through a gate, nor out of the phase, nor to where tracking errors were large: there
    the cable may have caught, and pulling back tightens it.
    """
    phase, progress = flight.phase, flight.progress
    if not phase.reversible:
        return flight.clock.time, f"the phase {phase.name} does not run backwards"
    gate_before = flight.setup.gates[progress.gate - 1].time if progress.gate else 0.0
    return max(
        (phase.start, f"the phase {phase.name} begins there"),
        (gate_before, "no gate is passed backwards"),
        (progress.error_kept_since, "tracking errors were too large there"),
        key=lambda limit: limit[0],
    )


def steer_clock(flight: FlightState) -> None:
    """Set the clock's target rate."""
    clock, options = flight.clock, flight.setup.options
    worst = flight.observation.largest_error / flight.allowed_error
    if worst > 1.0:
        error_too_large(flight)
    clock.urgent = worst > 1.0 or any(cause != OPERATOR for cause in flight.holds.causes)
    if flight.holds.causes or options.open_loop:
        clock.target = 0.0 if flight.holds.causes else 1.0
        return
    pace = min(1.0, max(0.0, (1.0 - worst) / (1.0 - SLOW_FROM)))
    if options.error_limit is not None and flight.phase.name == "hold":
        pace = 1.0  # the errors that are measured here must not decide for how long
    if flight.monitored.sample is not None:
        pace = min(pace, flight.monitored.sample.pace)
        clock.urgent |= flight.monitored.sample.pace == 0.0
    pace = min(pace, flight.stream_loss.rate_limit(clock.time))
    if flight.progress.rewinding:
        pace = -pace
        if clock.stopped and clock.time <= rewind_end(flight) + 1e-6:
            set_rewinding(flight, rewinding=False)
            hold(flight, OPERATOR, f"rewound to {clock.time:.1f} s: {rewind_limit(flight)[1]}")
            pace = 0.0
    clock.target = pace
