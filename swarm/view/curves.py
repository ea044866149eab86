"""Curves of a live recording: their points go to Rerun some at a time, as columns.

Every call costs the same whatever it carries, and a curve may come a moment late.
"""

from typing import Final

import numpy as np
import numpy.typing as npt
import rerun as rr

Floats = npt.NDArray[np.float64]

EVERY: Final = 0.4
"""Seconds of a curve that are sent together."""


class Curves:
    """Points of curves that wait to be sent, each with its time and mission time."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._waiting: dict[str, list[tuple[float, float, Floats]]] = {}
        self._since = -np.inf

    def add(self, entity: str, time: float, mission_time: float, values: npt.ArrayLike) -> None:
        """Take the next point of an entity's curves (n,)."""
        row = np.atleast_1d(np.asarray(values, dtype=np.float64))
        self._waiting.setdefault(entity, []).append((time, mission_time, row))

    def pass_on(self, now: float) -> None:
        """Send what waits, if it has waited for long enough."""
        if not 0.0 <= now - self._since < EVERY:
            self._since = now
            self.send()

    def send(self) -> None:
        """Send all that waits."""
        for entity, points in self._waiting.items():
            times, clock, values = zip(*points, strict=True)
            self._stream.send_columns(
                entity,
                indexes=[
                    rr.TimeColumn("time", duration=times),
                    rr.TimeColumn("mission_time", duration=clock),
                ],
                columns=rr.Scalars.columns(scalars=np.concatenate(values)).partition(
                    [len(row) for row in values]
                ),
            )
        self._waiting.clear()
