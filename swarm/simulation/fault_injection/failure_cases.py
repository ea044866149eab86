"""What can go wrong, what is asked of the team then, and how it may end: the table of drills."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from swarm.errors import InputError, Problem, Refused
from swarm.flight.parameters import STREAM_LOSS_TIME
from swarm.planning import Plan

Part = Literal["fold", "grab", "release"]
Group = Literal["one vehicle", "links", "ground station", "world"]
Station = Literal["asleep", "killed", "interrupted", "interrupted twice"]
End = Literal["goes on", "landed", "released and landed", "landed by failsafe", "flown to the end"]


@dataclass(frozen=True)
class FailureCase:
    """What goes wrong, and what is asked of the team then.

    ``faults`` are the emulator's, without time and vehicle; ``whole_team`` hits everybody.
    ``within`` is the time in seconds in which it must be noticed (None: nothing to notice), by a
    word of the table of failures, or where ``slows`` by a clock that runs slower; of what ``hides``
    it counts from when there is anything to see. ``ends`` are the ends that are right. ``dead``
    says that the fault itself takes a vehicle out of the air; ``moves`` that it moves vehicles or
    cable beyond what was certified, ``drifts`` that it does so with one vehicle, and with the cable
    only where nobody may let go; ``strikes`` how many rotors may touch cable then, with ``why``.
    Where one ``stays`` where it is, and the others with it, one more rotor may where all can
    neither land nor let go without cable coming down on somebody.
    In the first ``falls`` seconds any may: it is what the fault lets fall on whoever is below.
    Where somebody ``coasts`` for want of setpoints, the coast certificate's worst case counts: the
    mission's own clearances.
    """

    name: str
    group: Group
    ends: tuple[End, ...]
    faults: tuple[Mapping[str, Any], ...] = ()
    part: Part = "fold"
    within: float | None = None
    slows: bool = False
    hides: bool = False
    whole_team: bool = False
    dead: bool = False
    moves: bool = False
    drifts: bool = False
    strikes: int = 0
    stays: bool = False
    falls: float = 0.0
    coasts: bool = False
    why: str = ""
    station: Station | None = None
    lasts: float = 0.0
    lose: str = ""
    by_hand: bool = False


class SystemFailureCase(NamedTuple):
    """What goes wrong outside the bytes between station and vehicles, and the tests that make it
    go wrong over real files, processes and sockets, with what must follow."""

    name: str
    follows: str
    tests: tuple[str, ...]


SYSTEM_FAILURE_CASES: tuple[SystemFailureCase, ...] = (
    SystemFailureCase(
        "disk full",
        "told once; the flight goes on, the record keeps what was written before",
        (
            "tests/ground/test_fly.py::"
            "test_a_disk_that_is_full_in_flight_costs_the_rest_of_the_record_and_not_the_flight",
            "tests/ground/test_record.py::test_a_full_disk_costs_the_record_and_not_the_flight",
        ),
    ),
    SystemFailureCase(
        "viewer hangs",
        "no setpoint is late; the viewer misses what it does not take",
        (
            "tests/ground/test_pilot.py::test_a_caller_that_is_slow_does_not_slow_the_flight",
            "tests/view/test_rerun_log.py::test_a_stalled_sink_holds_up_nobody",
            "tests/view/test_rerun_log.py::test_a_killed_sink_holds_up_nobody",
        ),
    ),
    SystemFailureCase(
        "killed in flight, and taken up again",
        "the record lacks a second at most; the next process finds the team and holds it",
        (
            "tests/ground/test_fly.py::"
            "test_after_sigkill_only_the_last_second_of_the_record_is_missing",
            "tests/flight/test_resuming.py",
            "tests/ground/test_resume.py",
        ),
    ),
    SystemFailureCase(
        "strangers on the links",
        "spoofed, replayed and fuzzed packets and floods change no setpoint",
        ("tests/flight/test_security.py", "tests/ground/test_flood.py"),
    ),
)


_ON: tuple[End, ...] = ("goes on", "flown to the end")
_DOWN: tuple[End, ...] = ("landed", "released and landed")
_FALLS = "it is out of the air; as it falls its rotors may strike what hangs there"
_STAYS = (
    "it no longer follows, so that nobody can move to where all can land together; where they can "
    "neither land nor let go as they stand, they land, and cable may touch a rotor on the ground"
)
_BEHIND = (
    "it shows by how far somebody falls behind, and takes longer where the plan hardly moves them"
)
_SILENCE = 1.2
"""Seconds: more than the fleet's limits.silence and a packet's time."""


def _gap(seconds: float, direction: str) -> tuple[Mapping[str, Any], ...]:
    return ({"kind": "link", "loss": 1.0, "direction": direction, "duration": seconds},)


def _gaps() -> Iterator[FailureCase]:
    """Gaps of 0.1, 0.5, 2 and 10 s: of telemetry, of setpoints, of both; for one and for all.

    Vehicles that miss half a second of setpoints may leave offboard mode, as PX4 does: the team
    holds then, and lands after T.
    """
    words = {"down": "telemetry", "up": "setpoint", "both": "two-way"}
    for whole in (False, True):
        for direction, word in words.items():
            for seconds in (0.1, 0.5, 2.0, 10.0):
                left: tuple[End, ...] = () if seconds < 0.5 or direction == "down" else ("landed",)
                late: tuple[End, ...] = ("landed by failsafe",) if seconds > 5.0 else ()
                yield FailureCase(
                    f"{word} gap of {seconds:g} s, {'all' if whole else 'one'}",
                    "links",
                    (*_ON, *left, *(late if left else ())),
                    _gap(seconds, direction),
                    within=None if seconds < 1.0 else 2.0 if direction == "up" else _SILENCE,
                    slows=direction == "up",
                    whole_team=whole,
                    lasts=seconds,
                    coasts=direction != "down" and seconds >= STREAM_LOSS_TIME,
                    why=_BEHIND if direction == "up" else "",
                )


FAILURE_CASES: tuple[FailureCase, ...] = (
    FailureCase(
        "lags", "one vehicle", _ON, ({"kind": "weak_thrust", "fraction": 0.9},), within=2.0,
        slows=True,
    ),
    FailureCase(
        "weak thrust", "one vehicle", (*_ON, "landed"),
        ({"kind": "weak_thrust", "fraction": 0.75},), within=2.0, slows=True,
    ),
    FailureCase("motor lost", "one vehicle", _DOWN, ({"kind": "motor_loss"},), within=0.3,
        dead=True, why=_FALLS),
    FailureCase(
        "battery low", "one vehicle", ("landed",), ({"kind": "battery", "charge": 0.18},),
        within=1.0,
    ),
    FailureCase(
        "battery critical", "one vehicle", ("landed",), ({"kind": "battery", "charge": 0.09},),
        within=1.0,
    ),
    FailureCase(
        "position lost", "one vehicle", _DOWN, ({"kind": "position_loss"},), within=1.0, moves=True,
        strikes=1,
        why="it comes down blind, drifting as it does, and takes the cable along; where some "
        "hangs above a rotor it cannot be let go of",
    ),
    FailureCase(
        "position worse", "one vehicle", _DOWN, ({"kind": "gps_loss"},), within=1.5, drifts=True,
        strikes=1,
        why="it drifts while it reckons, maybe towards another vehicle, and takes the cable along "
        "where some hangs above a rotor, so that nobody may let go",
    ),
    FailureCase(
        "position jumps", "one vehicle", ("landed",),
        ({"kind": "gps_jump", "offset": (3.0, -2.0, 0.5)},), within=0.3,
    ),
    FailureCase(
        "origin reset", "one vehicle", ("landed",),
        ({"kind": "origin_reset", "offset": (4.0, 3.0, 1.0)},), within=0.3,
    ),
    FailureCase(
        "barometer drifts", "one vehicle", _DOWN, ({"kind": "barometer_drift", "rate": 0.1},),
        within=6.0, strikes=1,
        why="a height drifts by as much as GPS can be off before GPS can tell: 0.3 m with these "
        "receivers, 1 m with poor ones; it drifts on as all come down, where nobody may let go, "
        "and a rotor may touch cable then",
    ),
    FailureCase(
        "pilot takes over", "one vehicle", ("landed",), ({"kind": "pilot"},), within=0.5,
        by_hand=True, stays=True, why=_STAYS,
    ),
    FailureCase(
        "leaves offboard", "one vehicle", ("landed",), ({"kind": "leave_offboard"},), within=0.5,
        stays=True, why=_STAYS,
    ),
    FailureCase("disarms", "one vehicle", _DOWN, ({"kind": "disarm"},), within=0.3, dead=True,
        why=_FALLS),
    FailureCase("reboots", "one vehicle", _DOWN, ({"kind": "reboot"},), within=1.5, dead=True,
        why=_FALLS),
    FailureCase(
        "thinks it has landed", "one vehicle", _DOWN, ({"kind": "believes_landed"},), within=0.5,
        dead=True, why=_FALLS,
    ),
    FailureCase(
        "gripper fails to grab", "one vehicle", ("landed",), ({"kind": "gripper_stuck_open"},),
        part="grab", within=8.0,
    ),
    FailureCase(
        "gripper slips", "one vehicle", ("landed", *_ON), ({"kind": "gripper_slip"},),
        within=10.0, hides=True, moves=True, falls=1.0,
        why="the cable between its neighbours is one long strand from then on; it shows by their "
        "leaning, and where that changes by less than 0.2 N only when the team has moved on; where "
        "it passed over a vehicle close below, it falls on its rotor within a second",
    ),
    FailureCase(
        "gripper sticks shut at release", "one vehicle", ("landed",),
        ({"kind": "gripper_stuck_shut"},), part="release", within=3.0,
    ),
    *_gaps(),
    FailureCase(
        "20 % loss", "links", _ON, ({"kind": "link", "loss": 0.2},), whole_team=True,
    ),
    FailureCase(
        "300 ms latency with jitter", "links", _ON,
        ({"kind": "link", "latency": 0.3, "jitter": 0.1},), whole_team=True, slows=True,
    ),
    FailureCase(
        "duplicates and reordering", "links", _ON,
        ({"kind": "link", "duplicate": 0.3, "reorder": 0.3},), whole_team=True,
    ),
    FailureCase("one ACK lost at the release", "links", _ON, part="release", lose="ack"),
    FailureCase(
        "starved of CPU for 1 s", "ground station", (*_ON, "landed"), station="asleep", lasts=1.0,
        slows=True, coasts=True,
    ),
    FailureCase(
        "interrupted once", "ground station", ("landed",), station="interrupted", within=0.1,
    ),
    FailureCase(
        "interrupted twice", "ground station", ("landed",), station="interrupted twice", within=0.1,
    ),
    FailureCase("killed", "ground station", ("landed by failsafe",), station="killed",
        coasts=True),
    FailureCase(
        "wind beyond w*", "world", (*_ON, *_DOWN), ({"kind": "wind"},), within=3.0, slows=True,
        moves=True, strikes=1,
        why="6 m/s all of a sudden blow the cable aside by 50° and push vehicles off their "
        "path; it may touch a rotor as all come down; from about 8 m/s on the emulated ones no "
        "longer hold against it",
    ),
    FailureCase(
        "snag", "world", (*_ON, *_DOWN), ({"kind": "snag"},), moves=True, slows=True,
        why="a strand that is held elsewhere is no longer where the cable model has it",
    ),
)  # fmt: skip


def cases_of(plan: Plan, names: Sequence[str] = ()) -> list[FailureCase]:
    """Return the failure cases that can happen in a plan, whose names contain one of ``names``.

    Raises :class:`InputError` where no name matches, and :class:`Refused` where the plan folds no
    cable in the air.
    """
    cases = [
        case for case in FAILURE_CASES if not names or any(part in case.name for part in names)
    ]
    if not cases:
        known = ", ".join(case.name for case in FAILURE_CASES)
        raise InputError([Problem("--row", f"expected a part of one of: {known}")])
    cases = [case for case in cases if case.part in _parts(plan)]
    if not cases:
        raise Refused("this mission folds no cable in the air: it has no failure cases")
    return cases


def _parts(plan: Plan) -> set[Part]:
    """Return the parts of a flight, of those with failure cases, that a plan has."""
    if not any(phase.name == "fold" and phase.cable == "aloft" for phase in plan.phases):
        return set()
    conditions = {gate.condition for gate in plan.gates}
    parts: set[Part] = {"fold"}
    if "gripped" in conditions:
        parts.add("grab")
    if "released" in conditions:
        parts.add("release")
    return parts
