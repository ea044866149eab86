"""The rate of the mission clock: held, slowed by the largest error of the team, back, or on."""

from swarm.flight.detect import SLOW_FROM
from swarm.flight.failures import OPERATOR
from swarm.flight.parameters import STREAM_LOSS_TIME
from swarm.flight.state import LONGEST_TICK, FlightState

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
    clock = flight.clock
    clock.urgent = _too_far(flight) or any(cause != OPERATOR for cause in flight.holds.causes)
    clock.prompt = _pace_of_errors(flight) < abs(clock.rate)
    if flight.holds.causes:
        clock.target = 0.0
        return
    pace = allowed_pace(flight, backwards=flight.progress.rewinding)
    if flight.monitored is not None:
        clock.urgent |= flight.monitored.pace == 0.0
    if flight.progress.rewinding:
        pace = -pace
        if clock.stopped and clock.time <= rewind_end(flight) + 1e-6:
            flight.progress.rewinding = False
            flight.hold(OPERATOR, f"rewound to {clock.time:.1f} s: {rewind_limit(flight)[1]}")
            pace = 0.0
    clock.target = pace


def allowed_pace(flight: FlightState, *, backwards: bool) -> float:
    """Return the largest rate, 0…1, that errors, clearances and a loss of setpoints allow now.

    For a clock that runs on or ``backwards``. Flights without feedback keep their rate.
    """
    return min(_paces(flight, backwards=backwards).values(), default=1.0)


def slowed_by(flight: FlightState) -> str:
    """Return what allows the clock the smallest rate now; "" where none is below 1."""
    paces = _paces(flight, backwards=flight.progress.rewinding)
    return min(
        (what for what in paces if paces[what] < 1.0), key=lambda what: paces[what], default=""
    )


def _paces(flight: FlightState, *, backwards: bool) -> dict[str, float]:
    if flight.setup.options.open_loop:
        return {}
    limit = flight.stream_loss.rate_limit(flight.clock.time, backwards=backwards)
    return {**_paces_of_errors(flight), "room for lost setpoints": limit}


def _pace_of_errors(flight: FlightState) -> float:
    return min(_paces_of_errors(flight).values())


def _paces_of_errors(flight: FlightState) -> dict[str, float]:
    """Return the largest rate, 0…1, that errors allow now, and that clearances do."""
    options = flight.setup.options
    pace = min(1.0, max(0.0, (1.0 - _worst(flight)) / (1.0 - SLOW_FROM)))
    if options.error_limit is not None and flight.phase.name == "hold":
        pace = 1.0  # the errors that are measured here must not decide for how long
    monitored = flight.monitored.pace if flight.monitored is not None else 1.0
    return {"tracking errors": pace, "clearances": monitored}


def _too_far(flight: FlightState) -> bool:
    """Return whether a tracking error is larger than the allowed one, and take note of it."""
    if _worst(flight) > 1.0:
        flight.progress.error_kept_since = flight.clock.time
        return True
    return False


def _worst(flight: FlightState) -> float:
    """Return the largest tracking error as a share of the allowed one."""
    return flight.observation.largest_error / flight.allowed_error
