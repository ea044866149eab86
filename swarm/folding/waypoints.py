"""A schedule from waypoints of the whole team, instead of a common path."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy

from swarm.folding.layout import KnotLayout
from swarm.folding.margins import Margins
from swarm.folding.penalty import TeamGeometry
from swarm.folding.schedule import REST, Schedule, relaxed_schedule, stage_spline

Floats = npt.NDArray[np.float64]

_STAGE = 0.6
"""Movement of the quickest vehicle in a stage, metres."""

_SMOOTHED = 1.0
"""Standard deviation in stages of the Gaussian that smooths the waypoints."""


@dataclass(frozen=True, eq=False)
class WaypointPaths:
    """Paths of n vehicles near waypoints (c, n, 3), one for each stage; progress is the stage."""

    waypoints: Floats

    @cached_property
    def _splines(self) -> "list[scipy.interpolate.BSpline]":
        return [stage_spline(self.waypoints[:, i]) for i in range(self.waypoints.shape[1])]

    def at(self, vehicle: int, progress: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the position (…, 3) of a vehicle at progress (…,), and two derivatives by it."""
        spline = self._splines[vehicle]
        stage = np.clip(progress, 0.0, len(self.waypoints) - 1.0)
        return spline(stage), spline(stage, nu=1), spline(stage, nu=2)

    def places(self, vehicle: int, progress: Floats) -> Floats:
        """Return the positions (…, 3) of :meth:`at` alone."""
        points: Floats = self._splines[vehicle](np.clip(progress, 0.0, len(self.waypoints) - 1.0))
        return points

    def line(self, count: int) -> Floats:
        """Return the path (count, 3) of the last vehicle, for pictures."""
        stages = np.linspace(0.0, len(self.waypoints) - 1.0, count)
        return self.places(self.waypoints.shape[1] - 1, stages)


def schedule_of_waypoints(layout: KnotLayout, waypoints: Floats, margins: Margins) -> Schedule:
    """Return the motion of a team near waypoints (k, n, 3), which end at the layout's corners."""
    stages = _in_stages(waypoints)
    progress = np.repeat(np.arange(float(len(stages)))[:, None], stages.shape[1], axis=1)
    team = TeamGeometry(layout.lengths, margins)
    return relaxed_schedule(WaypointPaths(stages), team, progress)


def _in_stages(waypoints: Floats) -> Floats:
    """Return waypoints (c, n, 3) one stage apart and smoothed, with rests at both ends."""
    steps = np.linalg.norm(np.diff(waypoints, axis=0), axis=2).max(axis=1)
    travelled = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.linspace(0.0, travelled[-1], int(np.ceil(travelled[-1] / _STAGE)) + 1)
    at = np.interp(wanted, travelled, np.arange(len(waypoints)))
    before = np.minimum(at.astype(np.intp), len(waypoints) - 2)
    share = (at - before)[:, None, None]
    even = waypoints[before] + share * (waypoints[before + 1] - waypoints[before])
    rest = int(4 * _SMOOTHED) + 1
    padded = np.pad(even, ((rest, rest + REST), (0, 0), (0, 0)), mode="edge")
    smooth: Floats = scipy.ndimage.gaussian_filter1d(padded, _SMOOTHED, axis=0, mode="nearest")
    return smooth
