"""Callbacks of a flight, called in a thread so that they cannot delay the flight loop."""

import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from swarm.flight.clearance import Audit
from swarm.flight.snapshot import Event, Snapshot
from swarm.ground.priority import run_behind_main_thread

_MAX_QUEUED = 200


@dataclass(frozen=True)
class FlightCallbacks:
    """Functions that a flight calls, each in a thread of its own or of the caller.

    - ``confirm``: called once the team has been audited on the ground; False refuses the flight.
      Without it an audit without errors is enough.
    - ``on_snapshot``: called about ten times a second.
    - ``on_event``: called for every event.
    - ``on_emulator``: called with the process id of the emulator.

    Snapshots and events that the callbacks are too slow for are dropped.
    """

    confirm: Callable[[Audit], bool] | None = None
    on_snapshot: Callable[[Snapshot], None] | None = None
    on_event: Callable[[Event], None] | None = None
    on_emulator: Callable[[int], None] | None = None


@contextmanager
def publisher(callbacks: FlightCallbacks) -> Iterator[Callable[[Snapshot | Event], None]]:
    """Yield a function that passes snapshots and events to the callbacks, in a thread."""
    on_snapshot, on_event = callbacks.on_snapshot, callbacks.on_event
    waiting: queue.Queue[Any] = queue.Queue(_MAX_QUEUED)

    def publish(item: Snapshot | Event) -> None:
        callback = on_event if isinstance(item, Event) else on_snapshot
        if callback is not None:
            with suppress(queue.Full):
                waiting.put_nowait(item)

    def work() -> None:
        run_behind_main_thread()
        while (item := waiting.get()) is not None:
            if isinstance(item, Event):
                if on_event is not None:
                    on_event(item)
            elif on_snapshot is not None:
                on_snapshot(item)

    worker = threading.Thread(target=work, name="callbacks", daemon=True)
    worker.start()
    try:
        yield publish
    finally:
        with suppress(queue.Full):
            waiting.put(None, timeout=1.0)
        worker.join(2.0)
