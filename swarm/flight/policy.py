"""The response to each failure: one table.

Theory of operation. Detectors compare the observed team with the commanded one and report a
:class:`.FailureKind` (:mod:`swarm.flight.detect`, :mod:`swarm.flight.grip_slip`).
:data:`TABLE` has the response to each kind while the plan is executed, and after the team has left
it. How the team comes down is decided where it has come to rest, by :data:`ENDS` and by the
:class:`Windows` that are open there: whether all can land together, and whether no cable hangs
above a rotor, so that it may be released. Both tables are complete (:func:`cells`);
``swarm failures --table`` prints them.

Responses are the team's, never one vehicle's: vehicles that hold one cable must not part. Returning
to launch, alone or together, is not among them.
"""

from collections.abc import Iterator, Mapping
from enum import StrEnum
from typing import NamedTuple

from swarm.flight.failures import FailureKind
from swarm.flight.stages import Stage


class Response(StrEnum):
    """What the team does about a failure.

    REPORT: go on. HOLD: stop the clock until the failure ends, or for the fleet's T at most. LAND:
    move along the plan to the nearest moment at which all can land, and land together. LAND_HERE:
    the same without moving; a team that has left the plan, and still moves along it, stops.
    RELEASE: move to the nearest moment at which no cable hangs above a rotor, release, separate,
    land. RELEASE_HERE: the same without moving. RELEASE_FALLEN: release at the fallen vehicle
    first, then beside it, then everywhere; the others separate and land.
    """

    REPORT = "report"
    HOLD = "hold"
    LAND = "land"
    LAND_HERE = "land here"
    RELEASE = "release"
    RELEASE_HERE = "release here"
    RELEASE_FALLEN = "release fallen"


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
_K = FailureKind

TABLE: Mapping[FailureKind, Responses] = {
    _K.SILENT: Responses(_R.HOLD, _R.REPORT, irreversible=False),
    _K.LOST: Responses(_R.HOLD, _R.REPORT),
    _K.ALL_LOST: Responses(_R.HOLD, _R.REPORT),
    _K.LEFT_OFFBOARD: Responses(_R.HOLD, _R.LAND_HERE, ends_stream=True),
    _K.PILOT: Responses(_R.HOLD, _R.LAND_HERE, ends_stream=True),
    _K.LANDING_ALONE: Responses(_R.LAND_HERE, _R.LAND_HERE, ends_stream=True),
    _K.RETURNING: Responses(_R.RELEASE_FALLEN, _R.RELEASE_FALLEN, ends_stream=True),
    _K.FALLING: Responses(_R.RELEASE_FALLEN, _R.RELEASE_FALLEN),
    _K.FALLEN_SILENT: Responses(_R.RELEASE_FALLEN, _R.RELEASE_FALLEN),
    _K.DISARMED: Responses(_R.RELEASE_FALLEN, _R.RELEASE_FALLEN, ends_stream=True),
    _K.REBOOTED: Responses(_R.RELEASE_FALLEN, _R.RELEASE_FALLEN, ends_stream=True),
    _K.FALSE_LANDING: Responses(_R.RELEASE_FALLEN, _R.RELEASE_FALLEN),
    _K.POSITION_JUMP: Responses(_R.LAND_HERE, _R.LAND_HERE),
    _K.ORIGIN_MOVED: Responses(_R.LAND_HERE, _R.LAND_HERE),
    _K.FIX_LOST: Responses(_R.RELEASE_HERE, _R.RELEASE_HERE),
    _K.POSITION_LOST: Responses(_R.RELEASE_HERE, _R.RELEASE_HERE),
    _K.HEIGHT_DRIFT: Responses(_R.LAND_HERE, _R.LAND_HERE),
    _K.BATTERY_LOW: Responses(_R.LAND, _R.REPORT),
    _K.BATTERY_CRITICAL: Responses(_R.LAND_HERE, _R.LAND_HERE),
    _K.STATION_STALLED: Responses(_R.HOLD, _R.REPORT, irreversible=False),
    _K.STANDSTILL: Responses(_R.HOLD, _R.LAND_HERE, irreversible=False),
    _K.TRACKING_ERROR: Responses(_R.LAND_HERE, _R.LAND_HERE),
    _K.SNAGGED: Responses(_R.RELEASE, _R.RELEASE_HERE),
    _K.GRIP_SLIP: Responses(_R.LAND_HERE, _R.LAND_HERE),
    _K.COMMAND_FAILED: Responses(_R.LAND_HERE, _R.LAND_HERE),
    _K.GATE_TIMEOUT: Responses(_R.LAND, _R.REPORT),
    _K.HOLD_TIMEOUT: Responses(_R.LAND, _R.REPORT, irreversible=False),
}
"""Failure → responses. Before the flight nothing is armed: a vehicle that is not ready is no
failure but keeps the team on the ground (:mod:`swarm.flight.readiness`)."""

LOSES_A_VEHICLE: frozenset[FailureKind] = frozenset(
    kind for kind, row in TABLE.items() if row.execute is Response.RELEASE_FALLEN
)


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


class Cell(NamedTuple):
    """One cell of the whole table."""

    failure: FailureKind
    stage: Stage
    windows: Windows
    response: Response
    end: End


def response_to(kind: FailureKind, stage: Stage) -> Response:
    """Return the response to a failure in a stage; REPORT in stages without flight."""
    row = TABLE[kind]
    if stage is Stage.EXECUTE:
        return row.execute
    return row.contingency if stage is Stage.CONTINGENCY else Response.REPORT


def end_of(response: Response, windows: Windows) -> End:
    """Return how the team comes down after a response, where these windows are open."""
    return ENDS[response][windows]


def cells() -> Iterator[Cell]:
    """Yield the whole table: failure × stage in flight × open windows."""
    for kind in TABLE:
        for stage in (Stage.EXECUTE, Stage.CONTINGENCY):
            response = response_to(kind, stage)
            for windows in Windows:
                yield Cell(kind, stage, windows, response, end_of(response, windows))


def rows() -> list[tuple[str, ...]]:
    """Return the table for print: a heading, then one row per failure and stage."""
    heading = ("failure", "stage", "response", *(f"open: {words}" for words in Windows))
    found: list[tuple[str, ...]] = [heading]
    for kind in TABLE:
        for stage in (Stage.EXECUTE, Stage.CONTINGENCY):
            response = response_to(kind, stage)
            ends = (end_of(response, windows).value for windows in Windows)
            found.append((kind.value, stage.name.lower(), response.value, *ends))
    return found
