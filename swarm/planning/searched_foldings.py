"""Foldings whose motion is searched by untangling the knot, not led along a common path."""

from collections.abc import Callable

import numpy as np

from swarm.folding.layout import KnotLayout
from swarm.folding.margins import Margins
from swarm.folding.penalty import TeamGeometry
from swarm.folding.untangling import shortened, untangle
from swarm.folding.waypoints import schedule_of_waypoints
from swarm.planning.foldings import Folding

Progress = Callable[[str, float], None]


def searched_folding(
    layout: KnotLayout, margins: Margins, progress: Progress | None
) -> Folding | None:
    """Return a folding to a layout, its motion found backwards; None where the search fails."""
    team = TeamGeometry(layout.lengths, margins)
    backwards = untangle(team, np.ascontiguousarray(layout.corners), progress)
    if backwards is None:
        return None
    waypoints = shortened(team, backwards)[::-1]
    return Folding(layout, schedule_of_waypoints(layout, waypoints, margins))
