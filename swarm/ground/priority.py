"""Real-time priority for the flight, where the system permits it."""

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

PRIORITY = 10
_BEHIND = 5
_BEHIND_ALL = 10
"""By how much nicer what helps a flight is: drawing, waiting for a person."""
_NICEST = 19
_SWITCH_INTERVAL = 0.0001


def settle() -> None:
    """Look through what Python keeps for garbage now, and never again; let threads take turns."""
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(_SWITCH_INTERVAL)


def prefer(priority: int = PRIORITY) -> bool:
    """Give the calling thread a real-time priority, where permitted; return whether it was.

    Processes and threads that begin later do not inherit it. Permitted or not, it settles.
    """
    settle()
    try:
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except (OSError, AttributeError):
        return False
    return True


def follow() -> None:
    """Go right behind the main thread where that has real-time priority.

    For threads that do little: while one of them holds the interpreter and other programs hold the
    processor, the flight's loop would wait for both.
    """
    with suppress(OSError, AttributeError):
        if os.sched_getscheduler(os.getpid()) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO:
            ahead = os.sched_getparam(os.getpid()).sched_priority
            policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(0, policy, os.sched_param(max(1, ahead - _BEHIND)))


def _niceness() -> int:
    return os.getpriority(os.PRIO_PROCESS, 0) if hasattr(os, "getpriority") else 0


_BEFORE = _niceness()


def behind_all() -> int:
    """Return the niceness of what helps a flight that is as nice as this program when it began."""
    return min(_BEFORE + _BEHIND_ALL, _NICEST)


def give_way(process: int = 0, to: int | None = None) -> None:
    """Let a process that draws or waits (0: this one) run behind the flight's, as nice as ``to``
    (None: :func:`behind_all`).

    Where the flight has no real-time priority this is what keeps it ahead of its own helpers.
    Processes that it begins later run behind, too. It stays so where the system does not permit
    to be less nice again.
    """
    with suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, process, behind_all() if to is None else to)


@contextmanager
def giving_way() -> Iterator[None]:
    """Run behind the flight for a while."""
    before = _niceness()
    give_way()
    try:
        yield
    finally:
        give_way(to=before)
