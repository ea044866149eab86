"""What can fail in flight, and what the team does about it: two tables.

Theory of operation. Detectors compare the observed team with the commanded one and report a
:class:`FailureKind` (:mod:`swarm.flight.detect`, :mod:`swarm.flight.grip_slip`). Its row has the
words of messages and records, and the response while the plan is executed, and after the team has
left it. How the team comes down is decided where it has come to rest, by :data:`ENDS` and by the
:class:`Windows` that are open there: whether all can land together, and whether no cable hangs
above a rotor, so that it may be released. Both tables are complete;
``swarm failures --table`` prints them.

Responses are the team's, never one vehicle's: vehicles that hold one cable must not part. Returning
to launch, alone or together, is not among them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.flight.stages import Stage

Floats = npt.NDArray[np.float64]


class Response(StrEnum):
    """What the team does about a failure.

    REPORT: go on. HOLD: stop the clock until the failure ends, or for the fleet's T at most. LAND:
    move along the plan to the nearest moment at which all can land, and land together. LAND_HERE:
    the same without moving; a team that has left the plan, and still moves along it, stops.
    RELEASE: move to the nearest moment at which no cable hangs above a rotor and no obstacle is
    above or below a vehicle, release, separate, land. RELEASE_HERE: without moving, where no cable
    hangs above a rotor. RELEASE_FALLEN: release at the fallen vehicle first, then beside it, then
    everywhere; the others separate and land.
    """

    REPORT = "report"
    HOLD = "hold"
    LAND = "land"
    LAND_HERE = "land here"
    RELEASE = "release"
    RELEASE_HERE = "release here"
    RELEASE_FALLEN = "release fallen"


class Responses(NamedTuple):
    """One failure's responses while the plan is executed, and while the team has left it.

    ``irreversible``: the flight has failed, however well it lands. ``ends_stream``: the vehicle
    gets no setpoints any more.
    """

    execute: Response
    contingency: Response
    irreversible: bool = True
    ends_stream: bool = False


_R = Response


class FailureKind(StrEnum):
    """What has failed: the words of messages and records, which are the value, and the responses.

    Before the flight nothing is armed: a vehicle that is not ready is no failure but keeps the team
    on the ground (:mod:`swarm.flight.preparation`).
    """

    responses: Responses

    def __new__(cls, words: str, responses: Responses) -> "FailureKind":
        """Return a member whose value is its words."""
        kind = str.__new__(cls, words)
        kind._value_ = words
        kind.responses = responses
        return kind

    SILENT = "silent", Responses(_R.HOLD, _R.REPORT, irreversible=False)
    LOST = "link lost", Responses(_R.HOLD, _R.REPORT)
    ALL_LOST = "all links lost", Responses(_R.HOLD, _R.REPORT)
    LEFT_OFFBOARD = "left offboard", Responses(_R.HOLD, _R.LAND_HERE, ends_stream=True)
    PILOT = "pilot control", Responses(_R.HOLD, _R.LAND_HERE, ends_stream=True)
    LANDING_ALONE = "landing alone", Responses(_R.LAND_HERE, _R.LAND_HERE, ends_stream=True)
    RETURNING = "returning", Responses(_R.RELEASE_FALLEN, _R.RELEASE_FALLEN, ends_stream=True)
    FALLING = "falling", Responses(_R.RELEASE_FALLEN, _R.RELEASE_FALLEN)
    FALLEN_SILENT = "fallen and silent", Responses(_R.RELEASE_FALLEN, _R.RELEASE_FALLEN)
    DISARMED = "disarmed", Responses(_R.RELEASE_FALLEN, _R.RELEASE_FALLEN, ends_stream=True)
    REBOOTED = "rebooted", Responses(_R.RELEASE_FALLEN, _R.RELEASE_FALLEN, ends_stream=True)
    FALSE_LANDING = "false landing report", Responses(_R.RELEASE_FALLEN, _R.RELEASE_FALLEN)
    POSITION_JUMP = "position jump", Responses(_R.LAND_HERE, _R.LAND_HERE)
    ORIGIN_MOVED = "origin moved", Responses(_R.LAND_HERE, _R.LAND_HERE)
    FIX_LOST = "GPS fix lost", Responses(_R.RELEASE_HERE, _R.RELEASE_HERE)
    POSITION_LOST = "position lost", Responses(_R.RELEASE_HERE, _R.RELEASE_HERE)
    HEIGHT_DRIFT = "height drift", Responses(_R.LAND_HERE, _R.LAND_HERE)
    HEADING_DISAGREES = "heading disagrees", Responses(_R.LAND_HERE, _R.LAND_HERE)
    BATTERY_LOW = "battery low", Responses(_R.LAND, _R.REPORT)
    BATTERY_CRITICAL = "battery critical", Responses(_R.LAND_HERE, _R.LAND_HERE)
    STATION_STALLED = "ground station stalled", Responses(_R.HOLD, _R.REPORT, irreversible=False)
    STANDSTILL = "standstill", Responses(_R.HOLD, _R.LAND_HERE, irreversible=False)
    TRACKING_ERROR = "tracking error", Responses(_R.LAND_HERE, _R.LAND_HERE)
    SNAGGED = "snagged", Responses(_R.RELEASE, _R.RELEASE_HERE)
    GRIP_SLIP = "grip slip", Responses(_R.LAND_HERE, _R.LAND_HERE)
    COMMAND_FAILED = "command failed", Responses(_R.LAND_HERE, _R.LAND_HERE)
    GATE_TIMEOUT = "gate timeout", Responses(_R.LAND, _R.REPORT)
    HOLD_TIMEOUT = "hold timeout", Responses(_R.LAND, _R.REPORT, irreversible=False)

    def response(self, stage: Stage) -> Response:
        """Return the response in a stage; REPORT in stages without flight."""
        if stage is Stage.EXECUTE:
            return self.responses.execute
        return self.responses.contingency if stage is Stage.CONTINGENCY else Response.REPORT

    @property
    def loses_a_vehicle(self) -> bool:
        """Whether the vehicle is given up."""
        return self.responses.execute is Response.RELEASE_FALLEN


class Windows(StrEnum):
    """What the plan allows where the team stands: land together, release the cable, both, none."""

    BOTH = "land or release"
    LAND = "land"
    RELEASE = "release"
    NEITHER = "neither"

    @classmethod
    def of(cls, *, landable: bool, releasable: bool) -> "Windows":
        """Return the windows that are open."""
        if landable:
            return cls.BOTH if releasable else cls.LAND
        return cls.RELEASE if releasable else cls.NEITHER


class End(StrEnum):
    """How the team comes down, decided where it has come to rest."""

    GO_ON = "go on"
    HOLD = "hold"
    LAND = "land together"
    RELEASE = "release, separate, land"
    RELEASE_FALLEN = "release all, the fallen first, separate, land"
    RELEASE_BESIDE = "release the fallen and its neighbours, land"


_LANDS = {
    Windows.BOTH: End.LAND,
    Windows.LAND: End.LAND,
    Windows.RELEASE: End.RELEASE,
    Windows.NEITHER: End.LAND,
}
_RELEASES_HERE = {
    Windows.BOTH: End.RELEASE,
    Windows.LAND: End.LAND,
    Windows.RELEASE: End.RELEASE,
    Windows.NEITHER: End.LAND,
}
_FALLEN = {
    Windows.BOTH: End.RELEASE_FALLEN,
    Windows.LAND: End.RELEASE_BESIDE,
    Windows.RELEASE: End.RELEASE_FALLEN,
    Windows.NEITHER: End.RELEASE_BESIDE,
}

ENDS: Mapping[Response, Mapping[Windows, End]] = {
    Response.REPORT: dict.fromkeys(Windows, End.GO_ON),
    Response.HOLD: dict.fromkeys(Windows, End.HOLD),
    Response.LAND: _LANDS,
    Response.LAND_HERE: _LANDS,
    Response.RELEASE: dict.fromkeys(Windows, End.RELEASE),
    Response.RELEASE_HERE: _RELEASES_HERE,
    Response.RELEASE_FALLEN: _FALLEN,
}
"""Response → windows where the team stands → how it comes down with a cable attached. With neither
window open it lands all the same, and cable may touch a rotor that stands on the ground. RELEASE
first moves the clock to a window for the release; after T without one, the team releases at its
present place. Where a caught strand stops it on the way and no window for the release is open, the
vehicles at that strand and beside them release before it lands, if none of their strands hangs
above a rotor."""


def response_rows() -> list[tuple[str, ...]]:
    """Return the table for print: a heading, then one row per failure and stage."""
    heading = ("failure", "stage", "response", *(f"open: {words}" for words in Windows))
    table: list[tuple[str, ...]] = [heading]
    for kind in FailureKind:
        for stage in (Stage.EXECUTE, Stage.CONTINGENCY):
            response = kind.response(stage)
            ends = (ENDS[response][windows].value for windows in Windows)
            table.append((kind.value, stage.name.lower(), response.value, *ends))
    return table


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

    def once(self, kind: FailureKind, k: int, message: str) -> list[Finding]:
        """Return a failure of a vehicle where it is reported for the first time."""
        return [Failure(kind, message, k)] if self.first(kind, k) else []

    def forget(self, kind: FailureKind, k: int) -> None:
        """Let a failure of a vehicle be reported once more."""
        self._reported.discard((kind, k))
