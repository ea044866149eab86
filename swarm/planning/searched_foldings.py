"""Foldings whose motion is searched by untangling the knot, not led along a common path."""

from collections.abc import Callable

import numpy as np

from swarm.folding.layout import KnotLayout
from swarm.folding.margins import Margins
from swarm.folding.penalty import TeamGeometry
from swarm.folding.waypoints import schedule_of_waypoints
from swarm.mission import Mission
from swarm.planning.foldings import Folding
from swarm.untangling.search import shortened, untangle

Progress = Callable[[str, float], None]


def may_search(mission: Mission) -> bool:
    """Return whether planning a mission may search a motion."""
    return mission.vehicles.count != "auto" or mission.layout.corners is not None


def searched_folding(
    layout: KnotLayout, margins: Margins, attempt: int, progress: Progress | None = None
) -> Folding | None:
    """Return a folding to a layout, its motion found backwards; None where the search fails.

    Each ``attempt`` moves vehicles in another order.
    """
    team = TeamGeometry(layout.lengths, margins)
    rng = np.random.default_rng(attempt)
    backwards = untangle(team, np.ascontiguousarray(layout.corners), rng, progress)
    if backwards is None:
        return None
    waypoints = shortened(team, backwards)[::-1]
    return Folding(layout, schedule_of_waypoints(layout, waypoints, margins))
