"""What follows from what when something goes wrong: one table.

The choices are the group's, never one vehicle's: vehicles that hold one cable must not part.
Returning to launch, alone or together, is not among them. How things are noticed is in
:mod:`swarm.flight.failure_detection`.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal, NamedTuple

from swarm.mavlink.vehicle import Vehicle

if TYPE_CHECKING:
    from swarm.flight.conductor import Conductor

Response = Literal["hold", "land", "land here", "release", "release here", "cut loose"]
Failure = Literal[
    "silent",
    "lost",
    "all lost",
    "left offboard",
    "pilot",
    "landing by itself",
    "flying home",
    "falling",
    "fallen silent",
    "disarmed",
    "rebooted",
    "believes it has landed",
    "position jumped",
    "origin moved",
    "position poor",
    "position lost",
    "heights disagree",
    "battery low",
    "battery critical",
    "stands still",
    "strayed",
    "snagged",
    "lost its grip",
    "command failed",
    "gate timed out",
    "held too long",
]


class Row(NamedTuple):
    """What follows from a failure, and whether the flight has failed however well it lands."""

    response: Response
    fatal: bool


TABLE: Mapping[Failure, Row] = {
    "silent": Row("hold", False),
    "lost": Row("hold", True),
    "all lost": Row("hold", True),
    "left offboard": Row("hold", True),
    "pilot": Row("hold", True),
    "landing by itself": Row("land here", True),
    "flying home": Row("cut loose", True),
    "falling": Row("cut loose", True),
    "fallen silent": Row("cut loose", True),
    "disarmed": Row("cut loose", True),
    "rebooted": Row("cut loose", True),
    "believes it has landed": Row("cut loose", True),
    "position jumped": Row("land here", True),
    "origin moved": Row("land here", True),
    "position poor": Row("release here", True),
    "position lost": Row("release here", True),
    "heights disagree": Row("land here", True),
    "battery low": Row("land", True),
    "battery critical": Row("land here", True),
    "stands still": Row("hold", False),
    "strayed": Row("land here", True),
    "snagged": Row("release", True),
    "lost its grip": Row("land here", True),
    "command failed": Row("land here", True),
    "gate timed out": Row("land", True),
    "held too long": Row("land", False),
}
"""``hold`` ends when its cause is over, or after the fleet's T in landing. ``land`` goes along the
plan to the nearest moment at which all can land straight down together; ``land here`` does not
move. ``release`` lets go as soon as nothing hangs above anybody, separates, lands; ``release here``
does so without moving along the plan, or lands where it may not. ``cut loose``
lets go of one that falls, then of the cable beside it, then of all of it; the rest separate on the
path that the plan has for that moment, and land."""

LOSES_A_VEHICLE: frozenset[Failure] = frozenset(
    failure for failure, row in TABLE.items() if row.response == "cut loose"
)


def failure(flight: "Conductor", what: Failure, words: str, vehicle: Vehicle | None = None) -> None:
    """Answer a failure as the table says."""
    row = TABLE[what]
    flight.say("failure", f"{what}: {words}", vehicle)
    if row.fatal:
        flight.fail(words)
    if flight.stage == "leave":
        if row.response == "cut loose" and vehicle is not None:
            flight.cut_loose(vehicle, words)
        elif row.response == "release here" and flight.way_out is not None:
            flight.way_out.drop()
        return
    if flight.stage != "fly":
        return
    match row.response:
        case "hold":
            flight.hold(f"{what} {vehicle.system}" if vehicle else what, words)
        case "land" | "land here":
            flight.leave("land", words, move=row.response == "land")
        case "release":
            flight.leave("release", words, move=True)
        case "release here":
            flight.leave("land", words, move=False)
            if flight.way_out is not None:
                flight.way_out.drop()
        case "cut loose" if vehicle is not None:
            flight.cut_loose(vehicle, words)
