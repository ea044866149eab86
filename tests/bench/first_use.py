"""What two newcomers wait for: every command of README in a fresh clone, with an empty cache.

    python -m tests.bench.first_use [student|engineer] [FOLDER]

The student has three drones and follows README from the first command to a mission of the own
vehicles. The engineer flies a reviewed plan beside QGroundControl and takes the flight to Foxglove
and PlotJuggler. Prints wall and processor time of every step and its exit code; the time for reading
is not in it.
Needs a package index, and an idle machine where wall times are to be quoted.
"""

import os
import resource
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
INSTALL = ("python3 -m venv .venv", ".venv/bin/pip install --quiet --no-compile .")
WALKS = {
    "student": (
        *INSTALL,
        "swarm fly missions/overhand.yaml --speed 4 --yes --record first",
        "swarm plan missions/first-steps/pass_over.yaml --report pass_over.html",
        "swarm dry-run missions/first-steps/pass_over.yaml",
        "swarm fly missions/first-steps/pass_over.yaml --speed 4 --yes --record second",
        "swarm init figure-eight --vehicles crazyflie-like --output mine.yaml",
        "swarm plan mine.yaml",
    ),
    "engineer": (
        *INSTALL,
        "swarm plan missions/overhand.yaml --save overhand.plan --report plan.html",
        "swarm dry-run overhand.plan",
        "swarm fly overhand.plan --speed 4 --yes --record flight --forward udp://127.0.0.1:{port}",
        "swarm verify flight --plan overhand.plan",
        "swarm export flight --output flight.mcap",
        "swarm export flight --output flight.parquet",
    ),
}


def walk(name: str, folder: Path) -> bool:
    """Take every step of a newcomer in a clone in ``folder``; return whether all exited with 0."""
    subprocess.run(["git", "clone", "--quiet", ROOT, folder], check=True)
    path = f"{folder / '.venv' / 'bin'}:{os.environ['PATH']}"
    environment = {k: v for k, v in os.environ.items() if k not in {"PYTHONPATH", "SWARM_PLANS"}}
    environment |= {"PATH": path, "XDG_CACHE_HOME": str(folder / ".cache")}
    total, done = 0.0, True
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", 0))
        for step in WALKS[name]:
            command = step.format(port=station.getsockname()[1]).split()
            began, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
            ended = subprocess.run(
                command, cwd=folder, env=environment, capture_output=True, text=True, check=False
            )
            took, after = time.monotonic() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
            total += took
            done &= ended.returncode == 0
            print(
                f"{took:6.1f} s  {after.ru_utime - before.ru_utime:6.1f} s of a processor  "
                f"exit {ended.returncode}  {' '.join(command)}",
                flush=True,
            )
            if ended.returncode:
                print(*ended.stderr.strip().splitlines()[-2:], sep="\n")
    print(f"{name}: {total / 60:.1f} min of waiting; load of the machine {os.getloadavg()[0]:.1f}")
    return done


def main(name: str | None = None, folder: str | None = None) -> int:
    """Take the walks; return the exit code: 1 where a step failed."""
    with tempfile.TemporaryDirectory(prefix="swarm-first-use-") as scratch:
        names = [name] if name else list(WALKS)
        return int([walk(one, Path(folder or scratch, one)) for one in names].count(False) > 0)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
