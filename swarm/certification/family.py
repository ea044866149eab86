"""Families: pairs of one kind whose margins are bounded, and searched, together."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import Boxes, Evaluator
from swarm.certification.cable_spans import Spans
from swarm.certification.minima import TOLERANCE, Intervals, failing, roots

Flags = npt.NDArray[np.bool_]

ROOT = 1.0
"""Largest width in seconds of an initial box; bounds of wider ones are too weak to be of use."""


@dataclass(frozen=True)
class Family:
    """Pairs of one kind whose margins are bounded together.

    ``others`` are the intervals of the coordinates beside time into which the evaluator divides a
    pair. ``far`` tells for initial boxes whether their margins are shown to be positive without a
    search. ``tolerance`` is the difference of reported and true margins at which a search may end.
    """

    check: str
    names: Sequence[tuple[str, str]]
    required: float
    spans: Spans
    evaluate: Evaluator
    others: Intervals = ()
    far: Callable[[Boxes], Flags] | None = None
    tolerance: float = TOLERANCE

    def failing(self) -> tuple[int, float] | None:
        """Return pair and time of a margin that is not shown to be kept, if any."""
        boxes, initial = self.doubtful()
        return failing(self.evaluate, boxes, initial, self.tolerance)

    def doubtful(self) -> tuple[Boxes, int]:
        """Return the initial boxes whose margins may be negative, and the number of all."""
        boxes = self.roots()
        initial = len(boxes)
        return boxes if self.far is None else boxes.taken(~self.far(boxes)), initial

    def roots(self) -> Boxes:
        """Return the initial boxes for all pairs over all spans of time."""
        return roots(len(self.names), self.spans, ROOT, self.others)
