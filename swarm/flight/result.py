"""The result of a flight, real or simulated, and its errors against those it was certified for."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from swarm.errors import Interrupted, Refused, SwarmError, VehicleError
from swarm.flight.flight_plan import Basis
from swarm.flight.parameters import STREAM_LOSS_TIME
from swarm.flight.snapshot import Event
from swarm.flight.trace import Trace
from swarm.flight.training import Training
from swarm.planning import Plan

_CERTIFIED_PHASES = frozenset({"lifting", "aloft"})
"""States of the cable in which tracking errors count against the certificate."""


@dataclass(frozen=True)
class Adherence:
    """The largest tracking error while the cable is aloft, and the certified one.

    ``largest`` is in metres, by reported positions, of ``vehicle`` (from 1) at ``mission_time``;
    None where no positions are known. ``certified`` is :attr:`Basis.max_tracking_error`.
    """

    largest: float | None
    vehicle: int
    mission_time: float
    planned: float
    certified: float | None

    @property
    def within(self) -> bool:
        """Whether the certificate covers the largest known tracking error."""
        if self.largest is None:
            return True
        return self.certified is not None and self.largest <= self.certified

    @property
    def words(self) -> str:
        """One sentence on the excess over the certified error; "" without an excess."""
        if self.within or self.largest is None:
            return ""
        allowed = "no error was certified"
        if self.certified is not None:
            allowed = f"it was certified for {self.planned:g} m"
            if self.certified > self.planned:
                allowed += f" and would hold up to {self.certified:.3g} m"
        return (
            f"flown outside its certificate: vehicle {self.vehicle} was {self.largest:.2f} m off "
            f"its setpoint at {self.mission_time:.1f} s of the plan; {allowed}"
        )


def adherence_object(adherence: Adherence) -> dict[str, Any]:
    """Return the adherence to the certificate as a JSON-ready object."""
    return {**asdict(adherence), "within": adherence.within, "words": adherence.words}


def adherence(plan: Plan, trace: Trace, basis: Basis) -> Adherence:
    """Compare a flight's trace with the errors for which it was certified."""
    planned = plan.mission.vehicles.tracking
    error = np.linalg.norm(trace.position - trace.setpoint, axis=-1)
    aloft = np.array(
        [
            name != "" and plan.phase_at(time).cable in _CERTIFIED_PHASES
            for name, time in zip(trace.phase, trace.mission_time.tolist(), strict=True)
        ],
        dtype=np.bool_,
    )
    error = np.where(aloft[:, None] & np.isfinite(error), error, -1.0)
    if not error.size or error.max() < 0.0:
        return Adherence(None, 0, 0.0, planned, basis.max_tracking_error)
    row, vehicle = np.unravel_index(int(np.argmax(error)), error.shape)
    return Adherence(
        largest=float(error[row, vehicle]),
        vehicle=int(vehicle) + 1,
        mission_time=float(trace.mission_time[row]),
        planned=planned,
        certified=basis.max_tracking_error,
    )


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


def skipped_words(steps: Sequence[str]) -> str:
    """Return in words which first tests were skipped; "" for none."""
    return f"flown with --skip-step; first tests not passed: {', '.join(steps)}" if steps else ""


@dataclass(frozen=True)
class FlightResult:
    """A flight: outcome, trace, events, statistics, and the folder of its record.

    ``basis`` is the basis on which it was flown, ``adherence`` its errors against that,
    ``training`` the faults that were injected, ``skipped`` the first tests that were skipped.
    """

    outcome: Outcome
    trace: Trace
    events: tuple[Event, ...]
    statistics: Statistics
    basis: Basis
    adherence: Adherence
    record: Path | None = None
    training: Training | None = None
    skipped: tuple[str, ...] = ()

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
