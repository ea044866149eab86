"""What follows from what when something goes wrong: one table.

The choices are the group's, never one vehicle's: vehicles that hold one cable must not part.
Returning to launch, alone or together, is not among them.
"""

from collections.abc import Mapping
from typing import Literal

Response = Literal["note", "hold", "land"]
Failure = Literal[
    "silent",
    "lost",
    "all lost",
    "left offboard",
    "disarmed",
    "rebooted",
    "origin moved",
    "command failed",
    "gate timed out",
    "held too long",
]

RESPONSES: Mapping[Failure, Response] = {
    "silent": "hold",
    "lost": "land",
    "all lost": "note",
    "left offboard": "land",
    "disarmed": "land",
    "rebooted": "land",
    "origin moved": "land",
    "command failed": "land",
    "gate timed out": "land",
    "held too long": "land",
}
"""``hold`` ends by itself when its cause is over; ``land`` brings everybody down together."""

FATAL: frozenset[Failure] = frozenset(RESPONSES) - {"silent", "held too long"}
"""Failures after which a flight has failed, however well it lands."""
