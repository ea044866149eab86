"""Curves of a live recording, sent to Rerun in batches of points.

A call to Rerun costs the same for any number of points, and a curve may be a moment late.
"""

from typing import Final

import numpy as np
import numpy.typing as npt
import rerun as rr

Floats = npt.NDArray[np.float64]

BATCH_TIME: Final = 0.4
"""Seconds of a curve in one batch."""


class CurveBuffer:
    """Points of curves that are not sent yet, each with its time and mission time."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._waiting: dict[str, list[tuple[float, float, Floats]]] = {}
        self._last_sent = -np.inf

    def add(self, entity: str, time: float, mission_time: float, values: npt.ArrayLike) -> None:
        """Add the next point of an entity's curves (n,)."""
        row = np.atleast_1d(np.asarray(values, dtype=np.float64))
        self._waiting.setdefault(entity, []).append((time, mission_time, row))

    def send_due(self, now: float) -> None:
        """Send all points if the last batch is :data:`BATCH_TIME` old."""
        if not 0.0 <= now - self._last_sent < BATCH_TIME:
            self._last_sent = now
            self.send()

    def send(self) -> None:
        """Send all points."""
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
