"""The flight in a process of its own: whatever its caller draws, writes or waits for.

:func:`fly_in_process` is :func:`swarm.ground.fly.fly` in another process. Snapshots, events and the
question before the flight come back over a pipe; what the caller does not take in time is dropped
over there. The process dies with its caller, as if it were one.
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
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType
from typing import Any

from swarm.errors import SwarmError, VehicleError
from swarm.flight.clearance import Audit
from swarm.flight.flight_plan import FlightPlan
from swarm.flight.result import FlightResult
from swarm.flight.resuming import LeftOff, Then
from swarm.flight.snapshot import Event, Snapshot
from swarm.ground.child import die_with_parent
from swarm.ground.fly import fly
from swarm.ground.operator import keys
from swarm.ground.priority import lowered_priority, raise_priority, run_behind_main_thread
from swarm.mission.fleet import Fleet

_POLL = 0.05


@dataclass(frozen=True)
class FlightRequest:
    """What is to be flown, as it is handed to the process."""

    flight_plan: FlightPlan
    fleet: Fleet
    folder: Path
    speed: float = 1.0
    no_cable: bool = False
    control: Path | None = None
    asks: bool = False
    audit: bool | None = None
    left: LeftOff | None = None
    then: Then = "hold"


def fly_in_process(
    flight: FlightRequest,
    *,
    confirm: Callable[[Audit], bool] | None = None,
    on_snapshot: Callable[[Snapshot], None] | None = None,
    on_event: Callable[[Event], None] | None = None,
    take_keys: bool = False,
    gives_way: bool = False,
) -> FlightResult:
    """Fly in a process of its own; callbacks are called here, and may be slow.

    The same as :func:`swarm.ground.fly.fly` otherwise; raises what that raises, and
    :class:`VehicleError` where the process ends before the flight does. SIGINT and SIGTERM are
    passed on: the first lands the team after a hold, the second at once. A caller that
    ``gives_way`` runs behind the flight meanwhile.
    """
    ours, theirs = socket.socketpair()
    process = subprocess.Popen(  # noqa: S603
        [sys.executable, "-m", "swarm.ground.flight_process", str(theirs.fileno())],
        pass_fds=[theirs.fileno()],
        stdin=subprocess.DEVNULL,
        start_new_session=True,
    )
    theirs.close()
    pipe = Connection(ours.detach())
    asking = threading.Event()
    try:
        with ExitStack() as around:
            around.enter_context(lowered_priority() if gives_way else nullcontext())
            around.enter_context(_passed_on(process, asking))
            pipe.send(flight)
            desk = _Typed(pipe)
            poll = around.enter_context(keys(desk)) if take_keys else lambda: None
            inbox = _Inbox(pipe)
            while True:
                while (came := inbox.take(_POLL)) is None:
                    poll()
                kind, what = came
                if kind == "end":
                    raise EOFError
                if kind == "result":
                    result: FlightResult = what
                    return result
                if kind == "error":
                    raise what
                if kind == "bug":
                    raise RuntimeError(f"in the flight's process:\n{what}")
                if kind == "snapshot" and on_snapshot is not None:
                    on_snapshot(what)
                elif kind == "event" and on_event is not None:
                    on_event(what)
                elif kind == "confirm":
                    pipe.send(("answer", _answered(confirm, what, asking)))
                poll()
    except (EOFError, BrokenPipeError, ConnectionResetError):
        code = process.wait(5.0)
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        raise VehicleError(f"the flight's process ended ({how})") from None
    finally:
        pipe.close()
        with suppress(subprocess.TimeoutExpired):
            process.wait(10.0)
        if process.poll() is None:
            process.kill()
            process.wait()


def _answered(
    confirm: Callable[[Audit], bool] | None, audit: Audit, asking: threading.Event
) -> bool:
    if confirm is None:
        return True
    asking.set()
    try:
        return confirm(audit)
    except KeyboardInterrupt:
        return False
    finally:
        asking.clear()


class _Inbox:
    """Takes what comes as it comes, in a thread, so that the flight never waits for its caller.

    Of snapshots only the newest is kept; everything else is kept in order.
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
                kind, what = self._pipe.recv()
                if kind != "snapshot":
                    self._waiting.put((kind, what))
                    continue
                with self._lock:
                    if not self._newest:
                        self._waiting.put((kind, None))
                    self._newest = [what]
        self._waiting.put(("end", None))

    def take(self, patience: float) -> tuple[str, Any] | None:
        """Return what came next; None where nothing did for so many seconds."""
        with suppress(queue.Empty):
            kind, what = self._waiting.get(timeout=patience)
            if kind == "snapshot":
                with self._lock:
                    (what,), self._newest = self._newest, []
            return kind, what
        return None


@dataclass
class _Typed:
    """Stands for the desk on this side: keys go over the pipe."""

    pipe: Connection

    def key(self, key: str) -> str | None:
        """Hand a key over."""
        self.pipe.send(("key", key))
        return None


@contextmanager
def _passed_on(process: "subprocess.Popen[bytes]", asking: threading.Event) -> Iterator[None]:
    """Pass signals on to the flight, where this is the main thread; a question is given up."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def catch(number: int, _frame: FrameType | None) -> None:
        process.send_signal(number)
        if asking.is_set():
            raise KeyboardInterrupt

    before = {number: signal.signal(number, catch) for number in (signal.SIGINT, signal.SIGTERM)}
    if hasattr(signal, "SIGHUP") and callable(signal.getsignal(signal.SIGHUP)):
        # Without its terminal it can tell nobody anything: it ends on the spot, and the flight.
        before[signal.SIGHUP] = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _Pilot:
    """The other side: flies, and speaks to the caller without waiting for it in the loop."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._lock = threading.Lock()
        self._answers: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._keys: queue.SimpleQueue[str] = queue.SimpleQueue()

    def run(self) -> None:
        flight: FlightRequest = self._pipe.recv()
        threading.Thread(target=self._listen, name="caller", daemon=True).start()
        names = ("speed", "no_cable", "control", "audit", "left", "then")
        given = {name: getattr(flight, name) for name in names}
        try:
            result = fly(
                flight.flight_plan,
                flight.fleet,
                flight.folder,
                confirm=self._confirm if flight.asks else None,
                on_snapshot=lambda snapshot: self._tell("snapshot", snapshot),
                on_event=lambda event: self._tell("event", event),
                typed=self._keys,
                **given,
            )
        except SwarmError as error:
            self._tell("error", error)
        except Exception:
            self._tell("bug", traceback.format_exc())
        else:
            self._tell("result", result)

    def _tell(self, kind: str, what: Any) -> None:
        with self._lock, suppress(OSError):
            self._pipe.send((kind, what))

    def _confirm(self, audit: Audit) -> bool:
        self._tell("confirm", audit)
        return self._answers.get()

    def _listen(self) -> None:
        run_behind_main_thread()
        with suppress(EOFError, OSError):
            while True:
                kind, what = self._pipe.recv()
                if kind == "answer":
                    self._answers.put(what)
                elif kind == "key":
                    self._keys.put(what)
        self._answers.put(False)


def main() -> None:
    """Fly what comes over the pipe whose descriptor is the first argument."""
    die_with_parent()
    raise_priority()
    with Connection(int(sys.argv[1])) as pipe:
        _Pilot(pipe).run()


if __name__ == "__main__":
    main()
