"""The curve γ that all vehicles follow: run-in, edges in lanes, sloped level changes at corners.

Along γ a vehicle's *progress* is measured in metres of arc length. Every edge is flown at its lane,
a height above (over edges) or below (under edges) the corners; the level changes around each corner
pass through the corner's own height, where one vehicle will come to rest. In plan view corners are
rounded for those who fly on, and sharp for the one that stops there.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BPoly, CubicSpline, PPoly

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FoldPath:
    """γ as a function of progress, for every vehicle.

    ``corners`` (n, 3) in metres ENU, in order along the cable; ``lanes`` (n − 1,) heights of the
    path over each edge above (below) its corners; ``slope`` and ``rounding`` say how far from a
    corner, in metres of plan view, levels change and turns begin; ``run_in`` is the length of the
    straight line that leads to the first corner.
    """

    corners: Floats
    lanes: Floats
    slope: float
    rounding: float
    run_in: float

    @cached_property
    def _headings(self) -> Floats:
        edges = np.diff(self.corners[:, :2], axis=0)
        heading: Floats = edges / np.linalg.norm(edges, axis=1, keepdims=True)
        return heading

    @cached_property
    def _stations(self) -> Floats:
        """Distance of every corner from the first one along the edges in plan view."""
        spans = np.linalg.norm(np.diff(self.corners[:, :2], axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(spans)])

    @cached_property
    def _plan(self) -> PPoly:
        """Plan view over station: straight edges, joined by quintics where the path turns."""
        stations, headings = self._stations, self._headings
        spans = np.diff(stations)
        x = [-self.run_in]
        values = [[self.corners[0, :2] - self.run_in * headings[0], headings[0], np.zeros(2)]]
        for k in range(1, len(stations) - 1):
            reach = min(self.rounding, 0.5 * spans[k - 1], 0.5 * spans[k])
            corner = self.corners[k, :2]
            for side, heading in ((-1.0, headings[k - 1]), (1.0, headings[k])):
                x.append(stations[k] + side * reach)
                values.append([corner + side * reach * heading, heading, np.zeros(2)])
        x.append(stations[-1])
        values.append([self.corners[-1, :2], headings[-1], np.zeros(2)])
        return _quintics(x, values)

    @cached_property
    def _height(self) -> PPoly:
        """Height over station; on the run-in it is that of the first corner."""
        stations, spans = self._stations, np.diff(self._stations)
        lanes = np.concatenate([[0.0], self.lanes, [0.0]])
        spans = np.concatenate([[np.inf], spans, [np.inf]])
        x: list[float] = [-self.run_in - 1.0]
        values = [[self.corners[0, 2], 0.0, 0.0]]
        for k, station in enumerate(stations):
            before, after = lanes[k], lanes[k + 1]
            back, ahead = min(self.slope, 0.5 * spans[k]), min(self.slope, 0.5 * spans[k + 1])
            level = self.corners[k, 2]
            crossing = before * after < 0.0
            steep = 1.5 * min(abs(before) / back, abs(after) / ahead) if crossing else 0.0
            if before:
                x.append(station - back)
                values.append([level + before, 0.0, 0.0])
            x.append(station)
            values.append([level, np.sign(after - before) * steep, 0.0])
            if after:
                x.append(station + ahead)
                values.append([level + after, 0.0, 0.0])
        return _quintics(x, [[np.array([v]) for v in row] for row in values])

    @cached_property
    def _station_of_progress(self) -> CubicSpline:
        finest = 0.1 * min(self.slope, self.rounding)
        before = int(np.ceil(self.run_in / finest))
        after = int(np.ceil(self._stations[-1] / finest))
        stations = np.concatenate(
            [
                np.linspace(-self.run_in, 0.0, before + 1)[:-1],
                np.linspace(0.0, self._stations[-1], after + 1),
            ]
        )
        slope = np.concatenate([self._plan(stations, 1), self._height(stations, 1)], axis=1)
        speed = np.linalg.norm(slope, axis=1)
        steps = 0.5 * (speed[1:] + speed[:-1]) * np.diff(stations)
        progress = np.concatenate([[0.0], np.cumsum(steps)])
        return CubicSpline(progress - progress[before], stations)

    @cached_property
    def stops(self) -> Floats:
        """Progress (n,) at which each vehicle rests on its own corner; 0 at the first corner."""
        knots, stations = (
            self._station_of_progress.x,
            self._station_of_progress(self._station_of_progress.x),
        )
        guess = np.interp(self._stations, stations, knots)
        for _ in range(4):
            guess -= (self._station_of_progress(guess) - self._stations) / (
                self._station_of_progress(guess, 1)
            )
        return np.clip(guess, knots[0], knots[-1])

    def station(self, progress: Floats) -> Floats:
        """Distance from the first corner along the edges in plan view, at progress (…,)."""
        station: Floats = self._station_of_progress(progress)
        return station

    @property
    def start(self) -> float:
        """The least progress there is: where the run-in begins (negative)."""
        return float(self._station_of_progress.x[0])

    def at(self, vehicle: int, progress: Floats) -> tuple[Floats, Floats, Floats]:
        """Place (…, 3) of one vehicle at progress (…,), and its two derivatives by progress."""
        station = self._station_of_progress(progress)
        rate = self._station_of_progress(progress, 1)[..., None]
        bend = self._station_of_progress(progress, 2)[..., None]
        place, along, curved = (
            np.concatenate([self._plan(station, k), self._height(station, k)], axis=-1)
            for k in range(3)
        )
        if vehicle > 0:
            last = self._stations[vehicle]
            heading = self._headings[vehicle - 1]
            span = last - self._stations[vehicle - 1]
            sharp = station > last - min(self.rounding, 0.5 * span)
            ahead = (station - last)[..., None] * heading + self.corners[vehicle, :2]
            sharp = sharp[..., None]
            place[..., :2] = np.where(sharp, ahead, place[..., :2])
            along[..., :2] = np.where(sharp, heading, along[..., :2])
            curved[..., :2] = np.where(sharp, 0.0, curved[..., :2])
        return place, along * rate, curved * rate**2 + along * bend


def _quintics(x: list[float], values: list[list[Floats]]) -> PPoly:
    """C² piecewise quintic through (value, slope, curvature) at increasing x; repeats dropped."""
    keep = [0, *(k for k in range(1, len(x)) if x[k] > x[k - 1] + 1e-9)]
    return PPoly.from_bernstein_basis(
        BPoly.from_derivatives(
            np.array([x[k] for k in keep]), [np.array(values[k], dtype=float) for k in keep]
        )
    )
