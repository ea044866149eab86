"""Start a Dask cluster of two workers on this machine, and print the address of its scheduler.

    python missions/cluster.py &
    swarm trials missions/overhand.yaml --scheduler tcp://127.0.0.1:8786

Needs the extra `cluster`. It ends with Ctrl-C. On several machines, `dask scheduler` on one of them
and `dask worker tcp://HOST:8786 --nthreads 1` on each do the same; all need this program.
"""

import argparse
import signal
import sys
import threading

sys.modules["snappy"] = None  # Dask takes SnapPy, a program of knot theory, for a compressor

from distributed import LocalCluster  # noqa: E402 - after the line above


def main() -> None:
    """Run the cluster until it is interrupted."""
    parser = argparse.ArgumentParser(description="A Dask cluster on this machine.")
    parser.add_argument("--port", type=int, default=8786, help="port of the scheduler; 0: any")
    parser.add_argument("--workers", type=int, default=2, help="number of workers")
    given = parser.parse_args()
    with LocalCluster(
        n_workers=given.workers,
        threads_per_worker=1,  # the loops of a flight hold Python's lock
        host="127.0.0.1",
        scheduler_port=given.port,
        dashboard_address=None,
    ) as cluster:
        stopped = threading.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: stopped.set())
        print(cluster.scheduler_address, flush=True)
        stopped.wait()


if __name__ == "__main__":
    main()
