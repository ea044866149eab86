"""Real-time priority for the flight, and lower priority for the programs beside it."""

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

PRIORITY = 10
_BEHIND_MAIN_THREAD = 5
_HELPER_NICENESS = 10
"""Increase of niceness for processes that draw or wait for a person."""
_MAX_NICENESS = 19
_SWITCH_INTERVAL = 0.0001


def configure_interpreter() -> None:
    """Collect garbage now, exclude all present objects from later collections, and shorten the
    interval at which threads take turns."""
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(_SWITCH_INTERVAL)


def raise_priority(priority: int = PRIORITY) -> bool:
    """Give the calling thread a real-time priority; return whether the system permits it.

    Processes and threads that start later do not inherit it. The interpreter is configured
    (:func:`configure_interpreter`) in both cases.
    """
    configure_interpreter()
    try:
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except (OSError, AttributeError):
        return False
    return True


def run_behind_main_thread() -> None:
    """Give the calling thread a priority just below the main thread's, if that is real-time.

    For threads with little work: while such a thread holds the interpreter lock and other programs
    hold the processor, the flight loop would wait for both.
    """
    with suppress(OSError, AttributeError):
        if os.sched_getscheduler(os.getpid()) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO:
            main = os.sched_getparam(os.getpid()).sched_priority
            policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(0, policy, os.sched_param(max(1, main - _BEHIND_MAIN_THREAD)))


def _niceness() -> int:
    return os.getpriority(os.PRIO_PROCESS, 0) if hasattr(os, "getpriority") else 0


_INITIAL = _niceness()


def helper_niceness() -> int:
    """Return the niceness of processes beside the flight, from this program's at its start."""
    return min(_INITIAL + _HELPER_NICENESS, _MAX_NICENESS)


def lower_priority(process: int = 0, niceness: int | None = None) -> None:
    """Set the niceness of a process (0: this one); None stands for :func:`helper_niceness`.

    If the flight has no real-time priority, this keeps it ahead of the processes that draw or
    wait. Child processes that start later inherit it. Some systems do not permit to undo it.
    """
    with suppress(OSError, AttributeError):
        os.setpriority(
            os.PRIO_PROCESS, process, helper_niceness() if niceness is None else niceness
        )


@contextmanager
def lowered_priority() -> Iterator[None]:
    """Run this process at lower priority inside the context."""
    before = _niceness()
    lower_priority()
    try:
        yield
    finally:
        lower_priority(niceness=before)
