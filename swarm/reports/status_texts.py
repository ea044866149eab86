"""What vehicles say in words (STATUSTEXT), gathered so that a screen says each text once."""

from dataclasses import dataclass, field
from typing import Final

from swarm.flight.snapshot import Event

SHOWN: Final = frozenset({"text warning", "text error"})
"""Kinds of texts for the screen: warnings and worse. The record has the others, too."""

WINDOW: Final = 2.0
"""Seconds of flight time for which a text waits for the same text of other vehicles. Nine
ArduCopter 4.6.2 took 1.1 s to say that they had heard a ground station."""


@dataclass
class Texts:
    """Texts that wait for the same text of other vehicles, each of a vehicle's once in a flight."""

    _waiting: dict[tuple[str, str], list[Event]] = field(default_factory=dict)
    _heard: set[tuple[str, str, int | None]] = field(default_factory=set)

    def hear(self, event: Event) -> None:
        """Take a text; what a vehicle has said before, or what no screen shows, is dropped."""
        known = event.kind, event.message, event.vehicle
        if event.kind in SHOWN and known not in self._heard:
            self._heard.add(known)
            self._waiting.setdefault((event.kind, event.message), []).append(event)

    def due(self, now: float) -> list[list[Event]]:
        """Return the texts that have waited long enough: the events of each, first one first."""
        return self._taken(now - WINDOW)

    def rest(self) -> list[list[Event]]:
        """Return all texts that wait."""
        return self._taken(float("inf"))

    def _taken(self, until: float) -> list[list[Event]]:
        ripe = [key for key, events in self._waiting.items() if events[0].time <= until]
        return [self._waiting.pop(key) for key in ripe]
