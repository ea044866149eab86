"""How fast mission time passes: held, slowed by the worst of the team, back, or on."""

import math
from typing import TYPE_CHECKING

import numpy as np

from swarm.flight.failures import failure
from swarm.flight.parameters import STREAM_LOSS_TIME

if TYPE_CHECKING:
    from swarm.flight.conductor import Conductor

SLOW_FROM = 0.6
"""Share of the tracking ball from which the clock slows down; at the full ball it stands still."""
LONGEST_TICK = 0.1
"""Seconds of mission time that one tick may pass. Time in which the ground station slept is not
flown afterwards: the setpoints would jump."""
ASLEEP = STREAM_LOSS_TIME
"""Seconds without a tick after which everybody has stopped: the clock starts anew from rest."""
CALM = 0.5
"""Share of the tracking ball within which those are whom nothing holds."""
STANDS_STILL = 0.02
STILL_FOR = 3.0
"""Seconds for which the clock may stand without a reason that ends by itself."""


def advance_clock(flight: "Conductor") -> bool:
    """Let mission time pass up to the next gate; return whether it was reached."""
    gates, gate = flight.gates, flight.gate
    upper = gates[gate].time if gate < len(gates) else flight.plan.duration
    lower = rewind_end(flight)
    if flight.now - flight.last > ASLEEP:
        flight.clock.set_stopped()
    elapsed = min(flight.now - flight.last, LONGEST_TICK)
    flight.clock.advance(elapsed, min(lower, flight.clock.time), upper)
    return flight.clock.time >= upper - 1e-9


def rewind_end(flight: "Conductor") -> float:
    """Return how far back the clock may run: not through a gate, nor to where errors were large."""
    if not flight.phase.reversible:
        return flight.clock.time
    gate_before = flight.gates[flight.gate - 1].time if flight.gate else 0.0
    return max(flight.phase.start, gate_before, flight.budget_kept_since)


def steer(flight: "Conductor") -> None:
    """Set the rate that the clock should have: held, or slowed by the worst of the team."""
    clock = flight.clock
    known = [error for error in flight.error.tolist() if error == error]  # noqa: PLR0124 - not NaN
    worst = max(known, default=0.0) / flight.budget
    if worst > 1.0:
        flight.budget_kept_since = clock.time
    _notice_standstill(flight, worst)
    if flight.holds or flight.open_loop:
        clock.target = 0.0 if flight.holds else 1.0
        return
    pace = min(1.0, max(0.0, (1.0 - worst) / (1.0 - SLOW_FROM)))
    if flight.stray_limit is not None and flight.phase.name == "hold":
        pace = 1.0  # what is measured here must not decide for how long
    if flight.sight is not None:
        pace = min(pace, flight.sight.pace)
    pace = min(pace, flight.stream_loss.rate_limit(clock.time))
    if flight.rewinding:
        pace = -pace
        if clock.stopped and clock.time <= rewind_end(flight) + 1e-6:
            flight.rewinding = False
            flight.hold("operator", "rewound as far as it is safe")
            pace = 0.0
    clock.target = pace


def _notice_standstill(flight: "Conductor", worst: float) -> None:
    """Tell when the clock stands for what does not end by itself, and when that is over.

    Somebody cannot follow; or all do, and stand where nothing is left of clearances or chords.
    """
    standing = abs(flight.clock.rate) < STANDS_STILL and not flight.rewinding
    unwatched = flight.open_loop or flight.stray_limit is not None
    if not (standing or "stands still" in flight.holds) or unwatched:
        flight.still_since = flight.now
        return
    off = worst >= SLOW_FROM
    kept = off or (flight.sight is not None and flight.sight.pace < STANDS_STILL)
    if "stands still" in flight.holds:
        if not kept:
            flight.still_since = flight.now
            flight.holds.pop("stands still")
            flight.say("hold", "everybody follows again")
    elif flight.holds or not kept:
        flight.still_since = flight.now
    elif flight.now - flight.still_since > STILL_FOR:
        words = _who_is_off(flight, worst) if off else _what_is_near(flight)
        failure(flight, "stands still", words)


def _who_is_off(flight: "Conductor", worst: float) -> str:
    off = [
        flight.name(vehicle)
        for vehicle, error in zip(flight.flyers, flight.error, strict=True)
        if error > SLOW_FROM * flight.budget
    ]
    return f"{', '.join(off)} cannot follow (up to {worst * flight.budget:.2f} m off)"


def _what_is_near(flight: "Conductor") -> str:
    seen = flight.clearances
    if seen is None:
        return "nothing is left of the clearances"
    cable = "no slack" if math.isnan(seen.cable) else f"strands {seen.cable:.2f} m apart"
    return (
        f"nothing is left of the clearances ({cable}, vehicles {seen.vehicle:.2f} m apart, "
        f"chords up to {seen.chord:.0%} of their cable)"
    )


def bound_hold(flight: "Conductor") -> None:
    """End a hold after the fleet's T: everybody lands together, before a battery decides it."""
    if not flight.holds:
        flight.hold_since = None
    elif flight.hold_since is None:
        flight.hold_since = flight.now
    elif flight.interrupted and flight.clock.stopped:
        flight.leave("land", "interrupted", move=True)
    elif flight.now - flight.hold_since > flight.fleet.limits.hold:
        words = f"on hold for {flight.fleet.limits.hold:g} s: {flight.holding}"
        snagged = "stands still" in flight.holds and _few_are_off(flight)
        failure(flight, "snagged" if snagged else "held too long", words)


def _few_are_off(flight: "Conductor") -> bool:
    """Whether one or two keep the clock standing while all others are in place; wind moves
    everybody. By then autopilots lean against what holds one, and have brought it nearer."""
    off = np.nan_to_num(flight.error, nan=0.0) / flight.budget
    far, calm = off >= SLOW_FROM, off < CALM
    return bool(1 <= far.sum() <= 2 and (far | calm).all())
