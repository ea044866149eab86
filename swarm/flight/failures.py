"""The failures that a flight detects, as types; :mod:`swarm.flight.policy` has the responses."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


class FailureKind(StrEnum):
    """What has failed. The values are the words of messages and records."""

    SILENT = "silent"
    LOST = "link lost"
    ALL_LOST = "all links lost"
    LEFT_OFFBOARD = "left offboard"
    PILOT = "pilot control"
    LANDING_ALONE = "landing alone"
    RETURNING = "returning"
    FALLING = "falling"
    FALLEN_SILENT = "fallen and silent"
    DISARMED = "disarmed"
    REBOOTED = "rebooted"
    FALSE_LANDING = "false landing report"
    POSITION_JUMP = "position jump"
    ORIGIN_MOVED = "origin moved"
    FIX_LOST = "GPS fix lost"
    POSITION_LOST = "position lost"
    HEIGHT_DRIFT = "height drift"
    BATTERY_LOW = "battery low"
    BATTERY_CRITICAL = "battery critical"
    STATION_STALLED = "ground station stalled"
    STANDSTILL = "standstill"
    TRACKING_ERROR = "tracking error"
    SNAGGED = "snagged"
    GRIP_SLIP = "grip slip"
    COMMAND_FAILED = "command failed"
    GATE_TIMEOUT = "gate timeout"
    HOLD_TIMEOUT = "hold timeout"


@dataclass(frozen=True, eq=False)
class Failure:
    """One detected failure.

    ``message`` is for people; ``vehicle`` the index along the cable (None: the team); ``jump`` (3,)
    the metres by which a position jumped, mission ENU; ``known`` says that it was reported before,
    and only the vehicle's frame follows.
    """

    kind: FailureKind
    message: str
    vehicle: int | None = None
    jump: Floats | None = None
    known: bool = False


@dataclass(frozen=True)
class Recovery:
    """The end of failures: their holds end. ``event`` is the kind of the event to report."""

    kinds: frozenset[FailureKind]
    message: str
    event: str
    vehicle: int | None = None


Finding = Failure | Recovery
"""What a detector returns."""


@dataclass(frozen=True)
class HoldCause:
    """Why the clock is held: a failure, of one vehicle by its system id or of the team.

    Without a failure: the operator.
    """

    failure: FailureKind | None = None
    system: int | None = None


OPERATOR = HoldCause()


class Latch:
    """Failures that have been reported, by kind and vehicle."""

    def __init__(self) -> None:
        self._reported: set[tuple[FailureKind, int]] = set()

    def first(self, kind: FailureKind, k: int) -> bool:
        """Return whether a failure of a vehicle is reported for the first time, and keep it."""
        new = (kind, k) not in self._reported
        self._reported.add((kind, k))
        return new

    def forget(self, kind: FailureKind, k: int) -> None:
        """Let a failure of a vehicle be reported once more."""
        self._reported.discard((kind, k))
