"""Lanes for every vehicle: low where that does, higher where a segment asks for it.

Tall lanes keep a segment that has to straddle corners above what it passes over; but they are steep
and long. So every vehicle begins low, and where the best way of a segment is still in the way of
others, the lanes that it uses there are moved.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from swarm.fold.clear import Margins
from swarm.fold.layout import Hanging
from swarm.fold.passage import Passage, Surfaces, Way, passage, surfaces, walked
from swarm.fold.path import FoldPath, Guide, last_lane

Floats = npt.NDArray[np.float64]

_MOVES = (1.35, 1.8, 0.75)
"""Factors by which lanes are tried to be moved."""

_LOOP = 0.34
"""Height of lanes over the corners as a share of the longest segment, so that its loops pass."""

_FINE = 0.05
"""Cost of a state while all margins are kept."""

_TOO_MUCH = 0.3
"""A way whose worst state costs more is worth other lanes."""


@dataclass(frozen=True, eq=False)
class Ways:
    """Paths of all vehicles, and the way of every segment along them."""

    path: FoldPath
    ways: tuple[Way, ...]

    @property
    def cost(self) -> float:
        """How much the ways miss their margins, in all."""
        return sum(_missed(way) for way in self.ways)

    @property
    def worst(self) -> float:
        """Cost of the worst state."""
        return max(float(way.cost.max()) for way in self.ways)


def found_ways(
    layout: Hanging,
    guide: Guide,
    margins: Margins,
    step: float,
    tries: int = 0,
    report: Callable[[float], None] | None = None,
) -> Ways:
    """Find lanes for every vehicle and a way for every segment.

    ``step`` is that of the lattice of progress, in metres; ``tries`` how often lanes are moved for
    a segment's sake; ``report`` is told the share that is done.
    """
    search = _Search(layout, guide, surfaces(layout), margins, step)
    count = len(layout.lengths)
    lanes = np.repeat(layout.lanes[:, None], count + 1, axis=1)
    lanes = np.maximum(lanes, np.where(lanes > 0.0, _loop_room(layout), -np.inf))
    for vehicle in range(count + 1):
        lanes[:, vehicle] = search.limited(vehicle, lanes[:, vehicle])
    found = search.along(FoldPath(guide, lanes))
    given_up: set[int] = set()
    for done in range(tries):
        if report:
            report(done / tries)
        costs = np.array([_missed(way) for way in found.ways])
        costs[list(given_up)] = 0.0
        worst = int(np.argmax(costs))
        if costs[worst] <= 0.0 or found.ways[worst].cost.max() < _TOO_MUCH:
            break
        better = search.moved(found, worst)
        if better.cost > 0.9 * found.cost:
            given_up.add(worst)
        found = better
    return found


def ways_along(path: FoldPath, layout: Hanging, margins: Margins, step: float) -> Ways:
    """Find a way for every segment along given paths, on a lattice of its own."""
    return _Search(layout, path.guide, surfaces(layout), margins, step).along(path)


def _missed(way: Way) -> float:
    return float(np.maximum(way.cost - _FINE, 0.0).sum())


def _loop_room(layout: Hanging) -> Floats:
    """Height (1, n) that lets the longer segment of each vehicle hang in a loop over others."""
    lengths = layout.lengths
    held = np.maximum(np.append(lengths, 0.0), np.insert(lengths, 0, 0.0))
    room: Floats = _LOOP * held[None]
    return room


@dataclass(frozen=True, eq=False)
class _Search:
    layout: Hanging
    guide: Guide
    between: Surfaces
    margins: Margins
    step: float
    tables: dict[tuple[int, bytes, bytes], Passage] = field(default_factory=dict)

    def way(self, path: FoldPath, segment: int, ways: list[Way | None]) -> Way:
        lanes = path.lanes
        key = segment, lanes[:, segment].tobytes(), lanes[:, segment + 1].tobytes()
        table = self.tables.get(key)
        if table is None:
            table = passage(segment, path, self.between, self.margins, self.step)
            self.tables[key] = table
        return walked(table, self._spacing(segment), self.margins, _beside(ways, segment))

    def along(self, path: FoldPath) -> Ways:
        count = len(self.layout.lengths)
        ways: list[Way | None] = [None] * count
        for segment in reversed(range(count)):
            ways[segment] = self.way(path, segment, ways)
        self.settle(ways, range(count))
        self.settle(ways, reversed(range(count)))
        return Ways(path, tuple(way for way in ways if way is not None))

    def settle(self, ways: list[Way | None], segments: Iterable[int]) -> None:
        """Let segments that are costly, or have costly neighbours, go again, beside these."""
        for segment in segments:
            near = [way for way in ways[max(segment - 1, 0) : segment + 2] if way is not None]
            if max(float(way.cost.max()) for way in near) > _FINE:
                ways[segment] = self.again(ways, segment)

    def again(self, ways: list[Way | None], segment: int) -> Way:
        way = ways[segment]
        assert way is not None  # noqa: S101 - every segment has gone once
        return walked(way.table, self._spacing(segment), self.margins, _beside(ways, segment))

    def _spacing(self, segment: int) -> float:
        return float(self.margins.spacing * self.layout.lengths[segment])

    def limited(self, vehicle: int, lanes: Floats) -> Floats:
        """Lanes (n − 1,) of a vehicle, the last one as low as its segment needs it."""
        if vehicle:
            edge, tracking = vehicle - 1, self.margins.tracking
            taut = self.margins.taut * self.layout.lengths[edge] - 2.0 * tracking
            span = float(self.guide.stations[vehicle] - self.guide.stations[edge])
            lanes = lanes.copy()
            lanes[edge] = last_lane(float(lanes[edge]), span, self.guide.slope, float(taut))
        return lanes

    def moved(self, found: Ways, segment: int) -> Ways:
        """The best of all moves of the lanes that a segment uses where its way is worst."""
        way = found.ways[segment]
        k = int(np.argmax(way.cost))
        table, path = way.table, found.path
        front = path.station(table.ahead[way.ahead[k]])
        rear = path.station(table.behind[way.behind[k]])
        first, last = np.searchsorted(path.stations, [rear - self.step, front + self.step]) - 1
        used = [e for e in range(max(first, 0), last + 1) if e < len(self.layout.lengths)]
        best = found
        for side in (1.0, -1.0):
            edges = [e for e in used if side * self.layout.lanes[e] > 0.0]
            for factor in _MOVES if edges else ():
                for vehicles in ((segment, segment + 1), (segment,), (segment + 1,)):
                    tried = self._with(found, edges, vehicles, factor)
                    if tried.cost < best.cost:
                        best = tried
                    if best.cost < 0.5 * found.cost:
                        return best
        return best

    def _with(
        self, found: Ways, edges: list[int], vehicles: tuple[int, ...], factor: float
    ) -> Ways:
        lanes = found.path.lanes.copy()
        for vehicle in vehicles:
            lanes[edges, vehicle] *= factor
            lanes[:, vehicle] = self.limited(vehicle, lanes[:, vehicle])
        path = replace(found.path, lanes=lanes)
        ways: list[Way | None] = list(found.ways)
        touched = {v for vehicle in vehicles for v in (vehicle - 1, vehicle)}
        near = range(max(min(touched) - 1, 0), min(max(touched) + 2, len(ways)))
        for segment in sorted(touched & set(near), reverse=True):
            ways[segment] = self.way(path, segment, ways)
        self.settle(ways, near)
        return Ways(path, tuple(way for way in ways if way is not None))


def _beside(ways: list[Way | None], segment: int) -> tuple[Way | None, Way | None]:
    """The ways of the segments behind and ahead, as far as they are known."""
    behind = ways[segment - 1] if segment else None
    return behind, ways[segment + 1] if segment + 1 < len(ways) else None
