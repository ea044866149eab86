"""Vehicles' texts (STATUSTEXT), collected so that the screen shows each text once."""

from dataclasses import dataclass, field
from typing import Final

from swarm.flight.snapshot import Event

SHOWN_KINDS: Final = frozenset({"text warning", "text error"})
"""Kinds of texts for the screen: warnings and worse. The record has all kinds."""

WINDOW: Final = 2.0
"""Seconds of flight time for which a text waits for the same text of other vehicles. Nine
ArduCopter 4.6.2 took 1.1 s to report that they had found a ground station."""


@dataclass
class StatusTexts:
    """Texts that wait for the same text of other vehicles; repeated texts are dropped."""

    _waiting: dict[tuple[str, str], list[Event]] = field(default_factory=dict)
    _seen: set[tuple[str, str, int | None]] = field(default_factory=set)

    def add(self, event: Event) -> None:
        """Add a text; a repeated text, and one that the screen does not show, is dropped."""
        key = event.kind, event.message, event.vehicle
        if event.kind in SHOWN_KINDS and key not in self._seen:
            self._seen.add(key)
            self._waiting.setdefault((event.kind, event.message), []).append(event)

    def due(self, now: float) -> list[list[Event]]:
        """Return the texts that have waited for :data:`WINDOW`: each text's events in order."""
        return self._take(now - WINDOW)

    def remaining(self) -> list[list[Event]]:
        """Return all texts that wait."""
        return self._take(float("inf"))

    def _take(self, until: float) -> list[list[Event]]:
        due = [key for key, events in self._waiting.items() if events[0].time <= until]
        return [self._waiting.pop(key) for key in due]
