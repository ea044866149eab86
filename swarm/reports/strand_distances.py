"""Sampled distances of strands, for curves; the certificate bounds them at every moment."""

from typing import Final

import numpy as np
import numpy.typing as npt

from swarm.flight.trace import Trace
from swarm.geometry.distance import strand_strand
from swarm.planning import Plan
from swarm.reports import scene

Floats = npt.NDArray[np.float64]

SAMPLE_INTERVAL: Final = 0.5
"""Seconds between two sampled distances."""


def planned_strand_distances(plan: Plan, step: float = SAMPLE_INTERVAL) -> tuple[Floats, Floats]:
    """Return times (k,) and the smallest surface distance (k,) of strands aloft, metres.

    The motion is the planned one without tracking errors.
    """
    aloft = [phase for phase in plan.phases if phase.cable == "aloft"]
    start, end = aloft[0].start, aloft[-1].end
    times = np.linspace(start, end, max(2, round((end - start) / step) + 1))
    return times, smallest_strand_distances(plan, plan.motion.at(times)[0])


def smallest_strand_distances(plan: Plan, grips: Floats) -> Floats:
    """Return the smallest surface distance (k,) of strands between grip points (k, n, 3), metres.

    Neighbouring segments meet at a grip point and are left out.
    """
    shapes = scene.strands(grips, plan.layout.lengths, scene.POINTS_PER_SEGMENT)
    first, second = np.triu_indices(plan.vehicles - 1, 2)
    closest = strand_strand(shapes, np.column_stack([first, second])).distance.min(axis=1)
    surface: Floats = closest - plan.mission.cable.diameter
    return surface


def sampling_step(trace: Trace) -> int:
    """Return the number of instants of the trace between two points of the sampled curves."""
    if len(trace.time) < 2:
        return 1
    return max(1, round(SAMPLE_INTERVAL / float(np.median(np.diff(trace.time)))))
