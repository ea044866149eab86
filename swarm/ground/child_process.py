"""A child process that exchanges pickled messages over a pipe, and ends with its parent.

For libraries that may crash or hang: a crash or a hang becomes an exception in this process.
"""

import ctypes
import signal
import socket
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from swarm.child_modules import module_command

_SET_PARENT_DEATH_SIGNAL = 1
_EXIT_TIMEOUT = 0.5
"""Seconds within which a child must exit by itself once its pipe is closed."""


class ChildError(Exception):
    """A child process ended or stopped responding; the text is the reason."""


class ChildProcess:
    """A module that runs by itself and gets the descriptor of its pipe as argument."""

    def __init__(self, module: str) -> None:
        ours, theirs = socket.socketpair()
        self._process = subprocess.Popen(  # noqa: S603
            module_command(module, str(theirs.fileno())),
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        theirs.close()
        self._pipe = Connection(ours.detach())

    def send(self, message: Any) -> None:
        """Send a message; :meth:`receive` reports a child that has ended."""
        with suppress(OSError):
            self._pipe.send(message)

    def receive(self, timeout: float) -> Iterator[Any]:
        """Yield the next message, if one arrives within ``timeout`` seconds.

        Raises :class:`ChildError` if the process has ended.
        """
        try:
            if self._pipe.poll(timeout):
                yield self._pipe.recv()
        except (EOFError, OSError):
            raise ChildError(f"its process ended ({self._end()})") from None

    def _end(self) -> str:
        try:
            code = self._process.wait(_EXIT_TIMEOUT)
        except subprocess.TimeoutExpired:
            return "it closed its pipe"
        return exit_reason(code)

    def close(self) -> None:
        """End the process: by closing its pipe, then by force."""
        self._pipe.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_EXIT_TIMEOUT)
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()


class RestartedProcess:
    """A child process that is started again where it ends; each gets ``first`` as first message."""

    def __init__(self, module: str, first: Any) -> None:
        self._module, self._first = module, first
        self._start()

    def _start(self) -> None:
        self._child = ChildProcess(self._module)
        self._child.send(self._first)

    def receive(self, timeout: float) -> Iterator[Any]:
        """Yield the next message, and raise, as :meth:`ChildProcess.receive`."""
        return self._child.receive(timeout)

    def arrived(self) -> Iterator[Any]:
        """Yield the messages that have arrived.

        Raises :class:`ChildError` where the process has ended; then another one was started.
        """
        try:
            while (message := next(self._child.receive(0.0), None)) is not None:
                yield message
        except ChildError:
            self._child.close()
            self._start()
            raise

    def close(self) -> None:
        """End the process."""
        self._child.close()


def exit_reason(code: int) -> str:
    """Return a return code of :mod:`subprocess` as text: a signal or an exit code."""
    return f"signal {-code}" if code < 0 else f"exit code {code}"


def die_with_parent() -> None:
    """Have this process killed when its parent ends, on systems that support it."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGKILL)
