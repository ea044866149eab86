"""The Python API in one short script: read a mission, plan it, check it, draw it, fly it.

    python missions/tour.py [MISSION.yaml] [FOLDER]

``docs/walkthrough.md`` goes through these functions one by one.
"""

import sys
from pathlib import Path

import swarm

HERE = Path(__file__).parent


def main(mission_file: Path, folder: Path) -> None:
    """Plan, certify, draw and simulate a mission; pictures and motion go into a folder."""
    plan = swarm.plan(swarm.load(mission_file))
    certificate = swarm.certify(plan)
    print(plan, certificate, sep="\n")
    for moment in certificate.tightest:
        what = " and ".join(moment.between)
        print(f"{moment.check}: {what}, {moment.distance:.2f} m at {moment.time:.0f} s")

    plan.save(folder / "mission.plan")
    plan.to_csv(folder / "motion.csv")
    plan.plot().savefig(folder / "plan.png")
    plan.plot("schedule").savefig(folder / "schedule.png")

    flight = swarm.simulate(swarm.load_plan(folder / "mission.plan"), certificate, seed=1)
    print(flight)
    flight.plot().savefig(folder / "flight.png")


if __name__ == "__main__":
    given = [Path(word) for word in sys.argv[1:]]
    try:
        main(*(given + [HERE / "overhand.yaml", Path()][len(given) :]))
    except swarm.SwarmError as error:
        sys.exit(f"{error}")
