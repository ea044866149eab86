"""The Python API in one short script: read a mission, plan it, check it, draw it, try it.

    python missions/tour.py [MISSION.yaml] [FOLDER]

Everything that the ``swarm`` command does is a function like these; the command is a shell around
them.
"""

import sys
from pathlib import Path

from swarm import api
from swarm.errors import Refused
from swarm.exports import motion_rows
from swarm.mission import parse_mission
from swarm.preflight.robustness import largest_tracking
from swarm.rehearse import rehearse
from swarm.verify import judge
from swarm.view.plots import plot_flight, plot_plan, plot_schedule

HERE = Path(__file__).parent


def main(mission_file: Path, folder: Path) -> None:
    """Plan a mission, certify, draw and rehearse it; pictures and motion go into a folder."""
    mission = parse_mission(mission_file.read_text(), str(mission_file))
    planned = api.plan(mission)
    plan, found = planned.plan, planned.assessment

    print(f"{mission.name}: {plan.vehicles} vehicles, {plan.layout.lengths.sum():.1f} m of cable")
    for finding in found.findings:
        if finding.severity != "info":
            print(f"{finding.severity}: {finding.check}: {finding.message}")
    if plan.vehicles > 3:
        tightest = found.cable
        print(f"cable to cable: {tightest.distance:.2f} m, {tightest.required:.2f} m are required")
        print(f"largest tracking error for which that holds: {largest_tracking(plan)} m")

    plot_plan(plan, folder / "plan.png")
    plot_schedule(plan, folder / "schedule.png")
    (folder / "motion.csv").write_text("\n".join(motion_rows(plan)) + "\n")

    try:
        proven = planned.certified()
    except Refused as refusal:
        print(f"refused, and so it is not flown:\n{refusal}")
        return
    flight = rehearse(proven, seed=1)
    flown = judge(plan, flight.trace)
    print(f"rehearsed: {flight.outcome.word}; reported positions imply {flown.knot}")
    plot_flight(plan, flight.trace, folder / "flight.png")


if __name__ == "__main__":
    given = [Path(word) for word in sys.argv[1:]]
    main(*(given + [HERE / "overhand.yaml", Path()][len(given) :]))
