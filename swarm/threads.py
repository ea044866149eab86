"""Independent computations on several cores: compiled functions release the lock of Python."""

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, nullcontext
from functools import cache, wraps
from typing import Any, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

_MOST = 4
"""Most threads: what is not compiled runs in one of them at a time, a fifth of the swings' work."""

_AHEAD = 2
"""Results for each thread that are computed ahead of the one that is used, which bounds memory."""

_THIS = threading.local()
"""What is known of the current thread: whether its work is one of several ``side_by_side``."""


def side_by_side(
    function: Callable[[Item], Result], items: Iterable[Item], *, threads: int | None = None
) -> Iterator[Result]:
    """Yield the results for all items in their order; the next ones are computed meanwhile.

    ``threads`` at a time, by default as many as this process has cores, at most four. With one
    thread each result is computed when it is asked for.
    """
    threads = usual_threads() if threads is None else threads
    if threads < 2:
        yield from map(function, items)
        return
    pending: deque[Future[Result]] = deque()
    with _pool(threads) as pool:
        try:
            for item in items:
                pending.append(pool.submit(function, item))
                if len(pending) > _AHEAD * threads:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()
            wait(pending)


def both(first: Callable[[], Item], second: Callable[[], Result]) -> tuple[Item, Result]:
    """Return the results of two computations, side by side."""
    tasks: tuple[Callable[[], Any], ...] = first, second
    outcome, other = side_by_side(lambda task: task(), tasks)
    return outcome, other


def once(function: Callable[[], Result]) -> Callable[[], Result]:
    """Return a function whose result is computed by one thread; others that ask for it wait."""
    lock, kept = threading.Lock(), cache(function)

    @wraps(function)
    def computed() -> Result:
        with lock:
            return kept()

    return computed


def usual_threads() -> int:
    """Return the number of cores that this process may use, at most four."""
    if hasattr(os, "sched_getaffinity"):
        return min(len(os.sched_getaffinity(0)), _MOST)
    return min(os.cpu_count() or 1, _MOST)


def _pool(threads: int) -> AbstractContextManager[ThreadPoolExecutor]:
    """Return a pool of threads: the kept one, but within other work side by side a pool of its own.

    Work that waits in all of its pool's threads for more work there would never end.
    """
    if getattr(_THIS, "works", False):
        return ThreadPoolExecutor(threads, initializer=_mark)
    return nullcontext(_kept_pool(threads))


@cache
def _kept_pool(threads: int) -> ThreadPoolExecutor:
    """Return the pool that a process keeps: to start two threads takes as long as the missed
    margins of ten teams, which an elastic band needs a thousand times."""
    return ThreadPoolExecutor(threads, initializer=_mark)


def _mark() -> None:
    _THIS.works = True


if hasattr(os, "register_at_fork"):
    # a forked process has none of the threads, and would wait for them
    os.register_at_fork(after_in_child=_kept_pool.cache_clear)
