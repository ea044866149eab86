"""What a flight, real or rehearsed, comes back with."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from swarm.errors import Interrupted, Refused, SwarmError, VehicleError
from swarm.flight.adherence import Adherence
from swarm.flight.flight_plan import Basis
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
    """How a flight ended: a word, and why."""

    word: Word
    explanation: str

    @property
    def exit_code(self) -> int:
        """The command line's exit code."""
        return 0 if self.word == "done" else _ERRORS[self.word].exit_code

    def error(self) -> SwarmError | None:
        """Return the outcome as an error; None where all went well."""
        return None if self.word == "done" else _ERRORS[self.word](self.explanation)


@dataclass(frozen=True)
class Statistics:
    """What a flight cost and how well it was timed.

    Times in seconds: ``lateness`` of setpoints as (median, 99 %), ``command_latency`` until the
    acknowledgement as (median, largest), ``cpu`` as a share of one core (None in a rehearsal),
    ``duration`` in flight time, ``round_trip`` per system id. ``lost`` and ``received`` count
    packets per system id. ``rejected`` counts packets that were not heard: by what is wrong with
    their signatures, and "stranger" for everything else; ``unsent`` what did not fit a link, by
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


@dataclass(frozen=True)
class FlightResult:
    """A flight: outcome, what was measured, what happened, and where its record is.

    ``basis`` is what it was certified for, ``adherence`` how it kept to that.
    """

    outcome: Outcome
    trace: Trace
    events: tuple[Event, ...]
    statistics: Statistics
    basis: Basis
    adherence: Adherence
    record: Path | None = None

    def error(self) -> SwarmError | None:
        """Return what went wrong; None where all went well.

        A flight that carried cable outside its certificate is a failure of its vehicles, however
        it ended.
        """
        error = self.outcome.error()
        if error is None and self.basis.cable and not self.adherence.within:
            return VehicleError(self.adherence.words)
        return error

    @property
    def exit_code(self) -> int:
        """The command line's exit code, as far as the flight itself decides it."""
        error = self.error()
        return error.exit_code if error is not None else 0
