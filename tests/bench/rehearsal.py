"""How much faster than real time a whole dry run is: ground station and emulator in one process.

Plans a mission, flies it in virtual time and prints flight time over CPU time of one core, without
the planning. Run: ``python tests/bench/rehearsal.py [mission] [--profile]``.
"""

import cProfile
import pstats
import sys
import time
from pathlib import Path

from swarm import api
from swarm.mission import parse_mission
from swarm.rehearse import rehearse


def main() -> None:
    arguments = [word for word in sys.argv[1:] if not word.startswith("-")]
    path = Path(arguments[0] if arguments else "missions/overhand.yaml")
    proven = api.plan(parse_mission(path.read_text(), str(path))).proven()
    profile = cProfile.Profile()
    if "--profile" in sys.argv:
        profile.enable()
    start = time.process_time()
    result = rehearse(proven)
    used = time.process_time() - start
    profile.disable()
    flown = result.trace.time[-1] - result.trace.time[0]
    print(
        f"{path.stem}: {result.outcome.word}, {flown:.0f} s flown in {used:.2f} s, "
        f"{flown / used:.0f} × real time on one core"
    )
    if "--profile" in sys.argv:
        pstats.Stats(profile).sort_stats("tottime").print_stats(40)


if __name__ == "__main__":
    main()
