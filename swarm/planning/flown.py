"""How a schedule is flown: which of its stages a paced and shaped fold is made of."""

import numpy as np
import numpy.typing as npt

from swarm.folding.schedule import Flown, Schedule
from swarm.geometry.distance import norms
from swarm.planning.shaping import PacedMotion, Shaper, shaped_from

Floats = npt.NDArray[np.float64]

_PER_STAGE = 8
"""Samples of a schedule per stage."""


def flown_stages(schedule: Schedule, paced: PacedMotion, shaper: Shaper) -> Flown:
    """Return how a schedule is flown by a paced motion along it, from its beginning, and shaped.

    A stage and a time of the motion belong together where the team has moved equally far.
    """
    stages = np.arange(round(schedule.last_stage * _PER_STAGE) + 1) / _PER_STAGE
    along_schedule = _moved(schedule.at(stages)[0])
    along_motion = _moved(paced.motion.places(paced.at))
    reached = np.interp(along_motion, along_schedule, stages)
    own = shaped_from(paced, shaper)
    return Flown(np.interp(own, paced.at, reached), shaper.shares)


def _moved(places: Floats) -> Floats:
    """Return how far a team has moved along its places (k, n, 3), as a share of all of it."""
    steps = norms(np.diff(places.reshape(len(places), -1), axis=0))
    moved: Floats = np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum()
    return moved
