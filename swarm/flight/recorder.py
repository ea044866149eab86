"""What is kept of a flight while it is flown: events, and the flown positions."""

import numpy as np
import numpy.typing as npt

from swarm.flight.snapshot import Event
from swarm.flight.trace import Trace

Floats = npt.NDArray[np.float64]


class Recorder:
    """Events since they were last taken, and all samples of the flight, which do not change."""

    def __init__(self) -> None:
        self._events: list[Event] = []
        self.samples: list[tuple[float, float, Floats, Floats, str, Floats]] = []
        self.next_sample = 0.0

    def event(self, time: float, kind: str, message: str, vehicle: int | None) -> None:
        """Add an event; ``vehicle`` is counted from 1."""
        self._events.append(Event(time, kind, message, vehicle))

    def take_events(self) -> list[Event]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    def sample(
        self,
        times: tuple[float, float],
        places: tuple[Floats, Floats],
        phase: str,
        stray: Floats,
    ) -> None:
        """Add a moment: its time and mission time, positions and setpoints (n, 3), the plan's
        phase, and the strays (n − 1,) of the strands."""
        self.samples.append((*times, *places, phase, stray))

    def trace(self, n: int, segments: int) -> Trace:
        """Return the flight of n vehicles with so many cable segments so far."""
        samples = self.samples
        return Trace(
            time=np.array([row[0] for row in samples]),
            mission_time=np.array([row[1] for row in samples]),
            position=np.array([row[2] for row in samples]).reshape(-1, n, 3),
            setpoint=np.array([row[3] for row in samples]).reshape(-1, n, 3),
            phase=tuple(row[4] for row in samples),
            stray=np.array([row[5] for row in samples]).reshape(len(samples), segments),
        )
