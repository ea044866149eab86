"""Missed margins of chords: segments that are close to taut."""

from typing import TypeVar

import numpy as np
import numpy.typing as npt

from swarm.folding.margins import Margins
from swarm.jit import compiled

Floats = npt.NDArray[np.float64]
Numbers = TypeVar("Numbers", float, Floats)

_PREFERRED_CHORD, _CHORD_WEIGHT = 0.985, 4.0
"""Share of the largest chord that the optimizer prefers to keep, and weight of metres beyond."""


@compiled
def chord_unit(margins: Margins) -> float:
    """Return the metres of a chord beyond the preferred one that cost 1."""
    return (margins.cable + 2.0 * margins.tracking) / _CHORD_WEIGHT


def missed_chords(ratio: Numbers, length: Numbers, extra: Numbers, margins: Margins) -> Numbers:
    """Return by how many units chords are beyond the preferred one; 0 or less where they are not.

    ``ratio`` is the chord over the ``length`` of its segment; ``extra`` metres are required beyond
    the margin.
    """
    longer = 2.0 * margins.tracking + extra
    over: Numbers = (ratio + longer / length) / margins.max_chord_ratio - _PREFERRED_CHORD
    return over * length / chord_unit(margins)


missed_chord = compiled(missed_chords)
"""As :func:`missed_chords`, compiled for one segment."""
