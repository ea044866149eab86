"""How a flight ends: what has failed, and the outcome."""

from dataclasses import replace

from swarm.flight.modes.transitions import change_stage
from swarm.flight.result import Outcome, Word
from swarm.flight.stages import Stage, Trigger
from swarm.flight.state import FlightState
from swarm.flight.streams import stop_all_streams

_LEAST_DRAG = 0.05
"""Smallest fitted drag, 1/s, that is reported: smaller ones are within the error of the fit."""


def mark_failed(flight: FlightState, message: str) -> None:
    """Keep the first reason for which the flight has failed, however it ends."""
    if flight.ending.failure is None:
        flight.ending = replace(flight.ending, failure=message)


def mark_interrupted(flight: FlightState) -> bool:
    """Note that the operator has interrupted the flight; return whether it was before."""
    before = flight.ending.interrupted
    flight.ending = replace(flight.ending, interrupted=True)
    return before


def conclude(flight: FlightState) -> None:
    """End a flight whose vehicles have all landed, with the outcome that it deserves."""
    ending = flight.ending
    if ending.failure is not None:
        finish(flight, "failed", ending.failure)
    elif ending.interrupted:
        finish(flight, "interrupted", "interrupted; all vehicles have landed")
    elif flight.stage is Stage.CONTINGENCY:
        finish(flight, "interrupted", "landed before the plan was flown to its end")
    else:
        finish(flight, "done", "all vehicles have landed and disarmed")


def finish(flight: FlightState, word: Word, message: str) -> None:
    """End the flight with an outcome."""
    stop_all_streams(flight)
    for vehicle in flight.roster.vehicles:
        vehicle.restore_streams()
    flight.ending = replace(flight.ending, outcome=Outcome(word, message))
    drag = flight.detectors.grip_slip.drag
    if drag > _LEAST_DRAG:
        flight.report("drag", f"the vehicles' drag, fitted in this flight: {drag:.2f} 1/s")
    flight.report("outcome", f"{word}: {message}")
    change_stage(flight, Trigger.END)
