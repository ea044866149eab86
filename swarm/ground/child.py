"""A child process that speaks pickled messages over a pipe, and ends with its parent.

For libraries that may crash or hang: whatever they do, it is an exception here and nothing more.
"""

import ctypes
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

_SET_PARENT_DEATH_SIGNAL = 1
_LAST_WORDS = 0.5
"""Seconds that a child has to end by itself when it is told to."""


class ChildError(Exception):
    """A child process ended, or was silent for too long; the text says how."""


class Child:
    """The process of a module that is run with ``python -m`` and the pipe's descriptor."""

    def __init__(self, module: str) -> None:
        ours, theirs = socket.socketpair()
        self._process = subprocess.Popen(  # noqa: S603
            [sys.executable, "-m", module, str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        theirs.close()
        self._pipe = Connection(ours.detach())

    def send(self, message: Any) -> None:
        """Send a message; a child that is gone shows when it is listened to."""
        with suppress(OSError):
            self._pipe.send(message)

    def received(self, patience: float) -> Iterator[Any]:
        """Yield the message that comes within so many seconds, or nothing.

        Raises :class:`ChildError` where the process has ended.
        """
        try:
            if self._pipe.poll(patience):
                yield self._pipe.recv()
        except (EOFError, OSError):
            raise ChildError(f"its process ended ({self._how()})") from None

    def _how(self) -> str:
        try:
            code = self._process.wait(_LAST_WORDS)
        except subprocess.TimeoutExpired:
            return "it closed its pipe"
        return f"signal {-code}" if code < 0 else f"exit code {code}"

    def close(self) -> None:
        """End the process, whatever it does."""
        self._pipe.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_LAST_WORDS)
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()


def die_with_parent() -> None:
    """End this process when its parent ends, where the system knows how."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGKILL)
