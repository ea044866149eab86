"""The memory that lets each failure be reported once."""

from swarm.flight.failures import FailureKind


class Latch:
    """Failures that have been reported, by kind and vehicle."""

    def __init__(self) -> None:
        self._reported: set[tuple[FailureKind, int]] = set()

    def first(self, kind: FailureKind, k: int) -> bool:
        """Return whether a failure of a vehicle is reported for the first time, and keep it."""
        new = (kind, k) not in self._reported
        self._reported.add((kind, k))
        return new

    def forget(self, kind: FailureKind, k: int) -> None:
        """Let a failure of a vehicle be reported once more."""
        self._reported.discard((kind, k))
