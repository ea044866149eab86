"""Real-time priority for the flight, where the system permits it."""

import gc
import os
import sys
from contextlib import suppress

PRIORITY = 10
_BEHIND = 5
_SWITCH_INTERVAL = 0.0005


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
