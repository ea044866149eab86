"""Trials in parallel, on the cores of this machine or on a Dask cluster."""

import functools
import gc
import signal
import threading
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from joblib import Parallel, delayed, parallel_config

from swarm.flight.flight_plan import FlightPlan
from swarm.flight.result import FlightResult
from swarm.flight.setup import FlightOptions
from swarm.simulation.loop import Fault
from swarm.simulation.monte_carlo.spread import Spread
from swarm.simulation.monte_carlo.trial import Trial, fly_trial
from swarm.simulation.workers import parallel_workers, process_count

FlyTrial = Callable[[int], tuple[Trial, FlightResult]]
"""Flies the trial of a number."""


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
    """Yield trials as they complete, in any order.

    They run in ``jobs`` processes of this machine (None: one per core), or on the workers of the
    Dask cluster at ``scheduler`` (tcp://host:port). ``open_loop`` is as in
    :class:`swarm.flight.setup.FlightOptions`. Closing the iterator aborts the running trials.
    Raises :class:`SwarmError` where the cluster's packages are missing or its scheduler does not
    answer.
    """
    options = FlightOptions(open_loop=open_loop)
    fly = functools.partial(fly_trial, flight_plan, spread, seed, faults=faults, options=options)
    if scheduler is None and process_count(jobs) == 1:
        for trial in trials:
            yield fly(trial)[0]
        return
    with parallel_workers(jobs, scheduler):
        yield from _parallel(fly, trials)


@contextmanager
def workers_starting(jobs: int | None) -> Iterator[None]:
    """Start the processes of :func:`fly_trials` in the background and load their modules.

    A process takes three seconds of a core to start; planning leaves a core idle. The processes
    ignore interrupts, which the parent process handles.
    """
    count = process_count(jobs)
    if count == 1 or threading.current_thread() is not threading.main_thread():
        yield
        return
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with parallel_config(backend="loky", n_jobs=count):
            parallel = Parallel(return_as="generator_unordered")
            starting = parallel(delayed(_freeze_loaded_objects)() for _ in range(count))
    finally:
        signal.signal(signal.SIGINT, handler)
    try:
        yield
        for _ in starting:
            pass
    finally:
        _close(starting)


def _parallel(fly: FlyTrial, trials: Iterable[int]) -> Generator[Trial, None, None]:
    parallel = Parallel(return_as="generator_unordered")
    results = parallel(delayed(_fly_in_worker)(fly, trial) for trial in trials)
    try:
        yield from results
    finally:
        _close(results)


def _close(results: Generator[Any, None, None]) -> None:
    """Abort the running tasks, without joblib's warning about them."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "[0-9]+ tasks ", UserWarning)
        results.close()


@functools.cache
def _freeze_loaded_objects() -> None:
    """Exclude the loaded modules from garbage collection, and collect less often.

    A full collection takes a tenth of a second, in every other trial.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 10, 10)


def _fly_in_worker(fly: FlyTrial, trial: int) -> Trial:
    """Return one trial; interrupts are ignored, because the parent process handles them."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    _freeze_loaded_objects()
    result = fly(trial)[0]
    # The objects of a flight refer to each other in cycles and hold large arrays.
    gc.collect()
    return result
