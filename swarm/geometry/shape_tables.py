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

import hashlib
import io
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.errors import InputError
from swarm.files import read_bytes, write_bytes
from swarm.geometry.catenary_kernel import solve
from swarm.geometry.catenary_shape import SMALLEST_HALF_ANGLE
from swarm.jit import cache, compiled, key
from swarm.signatures import Floats1, Floats3

Floats = npt.NDArray[np.float64]


_LARGEST_TABLE = 2**26
"""Bytes of a table that is read: those of the sensitivity are 13 MB."""


def kept(file: str, name: str, compute: Callable[[], Floats]) -> Floats:
    """Return a computed table that depends on the sources of a file alone, from the user's cache.

    It is kept as the file's machine code is, for the same sources, compiler and processor, and as
    that computed where it is not kept or cannot be. Its digest shows what was damaged since.
    """
    try:
        path = cache() / key(file) / f"{name}.table"
    except OSError:  # the file has changed
        return compute()
    with suppress(InputError):
        digest, _, contents = read_bytes(path, _LARGEST_TABLE).partition(b"\n")
        if digest == hashlib.sha256(contents).hexdigest().encode():
            found: Floats = np.load(io.BytesIO(contents), allow_pickle=False)
            return found
    found, written = compute(), io.BytesIO()
    np.save(written, found)
    contents = written.getvalue()
    with suppress(InputError, OSError):  # where the cache is not writable
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, hashlib.sha256(contents).hexdigest().encode() + b"\n" + contents)
    return found


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
            theta, sinh = first, np.sinh(first)
            for k in range(1, steps):
                for _ in range(3):
                    inclined = (np.arcsin(np.tanh(theta)) - level) / (turned - level)
                    shares = 0.5 * (theta - first) / half + a * (sinh - slope) + inclined
                    cosh = np.cosh(theta)
                    rate = 0.5 / half + a * cosh + 1.0 / (cosh * (turned - level))
                    theta += (3.0 * k / steps - shares) / rate
                    sinh = np.sinh(theta)
                angle[k], fraction[k] = theta, a * (sinh - slope)
            angle[0], fraction[0] = first, 0.0
            angle[steps], fraction[steps] = first + 2.0 * half, 1.0


def bounds_over_cells(nodes: Nodes, figure: Floats, parts: int) -> Floats:
    """Return upper bounds (r − 1, e − 1, parts) of a figure between adjacent nodes.

    ``figure`` (r, e, p) holds its values at the nodes; ``parts`` is the number of equal
    parts of the strand.
    """
    rows, columns, points = figure.shape
    ratio = np.log(nodes.ratio / (1.0 - nodes.ratio))
    by_ratio, by_steepness, by_point = (
        _remainder(figure, at, axis)
        for axis, at in enumerate((ratio, nodes.steepness, np.arange(float(points))))
    )
    found = np.zeros((rows - 1, columns - 1, parts))
    _write_parts(figure, by_ratio, by_steepness, by_point, nodes.fraction, found)
    return found


def _remainder(figure: Floats, at: Floats, axis: int) -> Floats:
    """Return the remainder of interpolation in every step along an axis, with nodes ``at``."""
    count, shape = len(at), list(figure.shape)
    shape[axis] -= 1
    found = np.empty(shape)
    inside = int(np.prod(shape[axis + 1 :]))
    _write_remainder(
        figure.reshape(-1, count, inside), np.diff(at), found.reshape(-1, count - 1, inside)
    )
    return found


@compiled
def _write_remainder(figure: Floats3, width: Floats1, found: Floats3) -> None:
    """Write the remainder in every step along the second axis, of steps with widths.

    The second derivative in a step is the larger of those at both of its nodes; the first and the
    last node have that of their neighbour.
    """
    last = len(width) - 1
    for i in range(figure.shape[0]):
        for j in range(1, last + 1):
            for k in range(figure.shape[2]):
                after = (figure[i, j + 1, k] - figure[i, j, k]) / width[j]
                before = (figure[i, j, k] - figure[i, j - 1, k]) / width[j - 1]
                found[i, j, k] = abs(2.0 * (after - before) / (width[j - 1] + width[j]))
        for k in range(figure.shape[2]):
            found[i, 0, k] = found[i, 1, k]
        # found[j] is the second derivative at node j, and then the remainder of the step after it.
        for j in range(last + 1):
            factor = 2.0 * width[j] ** 2 / 8.0
            for k in range(figure.shape[2]):
                found[i, j, k] = factor * max(found[i, j, k], found[i, min(j + 1, last), k])


@compiled
def _write_parts(
    figure: Floats3, by_ratio: Floats3, by_steepness: Floats3, by_point: Floats3,
    fraction: Floats3, found: Floats3,
) -> None:  # fmt: skip
    """Write the largest bounds (r − 1, e − 1, parts) of the cells that reach into each part.

    The bound of a cell is the largest figure at its corners and, for each coordinate, the largest
    remainder at the four edges along it.
    """
    parts = found.shape[2]
    for i in range(found.shape[0]):
        for j in range(found.shape[1]):
            for k in range(figure.shape[2] - 1):
                most = ratio = steepness = point = end = 0.0
                begin = 1.0
                for a in (i, i + 1):
                    for b in (j, j + 1):
                        point = max(point, by_point[a, b, k])
                        begin = min(begin, fraction[a, b, k])
                        end = max(end, fraction[a, b, k + 1])
                        for c in (k, k + 1):
                            most = max(most, figure[a, b, c])
                for c in (k, k + 1):
                    for b in (j, j + 1):
                        ratio = max(ratio, by_ratio[i, b, c])
                    for a in (i, i + 1):
                        steepness = max(steepness, by_steepness[a, j, c])
                bound = most + ratio + steepness + point
                first = min(int(begin * parts), parts - 1)
                last = min(max(int(np.ceil(end * parts)) - 1, first), parts - 1)
                for part in range(first, last + 1):
                    found[i, j, part] = max(found[i, j, part], bound)
