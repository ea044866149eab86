"""Foldings of a layout that the mission gives by corners and sags, instead of a grid diagram."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from swarm.folding.layout import lay_out_corners
from swarm.folding.margins import Margins
from swarm.folding.schedule import make_schedule
from swarm.mission import Layout
from swarm.planning.foldings import GOOD, Folding, make_guide
from swarm.planning.searched_foldings import searched_folding

Progress = Callable[[str, float], None]

_TRIED = ((0.19, 0.17, 0.2), (0.1, 0.3, 0.15), (0.25, 0.3, 0.15))
"""Distance between lanes, length of level changes and of turns, as shares of the shortest edge."""

_STEP = 0.06
"""Step of the lattice of progress, as a share of the shortest edge."""

_SEARCHES = 6
"""Attempts to search a motion; the pentagram's overhand takes one."""


def foldings_of_given_layout(
    section: Layout, margins: Margins, progress: Progress | None
) -> list[tuple[Folding, str]]:
    """Return foldings of the mission's corners and sags, each with a note for the plan.

    Lanes are ordered as the sags: the segment with the smallest sag is flown highest. The distances
    between lanes, level changes and turns differ between the foldings. Where all of them miss their
    margins by much, another motion is searched.
    """
    layout = lay_out_corners(section.corners or (), section.sags or (), 0.0)
    edges = np.diff(layout.corners[:, :2], axis=0)
    shortest = float(np.linalg.norm(edges, axis=1).min())
    heading = edges[0] / np.linalg.norm(edges[0])
    turn = np.array([[heading[0], heading[1]], [-heading[1], heading[0]]])
    corners = layout.corners.copy()
    corners[:, :2] = (corners[:, :2] - corners[0, :2]) @ turn.T
    levels = np.unique(layout.sags.round(6), return_inverse=True)[1].astype(np.float64)
    foldings: list[tuple[Folding, str]] = []
    for done, (spacing, slope, rounding) in enumerate(_TRIED):
        if progress:
            progress("folding the given layout", done / len(_TRIED))
        lanes = spacing * shortest * (0.5 * levels.max() - levels)
        placed = replace(layout, corners=corners, lanes=lanes)
        guide = make_guide(placed, slope * shortest, rounding * shortest)
        folding = Folding(placed, make_schedule(placed, guide, margins, _STEP * shortest))
        note = (
            f"tried lanes {spacing * shortest:.2f} m apart: misses its margins by "
            f"{folding.schedule.worst:.2g}"
        )
        foldings.append((folding, note))
    if min(folding.schedule.worst for folding, _ in foldings) >= GOOD:
        placed = replace(layout, corners=corners)
        attempts = (searched_folding(placed, margins, k, progress) for k in range(_SEARCHES))
        searched = next((attempt for attempt in attempts if attempt is not None), None)
        if searched is not None:
            worst = searched.schedule.worst
            note = f"searched a motion that untangles the knot: misses its margins by {worst:.2g}"
            foldings.append((searched, note))
    return foldings
