"""How far the cable of the default missions swings, against the tube: ``python -m tests.bench.swing``.

Plans each mission, flies its motion with vehicles exactly on it, and prints the largest stray of
independent lumped masses (48 links, half the step) from the catenary, the share of moments at which
every strand is inside the tube, and what remains of the clearance budget. ``swarm rope`` states the
stray of the rope of bodies (MuJoCo).
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from swarm import planner
from swarm.certification.swing_tube import swing_tube
from swarm.geometry.lumped_mass import cable_model, stray, swing
from swarm.mission import parse_mission
from swarm.planning import Plan

MISSIONS = Path(__file__).parents[2] / "missions"

REQUIRED = {"overhand": 0.06, "figure_eight": 0.08, "carrick_mat": 0.12}
"""Largest strays that were asked for, metres."""

LINKS, STEP, EVERY = 48, 0.005, 20


def independent_strays(plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    """Return mission times (k,) of fold and hold, and strays (k, n − 1) of finer lumped masses."""
    cable, lengths = plan.mission.cable, plan.layout.lengths
    model = replace(cable_model(cable.mass_per_length, cable.diameter), links=LINKS, step=STEP)
    times = np.arange(plan.phase("fold").start, plan.phase("hold").end, STEP)
    ends = plan.motion.at(times)[0]
    return times[::EVERY], stray(swing(ends, lengths, model, EVERY), ends[::EVERY], lengths)


def main() -> None:
    """Print one line for each mission."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(REQUIRED))
    given = parser.parse_args()
    for name in given.names:
        mission = parse_mission((MISSIONS / f"{name}.yaml").read_text(encoding="utf-8"), name)
        planned = planner.plan(mission, robustness=False)
        plan, tube = planned.plan, swing_tube(planned.plan)
        assert tube is not None
        times, strays = independent_strays(plan)
        allowed = np.array([tube.strands(float(time)) for time in times])
        inside = float((strays <= allowed).all(axis=1).mean())
        fold, rows = plan.phase("fold"), planned.assessment.budget
        print(
            f"{name}: stray {strays.max():.3f} m ({REQUIRED.get(name, np.nan):.2f} m asked), inside "
            f"the tube at {inside:.1%} of {len(times)} moments, after changes of the rate up to "
            f"{max(tube.changed.values()):.3f} m; budget {min(row.remaining for row in rows):+.3f} m; "
            f"cable {plan.layout.lengths.sum():.1f} m, fold {fold.end - fold.start:.1f} s; "
            f"cleared: {planned.certificate.cleared}",
            flush=True,
        )


if __name__ == "__main__":
    main()
