"""A chain of rigid links that hangs at rest between two points, as lumped masses do.

Joints at equal distances along a catenary are not at rest: they are nearer to each other than links
are long, by a fifth where the catenary turns over within a link's length.
"""

import math

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.catenary_kernel import solve_catenary
from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Floats2

Floats = npt.NDArray[np.float64]

_LEAST = 1e-6
"""Smallest span over length, as for catenaries."""

_STEPS = 60
"""Most Newton steps: four or five close the strands of plans."""

_CLOSED = 1e-12
"""Distance from the last joint to the end, over the length, at which the chain is closed."""


def hung_strands(starts: Floats, ends: Floats, lengths: Floats, links: int) -> Floats:
    """Return the joints (s, links + 1, 3) of strands at rest between grip points (s, 3) each.

    Where a strand's span is less than a link there may be no chain at rest: its joints are on the
    catenary. Raises :class:`swarm.geometry.catenary.OverStretched` where a chord is longer than its
    strand.
    """
    starts, ends = (np.ascontiguousarray(one, dtype=np.float64) for one in (starts, ends))
    joints = solve_catenaries(starts, ends, lengths).points(np.linspace(0.0, 1.0, links + 1))
    hung = np.empty(joints.shape[1:])
    for k, length in enumerate(lengths.tolist()):
        if hang_links(starts[k], ends[k], length, hung):
            joints[k] = hung
    return joints


@compiled
def hang_links(start: Floats1, end: Floats1, length: float, joints: Floats2) -> bool:
    """Write the joints (k + 1, 3) of k equal links at rest between two points, metres.

    A link between joints of equal mass points along its tension (H, V + i): H is the horizontal
    tension and V the vertical one of the first link, over the weight of a joint. They minimize the
    complementary energy Σ l·|(H, V + i)| − H·span − V·rise, which is convex; its gradient is the
    gap to the end. Return whether the chain could be closed: with a span of a link's length or
    more it can; a narrower one may hang with a link under pressure.
    """
    links = len(joints) - 1
    link = length / links
    strand = solve_catenary(start, end, length, _LEAST)
    chain = (link, strand.span, strand.rise)
    across = strand.parameter / link
    up = across * strand.slope + 0.5
    gap, slopes = _gap(across, up, links, chain)
    size = math.hypot(gap[0], gap[1])
    for _ in range(_STEPS):
        if size <= _CLOSED * length:
            break
        scale = slopes[0] * slopes[2] - slopes[1] * slopes[1]
        if not scale > 0.0:
            break
        step = (
            (slopes[1] * gap[1] - slopes[2] * gap[0]) / scale,
            (slopes[1] * gap[0] - slopes[0] * gap[1]) / scale,
        )
        share = 1.0
        while share > 1e-6:
            level = max(across + share * step[0], 0.1 * across)
            moved, bent = _gap(level, up + share * step[1], links, chain)
            if math.hypot(moved[0], moved[1]) < size:
                break
            share *= 0.5
        if not math.hypot(moved[0], moved[1]) < size:
            break
        across, up, gap, slopes = level, up + share * step[1], moved, bent
        size = math.hypot(gap[0], gap[1])
    along = height = 0.0
    for i in range(links + 1):
        for axis in range(2):
            joints[i, axis] = start[axis] + along / strand.span * (end[axis] - start[axis])
        joints[i, 2] = start[2] + height
        tension = math.hypot(across, up + i)
        along, height = along + link * across / tension, height + link * (up + i) / tension
    for axis in range(3):
        joints[links, axis] = end[axis]
    return size <= 1e3 * _CLOSED * length


@inner
def _gap(
    across: float, up: float, links: int, chain: tuple[float, float, float]
) -> tuple[tuple[float, float], tuple[float, float, float]]:
    """Return how far the last joint is beyond the end, level and up, and the derivatives of that
    by the tensions of the first link: level by level, level by up, up by up."""
    link, span, rise = chain
    x, z, xx, xz, zz = -span, -rise, 0.0, 0.0, 0.0
    for i in range(links):
        size = math.hypot(across, up + i)
        cosine, sine = across / size, (up + i) / size
        x, z = x + link * cosine, z + link * sine
        xx += link * sine * sine / size
        xz -= link * cosine * sine / size
        zz += link * cosine * cosine / size
    return (x, z), (xx, xz, zz)
