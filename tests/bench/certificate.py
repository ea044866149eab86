"""Computing time of certificates, and their sharpness against a random search.

Usage: ``python tests/bench/certificate.py [MISSION …]`` (default: the overhand). Times are processor
time of one core; sharpness is the certified distance of the tightest strands against the
smallest that random tracking errors, improved step by step, reach.
"""

import sys
import time
from pathlib import Path

import numpy as np

from swarm.certification.assessment import assess
from swarm.certification.clearances import (
    Moment,
    families,
    largest_tracking,
    largest_wind,
    tightest_moments,
)
from swarm.certification.minima import smallest
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.distance import polyline_polyline
from swarm.mission import mission_for_knot, parse_mission
from swarm.planning import Plan
from swarm.planning.candidates import make_plan

FRACTIONS = np.linspace(0.0, 1.0, 101)


def main() -> None:
    """Measure the given missions."""
    for name in sys.argv[1:] or ["overhand"]:
        path = Path(name)
        mission = parse_mission(path.read_text(), name) if path.exists() else mission_for_knot(name)
        started = time.process_time()
        plan = make_plan(mission)
        print(f"{name}: {plan.vehicles} vehicles, {plan.duration:.0f} s of motion, planned in "
              f"{time.process_time() - started:.1f} s")  # fmt: skip
        measure(plan)


def measure(plan: Plan) -> None:
    """Print times per part, and the sharpness."""
    assess(plan)  # tables are computed once per process
    started = time.process_time()
    assessment = assess(plan)
    print(f"  all checks {time.process_time() - started:7.2f} s   cleared: {assessment.cleared}")
    for family in families(plan, plan.mission.vehicles.tracking):
        started = time.process_time()
        count = len(family.names)
        found = smallest(family.evaluate, count, family.roots())
        print(f"  {family.check:<26} {time.process_time() - started:7.2f} s"
              f" {found.boxes:>9} boxes {count:>5} pairs")  # fmt: skip
    for what, find in (("e*", largest_tracking), ("w*", largest_wind)):
        started = time.process_time()
        print(f"  {what} = {find(plan)}, in {time.process_time() - started:.1f} s")
    for moment in tightest_moments(plan, checks=("cable clearance",))[:3]:
        worst = searched(plan, moment)
        print(f"  {moment.between[0]} and {moment.between[1]}: certified {moment.distance:.3f} m, "
              f"smallest found {worst:.3f} m")  # fmt: skip


def searched(plan: Plan, moment: Moment) -> float:
    """Return the smallest distance that a random search finds near a moment."""
    rng = np.random.default_rng(1)
    radius = plan.mission.vehicles.tracking
    i, j = (int(name.split()[1]) - 1 for name in moment.between)
    lengths = plan.layout.lengths

    def distance(times: np.ndarray, errors: np.ndarray) -> np.ndarray:
        grips = plan.motion.at(times)[0][:, [i, i + 1, j, j + 1]] + errors
        one = solve_catenaries(grips[:, 0], grips[:, 1], lengths[i]).points(FRACTIONS)
        other = solve_catenaries(grips[:, 2], grips[:, 3], lengths[j]).points(FRACTIONS)
        return polyline_polyline(one, other).distance - plan.mission.cable.diameter

    time_, error = moment.time, np.zeros((4, 3))
    best = float(distance(np.array([time_]), error[None])[0])
    for step in range(60):
        size = 0.85 ** (step % 30)
        times = time_ + 0.1 * size * rng.normal(size=200)
        errors = error + radius * size * rng.normal(size=(200, 4, 3))
        length = np.linalg.norm(errors, axis=-1, keepdims=True)
        errors *= np.minimum(1.0, radius / np.maximum(length, 1e-12))
        found = distance(times, errors)
        nearest = int(np.argmin(found))
        if found[nearest] < best:
            best, time_, error = float(found[nearest]), times[nearest], errors[nearest]
    return best


if __name__ == "__main__":
    main()
