"""Foldings of a knot with few vehicles: layouts from polygons with few edges, and their motions."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Literal

import numpy as np
import numpy.typing as npt

from swarm.errors import Refused, SwarmError
from swarm.folding.layout import KnotLayout
from swarm.folding.margins import Margins
from swarm.folding.polygon_layout import lay_out_polygon, lay_out_star
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

_POLYGONS = 12
"""Number of polygons with a number of edges that are laid out."""

_ATTEMPTS = 24
"""Number of attempts to find a motion with a number of vehicles. One succeeds in about two for 5_1
with 8, in five for 8_18 with 11; each takes 1 to 5 s."""

_FOLDED = 2
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
class FewVehicles:
    """The search for a knot with few vehicles.

    ``count`` is a number of vehicles, or ``fewest``. ``opened`` are openings of the knot's grid
    diagram, which needs 2N − 1 vehicles.
    """

    knot: KnotChoice
    opened: Sequence[OpenGrid]
    count: int | Literal["fewest"]
    margins: Margins

    @property
    def least(self) -> int:
        """Lower bound of the number of vehicles, see :func:`least_vehicles`."""
        return least_vehicles(self.knot.crossings)

    @property
    def most(self) -> int:
        """Number of vehicles of the grid diagram."""
        return len(self.opened[0].corners)

    def foldings(self, progress: Progress | None) -> Iterator[tuple[Folding, str]]:
        """Yield foldings, those with the fewest vehicles first, each with a note for the plan.

        Raises :class:`swarm.errors.Refused` where a number is out of range, and where no motion
        with it is found, with the nearest number for which one is.
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
        if self.count == "fewest":
            for count in range(self.least, self.most):
                for folding in self._with(count, progress):
                    yield folding, f"folded with {count} vehicles; {bound}"
            return
        if not self.least <= self.count <= self.most:
            raise Refused(
                f"vehicles.count {self.count}: {bound}, and the grid diagram has {self.most}"
            )
        none = True
        for folding in self._with(self.count, progress):
            none = False
            yield folding, f"folded with {self.count} vehicles; {bound}"
        if none:
            raise Refused(f"vehicles.count {self.count}: {self._nearest(self.count, progress)}")

    def _nearest(self, count: int, progress: Progress | None) -> str:
        """Return in words for which larger number of vehicles a motion is found."""
        for more in range(count + 1, self.most):
            if next(self._with(more, progress), None) is not None:
                return f"no motion was found; the nearest number with one is {more}"
        return f"no motion was found; the grid diagram has {self.most}"

    def _with(self, count: int, progress: Progress | None) -> Iterator[Folding]:
        """Yield foldings with a number of vehicles, those with a short cable first."""
        layouts = sorted(self._layouts(count, progress), key=lambda one: one.lengths.sum())
        folded: set[int] = set()
        for attempt in range(_ATTEMPTS if layouts else 0):
            if progress:
                progress(f"untangling the knot with {count} vehicles", attempt / _ATTEMPTS)
            again, which = divmod(attempt, len(layouts))
            if which in folded:
                continue
            folding = searched_folding(layouts[which], self.margins, again)
            if folding is not None and folding.schedule.worst < GOOD:
                yield folding
                folded.add(which)
                if len(folded) == _FOLDED:
                    return

    def _layouts(self, count: int, progress: Progress | None) -> Iterator[KnotLayout]:
        """Yield layouts with a number of vehicles that keep the margins at rest."""
        if count == _STAR:
            for order in permutations(range(count - 1)):
                star = lay_out_star(count, order, self.margins)
                if star is not None and self._is_the_knot(star):
                    yield star
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
            layout = lay_out_polygon(polygon, self.margins)
            if layout is not None and len(layout.corners) == count and self._is_the_knot(layout):
                yield layout

    def _is_the_knot(self, layout: KnotLayout) -> bool:
        """Return whether the cable of a layout at rest has the knot."""
        try:
            found = identify_curve(_curve(layout))
        except SwarmError:
            return False
        return (found.name, found.chirality) == (self.knot.name, self.knot.chirality)


def code_at_rest(layout: KnotLayout) -> SignedGauss:
    """Return the signed Gauss code of the cable of a layout at rest, closed without a crossing."""
    return curve_gauss(_curve(layout)).as_closed()


def _curve(layout: KnotLayout) -> npt.NDArray[np.float64]:
    return polyline(layout.corners, layout.lengths, _PIECES)
