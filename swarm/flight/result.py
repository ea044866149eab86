"""The result of a flight, real or simulated."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from swarm.errors import Interrupted, Refused, SwarmError, VehicleError
from swarm.flight.adherence import Adherence
from swarm.flight.flight_plan import Basis
from swarm.flight.parameters import STREAM_LOSS_TIME
from swarm.flight.snapshot import Event
from swarm.flight.trace import Trace

Word = Literal["done", "refused", "failed", "interrupted"]

_ERRORS: Mapping[Word, type[SwarmError]] = {
    "refused": Refused,
    "failed": VehicleError,
    "interrupted": Interrupted,
}


@dataclass(frozen=True)
class Outcome:
    """How a flight ended: a word, and an explanation."""

    word: Word
    explanation: str

    @property
    def exit_code(self) -> int:
        """The command line's exit code."""
        return 0 if self.word == "done" else _ERRORS[self.word].exit_code

    def error(self) -> SwarmError | None:
        """Return the outcome as an error; None after a complete flight."""
        return None if self.word == "done" else _ERRORS[self.word](self.explanation)


@dataclass(frozen=True)
class Statistics:
    """Counts and times of a flight.

    Times in seconds: ``lateness`` of setpoints as (median, 99 %), ``command_latency`` until the
    acknowledgement as (median, largest), ``cpu`` as a share of one core (None in a simulation),
    ``duration`` in flight time, ``round_trip`` per system id; ``gap`` is the longest time between
    two setpoints of this ground station, and the time of the flight at which it began. ``lost`` and
    ``received`` count packets per system id. ``rejected`` counts rejected packets: by the error of
    their signatures, and "stranger" for all others; ``unsent`` packets that did not fit a link, by
    the link's name.
    """

    duration: float
    setpoints: int
    command_latency: tuple[float, float] | None
    received: Mapping[int, int]
    lost: Mapping[int, int]
    round_trip: Mapping[int, float]
    rejected: Mapping[str, int] = field(default_factory=dict)
    unsent: Mapping[str, int] = field(default_factory=dict)
    lateness: tuple[float, float] | None = None
    cpu: float | None = None
    gap: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class FlightResult:
    """A flight: outcome, trace, events, statistics, and the folder of its record.

    ``basis`` is the basis on which it was flown, ``adherence`` its errors against that.
    """

    outcome: Outcome
    trace: Trace
    events: tuple[Event, ...]
    statistics: Statistics
    basis: Basis
    adherence: Adherence
    record: Path | None = None

    def error(self) -> SwarmError | None:
        """Return the error with which the flight ended; None after a complete flight.

        A flight that carried cable outside its certificate is a failure of its vehicles, also
        where it was complete.
        """
        error = self.outcome.error()
        if error is None and self.basis.cable and not self.adherence.within:
            return VehicleError("; ".join(filter(None, (self.stall, self.adherence.words))))
        return error

    @property
    def stall(self) -> str:
        """The longest gap of our own setpoints in words, where it stopped the vehicles; or ""."""
        seconds, at = self.statistics.gap
        if seconds <= STREAM_LOSS_TIME:
            return ""
        return f"the ground station stood still for {seconds:.1f} s, {at:.1f} s into the flight"

    @property
    def exit_code(self) -> int:
        """The command line's exit code by the flight itself."""
        error = self.error()
        return error.exit_code if error is not None else 0
