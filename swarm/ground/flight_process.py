"""The flight in a process of its own, independent of drawing, writing and waiting in the caller.

:func:`fly_in_process` is :func:`swarm.ground.fly.fly` in another process. Snapshots, events and
the question before the flight arrive over a pipe. The process ends with its caller.
"""

import queue
import signal
import socket
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType
from typing import Any

from swarm.child_modules import module_command
from swarm.errors import SwarmError, VehicleError
from swarm.flight.clearance import Audit
from swarm.flight.flight_plan import FlightPlan
from swarm.flight.result import FlightResult
from swarm.ground.callbacks import FlightCallbacks
from swarm.ground.child_process import die_with_parent, exit_reason
from swarm.ground.fly import FlyOptions, fly
from swarm.ground.operator import terminal_keys
from swarm.ground.priority import lowered_priority, raise_priority, run_behind_main_thread
from swarm.mission.fleet import Fleet

_POLL = 0.05


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
    passed on: the first lands the team after a hold, the second at once.

    Raises the errors of :func:`swarm.ground.fly.fly`, and :class:`VehicleError` if the process ends
    before the flight does.
    """
    ours, theirs = socket.socketpair()
    process = subprocess.Popen(  # noqa: S603
        module_command("swarm.ground.flight_process", str(theirs.fileno())),
        pass_fds=[theirs.fileno()],
        stdin=subprocess.DEVNULL,
        start_new_session=True,
    )
    theirs.close()
    pipe = Connection(ours.detach())
    confirming = threading.Event()
    try:
        with ExitStack() as context:
            context.enter_context(lowered_priority() if low_priority else nullcontext())
            context.enter_context(_forwarded_signals(process, confirming))
            pipe.send(request)
            keys = _Keys(context, _KeySender(pipe), enabled=read_keys)
            if not request.confirm:
                keys.start()
            return _serve(pipe, callbacks or FlightCallbacks(), keys, confirming)
    except (EOFError, BrokenPipeError, ConnectionResetError):
        reason = exit_reason(process.wait(5.0))
        raise VehicleError(f"the flight's process ended ({reason})") from None
    finally:
        pipe.close()
        with suppress(subprocess.TimeoutExpired):
            process.wait(10.0)
        if process.poll() is None:
            process.kill()
            process.wait()


def _serve(
    pipe: Connection,
    callbacks: FlightCallbacks,
    keys: "_Keys",
    confirming: threading.Event,
) -> FlightResult:
    """Handle the messages of the flight process until it sends a result or an error."""
    inbox = _Inbox(pipe)
    while True:
        while (message := inbox.receive(_POLL)) is None:
            keys.poll()
        kind, content = message
        match kind:
            case "end":
                raise EOFError
            case "result":
                result: FlightResult = content
                return result
            case "error":
                raise content
            case "bug":
                raise RuntimeError(f"in the flight's process:\n{content}")
            case "snapshot" if callbacks.on_snapshot is not None:
                callbacks.on_snapshot(content)
            case "event" if callbacks.on_event is not None:
                callbacks.on_event(content)
            case "confirm":
                pipe.send(("answer", _confirm(callbacks.confirm, content, confirming)))
                keys.start()  # the question is answered on the same terminal
        keys.poll()


def _confirm(
    confirm: Callable[[Audit], bool] | None, audit: Audit, confirming: threading.Event
) -> bool:
    if confirm is None:
        return True
    confirming.set()
    try:
        return confirm(audit)
    except KeyboardInterrupt:
        return False
    finally:
        confirming.clear()


class _Inbox:
    """Reads messages in a thread as they arrive, so that the flight never waits for its caller.

    Of the snapshots only the newest is kept; all other messages are kept in order.
    """

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._waiting: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self._newest: list[Any] = []
        self._lock = threading.Lock()
        threading.Thread(target=self._read, name="flight", daemon=True).start()

    def _read(self) -> None:
        with suppress(EOFError, OSError):
            while True:
                kind, content = self._pipe.recv()
                if kind != "snapshot":
                    self._waiting.put((kind, content))
                    continue
                with self._lock:
                    if not self._newest:
                        self._waiting.put((kind, None))
                    self._newest = [content]
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
class _KeySender:
    """Sends keys to the console in the flight process."""

    pipe: Connection

    def key(self, key: str) -> str | None:
        """Send a key."""
        self.pipe.send(("key", key))
        return None


@dataclass
class _Keys:
    """Keys of this terminal, read from :meth:`start` on and until the context ends."""

    context: ExitStack
    sender: _KeySender
    enabled: bool
    poll: Callable[[], None] = lambda: None

    def start(self) -> None:
        """Begin to read keys; what was typed before is dropped."""
        if self.enabled:
            self.enabled = False
            self.poll = self.context.enter_context(terminal_keys(self.sender))


@contextmanager
def _forwarded_signals(
    process: "subprocess.Popen[bytes]", confirming: threading.Event
) -> Iterator[None]:
    """Forward signals to the flight, if this is the main thread; they also cancel a question."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def catch(number: int, _frame: FrameType | None) -> None:
        process.send_signal(number)
        if confirming.is_set():
            raise KeyboardInterrupt

    before = {number: signal.signal(number, catch) for number in (signal.SIGINT, signal.SIGTERM)}
    if hasattr(signal, "SIGHUP") and callable(signal.getsignal(signal.SIGHUP)):
        # without its terminal it cannot show messages: it ends at once, and the flight with it
        before[signal.SIGHUP] = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _FlightServer:
    """The side of the flight process: flies, and sends messages without blocking the loop."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._lock = threading.Lock()
        self._answers: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._keys: queue.SimpleQueue[str] = queue.SimpleQueue()

    def run(self) -> None:
        request: FlightRequest = self._pipe.recv()
        threading.Thread(target=self._listen, name="caller", daemon=True).start()
        callbacks = FlightCallbacks(
            confirm=self._confirm if request.confirm else None,
            on_snapshot=lambda snapshot: self._send("snapshot", snapshot),
            on_event=lambda event: self._send("event", event),
        )
        try:
            result = fly(
                request.flight_plan,
                request.fleet,
                request.folder,
                request.options,
                callbacks,
                key_queue=self._keys,
            )
        except SwarmError as error:
            self._send("error", error)
        except Exception:
            self._send("bug", traceback.format_exc())
        else:
            self._send("result", result)

    def _send(self, kind: str, content: Any) -> None:
        with self._lock, suppress(OSError):
            self._pipe.send((kind, content))

    def _confirm(self, audit: Audit) -> bool:
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
                    self._keys.put(content)
        self._answers.put(False)


def main() -> None:
    """Fly the request that arrives over the pipe whose descriptor is the first argument."""
    die_with_parent()
    raise_priority()
    with Connection(int(sys.argv[1])) as pipe:
        _FlightServer(pipe).run()


if __name__ == "__main__":
    main()
