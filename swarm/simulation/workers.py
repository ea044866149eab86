"""Where parallel work runs: processes of this machine, or the workers of a Dask cluster."""

import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

from joblib import parallel_config
from joblib.externals.loky.process_executor import TerminatedWorkerError

from swarm.errors import SwarmError


def process_count(jobs: int | None) -> int:
    """Return the number of processes on this machine: ``jobs``, or one per core for None."""
    return jobs or os.cpu_count() or 1


@contextmanager
def parallel_workers(jobs: int | None, scheduler: str | None) -> Iterator[None]:
    """Let joblib run in ``jobs`` processes of this machine, or on the cluster at ``scheduler``.

    ``scheduler`` is tcp://host:port. Raises :class:`swarm.errors.SwarmError` where a process of
    this machine is killed, the cluster's packages are missing, or its scheduler does not answer.
    """
    if scheduler is None:
        with parallel_config(backend="loky", n_jobs=process_count(jobs)), warnings.catch_warnings():
            # a process whose memory grew is replaced between tasks, which loses nothing
            warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
            try:
                yield
            except TerminatedWorkerError:
                raise SwarmError(
                    "a worker process was killed (too little memory for as many --jobs?)"
                ) from None
        return
    with _cluster(scheduler), parallel_config(backend="dask"):
        yield


def _cluster(scheduler: str) -> AbstractContextManager[Any]:
    """Return a client of the Dask cluster at an address."""
    # Dask takes every package named snappy for the compressor; SnapPy, the package of knot theory,
    # has the same name, and importing Dask would fail.
    loaded = sys.modules.get("snappy")
    sys.modules["snappy"] = None  # type: ignore[assignment]
    try:
        from distributed import Client  # noqa: PLC0415 - an optional extra
    except ImportError:
        raise SwarmError(
            "work on a cluster needs more packages: pip install 'swarm-ground-station[cluster]'"
        ) from None
    finally:
        if loaded is None:
            del sys.modules["snappy"]
        else:
            sys.modules["snappy"] = loaded
    try:
        client: AbstractContextManager[Any] = Client(scheduler, timeout=10)
    except (OSError, ValueError) as error:
        raise SwarmError(f"no Dask scheduler at {scheduler}: {error}") from None
    return client
