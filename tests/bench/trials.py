"""Processor time and memory per trial of the overhand.

The time of ten million additions is printed as well, because a busy machine is slow, and a Python
built without --enable-optimizations takes a third longer. Run: ``python -m tests.bench.trials [trials]``.
"""

import resource
import sys
import time
from pathlib import Path

from swarm import planner
from swarm.mission import parse_mission
from swarm.simulation.spread import Spread
from swarm.simulation.trials import fly_trial

BUDGET = 2.4
"""Seconds of a core per trial: 200 of them in four minutes on two cores."""


def speed() -> float:
    """Return the processor time of ten million additions, seconds."""
    began, total = time.process_time(), 0
    for number in range(10_000_000):
        total += number
    return time.process_time() - began


def main() -> None:
    """Fly trials one after the other and print the time and memory of each."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    path = Path(__file__).parents[2] / "missions" / "overhand.yaml"
    flight_plan = planner.plan(
        parse_mission(path.read_text(), str(path)), robustness=False
    ).certified()
    for number in range(count):
        began = time.process_time()
        trial, _ = fly_trial(flight_plan, Spread(failing=0), 1, number)
        took = time.process_time() - began
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(
            f"trial {number}: {took:.1f} s for {trial.duration:.0f} s of flight "
            f"({took / BUDGET:.1f} × the budget), {memory:.0f} MB; "
            f"ten million additions take {speed():.2f} s"
        )


if __name__ == "__main__":
    main()
