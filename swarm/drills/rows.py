"""What can go wrong, what is asked of the team then, and how it may end: the table of drills."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

Part = Literal["fold", "grab", "release"]
Group = Literal["one vehicle", "links", "ground station", "world"]
Station = Literal["asleep", "killed", "interrupted", "interrupted twice"]
End = Literal["goes on", "landed", "released and landed", "landed by failsafe", "flown to the end"]


@dataclass(frozen=True)
class Row:
    """What goes wrong, and what is asked of the team then.

    ``faults`` are the emulator's, without time and vehicle; ``whole_team`` hits everybody.
    ``within`` is the time in seconds in which it must be noticed (None: nothing to notice).
    ``ends`` are the ends that are right. ``dead`` says that the fault itself takes a vehicle out of
    the air; ``moves`` that it moves vehicles or cable beyond what was certified, with ``why``.
    """

    name: str
    group: Group
    ends: tuple[End, ...]
    faults: tuple[Mapping[str, Any], ...] = ()
    part: Part = "fold"
    within: float | None = None
    whole_team: bool = False
    dead: bool = False
    moves: bool = False
    why: str = ""
    station: Station | None = None
    lasts: float = 0.0
    lose: str = ""
    by_hand: bool = False


_ON: tuple[End, ...] = ("goes on", "flown to the end")
_DOWN: tuple[End, ...] = ("landed", "released and landed")


def _gap(seconds: float, direction: str) -> tuple[Mapping[str, Any], ...]:
    return ({"kind": "link", "loss": 1.0, "direction": direction, "duration": seconds},)


def _gaps() -> Iterator[Row]:
    """Gaps of 0.1, 0.5, 2 and 10 s: of telemetry, of setpoints, of both; for one and for all."""
    words = {"down": "telemetry", "up": "setpoint", "both": "two-way"}
    for whole in (False, True):
        for direction, word in words.items():
            for seconds in (0.1, 0.5, 2.0, 10.0):
                short = seconds < 0.5
                noticed = seconds > 1.0
                yield Row(
                    f"{word} gap of {seconds:g} s, {'all' if whole else 'one'}",
                    "links",
                    _ON if short else (*_ON, *_DOWN, "landed by failsafe"),
                    _gap(seconds, direction),
                    within=2.0 if noticed and direction != "up" else None,
                    whole_team=whole,
                    lasts=seconds,
                )


ROWS: tuple[Row, ...] = (
    Row("lags", "one vehicle", (*_ON, *_DOWN), ({"kind": "weak_thrust", "fraction": 0.9},)),
    Row(
        "weak thrust", "one vehicle", (*_ON, *_DOWN), ({"kind": "weak_thrust", "fraction": 0.75},),
    ),
    Row("motor lost", "one vehicle", _DOWN, ({"kind": "motor_loss"},), within=0.3, dead=True),
    Row("battery low", "one vehicle", _DOWN, ({"kind": "battery", "charge": 0.18},), within=3.0),
    Row(
        "battery critical", "one vehicle", _DOWN, ({"kind": "battery", "charge": 0.09},),
        within=3.0,
    ),
    Row(
        "position lost", "one vehicle", _DOWN, ({"kind": "position_loss"},), within=3.0, moves=True,
        why="a vehicle without a position drifts down on its own",
    ),
    Row(
        "position worse", "one vehicle", _DOWN, ({"kind": "gps_loss"},), within=3.0, moves=True,
        why="its position drifts while it reckons",
    ),
    Row(
        "position jumps", "one vehicle", _DOWN,
        ({"kind": "gps_jump", "offset": (3.0, -2.0, 0.5)},), within=0.5, moves=True,
        why="it flies the jump until the next report shows it",
    ),
    Row(
        "origin reset", "one vehicle", _DOWN,
        ({"kind": "origin_reset", "offset": (4.0, 3.0, 1.0)},), within=0.5, moves=True,
        why="it flies the reset until the next report shows it",
    ),
    Row(
        "barometer drifts", "one vehicle", _DOWN, ({"kind": "barometer_drift", "rate": 0.1},),
        within=15.0, moves=True, why="heights drift by a metre before GPS can tell",
    ),
    Row(
        "pilot takes over", "one vehicle", _DOWN, ({"kind": "pilot"},), within=1.0, by_hand=True,
    ),
    Row("leaves offboard", "one vehicle", _DOWN, ({"kind": "leave_offboard"},), within=1.0),
    Row("disarms", "one vehicle", _DOWN, ({"kind": "disarm"},), within=0.3, dead=True),
    Row("reboots", "one vehicle", _DOWN, ({"kind": "reboot"},), within=1.5, dead=True),
    Row(
        "thinks it has landed", "one vehicle", _DOWN, ({"kind": "believes_landed"},), within=0.5,
        dead=True,
    ),
    Row(
        "gripper fails to grab", "one vehicle", _DOWN, ({"kind": "gripper_stuck_open"},),
        part="grab", within=8.0,
    ),
    Row(
        "gripper slips", "one vehicle", (*_ON, *_DOWN), ({"kind": "gripper_slip"},), moves=True,
        why="the cable between its neighbours is one long strand from then on",
    ),
    Row(
        "gripper sticks shut at release", "one vehicle", _DOWN, ({"kind": "gripper_stuck_shut"},),
        part="release", within=3.0,
    ),
    *_gaps(),
    Row(
        "20 % loss", "links", _ON, ({"kind": "link", "loss": 0.2},), whole_team=True,
    ),
    Row(
        "300 ms latency with jitter", "links", (*_ON, *_DOWN),
        ({"kind": "link", "latency": 0.3, "jitter": 0.1},), whole_team=True,
    ),
    Row(
        "duplicates and reordering", "links", _ON,
        ({"kind": "link", "duplicate": 0.3, "reorder": 0.3},), whole_team=True,
    ),
    Row("one ACK lost at the release", "links", _ON, part="release", lose="ack"),
    Row(
        "starved of CPU for 1 s", "ground station", (*_ON, *_DOWN), station="asleep", lasts=1.0,
    ),
    Row("interrupted once", "ground station", _DOWN, station="interrupted", within=0.1),
    Row("interrupted twice", "ground station", _DOWN, station="interrupted twice", within=0.1),
    Row("killed", "ground station", ("landed by failsafe",), station="killed"),
    Row(
        "wind beyond w*", "world", (*_ON, *_DOWN),
        ({"kind": "wind"},), moves=True,
        why="the cable is blown aside and vehicles are pushed off their path",
    ),
    Row(
        "snag", "world", (*_ON, *_DOWN), ({"kind": "snag"},), moves=True,
        why="a strand that is held elsewhere is no longer where the cable model has it",
    ),
)  # fmt: skip
