"""Many trials at once: on this machine's cores, or on a Dask cluster."""

import functools
import gc
import os
import signal
import sys
import threading
import warnings
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import Any

from joblib import Parallel, delayed, parallel_config

from swarm.errors import SwarmError
from swarm.flight.flight_plan import FlightPlan
from swarm.simulation.loop import Fault
from swarm.simulation.monte_carlo.spread import Spread
from swarm.simulation.monte_carlo.trial import Trial, fly_trial


def fly_trials(
    flight_plan: FlightPlan,
    spread: Spread,
    *,
    seed: int,
    trials: Iterable[int],
    faults: Sequence[Fault] = (),
    jobs: int | None = None,
    scheduler: str | None = None,
    open_loop: bool = False,
) -> Generator[Trial, None, None]:
    """Fly trials in parallel; yields each as soon as it is done, in no order.

    ``jobs`` processes of this machine (None: as many as it has cores), or the workers of the Dask
    cluster whose ``scheduler`` is given (tcp://host:port). ``open_loop`` trials keep the planned
    pace whatever comes near. Closing the iterator ends what is being flown. Raises
    :class:`SwarmError` where the cluster's packages are missing or it is not there.
    """
    if scheduler is None and processes(jobs) == 1:
        for trial in trials:
            yield fly_trial(flight_plan, spread, seed, trial, faults=faults, open_loop=open_loop)[0]
        return
    if scheduler is None:
        with parallel_config(backend="loky", n_jobs=processes(jobs)):
            yield from _parallel(flight_plan, spread, seed, trials, faults, open_loop)
        return
    with _cluster(scheduler), parallel_config(backend="dask"):
        yield from _parallel(flight_plan, spread, seed, trials, faults, open_loop)


def processes(jobs: int | None) -> int:
    """Return how many processes of this machine share the work; None: as many as it has cores."""
    return jobs or os.cpu_count() or 1


@contextmanager
def workers_starting(jobs: int | None) -> Iterator[None]:
    """Have the processes of :func:`fly_trials` start, and load what a trial needs, meanwhile.

    That takes three seconds of a core each: while a plan is made there is one that has nothing to
    do. An interrupt is the parent's to answer, so they begin with interrupts ignored.
    """
    count = processes(jobs)
    if count == 1 or threading.current_thread() is not threading.main_thread():
        yield
        return
    answer = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with parallel_config(backend="loky", n_jobs=count):
            work = Parallel(return_as="generator_unordered")
            starting = work(delayed(_keep_what_is_loaded)() for _ in range(count))
    finally:
        signal.signal(signal.SIGINT, answer)
    try:
        yield
        for _ in starting:
            pass
    finally:
        _end(starting)


def _cluster(scheduler: str) -> AbstractContextManager[Any]:
    """Return a client of the Dask cluster whose scheduler is given."""
    # Dask takes any package named snappy for the compressor; knot theorists have SnapPy, which
    # is none, and importing Dask would fail.
    known = sys.modules.get("snappy")
    sys.modules["snappy"] = None  # type: ignore[assignment]
    try:
        from distributed import Client  # noqa: PLC0415 - an optional extra
    except ImportError:
        raise SwarmError(
            "trials on a cluster need more packages: pip install 'swarm-ground-station[cluster]'"
        ) from None
    finally:
        if known is None:
            del sys.modules["snappy"]
        else:
            sys.modules["snappy"] = known
    try:
        client: AbstractContextManager[Any] = Client(scheduler, timeout=10)
    except (OSError, ValueError) as error:
        raise SwarmError(f"no Dask scheduler at {scheduler}: {error}") from None
    return client


def _parallel(
    flight_plan: FlightPlan,
    spread: Spread,
    seed: int,
    trials: Iterable[int],
    faults: Sequence[Fault],
    open_loop: bool,
) -> Generator[Trial, None, None]:
    work = Parallel(return_as="generator_unordered")
    done = work(
        delayed(_in_worker)(flight_plan, spread, seed, trial, faults, open_loop) for trial in trials
    )
    try:
        yield from done
    finally:
        _end(done)


def _end(work: Generator[Any, None, None]) -> None:
    """End what workers still do, which whoever interrupts it knows."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "[0-9]+ tasks ", UserWarning)
        work.close()


@functools.cache
def _keep_what_is_loaded() -> None:
    """Have Python no longer look through what is loaded for what nobody uses, and less often.

    That takes a tenth of a second, in every other trial. What a trial leaves behind is looked
    through when it ends.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 10, 10)


def _in_worker(
    flight_plan: FlightPlan,
    spread: Spread,
    seed: int,
    trial: int,
    faults: Sequence[Fault],
    open_loop: bool,
) -> Trial:
    """One trial in a worker: an interrupt is the parent's to answer."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    _keep_what_is_loaded()
    flown = fly_trial(flight_plan, spread, seed, trial, faults=faults, open_loop=open_loop)[0]
    # A flight's parts know each other: few objects, which Python is in no hurry to look through,
    # and large arrays.
    gc.collect()
    return flown
