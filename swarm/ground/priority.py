"""Real-time priority for the flight, where the system permits it."""

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

PRIORITY = 10
_BEHIND = 5
BEHIND_ALL = 10
"""Niceness of what helps a flight: drawing, waiting for a person."""
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


def give_way(process: int = 0, to: int = BEHIND_ALL) -> None:
    """Let a process that draws or waits (0: this one) run behind the flight's, as nice as ``to``.

    Where the flight has no real-time priority this is what keeps it ahead of its own helpers.
    Processes that it begins later run behind, too. It stays so where the system does not permit
    to be less nice again.
    """
    with suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, process, to)


@contextmanager
def giving_way() -> Iterator[None]:
    """Run behind the flight for a while."""
    before = os.getpriority(os.PRIO_PROCESS, 0)
    give_way()
    try:
        yield
    finally:
        give_way(to=before)
