"""Speed of a whole simulated flight: ground station and emulator in one process.

Plans a mission, flies it in virtual time and prints flight time over CPU time of one core, without
the planning. The same flight is flown several times; the sum of the shortest time of every tick is
the time on a machine without other load.
Run: ``python tests/bench/simulation.py [mission] [--profile]``.
"""

import cProfile
import pstats
import sys
import time
from pathlib import Path

import numpy as np

from swarm import planner
from swarm.mission import parse_mission
from swarm.simulation.loop import Callbacks, simulate_flight

FLIGHTS = 3


def main() -> None:
    arguments = [word for word in sys.argv[1:] if not word.startswith("-")]
    path = Path(arguments[0] if arguments else "missions/overhand.yaml")
    flight_plan = planner.plan(parse_mission(path.read_text(), str(path))).certified()
    if "--profile" in sys.argv:
        profile = cProfile.Profile()
        profile.runcall(simulate_flight, flight_plan)
        pstats.Stats(profile).sort_stats("tottime").print_stats(40)
        return
    flights = []
    for _ in range(FLIGHTS):
        marks = [time.process_time()]
        result = simulate_flight(
            flight_plan,
            callbacks=Callbacks(on_step=lambda *_, at=marks: at.append(time.process_time())),
        )
        flights.append(np.diff(marks))
        flown, used = result.statistics.duration, float(flights[-1].sum())
        print(
            f"{path.stem}: {result.outcome.word}, {flown:.0f} s flown in {used:.2f} s, "
            f"{flown / used:.0f} × real time on one core"
        )
    shortest = float(np.min(flights, axis=0).sum())
    print(f"shortest time of each tick: {shortest:.2f} s, {flown / shortest:.0f} × real time")


if __name__ == "__main__":
    main()
