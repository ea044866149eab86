"""Upper bounds of figures of a strand over all its shapes, from their values at nodes.

A shape is the chord as a share of the length, and the chord's elevation; the third coordinate is
the point on the strand. Between the nodes of a cell a figure is at most the largest at its corners
and, for each coordinate, h²/8 times the largest second derivative (h the step), the remainder of
linear interpolation. The second derivatives are divided differences at the corners, twice: that
they do not change by more within a step is what the tests search for exceptions of.

In these coordinates figures are smooth everywhere: log(ρ / (1 − ρ)) for the ratio ρ; for the
elevation of the chord its steepness, arsinh of its slope; and for the point the mean of its shares
of the length, of the inclination by which the strand turns, and of θ (sinh θ is its slope). So the
steps are small in a bend and beside it, too, however narrow it is.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary_kernel import solve
from swarm.geometry.catenary_shape import SMALLEST_HALF_ANGLE
from swarm.jit import compiled
from swarm.signatures import Floats1, Floats3

Floats = npt.NDArray[np.float64]


class Nodes(NamedTuple):
    """Points of strands of length 1, by chord ratio, steepness and point: angle θ and fraction.

    ``ratio`` (r,), ``steepness`` (e,), ``angle`` and ``fraction`` (r, e, p); the first and the last
    angle are those of the ends.
    """

    ratio: Floats1
    steepness: Floats1
    angle: Floats3
    fraction: Floats3


def nodes_of(ratio: Floats, steepness: Floats, steps: int) -> Nodes:
    """Return nodes for increasing chord ratios and steepnesses, with ``steps`` along a strand."""
    nodes = Nodes(ratio, steepness, *np.empty((2, len(ratio), len(steepness), steps + 1)))
    _place_nodes(nodes)
    return nodes


@compiled
def _place_nodes(nodes: Nodes) -> None:
    """Write angles and fractions: Newton's method from one point to the next."""
    steps = nodes.angle.shape[2] - 1
    for i in range(len(nodes.ratio)):
        for j in range(len(nodes.steepness)):
            span = nodes.ratio[i] / np.cosh(nodes.steepness[j])
            rise = nodes.ratio[i] * np.tanh(nodes.steepness[j])
            half, a, slope = solve(span, rise, 1.0, SMALLEST_HALF_ANGLE)
            first = np.arcsinh(slope)
            angle, fraction = nodes.angle[i, j], nodes.fraction[i, j]
            level, turned = np.arcsin(np.tanh(first)), np.arcsin(np.tanh(first + 2.0 * half))
            theta = first
            for k in range(1, steps):
                for _ in range(3):
                    inclined = (np.arcsin(np.tanh(theta)) - level) / (turned - level)
                    shares = 0.5 * (theta - first) / half + a * (np.sinh(theta) - slope) + inclined
                    cosh = np.cosh(theta)
                    rate = 0.5 / half + a * cosh + 1.0 / (cosh * (turned - level))
                    theta += (3.0 * k / steps - shares) / rate
                angle[k], fraction[k] = theta, a * (np.sinh(theta) - slope)
            angle[0], fraction[0] = first, 0.0
            angle[steps], fraction[steps] = first + 2.0 * half, 1.0


def bounds_over_cells(nodes: Nodes, figure: Floats, parts: int) -> Floats:
    """Return upper bounds (r − 1, e − 1, parts) of a figure between adjacent nodes.

    ``figure`` (r, e, p) holds its values at the nodes; ``parts`` is the number of equal
    parts of the strand.
    """
    ratio = np.log(nodes.ratio / (1.0 - nodes.ratio))
    steps = ratio, nodes.steepness, np.arange(float(figure.shape[2]))
    bounds = _over_corners(figure, np.maximum)
    for axis, at in enumerate(steps):
        bounds += _over_corners(_remainder(figure, at, axis), np.maximum, axis)
    begin = _over_corners(nodes.fraction, np.minimum)
    end = _over_corners(nodes.fraction, np.maximum)
    found = np.zeros((*bounds.shape[:2], parts))
    _write_parts(bounds, begin, end, found)
    return found


def _over_corners(values: Floats, extreme: np.ufunc, done: int | None = None) -> Floats:
    """Return the extremes over the corners of every cell, but for an axis that is ``done``."""
    for axis in range(3):
        if axis != done:
            values = np.moveaxis(values, axis, 0)
            values = np.moveaxis(extreme(values[:-1], values[1:]), 0, axis)
    return values


def _remainder(figure: Floats, at: Floats, axis: int) -> Floats:
    """Return the remainder of interpolation in every step along an axis, with nodes ``at``."""
    values = np.moveaxis(figure, axis, 0)
    width = np.diff(at)[:, None, None]
    slope = np.diff(values, axis=0) / width
    second = np.abs(2.0 * np.diff(slope, axis=0) / (width[:-1] + width[1:]))
    around = np.concatenate([second[:1], second, second[-1:]])
    remainder = 2.0 * width**2 / 8.0 * np.maximum(around[:-1], around[1:])
    return np.moveaxis(remainder, 0, axis)


@compiled
def _write_parts(bounds: Floats3, begin: Floats3, end: Floats3, found: Floats3) -> None:
    """Write the largest bounds (r, e, parts) of the cells that reach into each part."""
    parts = found.shape[2]
    for i in range(bounds.shape[0]):
        for j in range(bounds.shape[1]):
            for k in range(bounds.shape[2]):
                first = min(int(begin[i, j, k] * parts), parts - 1)
                last = min(max(int(np.ceil(end[i, j, k] * parts)) - 1, first), parts - 1)
                for part in range(first, last + 1):
                    found[i, j, part] = max(found[i, j, part], bounds[i, j, k])
