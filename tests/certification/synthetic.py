"""Small synthetic plans, to certify or to break on purpose."""

import numpy as np

from swarm.geometry.motion import Motion, through_states
from swarm.mission import mission_for_knot
from swarm.planning import CableState, KnotLayout, KnotSummary, Phase, PhaseName, Plan

NO_KNOT = KnotSummary("", "none", "", ())


def moving(times, places):
    """A C² motion that rests at each of the places (k, n, 3) at the given times."""
    places = np.asarray(places, dtype=float)
    still = np.zeros_like(places)
    return through_states(np.asarray(times, dtype=float), places, still, still)


def wandering(rng, vehicles, pieces, *, spacing=2.5, size=1.0, height=8.0, every=2.0):
    """A random smooth motion about a line of vehicles, fast enough to be interesting."""
    line = np.zeros((vehicles, 3))
    line[:, 0] = spacing * np.arange(vehicles)
    line[:, 2] = height
    shape = (pieces + 1, vehicles, 3)
    return through_states(
        every * np.arange(pieces + 1.0),
        line + rng.normal(0.0, size, shape),
        rng.normal(0.0, 0.5 * size, shape),
        rng.normal(0.0, 0.5 * size, shape),
    )


def plan_of(
    motion: Motion,
    lengths,
    *overrides: str,
    name: PhaseName = "fold",
    cable: CableState = "aloft",
    knot: KnotSummary = NO_KNOT,
    crossings=(),
    reversible: bool = False,
):
    """A plan of one phase, with the default mission and overrides."""
    lengths = np.asarray(lengths, dtype=float)
    start, end = float(motion.times[0]), float(motion.times[-1])
    corners = motion.at(end)[0]
    layout = KnotLayout(corners, 0 * lengths, lengths, 0 * lengths, tuple(crossings), 0.0)
    mission = mission_for_knot("overhand", ("workspace.ceiling=100", *overrides))
    phases = (Phase(name, start, end, cable, reversible),)
    return Plan(mission, knot, layout, motion, phases, (), corners)
