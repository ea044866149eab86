"""A flight shown and recorded, in Rerun or for Foxglove, without a delay of the flight.

Each sink, a file or a live view, is a separate process. A queue feeds it that drops its
oldest snapshots when the process is too slow; only the thread of this queue waits for the process.
A viewer that stalls, or that is not opened, delays neither the flight nor other sinks.
"""

import importlib.util
import os
import pickle
import signal
import subprocess
import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, BinaryIO, Final, Literal, cast

from swarm.child_modules import module_command
from swarm.errors import SwarmError
from swarm.files import require_writable
from swarm.flight.snapshot import Event, Snapshot
from swarm.ground.priority import lower_priority
from swarm.planning import Plan
from swarm.view.viewers import LOOPBACK, free_port, has_display, proxy_url, web_url

Live = Literal["native", "web", "foxglove"]

NEWEST_SNAPSHOTS: Final = 400
"""Snapshots in the queue of a sink that is slow or still starting; beyond it the oldest drop."""

NEWEST_EVENTS: Final = 10_000
"""Events in the queue; they are few, and none should be lost."""


FOXGLOVE_MISSING: Final = (
    "--view foxglove needs more packages: pip install 'swarm-ground-station[mcap]'"
)
FOXGLOVE_PORT: Final = 8765
"""The port to which Foxglove connects by itself."""


@dataclass(frozen=True)
class SinkOptions:
    """The output of a sink: a file, a server on loopback for viewers, or for Foxglove both."""

    path: str | None = None
    live: Live | None = None
    port: int = 0
    web_port: int | None = None

    @property
    def module(self) -> str:
        """The module that runs as the sink's process."""
        name = "foxglove_sink" if self.live == "foxglove" else "rerun_sink"
        return f"swarm.view.{name}"


def first_item(source: BinaryIO) -> tuple[Plan, SinkOptions]:
    """Return the plan and the output with which the input of a sink's process begins."""
    first: tuple[Plan, SinkOptions] = pickle.load(source)  # noqa: S301 - by our own parent
    return first


def items(source: BinaryIO) -> Iterator[Snapshot | Event]:
    """Yield what follows in the input of a sink's process, to its end, also a broken one."""
    while True:
        try:
            yield pickle.load(source)  # noqa: S301 - as above
        except (EOFError, pickle.UnpicklingError):
            return


class Viewer:
    """A flight's recording and live view; :meth:`offer` never blocks and never raises."""

    def __init__(self, feeds: list["Feed"], message: str | None) -> None:
        self._feeds = feeds
        self.message: Final = message
        """One line for the user: the address of the live view, or the reason for its absence."""

    @property
    def dropped(self) -> int:
        """Number of dropped snapshots, because a sink was too slow."""
        return sum(feed.dropped for feed in self._feeds)

    def offer(self, item: Snapshot | Event) -> None:
        """Queue a snapshot or event for all sinks; return at once."""
        for feed in self._feeds:
            feed.offer(item)

    def close(self, timeout: float = 10.0) -> bool:
        """Write the queued items and end the processes; an open window stays.

        Items that are not written after ``timeout`` seconds are discarded. Returns whether all
        queued items are written.
        """
        until = time.monotonic() + timeout
        for feed in self._feeds:
            feed.finish()
        written = [feed.join(until) for feed in self._feeds]
        return all(written)


def start(plan: Plan, path: Path | None, live: Live | None) -> Viewer:
    """Start recording a flight to ``path`` (.rrd) and showing it ``live``; either may be None.

    ``native`` opens a window, ``web`` serves a page on loopback, ``foxglove`` serves Foxglove and
    writes an .mcap file beside ``path``. Without a display there is no window;
    :attr:`Viewer.message` reports that, and the file is written. Raises :class:`InputError` where a
    file cannot be written, and :class:`SwarmError` where a package is missing.
    """
    if live == "foxglove" and importlib.util.find_spec("foxglove") is None:
        raise SwarmError(FOXGLOVE_MISSING)
    feeds: list[Feed] = []
    message = None
    if path is not None:
        require_writable(path)
        feeds.append(Feed(plan, SinkOptions(path=str(path))))
    if live == "native" and not has_display():
        later = f"; open {path} later with: swarm view {path}" if path else ""
        message = f"no display, so no window{later}"
    elif live == "foxglove":
        log = None if path is None else path.with_suffix(".mcap")
        if log is not None:
            require_writable(log)
        port = free_port(FOXGLOVE_PORT)
        options = SinkOptions(path=None if log is None else str(log), live=live, port=port)
        feeds.append(Feed(plan, options))
        message = f"live view: open connection ws://{LOOPBACK}:{port} in Foxglove"
    elif live is not None:
        port = free_port()
        web_port = free_port() if live == "web" else None
        feeds.append(Feed(plan, SinkOptions(live=live, port=port, web_port=web_port)))
        message = (
            f"live view: {web_url(web_port, port)}"
            if web_port is not None
            else f"live view is opening; another one: rerun --connect {proxy_url(port)}"
        )
    return Viewer(feeds, message)


class Feed:
    """One sink's process, the queue before it and the thread between them."""

    def __init__(self, plan: Plan, options: SinkOptions) -> None:
        self.dropped = 0
        self._snapshots: deque[Snapshot] = deque(maxlen=NEWEST_SNAPSHOTS)
        self._events: deque[Event] = deque(maxlen=NEWEST_EVENTS)
        self._waiting = threading.Event()
        self._finished = False
        # A new session: an interrupt from the keyboard ends the flight, and the recording must be
        # completed after that.
        self._process = subprocess.Popen(  # noqa: S603
            module_command(options.module),
            stdin=subprocess.PIPE,
            bufsize=0,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        lower_priority(self._process.pid)
        self._pipe = cast("IO[bytes]", self._process.stdin)
        self._thread = threading.Thread(
            target=self._pump, args=(plan, options), name="view", daemon=True
        )
        self._thread.start()

    def offer(self, item: Snapshot | Event) -> None:
        """Queue an item; a full queue drops its oldest snapshot."""
        if isinstance(item, Event):
            self._events.append(item)
        else:
            self.dropped += len(self._snapshots) == NEWEST_SNAPSHOTS
            self._snapshots.append(item)
        self._waiting.set()

    def finish(self) -> None:
        """Mark the end of the queue."""
        self._finished = True
        self._waiting.set()

    def join(self, until: float) -> bool:
        """Wait for the process until a time of the monotonic clock, then kill it.

        Returns whether it ended by itself with all items written.
        """
        self._thread.join(max(0.0, until - time.monotonic()))
        try:
            return self._process.wait(max(0.0, until - time.monotonic())) == 0
        except subprocess.TimeoutExpired:
            self._kill()
            return False

    def _kill(self) -> None:
        if hasattr(os, "killpg"):
            os.killpg(self._process.pid, signal.SIGKILL)
        else:
            self._process.kill()
        self._process.wait()

    def _pump(self, plan: Plan, options: SinkOptions) -> None:
        try:
            self._send((plan, options))
            while not (self._finished and not self._events and not self._snapshots):
                self._waiting.wait()
                self._waiting.clear()
                while self._events or self._snapshots:
                    self._send((self._events or self._snapshots).popleft())
        except OSError:
            # The sink has ended (killed, or its disk is full); the flight continues without it.
            self._events.clear()
            self._snapshots.clear()
        finally:
            self._pipe.close()

    def _send(self, item: object) -> None:
        unsent = memoryview(pickle.dumps(item))
        while unsent:
            unsent = unsent[self._pipe.write(unsent) :]
