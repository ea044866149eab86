"""One connection of one vehicle, and the commands that arrive on it."""

import heapq
from dataclasses import dataclass, field
from typing import NamedTuple

from sitl.protocol import wire

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = range(6)
"""MAV_RESULT."""


@dataclass
class Link:
    """A connection: telemetry streams, parser, sender and the frames that wait to be sent.

    ``intervals`` are seconds between two messages of a name, ``due`` is a heap of (time, name).
    """

    vehicle: int
    kind: str
    sender: wire.Sender
    receiver: wire.Receiver = field(default_factory=wire.Receiver)
    intervals: dict[str, float] = field(default_factory=dict)
    due: list[tuple[float, str]] = field(default_factory=list)
    outgoing: list[bytes] = field(default_factory=list)

    def stream(self, name: str, interval: float | None, now: float) -> None:
        """Send a message every ``interval`` seconds; None ends the stream."""
        if interval is None:
            self.intervals.pop(name, None)
            return
        fresh = name not in self.intervals
        faster = not fresh and interval < self.intervals[name]
        self.intervals[name] = interval
        if fresh or faster:
            self.due = [entry for entry in self.due if entry[1] != name]
            heapq.heapify(self.due)
            heapq.heappush(self.due, (now, name))


class Command(NamedTuple):
    """A received command: number, seven parameters, position in 1e-7 degrees, link and sender."""

    number: int
    p: list[float]
    x: int
    y: int
    link: Link
    system: int
    component: int
