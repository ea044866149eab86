"""The curve γ that all vehicles follow: run-in, edges in lanes, level changes at corners.

Progress along γ is the arc length of a mean vehicle's path, in metres. Every edge has a lane, a
height above (over edges) or below (under edges) the corners; the level changes around each corner
pass through the corner's own height, where one vehicle will come to rest. Vehicles share the plan
view, but each may have lanes of its own: long segments need higher ones. In plan view corners are
rounded for vehicles that continue, and sharp for the vehicle that stops there. That vehicle
descends to its corner late, as on an arc around the corner before, so that its own segment stays as
tight as it will be.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import numpy.typing as npt
import scipy

Floats = npt.NDArray[np.float64]


class TeamPaths(Protocol):
    """A path for every vehicle of a team, as a function of its progress."""

    def at(self, vehicle: int, progress: Floats, /) -> tuple[Floats, Floats, Floats]:
        """Return the position (…, 3) of a vehicle at progress (…,), and two derivatives by it."""
        ...

    def places(self, vehicle: int, progress: Floats, /) -> Floats:
        """Return the positions (…, 3) of :meth:`at` alone, in a third of the time."""
        ...

    def line(self, count: int, /) -> Floats:
        """Return the path (count, 3) of the last vehicle, for pictures."""
        ...


@dataclass(frozen=True, eq=False)
class Guide:
    """The line that defines progress, and the plan view of all vehicles' paths.

    ``corners`` (n, 3) in metres ENU, in order along the cable; ``lanes`` (n − 1,) heights of the
    line over each edge above (below) its corners; ``slope`` and ``rounding`` are the distances from
    a corner, in metres of plan view, at which level changes and turns begin; ``run_in`` is the
    length of the straight line to the first corner.
    """

    corners: Floats
    lanes: Floats
    slope: float
    rounding: float
    run_in: float

    @cached_property
    def headings(self) -> Floats:
        """Unit vectors (n − 1, 2) along the edges in plan view."""
        edges = np.diff(self.corners[:, :2], axis=0)
        heading: Floats = edges / np.linalg.norm(edges, axis=1, keepdims=True)
        return heading

    @cached_property
    def stations(self) -> Floats:
        """Distance of every corner from the first one along the edges in plan view."""
        spans = np.linalg.norm(np.diff(self.corners[:, :2], axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(spans)])

    @cached_property
    def plan(self) -> "scipy.interpolate.PPoly":
        """Plan view over station: straight edges, joined by quintics where the path turns."""
        stations, headings = self.stations, self.headings
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

    def height(self, lanes: Floats, stop: int) -> "scipy.interpolate.PPoly":
        """Return the height over station in given lanes, up to corner ``stop``.

        On the run-in it is the height of the first corner.
        """
        stations, spans = self.stations, np.diff(self.stations)
        lanes = np.concatenate([[0.0], lanes, [0.0]])
        spans = np.concatenate([[np.inf], spans, [np.inf]])
        x: list[float] = [-self.run_in - 1.0]
        values = [[self.corners[0, 2], 0.0, 0.0]]
        for k, station in enumerate(stations[: stop + 1]):
            before, after = lanes[k], lanes[k + 1] if k < stop else 0.0
            back, ahead = min(self.slope, 0.5 * spans[k]), min(self.slope, 0.5 * spans[k + 1])
            level = self.corners[k, 2]
            if k == stop and before:
                back = _late_descent(abs(before), spans[k], self.slope)
                x += [station - back, station]
                values += [[level + before, 0.0, 0.0], [level, -_STEEP_END * before / back, 0.0]]
                break
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
    def station_of_progress(self) -> "scipy.interpolate.CubicSpline":
        """Distance from the first corner along the edges in plan view, over progress."""
        finest = 0.1 * min(self.slope, self.rounding)
        before = int(np.ceil(self.run_in / finest))
        after = int(np.ceil(self.stations[-1] / finest))
        stations = np.concatenate(
            [
                np.linspace(-self.run_in, 0.0, before + 1)[:-1],
                np.linspace(0.0, self.stations[-1], after + 1),
            ]
        )
        height = self.height(self.lanes, len(self.corners))
        slope = np.concatenate([self.plan(stations, 1), height(stations, 1)], axis=1)
        speed = np.linalg.norm(slope, axis=1)
        steps = 0.5 * (speed[1:] + speed[:-1]) * np.diff(stations)
        progress = np.concatenate([[0.0], np.cumsum(steps)])
        return scipy.interpolate.CubicSpline(progress - progress[before], stations)

    @cached_property
    def stops(self) -> Floats:
        """Progress (n,) at which each vehicle rests on its own corner; 0 at the first corner."""
        knots, stations = (
            self.station_of_progress.x,
            self.station_of_progress(self.station_of_progress.x),
        )
        guess = np.interp(self.stations, stations, knots)
        for _ in range(4):
            guess -= (self.station_of_progress(guess) - self.stations) / (
                self.station_of_progress(guess, 1)
            )
        return np.clip(guess, knots[0], knots[-1])


@dataclass(frozen=True, eq=False)
class FoldPath:
    """γ as a function of progress, for every vehicle.

    ``lanes`` (n − 1, n) are the heights over each edge at which each vehicle flies it.
    """

    guide: Guide
    lanes: Floats

    @property
    def corners(self) -> Floats:
        """Corners (n, 3) in metres ENU."""
        return self.guide.corners

    @property
    def stations(self) -> Floats:
        """Distance (n,) of every corner from the first one along the edges in plan view."""
        return self.guide.stations

    @property
    def stops(self) -> Floats:
        """Progress (n,) at which each vehicle rests on its own corner; 0 at the first corner."""
        return self.guide.stops

    @cached_property
    def _heights(self) -> "dict[int, scipy.interpolate.PPoly]":
        return {}

    def _height(self, vehicle: int) -> "scipy.interpolate.PPoly":
        """Return the height over station of a vehicle, up to its own corner."""
        if vehicle not in self._heights:
            self._heights[vehicle] = self.guide.height(self.lanes[:, vehicle], vehicle)
        return self._heights[vehicle]

    def station(self, progress: Floats) -> Floats:
        """Return the distance (…,) from the first corner along the edges, at progress (…,)."""
        station: Floats = self.guide.station_of_progress(progress)
        return station

    @property
    def start(self) -> float:
        """The progress at which the run-in begins; negative."""
        return float(self.guide.station_of_progress.x[0])

    def line(self, count: int) -> Floats:
        """Return the path (count, 3) of the last vehicle, for pictures."""
        return self.places(len(self.corners) - 1, np.linspace(0.0, self.stops[-1], count))

    def at(self, vehicle: int, progress: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the position (…, 3) of a vehicle at progress (…,), and two derivatives by it."""
        guide = self.guide
        station = guide.station_of_progress(progress)
        rate = guide.station_of_progress(progress, 1)[..., None]
        bend = guide.station_of_progress(progress, 2)[..., None]
        place, along, curved = (self._by_station(vehicle, station, k) for k in range(3))
        return place, along * rate, curved * rate**2 + along * bend

    def places(self, vehicle: int, progress: Floats) -> Floats:
        """Return the positions (…, 3) of :meth:`at` alone, in a third of the time."""
        return self._by_station(vehicle, self.station(progress), 0)

    def _by_station(self, vehicle: int, station: Floats, order: int) -> Floats:
        """Return a derivative (…, 3) of a vehicle's position by the station (…,)."""
        guide, height = self.guide, self._height(vehicle)
        derivative: Floats = np.concatenate(
            [guide.plan(station, order), height(station, order)], axis=-1
        )
        if vehicle > 0:
            # straight over the own corner, which others pass around
            last, heading = guide.stations[vehicle], guide.headings[vehicle - 1]
            span = last - guide.stations[vehicle - 1]
            sharp = (station > last - min(guide.rounding, 0.5 * span))[..., None]
            ahead = (station - last)[..., None] * heading + guide.corners[vehicle, :2]
            straight = (ahead, heading, 0.0)[order]
            derivative[..., :2] = np.where(sharp, straight, derivative[..., :2])
        return derivative


_STEEP_END = 1.6
"""Slope of the path at a vehicle's own corner, over the mean one of its descent."""


def _late_descent(lane: float, span: float, slope: float) -> float:
    """Return the distance before its own corner at which a vehicle leaves its lane, in metres.

    As short as an arc around the corner before allows, with the edge's span as its radius.
    """
    arc = span - np.sqrt(max(span**2 - lane**2, 0.0))
    return float(min(max(arc, 0.5 * lane), span - min(slope, 0.5 * span)))


def last_lane(lane: float, span: float, slope: float, longest: float) -> float:
    """Return the lane of a vehicle's last edge, reduced as its segment requires.

    The chord of that segment, to the corner before, must not exceed ``longest`` metres; ``span`` is
    the edge's length and ``slope`` the distance over which levels change.
    """
    for part in np.linspace(1.0, 0.1, 31):
        height = part * abs(lane)
        ahead, back = min(slope, 0.5 * span), _late_descent(height, span, slope)
        end = -_STEEP_END * height / back if height else 0.0
        x = [0.0, ahead, span - back, span]
        values = [[0.0, 1.5 * height / ahead, 0.0], [height, 0.0, 0.0], [height, 0.0, 0.0]]
        values.append([0.0, end, 0.0])
        path = _quintics(x, [[np.array([v]) for v in row] for row in values])
        station = np.linspace(0.0, span, 60)
        if np.hypot(station, path(station)[:, 0]).max() <= longest:
            break
    return float(np.sign(lane) * height)


def _quintics(x: list[float], values: list[list[Floats]]) -> "scipy.interpolate.PPoly":
    """Return the C² piecewise quintic through (value, slope, curvature) at increasing x.

    Repeated x are dropped.
    """
    keep = [0, *(k for k in range(1, len(x)) if x[k] > x[k - 1] + 1e-9)]
    at = np.array([x[k] for k in keep])
    given = np.array([np.broadcast_arrays(*values[k]) for k in keep], dtype=np.float64)
    value, slope, bend = given[:, 0], given[:, 1], given[:, 2]
    h = np.diff(at)[:, None]
    rise, v0, v1 = np.diff(value, axis=0), slope[:-1] * h, slope[1:] * h
    a0, a1 = bend[:-1] * h * h, bend[1:] * h * h
    unit = [
        6.0 * rise - 3.0 * (v0 + v1) + 0.5 * (a1 - a0),
        -15.0 * rise + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1,
        10.0 * rise - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1,
        0.5 * a0,
        v0,
        value[:-1],
    ]
    return scipy.interpolate.PPoly(np.stack([c / h ** (5 - k) for k, c in enumerate(unit)]), at)
