"""How far the cable of the default missions swings, against the tube: ``python -m tests.bench.swing``.

Plans each mission, flies its motion with vehicles exactly on it, and prints the largest stray of
independent lumped masses (96 links, a quarter of the step or less) from the catenary, the share of moments at which
every strand is inside the tube, and what remains of the clearance budget. With ``--rope`` also those
of the rope with contact (MuJoCo), which takes as long as the fold or longer.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from swarm import planner
from swarm.certification.clearances import PlanChecks
from swarm.certification.swing_tube import SwingTube
from swarm.geometry.lumped_mass import cable_model
from swarm.mission import parse_mission
from swarm.planning import Plan
from swarm.rope import planned_grips, simulate_rope
from tests.geometry.swinging import stray, swing

MISSIONS = Path(__file__).parents[2] / "missions"

REQUIRED = {"overhand": 0.06, "figure_eight": 0.08, "carrick_mat": 0.12}
"""Largest strays that were asked for, metres."""

LINKS, STEP, EVERY = 96, 0.0025, 40


def independent_strays(plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    """Return mission times (k,) of fold and hold, and strays (k, n − 1) of finer lumped masses."""
    cable, lengths = plan.mission.cable, plan.layout.lengths
    model = replace(cable_model(cable.mass_per_length, cable.diameter), links=LINKS, step=STEP)
    times = np.arange(plan.phase("fold").start, plan.phase("hold").end, STEP)
    ends = plan.motion.at(times)[0]
    return times[::EVERY], stray(swing(ends, lengths, model, EVERY), ends[::EVERY], lengths)


def rope_strays(plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    """Return mission times (k,) of fold and hold, and strays (k, n − 1) of the rope in MuJoCo."""
    run = simulate_rope(plan, planned_grips(plan))
    assert not run.invalid, run.invalid
    return run.times, run.deviation


def compared(asked: float, tube: SwingTube, found: tuple[np.ndarray, np.ndarray]) -> str:
    """Return the largest stray beside the one that was asked for, and the share of moments at which all are inside the tube."""
    times, strays = found
    allowed = np.array([tube.ordinary.strands(float(time)) for time in times])
    inside = float((strays <= allowed).all(axis=1).mean())
    return (
        f"{strays.max():.3f} m ({asked:.2f} m asked), inside the tube at {inside:.1%} of "
        f"{len(times)} moments"
    )


def main() -> None:
    """Print one line for each mission."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rope", action="store_true")
    parser.add_argument("names", nargs="*", default=list(REQUIRED))
    given = parser.parse_args()
    for name in given.names:
        mission = parse_mission((MISSIONS / f"{name}.yaml").read_text(encoding="utf-8"), name)
        planned = planner.plan(mission, robustness=False)
        plan, tube = planned.plan, PlanChecks.of(planned.plan).tube
        assert tube is not None
        asked = REQUIRED.get(name, np.nan)
        fold, rows = plan.phase("fold"), planned.assessment.budget
        print(
            f"{name}: stray {compared(asked, tube, independent_strays(plan))}; after changes of "
            f"the rate up to {max(tube.changed.values()):.3f} m; "
            f"budget {min(row.remaining for row in rows):+.3f} m; cable {plan.layout.lengths.sum():.1f} m, fold {fold.end - fold.start:.1f} s; "
            f"cleared: {planned.certificate.cleared}",
            flush=True,
        )
        if given.rope:
            print(f"{name}: rope {compared(asked, tube, rope_strays(plan))}", flush=True)


if __name__ == "__main__":
    main()
