"""Position of a vehicle in its uploaded mission."""

from typing import Any


class MissionProgress:
    """The current mission item, its goal (world ENU) and timers; ``first`` is the start item."""

    def __init__(self, first: int) -> None:
        self.first = first
        self.restart()

    def restart(self) -> None:
        """Return to the first item."""
        self.seq = self.first
        self.goal: Any = None
        self.wait_until: float | None = None
        self.jumps: dict[int, int] = {}

    def jump_to(self, seq: int, count: int) -> bool:
        """Continue with another item of ``count``; return False if it does not exist."""
        if not 0 <= seq < count:
            return False
        self.seq = max(seq, self.first)
        self.goal = self.wait_until = None
        return True

    def advance(self) -> None:
        """Continue with the next item."""
        self.seq += 1
        self.goal = self.wait_until = None
