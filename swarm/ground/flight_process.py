"""The flight in a process of its own, independent of drawing, writing and waiting in the caller.

:func:`fly_in_process` is :func:`swarm.ground.fly.fly` in another process. Snapshots, events and
the question before the flight arrive over a pipe; keys and signals go the other way. The caller is
the first screen of the flight, which outlives it: where the caller ends, or loses its terminal,
the flight goes on as ``FlyOptions.unattended`` says, and others attach to its control socket.
"""

import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType
from typing import Any, Final

from swarm.child_modules import module_command
from swarm.errors import Interrupted, SwarmError, VehicleError
from swarm.flight.flight_plan import Audit, FlightPlan
from swarm.flight.result import FlightResult
from swarm.ground.child_process import exit_reason
from swarm.ground.fly import Caller, FlightCallbacks, FlyOptions, fly
from swarm.ground.operator import signal_handlers, terminal_keys
from swarm.ground.priority import lowered_priority, raise_priority, run_behind_main_thread
from swarm.mission.fleet import Fleet

_POLL = 0.05

MODULE: Final = "swarm.ground.flight_process"
"""The module that the process runs; its last argument is the folder of the record."""


@dataclass(frozen=True)
class FlightRequest:
    """A flight as it is sent to the process; ``confirm`` requires a confirmation by the caller."""

    flight_plan: FlightPlan
    fleet: Fleet
    folder: Path
    options: FlyOptions = field(default_factory=FlyOptions)
    confirm: bool = False


def fly_in_process(
    request: FlightRequest,
    callbacks: FlightCallbacks | None = None,
    *,
    read_keys: bool = False,
    low_priority: bool = False,
) -> FlightResult:
    """Fly in another process; the callbacks run in this one and may be slow.

    ``read_keys`` passes keys of this terminal on, from the confirmation on where there is one;
    ``low_priority`` runs this process at lower priority during the flight. SIGINT and SIGTERM are
    passed on: the first lands the team after a hold, the second at once. SIGHUP ends this process,
    as a callback that raises ends this function; the flight goes on.

    Raises the errors of :func:`swarm.ground.fly.fly`, and :class:`VehicleError` if the process ends
    before the flight does.
    """
    ours, theirs = socket.socketpair()
    process = subprocess.Popen(  # noqa: S603
        module_command(MODULE, str(theirs.fileno()), str(request.folder.absolute())),
        pass_fds=[theirs.fileno()],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )
    theirs.close()
    pipe = Connection(os.dup(ours.fileno()))
    confirming = threading.Event()
    with ExitStack() as context:
        context.callback(_disconnect, ours)
        context.enter_context(lowered_priority() if low_priority else nullcontext())
        try:
            with suppress(OSError):
                pipe.send(request)
            _forward_signals(context, pipe, confirming)
            keys = _Keys(context, pipe, enabled=read_keys)
            if not request.confirm:
                keys.start()
            callbacks = callbacks or FlightCallbacks()
            kind, content = _serve(pipe, callbacks, keys, confirming)
        except _FlightEndedError:
            reason = exit_reason(process.wait(5.0))
            raise VehicleError(f"the flight's process ended ({reason})") from None
    with suppress(subprocess.TimeoutExpired):
        process.wait(10.0)
    if process.poll() is None:
        process.kill()
        process.wait()
    if kind == "error":
        raise content
    if kind == "bug":
        raise RuntimeError(f"in the flight's process:\n{content}")
    result: FlightResult = content
    return result


def _serve(
    pipe: Connection,
    callbacks: FlightCallbacks,
    keys: "_Keys",
    confirming: threading.Event,
) -> tuple[str, Any]:
    """Handle the messages of the flight process until it sends a result or an error."""
    inbox = _Inbox(pipe, callbacks.on_answered)
    while True:
        while (message := inbox.receive(_POLL)) is None:
            keys.poll()
        kind, content = message
        match kind:
            case "end":
                raise _FlightEndedError
            case "result" | "error" | "bug":
                return kind, content
            case "snapshot" if callbacks.on_snapshot is not None:
                callbacks.on_snapshot(content)
            case "event" if callbacks.on_event is not None:
                callbacks.on_event(content)
            case "confirm":
                try:
                    answer = _confirm(callbacks.confirm, content, confirming)
                except Exception:  # as the end of the input: no answer of another screen counts
                    _send(pipe, "answer", False)
                    raise
                _send(pipe, "answer", answer)
                keys.start()  # the question is answered on the same terminal
        keys.poll()


def _send(pipe: Connection, kind: str, content: Any) -> None:
    """Send a message; that the process has ended is what the inbox reports."""
    with suppress(OSError):
        pipe.send((kind, content))


def _confirm(
    confirm: Callable[[Audit], bool | None] | None,
    audit: Audit,
    confirming: threading.Event,
) -> bool | None:
    if confirm is None:
        return True
    try:
        confirming.set()
        try:
            return confirm(audit)
        finally:
            confirming.clear()
    except KeyboardInterrupt:  # the handler raises it once, and only while this is set
        return False


def _disconnect(ours: socket.socket) -> None:
    """End both directions; the inbox, whose thread reads the pipe, gets its end and closes it."""
    with ours, suppress(OSError):
        ours.shutdown(socket.SHUT_RDWR)


class _FlightEndedError(Exception):
    """The process of the flight ended before the flight did."""


class _Inbox:
    """Reads messages in a thread as they arrive, so that the flight never waits for its caller.

    Of the snapshots only the newest is kept; all other messages are kept in order. ``on_answered``
    is called at once, in the thread.
    """

    def __init__(self, pipe: Connection, on_answered: Callable[[], None] | None) -> None:
        self._pipe, self._on_answered = pipe, on_answered
        self._waiting: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self._newest: list[Any] = []
        self._lock = threading.Lock()
        threading.Thread(target=self._read, name="flight", daemon=True).start()

    def _read(self) -> None:
        with suppress(EOFError, OSError):
            while True:
                kind, content = self._pipe.recv()
                if kind == "answered":
                    if self._on_answered is not None:
                        self._on_answered()
                    continue
                if kind != "snapshot":
                    self._waiting.put((kind, content))
                    continue
                with self._lock:
                    if not self._newest:
                        self._waiting.put((kind, None))
                    self._newest = [content]
        self._pipe.close()
        self._waiting.put(("end", None))

    def receive(self, timeout: float) -> tuple[str, Any] | None:
        """Return the next message; None if there is none for ``timeout`` seconds."""
        with suppress(queue.Empty):
            kind, content = self._waiting.get(timeout=timeout)
            if kind == "snapshot":
                with self._lock:
                    (content,), self._newest = self._newest, []
            return kind, content
        return None


@dataclass
class _Keys:
    """Keys of this terminal, read from :meth:`start` on and until the context ends."""

    context: ExitStack
    pipe: Connection
    enabled: bool
    poll: Callable[[], None] = lambda: None

    def start(self) -> None:
        """Begin to read keys; what was typed before is dropped."""
        if self.enabled:
            self.enabled = False
            sender = partial(_send, self.pipe, "key")
            self.poll = self.context.enter_context(terminal_keys(sender))


def _forward_signals(context: ExitStack, pipe: Connection, confirming: threading.Event) -> None:
    """Forward signals to the flight while the context lasts; they also cancel a question."""

    def catch(number: int, _frame: FrameType | None) -> None:
        _send(pipe, "signal", number)
        if confirming.is_set():
            confirming.clear()
            raise KeyboardInterrupt

    def leave(_number: int, _frame: FrameType | None) -> None:
        # Its terminal is gone: whatever this process writes now fails. The flight goes on.
        os._exit(Interrupted.exit_code)

    context.enter_context(signal_handlers((signal.SIGINT, signal.SIGTERM), catch))
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        context.enter_context(signal_handlers((signal.SIGHUP,), leave))


class _FlightServer:
    """The side of the flight process: flies, and sends messages without blocking the loop."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._lock = threading.Lock()
        self._answers: queue.SimpleQueue[bool | None] = queue.SimpleQueue()
        self._caller = Caller()

    def run(self) -> None:
        try:
            request: FlightRequest = self._pipe.recv()
        except (EOFError, OSError):
            return  # the caller ended before it sent its request
        threading.Thread(target=self._listen, name="caller", daemon=True).start()
        callbacks = FlightCallbacks(
            confirm=self._confirm if request.confirm else None,
            on_snapshot=lambda snapshot: self._send("snapshot", snapshot),
            on_event=lambda event: self._send("event", event),
            on_answered=lambda: self._send("answered", None),
        )
        try:
            result = fly(
                request.flight_plan,
                request.fleet,
                request.folder,
                request.options,
                callbacks,
                caller=self._caller,
            )
        except SwarmError as error:
            self._send("error", error)
        except Exception:
            self._send("bug", traceback.format_exc())
        else:
            self._send("result", result)

    def _send(self, kind: str, content: Any) -> None:
        with self._lock:
            _send(self._pipe, kind, content)

    def _confirm(self, audit: Audit) -> bool | None:
        self._send("confirm", audit)
        return self._answers.get()

    def _listen(self) -> None:
        run_behind_main_thread()
        with suppress(EOFError, OSError):
            while True:
                kind, content = self._pipe.recv()
                if kind == "answer":
                    self._answers.put(content)
                elif kind == "key":
                    self._caller.keys.put(content)
                elif kind == "signal":
                    self._caller.interrupts.append(content)
        self._caller.gone.set()
        self._answers.put(None)


def main() -> None:
    """Fly the request that arrives over the pipe whose descriptor is the first argument."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # before the flight: ends without a traceback
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_IGN)  # a session that ends is no reason to land
    raise_priority()
    with Connection(int(sys.argv[1])) as pipe:
        _FlightServer(pipe).run()


if __name__ == "__main__":
    main()
