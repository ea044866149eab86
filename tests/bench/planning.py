"""How long plans and their certificates take, how that grows with the team, and what they reach.

Run it: ``python tests/bench/planning.py [KNOT …]`` (default: 3_1 4_1 8_18); ``--growth`` adds torus
knots and sums up to twelve crossings and fits the exponent in the number of vehicles, and that of
the flights themselves. Times are of one core's processor time. Two missions each: the default one, and the line of figures that earlier
work is compared by (cell 1 m, tracking 0, radius 0.1 m, clearances 0.15, 0.8 and 0.8 m).
"""

import sys
import time

import numpy as np

from swarm import planner
from swarm.errors import Refused
from swarm.mission import mission_for_knot

LINE = (
    "layout.cell=1.0",
    "vehicles.tracking=0.0",
    "vehicles.radius=0.1",
    "clearance.cable=0.15",
    "clearance.vehicle=0.8",
    "clearance.downwash=0.8",
)
GROWTH = ("3_1", "4_1", "5_1", "6_1", "7_1", "8_18", "9_1", "10_1", "torus(2,11)", "3_1#9_1")
BUDGET = {"3_1": 6.0, "4_1": 10.0, "8_18": 140.0}
"""Seconds that plan and certificate may take with the default mission: a fifth more than measured on
a busy computer (5.0, 8.2 and 115 s). 8_18 tries every folding in its cells of 1.5 m, since none
closes the clearance budget there."""

REACH = {"3_1": (25.0, 40.0), "4_1": (33.0, 55.0), "8_18": (105.0, 180.0)}
"""Metres of cable and seconds of fold to stay below, on the line of figures."""


def main() -> None:
    """Plan and print."""
    asked = [name for name in sys.argv[1:] if not name.startswith("--")]
    growth = "--growth" in sys.argv[1:]
    measured: list[tuple[int, float, float]] = []
    for name in asked or (GROWTH if growth else tuple(BUDGET)):
        taken = _planned(name, (), BUDGET.get(name))
        if taken is not None:
            measured.append(taken)
        if not growth:
            _planned(name, LINE, None)
    if growth and len(measured) > 2:
        vehicles, seconds, flight = np.log(np.array(measured)).T
        print(
            f"time grows with the number of vehicles to the {np.polyfit(vehicles, seconds, 1)[0]:.2f}"
            f", and what is planned, vehicles times seconds of the fold, to the "
            f"{1.0 + np.polyfit(vehicles, flight, 1)[0]:.2f}"
        )


def _planned(
    name: str, overrides: tuple[str, ...], budget: float | None
) -> tuple[int, float, float] | None:
    begun = time.process_time()
    what = f"{name:<12} {'line' if overrides else 'default':<8}"
    try:
        planned = planner.plan(mission_for_knot(name, overrides), robustness=False)
    except Refused as refusal:
        print(f"{what} refused after {time.process_time() - begun:.1f} s: {refusal}")
        return None
    taken = time.process_time() - begun
    plan, found = planned.plan, planned.assessment
    fold, cable = plan.phase("fold"), float(plan.layout.lengths.sum())
    words = f"{taken:6.1f} s" + (f" ({taken / budget:.2f} of {budget:g} s)" if budget else "")
    words += f", {plan.vehicles} vehicles, cell {plan.layout.cell:.2f} m, cable {cable:.1f} m"
    words += (
        f", fold {fold.end - fold.start:.0f} s, strands {found.distances['cable'].distance:.2f} m"
    )
    if overrides and name in REACH:
        most_cable, most_fold = REACH[name]
        words += f" (cable {cable / most_cable:.2f}, fold {(fold.end - fold.start) / most_fold:.2f}"
        words += " of what it must reach)"
    if not found.cleared:
        errors = sorted({f.check for f in found.findings if f.severity == "error"})
        words += f"; NOT cleared: {', '.join(errors)}"
    print(f"{what} {words}", flush=True)
    return plan.vehicles, taken, fold.end - fold.start


if __name__ == "__main__":
    main()
