"""Foldings of a knot with few vehicles: layouts from polygons with few edges, and their motions."""

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Literal

import numpy as np
import numpy.typing as npt

from swarm.errors import Refused, SwarmError
from swarm.folding.layout import KnotLayout
from swarm.folding.margins import Margins
from swarm.folding.polygon_layout import lay_out_polygon, lay_out_star
from swarm.geometry.catenary import STANDARD_GRAVITY, solve_catenaries
from swarm.geometry.chain import polyline
from swarm.knots.catalog import KnotChoice
from swarm.knots.curve import curve_gauss
from swarm.knots.gauss import SignedGauss
from swarm.knots.grid import OpenGrid
from swarm.knots.invariants import identify_curve
from swarm.knots.sticks import fewest_edges, reduced_polygon
from swarm.planning.foldings import GOOD, Folding
from swarm.planning.searched_foldings import searched_folding

Progress = Callable[[str, float], None]
NotedFolding = tuple[Folding, tuple[str, ...]]
Noted = Generator[NotedFolding, None, "_Searched"]

_POLYGONS = 12
"""Number of polygons with a number of edges that are laid out."""

_ATTEMPTS = 24
"""Number of attempts to find a motion with a number of vehicles. One succeeds in about two for 5_1
with 8, in five for 8_18 with 11; each takes 1 to 5 s."""

_ATTEMPTS_IN_ALL = 96
"""Number of attempts to find a motion with all numbers of vehicles together, so that a search ends:
most take up to 5 s of a processor with 8 crossings, and with laying out and certifying fit into 10
min. In layouts of 8_14, with 131 m of cable, one takes 60 to 80 s, in lattices of free places that
grow with the longest segments. Counted, not timed: the same search on every machine."""

_FOLDED = 4
"""Number of foldings with a number of vehicles that are certified."""

_WITHOUT = 3
"""Number of polygons that are not found with a number of edges, after which there is none."""

_STAR = 5
"""Number of vertices of star polygons that are laid out with every order of levels: a pentagram has
24. Straight edges in space need one more for an overhand with its ends outside."""

_PIECES = 16
"""Straight pieces of a segment in the curve whose knot is identified."""


def least_vehicles(crossings: int) -> int:
    """Return a lower bound of the number of vehicles for a knot with so many crossings.

    Below it no layout exists with a catenary for each edge and with both ends outside in plan view.
    A mission has at least 3 vehicles.
    """
    return max(fewest_edges(crossings) + 1, 3)


@dataclass(frozen=True)
class _Searched:
    """Notes of a search that no folding came with yet, and its number of attempts at a motion."""

    notes: tuple[str, ...]
    attempts: int


@dataclass(frozen=True)
class FewVehicles:
    """The search for a knot with few vehicles.

    ``count`` is a number of vehicles, or ``fewest``. ``opened`` are openings of the knot's grid
    diagram, which needs 2N − 1 vehicles. ``carried`` is the length of cable, metres, that weighs as
    much as a vehicle can carry. The search ends after ``attempts`` at a motion.
    """

    knot: KnotChoice
    opened: Sequence[OpenGrid]
    count: int | Literal["fewest"]
    margins: Margins
    carried: float = np.inf
    attempts: int = _ATTEMPTS_IN_ALL

    @property
    def least(self) -> int:
        """Lower bound of the number of vehicles, see :func:`least_vehicles`."""
        return least_vehicles(self.knot.crossings)

    @property
    def most(self) -> int:
        """Number of vehicles of the grid diagram."""
        return len(self.opened[0].corners)

    def foldings(self, progress: Progress | None) -> Generator[NotedFolding, None, tuple[str, ...]]:
        """Yield foldings, those with the fewest vehicles first, with notes on the search so far.

        Returns the notes that no folding came with. Raises :class:`swarm.errors.Refused` where a
        number is out of range, and where no motion with it is found, with the nearest number for
        which one is.
        """
        if self.knot.name == "unknown":
            raise Refused(
                f"vehicles.count {self.count}: this knot is in no table, so that no layout can be "
                "compared with it"
            )
        bound = (
            f"at least {self.least} vehicles are needed for {self.knot.crossings} crossings, with "
            "one catenary for each edge and both ends outside in plan view"
        )
        record = _Searched((bound,), 0)
        if self.count == "fewest":
            for count in range(self.least, self.most):
                if record.attempts >= self.attempts:
                    return (*record.notes, self._ended(count))
                record = yield from self._with(count, record, progress)
            return record.notes
        if not self.least <= self.count <= self.most:
            raise Refused(
                f"vehicles.count {self.count}: {bound}, and the grid diagram has {self.most}"
            )
        record = yield from self._with(self.count, record, progress)
        if record.notes:
            nearest = self._nearest(self.count, record, progress)
            raise Refused(f"vehicles.count {self.count}: {record.notes[-1]}; {nearest}")
        return ()

    def _ended(self, count: int) -> str:
        return f"the search ended after {self.attempts} attempts, before {count} vehicles"

    def _nearest(self, count: int, record: _Searched, progress: Progress | None) -> str:
        """Return in words for which larger number of vehicles a motion is found."""
        for more in range(count + 1, self.most):
            if record.attempts >= self.attempts:
                return f"{self._ended(more)}; the grid diagram has {self.most}"
            search = self._with(more, record, progress)
            try:
                next(search)
            except StopIteration as end:
                record = end.value
            else:
                return f"the nearest number with a motion is {more}"
        return f"the grid diagram has {self.most}"

    def _with(self, count: int, record: _Searched, progress: Progress | None) -> Noted:
        """Yield foldings with a number of vehicles, the first one with the notes before it.

        Those with a short cable come first. Returns the notes, and why there is none, where no
        folding was yielded.
        """
        layouts, why = self._layouts(count, progress)
        most = min(_ATTEMPTS, self.attempts - record.attempts) if layouts else 0
        notes, attempts = record.notes, record.attempts
        folded: set[int] = set()
        for attempt in range(most):
            if progress:
                progress(f"untangling the knot with {count} vehicles", attempt / _ATTEMPTS)
            again, which = divmod(attempt, len(layouts))
            if which in folded:
                continue
            attempts += 1
            folding = searched_folding(layouts[which], self.margins, again)
            if folding is not None and folding.schedule.worst < GOOD:
                yield folding, (*notes, f"folded with {count} vehicles")
                notes = ()
                folded.add(which)
                if len(folded) == _FOLDED:
                    break
        if not folded:
            notes = (*notes, why)
        return _Searched(notes, attempts)

    def _layouts(self, count: int, progress: Progress | None) -> tuple[list[KnotLayout], str]:
        """Return layouts with a number of vehicles, and why none of them may be folded.

        They keep the margins at rest, the shortest first, and the vehicles can carry them.
        """
        layouts = [
            layout
            for layout in self._polygons(count, progress)
            if layout is not None and self._is_the_knot(layout)
        ]
        carried = [layout for layout in layouts if _largest_load(layout) <= self.carried]
        if not layouts:
            return [], f"no layout with {count} vehicles was found"
        if not carried:
            return [], f"the layouts with {count} vehicles are too heavy for them"
        why = f"no motion with {count} vehicles was found; layouts: {len(carried)}"
        return sorted(carried, key=lambda shape: shape.lengths.sum()), why

    def _polygons(self, count: int, progress: Progress | None) -> Iterator[KnotLayout | None]:
        """Yield layouts with a number of vehicles, of any knot; None where margins are missed."""
        if count == _STAR:
            for order in permutations(range(count - 1)):
                yield lay_out_star(count, order, self.margins)
        missing = 0
        for seed in range(_POLYGONS):
            if progress:
                progress(f"looking for a layout with {count} vehicles", seed / _POLYGONS)
            opened = self.opened[seed % len(self.opened)]
            polygon = reduced_polygon(opened, count, np.random.default_rng(seed))
            if polygon is None:
                missing += 1
                if missing == _WITHOUT:
                    return
                continue
            if len(polygon) == count:
                yield lay_out_polygon(polygon, self.margins)

    def _is_the_knot(self, layout: KnotLayout) -> bool:
        """Return whether the cable of a layout at rest has the knot."""
        try:
            knot = identify_curve(_curve(layout))
        except SwarmError:
            return False
        return (knot.name, knot.chirality) == (self.knot.name, self.knot.chirality)


def code_at_rest(layout: KnotLayout) -> SignedGauss:
    """Return the signed Gauss code of the cable of a layout at rest, closed without a crossing."""
    return curve_gauss(_curve(layout)).as_closed()


def _largest_load(layout: KnotLayout) -> float:
    """Return the largest force on a vehicle at rest, as the length of cable with that weight."""
    strands = solve_catenaries(layout.corners[:-1], layout.corners[1:], layout.lengths)
    at_start, at_end = strands.end_forces(1.0 / STANDARD_GRAVITY)
    force = np.pad(at_start, ((0, 1), (0, 0))) + np.pad(at_end, ((1, 0), (0, 0)))
    return float(np.linalg.norm(force, axis=1).max())


def _curve(layout: KnotLayout) -> npt.NDArray[np.float64]:
    return polyline(layout.corners, layout.lengths, _PIECES)
