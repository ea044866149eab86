"""Cost of a team's clearances at sampled moments, with its derivatives; compiled.

Every distance that must be kept has a *slack*: what it has beyond its need. The slack costs a
barrier (:func:`barrier`), which grows without limit towards 0 and ends smoothly at a range. The
cost has a gradient, and a Gauss-Newton matrix: its second derivative without those of distances.

Distances of strands change with their ends by the exact derivative of the catenary (the response
``B`` of :mod:`swarm.geometry.sensitivity`), and needs by tracking errors to first order in it.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary import solve_catenary
from swarm.geometry.distance import Vector, segment_distance
from swarm.geometry.solids import plane_beside
from swarm.jit import compiled, inner
from swarm.signatures import Floats1, Floats2, Floats3, Floats4, Ints1

Floats = npt.NDArray[np.float64]

RANGE, RELAXED = 0.6, 0.015
"""Metres of slack at which a barrier ends, and below which it continues as a parabola."""

_CHORD_RANGE, _STEEP_RANGE, _DISC_RANGE = 0.3, 0.5, 0.15
"""The same ends for chords, for the steepness of strands, and for rotor discs: metres."""

_STEEPEST = 0.45
"""Largest difference of heights of a strand's ends over its length: steeper ones swing farther."""

_DISC = 0.42
"""Metres from a rotor disc's centre to its own strands, for a disc of 0.25 m 0.6 m above them."""

_PART = 0.2
"""Weight of a pair of pieces of strands: about five are near each other at a crossing."""

_FLAT = 1e-9
"""Determinant of K(ℓ) below which a strand's response counts as that of a straight line."""


class Walls(NamedTuple):
    """What bounds the workspace, or stands in it: solids for vehicles, and solids for strands.

    Grip points keep ``inside`` (q,) metres from the ``grown`` solids (q, 12), and the middles of
    strands ``beside`` (r,) metres from ``solids`` (r, 12).
    """

    grown: Floats2
    solids: Floats2
    inside: Floats1
    beside: Floats1


class Team(NamedTuple):
    """What all moments share: ``lengths`` (m,), ``walls``, and distances in metres.

    ``exempt`` is the length of cable beside a shared vehicle that is not compared, ``tracking`` the
    tracking radius, ``offset`` the height of a vehicle's centre above its grip point, ``chord`` the
    largest chord over length, and ``taut`` by how much less it is. ``cable`` and ``body`` are
    required between the middles of two strands, and of a strand and a vehicle's centre, ``floor``
    below a strand, ``aside`` or ``above`` between two vehicles. ``tilt`` is that of the effective
    gravity in the mission's wind.
    """

    lengths: Floats1
    walls: Walls
    exempt: float
    tracking: float
    offset: float
    chord: float
    taut: float
    cable: float
    body: float
    floor: float
    aside: float
    above: float
    tilt: float


class Needs(NamedTuple):
    """Needed distances at s moments, metres: of strands (s, m, m), of vehicles and strands
    (s, n, m), of the lowest points of strands (s, m) from the floor, of vehicles (s, q) from
    walls, of strands (s, m) from them beyond :attr:`Walls.beside`, and of vehicles beside each
    other or above each other (s, n, n), of which either is enough; and by how much chords are
    shorter than the longest (s,)."""

    strands: Floats3
    bodies: Floats3
    floor: Floats2
    inside: Floats2
    beside: Floats2
    aside: Floats3
    above: Floats3
    taut: Floats1


class ShownNeeds(NamedTuple):
    """What a moment shows: needs by the tracking errors at its team, and distances of strands.

    As in :class:`Needs`; ``distances`` (s, m, m) are 9 where strands are far apart, ``sags``
    (s, m) metres below the chord; ``missed`` (s,) the largest missed need, metres.
    """

    strands: Floats3
    bodies: Floats3
    floor: Floats2
    beside: Floats2
    distances: Floats3
    sags: Floats2
    missed: Floats1


class Memory(NamedTuple):
    """Points of strands (m, p, 3), their responses (m, p, 5), boxes around them (m, 6), and sags.

    They are those of the pose before where both ends are; otherwise ``written`` (m,) is 1 for
    strands whose points are those of the pose: of others, which are not near anything that counts,
    only a box is. ``place`` (n, 3) is that pose, ``moved`` (n,) 1 for vehicles that the pose before
    had elsewhere.
    """

    place: Floats2
    moved: Ints1
    points: Floats3
    responses: Floats3
    boxes: Floats2
    sags: Floats1
    written: Ints1


class Derivatives(NamedTuple):
    """Gradient (3n,) and Gauss-Newton matrix (3n, 3n) of a pose's cost by the vehicles' positions;
    the matrix times how these change with the duration, ``pushed`` (3n,); and memory for a term's
    derivatives, ``by`` (4, 3), and the ``weights`` (6, 3n) of splines."""

    gradient: Floats1
    matrix: Floats2
    pushed: Floats1
    by: Floats2
    weights: Floats2

    @staticmethod
    def zeros(vehicles: int, splines: int) -> "Derivatives":
        """Return derivatives of a cost of 0."""
        size = 3 * vehicles
        return Derivatives(
            np.zeros(size), np.zeros((size, size)), np.zeros(size), np.zeros((4, 3)),
            np.zeros((splines, size)),
        )  # fmt: skip


class Poses(NamedTuple):
    """Poses of a team at s moments, with the rows (s,) of its needs there.

    One for each of ``apart`` (w,): all vehicles are at their ``places`` (s, n, 3), but that one is
    at its place in ``elsewhere`` (s, n, 3), and only what involves it counts. For −1 all are
    elsewhere, and everything counts. Barriers end at ``range`` metres, and cost ``weight`` times as
    much; they are parabolas below ``relaxed`` metres.
    """

    places: Floats3
    elsewhere: Floats3
    apart: Ints1
    rows: Ints1
    range: float
    weight: float
    relaxed: float


class Splines(NamedTuple):
    """What moves the poses of a team: of both places, six splines next to each other.

    Shares (s, 6) of splines, which are those of all vehicles, the number (s,) of the first one, and
    how places change (s, n, 3) with the logarithm of the duration; elsewhere, shares (s, n, 6).
    """

    shares: Floats2
    first: Ints1
    longer: Floats3
    shares_elsewhere: Floats3
    first_elsewhere: Ints1
    longer_elsewhere: Floats3


class Sums(NamedTuple):
    """Derivatives of a cost by control points and the duration, to which those of poses are added.

    ``gradient`` (k, 3n); the Gauss-Newton matrix (k·3n, k·3n), of which a lower ``band`` (k·3n, h)
    is kept: row r, column c in ``band[c, r − c]``; ``mixed`` (k, 3n) by control points and the
    logarithm of the duration; and by that alone, once and twice: ``by_duration`` (2,).
    """

    gradient: Floats2
    band: Floats2
    mixed: Floats2
    by_duration: Floats1


class _At(NamedTuple):
    """A pose: the row of its needs, its barriers, and whether to derive."""

    row: int
    range: float
    weight: float
    relaxed: float
    derive: bool


@inner
def barrier(slack: float, end: float, relaxed: float) -> tuple[float, float, float]:
    """Return value, slope and curvature of the barrier of a slack.

    −log(x) with x = slack / end, less its expansion to second order at 1, so that it ends there
    with two derivatives; below ``relaxed`` it continues as the parabola with the same derivatives.
    """
    if slack >= end:
        return 0.0, 0.0, 0.0
    held = max(slack, relaxed)
    beyond = held / end - 1.0
    value = -np.log(held / end) + beyond - 0.5 * beyond * beyond
    slope = -1.0 / held + 1.0 / end - beyond / end
    curvature = 1.0 / (held * held) - 1.0 / (end * end)
    below = min(slack - relaxed, 0.0)
    value += below * (slope + 0.5 * curvature * below)
    return value, slope + curvature * below, curvature


@inner
def _write_strand(
    start: Floats, end: Floats, length: float, points: Floats, response: Floats
) -> float:
    """Write points (p, 3) of a strand at equal lengths, and their responses (p, 5); return its sag.

    The response is B by the far end: along the heading by ahead and up, upward by ahead and up, and
    across; see :mod:`swarm.geometry.sensitivity`.
    """
    strand = solve_catenary(start, end, length)
    east, north = end[0] - start[0], end[1] - start[1]
    level = np.sqrt(east * east + north * north)
    east, north = (east / level, north / level) if level > 1e-9 else (1.0, 0.0)
    low, turn = strand.slope, length / strand.parameter
    high = low + turn
    cosh_low, cosh_high = np.sqrt(1.0 + low * low), np.sqrt(1.0 + high * high)
    first = np.arcsinh(low)
    whole = np.arcsinh(high) - first
    tanh, sech = high / cosh_high - low / cosh_low, 1.0 / cosh_high - 1.0 / cosh_low
    bent = whole - tanh
    determinant = bent * tanh - sech * sech
    straight = determinant < _FLAT
    last, sag = len(points) - 1, 0.0
    for k in range(last + 1):
        share = k / last
        slope = low + share * turn
        cosh = np.sqrt(1.0 + slope * slope)
        angle = np.arcsinh(slope) - first
        along, up = strand.parameter * angle, strand.parameter * (cosh - cosh_low)
        points[k, 0] = start[0] + along * east
        points[k, 1] = start[1] + along * north
        points[k, 2] = start[2] + up
        sag = max(sag, share * strand.rise - up)
        here = slope / cosh - low / cosh_low
        cross = 1.0 / cosh - 1.0 / cosh_low
        turned = angle - here
        response[k, 4] = angle / whole
        if straight:
            response[k, 0] = response[k, 3] = share
            response[k, 1] = response[k, 2] = 0.0
        else:
            response[k, 0] = (turned * tanh - cross * sech) / determinant
            response[k, 1] = (cross * bent - turned * sech) / determinant
            response[k, 2] = (cross * tanh - here * sech) / determinant
            response[k, 3] = (here * bent - cross * sech) / determinant
    return sag


@inner
def _by_end(
    start: Floats, end: Floats, response: Floats, piece: tuple[int, float], direction: Vector
) -> Vector:
    """Return the derivative by a strand's far end of a point's movement along a direction.

    The point is a share of the way along a piece. By the near end it is the rest of the direction.
    """
    k, part = piece
    east, north = end[0] - start[0], end[1] - start[1]
    level = np.sqrt(east * east + north * north)
    east, north = (east / level, north / level) if level > 1e-9 else (1.0, 0.0)
    ahead, up = direction[0] * east + direction[1] * north, direction[2]
    rest = 1.0 - part
    a0 = rest * response[k, 0] + part * response[k + 1, 0]
    a1 = rest * response[k, 1] + part * response[k + 1, 1]
    a2 = rest * response[k, 2] + part * response[k + 1, 2]
    a3 = rest * response[k, 3] + part * response[k + 1, 3]
    a4 = rest * response[k, 4] + part * response[k + 1, 4]
    along = ahead * a0 + up * a2
    return (
        along * east + a4 * (direction[0] - ahead * east),
        along * north + a4 * (direction[1] - ahead * north),
        ahead * a1 + up * a3,
    )


@inner
def _depth(start: Floats, end: Floats, height: float, share: float) -> float:
    """Return how far a point at a share of a strand is below its chord."""
    return float(start[2] + share * (end[2] - start[2]) - height)


@inner
def _add(
    derivatives: Derivatives, at: _At, vehicles: tuple[int, int, int, int], count: int,
    slope: float, curvature: float,
) -> None:  # fmt: skip
    """Add a cost whose argument has the derivative ``by`` by ``count`` vehicles."""
    gradient, matrix, by = derivatives.gradient, derivatives.matrix, derivatives.by
    slope, curvature = at.weight * slope, at.weight * curvature
    for a in range(count):
        row = 3 * vehicles[a]
        for x in range(3):
            gradient[row + x] += slope * by[a, x]
            scaled = curvature * by[a, x]
            for b in range(count):
                column = 3 * vehicles[b]
                for y in range(3):
                    matrix[row + x, column + y] += scaled * by[b, y]


@inner
def _between(
    first: Floats, here: tuple[int, float], second: Floats, there: tuple[int, float], size: float
) -> Vector:
    """Return the vector to a point of one polygon from one of another, over its size."""
    (a, p), (b, q) = here, there
    step = (
        first[a, 0] + p * (first[a + 1, 0] - first[a, 0]),
        first[a, 1] + p * (first[a + 1, 1] - first[a, 1]),
        first[a, 2] + p * (first[a + 1, 2] - first[a, 2]),
    )
    return (
        (step[0] - second[b, 0] - q * (second[b + 1, 0] - second[b, 0])) / size,
        (step[1] - second[b, 1] - q * (second[b + 1, 1] - second[b, 1])) / size,
        (step[2] - second[b, 2] - q * (second[b + 1, 2] - second[b, 2])) / size,
    )


@inner
def _size(vector: Vector) -> float:
    return float(np.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]))


@inner
def _less(first: Vector, second: Vector) -> Vector:
    return first[0] - second[0], first[1] - second[1], first[2] - second[2]


@inner
def _set(by: Floats, row: int, vector: Vector, sign: float) -> None:
    by[row, 0], by[row, 1], by[row, 2] = sign * vector[0], sign * vector[1], sign * vector[2]


@inner
def _write_box(points: Floats, box: Floats) -> None:
    """Write the lowest and highest coordinates (6,) of points (p, 3)."""
    for x in range(3):
        box[x] = box[x + 3] = points[0, x]
        for k in range(1, len(points)):
            box[x] = min(box[x], points[k, x])
            box[x + 3] = max(box[x + 3], points[k, x])


@inner
def _write_bounds(start: Floats, end: Floats, length: float, box: Floats) -> None:
    """Write a box (6,) around a strand of a length, from its ends alone.

    Its lowest point is no farther below the lower end than that of a triangle of the same length.
    """
    for x in range(3):
        box[x], box[x + 3] = min(start[x], end[x]), max(start[x], end[x])
    east, north = end[0] - start[0], end[1] - start[1]
    box[2] -= 0.5 * np.sqrt(max(length * length - east * east - north * north, 0.0))


@inner
def _begin_pose(s: int, only: int, begun: bool, poses: Poses, team: Team, memory: Memory) -> None:
    """Write a pose, and boxes around the strands that have other ends than in the pose before."""
    for k in range(len(memory.place)):
        place = poses.elsewhere[s, k] if only < 0 or only == k else poses.places[s, k]
        memory.moved[k] = 0 if begun else 1
        for x in range(3):
            if place[x] != memory.place[k, x]:
                memory.moved[k] = 1
            memory.place[k, x] = place[x]
    for i in range(len(team.lengths)):
        if memory.moved[i] + memory.moved[i + 1] > 0:
            memory.written[i] = 0
            _write_bounds(memory.place[i], memory.place[i + 1], team.lengths[i], memory.boxes[i])


@inner
def _require_strand(
    i: int, at: _At, place: Floats, team: Team, record: ShownNeeds, memory: Memory
) -> None:
    """Write a strand's points, responses, box and sag, if they are not those of the pose."""
    if memory.written[i] == 0:
        memory.sags[i] = _write_strand(
            place[i], place[i + 1], team.lengths[i], memory.points[i], memory.responses[i]
        )
        _write_box(memory.points[i], memory.boxes[i])
        memory.written[i] = 1
    record.sags[at.row, i] = memory.sags[i]


@inner
def _gap(boxes: Floats, i: int, j: int) -> float:
    """Return a lower bound of the distance of the boxes around two strands."""
    gap = 0.0
    for x in range(3):
        gap = max(gap, boxes[i, x] - boxes[j, x + 3], boxes[j, x] - boxes[i, x + 3])
    return gap


@compiled
def add_clearances(
    poses: Poses, team: Team, needs: Needs, record: ShownNeeds, memory: Memory, splines: Splines,
    sums: Sums, derivatives: Derivatives, shared: Derivatives, derive: bool,
) -> float:  # fmt: skip
    """Return the cost of all clearances of poses, and write what each row of needs shows.

    With ``derive``, add the derivatives by control points and the duration; ``derivatives`` and
    ``shared`` are 0 before and after.
    """
    cost, weights = 0.0, derivatives.weights
    for s in range(len(poses.places)):
        at = _At(poses.rows[s], poses.range, poses.weight, poses.relaxed, derive)
        for w in range(len(poses.apart)):
            only = poses.apart[w]
            if only < 0:
                record.missed[at.row] = 0.0
            _begin_pose(s, only, s + w > 0, poses, team, memory)
            cost += _pose(at, only, memory.place, team, needs, record, memory, derivatives)
            if derive:
                _push(s, only, splines, derivatives, sums.by_duration)
                if only < 0:
                    for k in range(len(memory.place)):
                        _set_weights(weights, k, splines.shares_elsewhere[s, k])
                    _add_to_sums(derivatives, weights, splines.first_elsewhere[s], sums)
                else:
                    _add_apart(s, only, derivatives, splines, sums)
                    _add_to_shared(derivatives, shared)
        if derive and poses.apart[-1] >= 0:
            # vehicles at their places have the same splines in all of these poses
            for k in range(len(memory.place)):
                _set_weights(weights, k, splines.shares[s])
            _add_to_sums(shared, weights, splines.first[s], sums)
    return poses.weight * cost


@inner
def _set_weights(weights: Floats, vehicle: int, shares: Floats) -> None:
    for a in range(len(shares)):
        for x in range(3 * vehicle, 3 * vehicle + 3):
            weights[a, x] = shares[a]


@inner
def _push(
    s: int, only: int, splines: Splines, derivatives: Derivatives, by_duration: Floats
) -> None:
    """Add the matrix times how places change with the duration to what is pushed; and their own
    derivatives."""
    gradient, matrix, pushed = derivatives.gradient, derivatives.matrix, derivatives.pushed
    for r in range(len(gradient)):
        elsewhere = only < 0 or only == r // 3
        longer = splines.longer_elsewhere if elsewhere else splines.longer
        change = longer[s, r // 3, r % 3]
        if change != 0.0:
            by_duration[0] += gradient[r] * change
            for c in range(len(gradient)):
                pushed[c] += matrix[r, c] * change
    for r in range(len(gradient)):
        elsewhere = only < 0 or only == r // 3
        longer = splines.longer_elsewhere if elsewhere else splines.longer
        by_duration[1] += pushed[r] * longer[s, r // 3, r % 3]


@inner
def _add_to_sums(derivatives: Derivatives, weights: Floats, first: int, sums: Sums) -> None:
    """Add derivatives by the ``weights`` (6, 3n) of splines, and set them to 0."""
    gradient, matrix, pushed = derivatives.gradient, derivatives.matrix, derivatives.pushed
    for a in range(len(weights)):
        for r in range(len(gradient)):
            sums.gradient[first + a, r] += weights[a, r] * gradient[r]
            sums.mixed[first + a, r] += weights[a, r] * pushed[r]
    _add_to_band(matrix, weights, first, sums.band)
    gradient[:] = 0.0
    matrix[:] = 0.0
    pushed[:] = 0.0


@inner
def _add_to_shared(derivatives: Derivatives, shared: Derivatives) -> None:
    """Add derivatives to those that poses share, and set them to 0."""
    for r in range(len(derivatives.gradient)):
        shared.gradient[r] += derivatives.gradient[r]
        shared.pushed[r] += derivatives.pushed[r]
        for c in range(len(derivatives.gradient)):
            shared.matrix[r, c] += derivatives.matrix[r, c]
            derivatives.matrix[r, c] = 0.0
        derivatives.gradient[r] = derivatives.pushed[r] = 0.0


@inner
def _add_to_band(matrix: Floats, weights: Floats, first: int, band: Floats) -> None:
    """Add a symmetric matrix (3n, 3n) to a band by the ``weights`` (6, 3n) of splines."""
    many, size = weights.shape
    for b in range(many):
        for c in range(size):
            column, scale = (first + b) * size + c, weights[b, c]
            for a in range(b, many):
                below = (a - b) * size - c
                for r in range(c if a == b else 0, size):
                    band[column, below + r] += scale * weights[a, r] * matrix[c, r]


@inner
def _add_apart(s: int, k: int, derivatives: Derivatives, splines: Splines, sums: Sums) -> None:
    """Add the derivatives by the vehicle that is elsewhere, and set them to 0."""
    gradient, matrix, pushed = derivatives.gradient, derivatives.matrix, derivatives.pushed
    for a in range(splines.shares.shape[1]):
        row, share = splines.first_elsewhere[s] + a, splines.shares_elsewhere[s, k, a]
        for x in range(3 * k, 3 * k + 3):
            sums.gradient[row, x] += share * gradient[x]
            sums.mixed[row, x] += share * pushed[x]
    for j in range(len(gradient) // 3):
        touched = 0.0
        for x in range(3 * k, 3 * k + 3):
            for y in range(3 * j, 3 * j + 3):
                touched += abs(matrix[x, y])
        if touched > 0.0:
            _add_pair(s, k, j, matrix, splines, sums.band)
    for x in range(3 * k, 3 * k + 3):
        gradient[x] = pushed[x] = 0.0
        for c in range(len(gradient)):
            matrix[x, c] = matrix[c, x] = 0.0


@inner
def _add_pair(s: int, k: int, j: int, matrix: Floats, splines: Splines, band: Floats) -> None:
    """Add what couples the vehicle that is elsewhere with itself or another one."""
    size, many = len(matrix), splines.shares.shape[1]
    first = splines.first_elsewhere[s]
    for a in range(many):
        for b in range(many):
            share, first_of_j = splines.shares[s, b], splines.first[s]
            if j == k:
                share, first_of_j = splines.shares_elsewhere[s, k, b], first
            factor = splines.shares_elsewhere[s, k, a] * share
            for x in range(3 * k, 3 * k + 3):
                for y in range(3 * j, 3 * j + 3):
                    row, column = (first + a) * size + x, (first_of_j + b) * size + y
                    if row >= column:
                        band[column, row - column] += factor * matrix[x, y]
                    elif j != k:
                        band[row, column - row] += factor * matrix[x, y]


@inner
def _pose(
    at: _At, only: int, place: Floats, team: Team, needs: Needs, record: ShownNeeds, memory: Memory,
    derivatives: Derivatives,
) -> float:  # fmt: skip
    strands = len(team.lengths)
    cost = 0.0  # calls pass all arrays by value, so that there is none for what is far apart
    for i in range(strands):
        if only < 0 or only in (i, i + 1):
            cost += _strand_alone(at, i, place, team, needs, record, memory, derivatives)
            cost += _beside_walls(at, i, place, team, needs, record, memory, derivatives)
        for j in range(i + 1, strands):
            if only < 0 or only in (i, i + 1, j, j + 1):
                record.strands[at.row, i, j], record.distances[at.row, i, j] = 0.0, 9.0
                need = needs.strands[at.row, i, j]
                if _gap(memory.boxes, i, j) <= need + at.range:
                    cost += _strands(at, i, j, need, place, team, record, memory, derivatives)
    for i in range(strands + 1):
        if only < 0 or only == i:
            cost += _within_walls(at, i, place, team, needs, record, derivatives)
        for j in range(i + 1, strands + 1):
            if only < 0 or only in (i, j):
                cost += _vehicles(at, i, j, place, needs.aside, needs.above, record, derivatives)
        for j in range(strands):
            if only < 0 or only in (i, j, j + 1):
                record.bodies[at.row, i, j] = 0.0
                own = i in (j, j + 1)
                need = _DISC if own else needs.bodies[at.row, i, j]
                end = _DISC_RANGE if own else at.range
                if not _outside(place[i], team.offset, memory.boxes[j], need + end):
                    bounds = need, end
                    cost += _bodies(at, i, j, bounds, place, team, record, memory, derivatives)
    return cost


@inner
def _are_near(
    i: int, j: int, reach: float, at: _At, place: Floats, team: Team, record: ShownNeeds,
    memory: Memory,
) -> bool:  # fmt: skip
    """Return whether two strands may be nearer than ``reach``; then both are written."""
    for k in (i, j):
        _require_strand(k, at, place, team, record, memory)
        if _gap(memory.boxes, i, j) > reach:
            return False
    return True


@inner
def _strands(
    at: _At, i: int, j: int, need: float, place: Floats, team: Team, record: ShownNeeds,
    memory: Memory, derivatives: Derivatives,
) -> float:  # fmt: skip
    """Cost of two strands: of all pairs of their pieces that are near, but beside a shared grip."""
    if not _are_near(i, j, need + at.range, at, place, team, record, memory):
        return 0.0
    first, second = memory.points[i], memory.points[j]
    pieces, near = len(first) - 1, j == i + 1
    exempt = min(team.exempt, 0.5 * team.lengths[i], 0.5 * team.lengths[j])
    half = 0.5 * (team.lengths[i] + team.lengths[j]) / pieces
    far = 4.0 * (need + at.range + half) ** 2
    cost, best = 0.0, np.inf
    for a in range(pieces):
        beside_a = near and team.lengths[i] * (pieces - a) / pieces <= exempt
        # no point of a piece is farther from its first one than its length
        if _outside(first[a], 0.0, memory.boxes[j], need + at.range + team.lengths[i] / pieces):
            continue
        for b in range(pieces):
            if beside_a or (near and team.lengths[j] * (b + 1) / pieces <= exempt):
                continue
            x = first[a, 0] + first[a + 1, 0] - second[b, 0] - second[b + 1, 0]
            y = first[a, 1] + first[a + 1, 1] - second[b, 1] - second[b + 1, 1]
            z = first[a, 2] + first[a + 1, 2] - second[b, 2] - second[b + 1, 2]
            if x * x + y * y + z * z > far:
                continue
            square, p, q = segment_distance(first, a, second, b)
            distance = max(np.sqrt(square), 1e-9)
            if distance >= need + at.range:
                continue
            normal = _between(first, (a, p), second, (b, q), distance)
            here = _by_end(place[i], place[i + 1], memory.responses[i], (a, p), normal)
            there = _by_end(place[j], place[j + 1], memory.responses[j], (b, q), normal)
            rest_here, rest_there = _less(normal, here), _less(normal, there)
            if distance < best:
                best = distance
                moved = _size(rest_here) + _size(there)
                if near:
                    moved += _size(_less(here, rest_there))
                else:
                    moved += _size(here) + _size(rest_there)
                # all strands lean alike: what hangs as deep moves as far
                deeper = _depth(
                    place[i], place[i + 1], first[a, 2] + p * (first[a + 1, 2] - first[a, 2]),
                    (a + p) / pieces,
                ) - _depth(
                    place[j], place[j + 1], second[b, 2] + q * (second[b + 1, 2] - second[b, 2]),
                    (b + q) / pieces,
                )  # fmt: skip
                record.strands[at.row, i, j] = (
                    team.cable + team.tracking * moved + team.tilt * abs(deeper)
                )
            value, slope, curvature = barrier(distance - need, at.range, at.relaxed)
            cost += _PART * value
            if at.derive:
                _set(derivatives.by, 0, rest_here, 1.0)
                _set(derivatives.by, 1, here, 1.0)
                _set(derivatives.by, 2, rest_there, -1.0)
                _set(derivatives.by, 3, there, -1.0)
                _add(derivatives, at, (i, i + 1, j, j + 1), 4, _PART * slope, _PART * curvature)
    if best < np.inf:
        record.distances[at.row, i, j] = best
        record.missed[at.row] = max(record.missed[at.row], need - best)
    return cost


@inner
def _vehicles(
    at: _At, i: int, j: int, place: Floats, aside: Floats, above: Floats, record: ShownNeeds,
    derivatives: Derivatives,
) -> float:  # fmt: skip
    """Cost of two vehicles: of their distance in plan view or in height, whichever misses less."""
    x, y, z = place[i, 0] - place[j, 0], place[i, 1] - place[j, 1], place[i, 2] - place[j, 2]
    level = max(np.sqrt(x * x + y * y), 1e-9)
    beside, over = level - aside[at.row, i, j], abs(z) - above[at.row, i, j]
    slack = max(beside, over)
    if slack >= at.range:
        return 0.0
    record.missed[at.row] = max(record.missed[at.row], -slack)
    value, slope, curvature = barrier(slack, at.range, at.relaxed)
    if at.derive:
        direction = (x / level, y / level, 0.0)
        if over > beside:
            direction = (0.0, 0.0, 1.0 if z > 0.0 else -1.0)
        _set(derivatives.by, 0, direction, 1.0)
        _set(derivatives.by, 1, direction, -1.0)
        _add(derivatives, at, (i, j, 0, 0), 2, slope, curvature)
    return value


@inner
def _outside(point: Floats, above: float, box: Floats, reach: float) -> bool:
    """Return whether what is ``above`` a point (3,) is farther than ``reach`` from a box (6,) along
    an axis."""
    x, y, z = point[0], point[1], point[2] + above
    return bool(
        x > box[3] + reach or y > box[4] + reach or z > box[5] + reach
        or x < box[0] - reach or y < box[1] - reach or z < box[2] - reach
    )  # fmt: skip


@inner
def _bodies(
    at: _At, i: int, j: int, bounds: tuple[float, float], place: Floats, team: Team,
    record: ShownNeeds, memory: Memory, derivatives: Derivatives,
) -> float:  # fmt: skip
    """Cost of a vehicle's body and a strand, or of its rotor disc and one that it holds.

    ``bounds`` are the need, and the slack at which the barrier ends.
    """
    need, end = bounds
    x, y, z = place[i, 0], place[i, 1], place[i, 2] + team.offset
    reach = need + end
    _require_strand(j, at, place, team, record, memory)
    if _outside(place[i], team.offset, memory.boxes[j], reach):
        return 0.0
    points, cost, best = memory.points[j], 0.0, np.inf
    for b in range(len(points) - 1):
        ax, ay, az = x - points[b, 0], y - points[b, 1], z - points[b, 2]
        ex = points[b + 1, 0] - points[b, 0]
        ey = points[b + 1, 1] - points[b, 1]
        ez = points[b + 1, 2] - points[b, 2]
        part = min(max((ax * ex + ay * ey + az * ez) / (ex * ex + ey * ey + ez * ez), 0.0), 1.0)
        ax, ay, az = ax - part * ex, ay - part * ey, az - part * ez
        distance = max(np.sqrt(ax * ax + ay * ay + az * az), 1e-9)
        if distance >= reach:
            continue
        normal = (ax / distance, ay / distance, az / distance)
        there = _by_end(place[j], place[j + 1], memory.responses[j], (b, part), normal)
        rest = _less(normal, there)
        if distance < best:
            best = distance
            deep = _depth(
                place[j], place[j + 1], points[b, 2] + part * ez, (b + part) / (len(points) - 1)
            )
            record.bodies[at.row, i, j] = (
                team.body + team.tracking * (1.0 + _size(there) + _size(rest)) + team.tilt * deep
            )
        value, slope, curvature = barrier(distance - need, end, at.relaxed)
        cost += _PART * value
        if at.derive:
            _set(derivatives.by, 0, normal, 1.0)
            _set(derivatives.by, 1, rest, -1.0)
            _set(derivatives.by, 2, there, -1.0)
            _add(derivatives, at, (i, j, j + 1, 0), 3, _PART * slope, _PART * curvature)
    if best < np.inf:
        record.missed[at.row] = max(record.missed[at.row], need - best)
    return cost


@inner
def _strand_alone(
    at: _At, i: int, place: Floats, team: Team, needs: Needs, record: ShownNeeds, memory: Memory,
    derivatives: Derivatives,
) -> float:  # fmt: skip
    """Cost of a strand's chord, its steepness, and its height above the floor."""
    along = (
        place[i + 1, 0] - place[i, 0], place[i + 1, 1] - place[i, 1], place[i + 1, 2] - place[i, 2]
    )  # fmt: skip
    chord = max(_size(along), 1e-9)
    slack = team.chord * team.lengths[i] - chord - needs.taut[at.row]
    cost, slope, curvature = barrier(slack, _CHORD_RANGE, 0.5 * at.relaxed)
    record.missed[at.row] = max(record.missed[at.row], -slack)
    if at.derive and cost > 0.0:
        direction = (along[0] / chord, along[1] / chord, along[2] / chord)
        _set(derivatives.by, 0, direction, 1.0)
        _set(derivatives.by, 1, direction, -1.0)
        _add(derivatives, at, (i, i + 1, 0, 0), 2, slope, curvature)
    value, slope, curvature = barrier(
        _STEEPEST * team.lengths[i] - abs(along[2]), _STEEP_RANGE, at.relaxed
    )
    cost += value
    if at.derive and value > 0.0:
        direction = (0.0, 0.0, 1.0 if along[2] > 0.0 else -1.0)
        _set(derivatives.by, 0, direction, 1.0)
        _set(derivatives.by, 1, direction, -1.0)
        _add(derivatives, at, (i, i + 1, 0, 0), 2, slope, curvature)
    _require_strand(i, at, place, team, record, memory)
    points = memory.points[i]
    lowest, up, last = 0, (0.0, 0.0, 1.0), len(points) - 2
    for k in range(1, last + 2):
        if points[k, 2] < points[lowest, 2]:
            lowest = k
    height = points[lowest, 2]
    lowest, part = (lowest, 0.0) if lowest <= last else (last, 1.0)
    there = _by_end(place[i], place[i + 1], memory.responses[i], (lowest, part), up)
    rest = _less(up, there)
    record.floor[at.row, i] = team.floor + team.tracking * (_size(there) + _size(rest))
    slack = height - needs.floor[at.row, i]
    value, slope, curvature = barrier(slack, at.range, at.relaxed)
    cost += value
    record.missed[at.row] = max(record.missed[at.row], -slack)
    if at.derive and value > 0.0:
        _set(derivatives.by, 0, rest, 1.0)
        _set(derivatives.by, 1, there, 1.0)
        _add(derivatives, at, (i, i + 1, 0, 0), 2, slope, curvature)
    return cost


@inner
def _within_walls(
    at: _At, i: int, place: Floats, team: Team, needs: Needs, record: ShownNeeds,
    derivatives: Derivatives,
) -> float:  # fmt: skip
    """Cost of a vehicle and all walls."""
    cost = 0.0
    for q in range(len(team.walls.grown)):
        normal, distance = plane_beside(
            team.walls.grown[q], (place[i, 0], place[i, 1], place[i, 2])
        )
        slack = distance - needs.inside[at.row, q]
        value, slope, curvature = barrier(slack, at.range, at.relaxed)
        cost += value
        record.missed[at.row] = max(record.missed[at.row], -slack)
        if at.derive and value > 0.0:
            _set(derivatives.by, 0, normal, 1.0)
            _add(derivatives, at, (i, 0, 0, 0), 1, slope, curvature)
    return cost


@compiled
def add_walls(
    places: Floats2, team: Team, needs: Needs, record: ShownNeeds, relaxed: float,
    derivatives: Derivatives, gradient: Floats2, matrix: Floats3,
) -> float:  # fmt: skip
    """Return the cost of vehicles at ``places`` (r, 3) and all walls, with the first row of needs.

    Write its ``gradient`` (r, 3) and ``matrix`` (r, 3, 3) by each place. ``derivatives`` are those
    of a team of one, 0 before and after.
    """
    cost = 0.0
    for s in range(len(places)):
        at = _At(0, RANGE, 1.0, relaxed, True)
        cost += _within_walls(at, 0, places[s : s + 1], team, needs, record, derivatives)
        for x in range(3):
            gradient[s, x] = derivatives.gradient[x]
            derivatives.gradient[x] = 0.0
            for y in range(3):
                matrix[s, x, y] = derivatives.matrix[x, y]
                derivatives.matrix[x, y] = 0.0
    return cost


@inner
def _beside_walls(
    at: _At, i: int, place: Floats, team: Team, needs: Needs, record: ShownNeeds, memory: Memory,
    derivatives: Derivatives,
) -> float:  # fmt: skip
    """Cost of a strand and all walls: of its points that are near."""
    cost, best, walls, length = 0.0, np.inf, team.walls, team.lengths[i]
    middle = (
        0.5 * (place[i, 0] + place[i + 1, 0]), 0.5 * (place[i, 1] + place[i + 1, 1]),
        0.5 * (place[i, 2] + place[i + 1, 2]),
    )  # fmt: skip
    for q in range(len(walls.solids)):
        need = walls.beside[q] + needs.beside[at.row, i]
        # no point of a strand is farther from the middle of its chord than half its length
        if plane_beside(walls.solids[q], middle)[1] >= need + at.range + 0.5 * length:
            continue
        _require_strand(i, at, place, team, record, memory)
        points, last = memory.points[i], len(memory.points[i]) - 1
        for k in range(last + 1):
            point = (points[k, 0], points[k, 1], points[k, 2])
            normal, distance = plane_beside(walls.solids[q], point)
            slack = distance - need
            if slack >= at.range:
                continue
            piece, part = (k, 0.0) if k < last else (last - 1, 1.0)
            there = _by_end(place[i], place[i + 1], memory.responses[i], (piece, part), normal)
            rest = _less(normal, there)
            if slack < best:
                best = slack
                deep = _depth(place[i], place[i + 1], points[k, 2], k / last)
                record.beside[at.row, i] = (
                    team.tracking * (_size(there) + _size(rest)) + team.tilt * deep
                )
            value, slope, curvature = barrier(slack, at.range, at.relaxed)
            cost += _PART * value
            if at.derive:
                _set(derivatives.by, 0, rest, 1.0)
                _set(derivatives.by, 1, there, 1.0)
                _add(derivatives, at, (i, i + 1, 0, 0), 2, _PART * slope, _PART * curvature)
    record.missed[at.row] = max(record.missed[at.row], -best)
    return cost


class Mode(NamedTuple):
    """A mode of a strand over t moments: squared frequencies, damping and factors of its size (t,).

    ``response`` is the share of an end's acceleration and drag that drives it, ``drag`` that of the
    cable, 1/m; splines k begin to move at the moments ``begins`` (k,), which do not fall.
    """

    squares: Floats1
    damping: Floats1
    gain: Floats1
    response: float
    drag: float
    begins: Ints1


@compiled
def oscillate(
    force: Floats2, squares: Floats1, damping: Floats1, step: float, swings: Floats2
) -> None:
    """Write ``swings`` (t, k): y″ + c·y′ + ω²·y = −f for columns of ``force`` (t, k), from rest.

    ω² are the ``squares`` (t,), c the ``damping`` (t,); by the trapezoidal rule with ``step``
    seconds. The second half of ``swings``'s rows is memory: it has 2 more rows than ``force``.
    """
    count, columns = force.shape
    place, speed = swings[count], swings[count + 1]
    for k in range(columns):
        place[k] = speed[k] = swings[0, k] = 0.0
    for t in range(1, count):
        rule = _trapezoid(squares, damping, t, step)
        for k in range(columns):
            mean = 0.5 * (force[t, k] + force[t - 1, k])
            place[k], speed[k] = _swung_on(place[k], speed[k], mean, step, rule)
            swings[t, k] = place[k]


@inner
def _trapezoid(squares: Floats, damping: Floats, t: int, step: float) -> Vector:
    """Return ω² between a moment and the one before, and what the new and the old speed are
    multiplied by there."""
    square, drag = 0.5 * (squares[t] + squares[t - 1]), 0.5 * (damping[t] + damping[t - 1])
    new = 1.0 + 0.5 * step * drag + 0.25 * step * step * square
    old = 1.0 - 0.5 * step * drag - 0.25 * step * step * square
    return square, new, old


@inner
def _swung_on(
    place: float, speed: float, force: float, step: float, rule: Vector
) -> tuple[float, float]:
    """Return place and speed of an oscillator after a step with a mean force."""
    square, new, old = rule
    faster = (speed * old + step * (-force - square * place)) / new
    return place + 0.5 * step * (speed + faster), faster


@compiled
def oscillate_by_points(
    velocity: Floats2, acceleration: Floats2, speed: Floats2, mode: Mode, step: float,
    rows: Floats3, memory: Floats3,
) -> None:  # fmt: skip
    """Write how swings change with control points: :func:`oscillate` of their forces, times gains.

    ``rows`` (t, 1 + c, 3k), of which the first is left as it is, are of c axes and the coordinates
    of k control points. A spline's ``velocity`` and ``acceleration`` (s, k) are 0 until ``begins``
    (k,); ``speed`` (s, 3) is that of the strand. ``memory`` (3, c, 3k) is 0.
    """
    count, axes, points = len(rows), rows.shape[1] - 1, velocity.shape[1]
    place, rate, force = memory[0], memory[1], memory[2]
    begun = 0
    for t in range(count):
        rule = _trapezoid(mode.squares, mode.damping, max(t, 1), step)
        size, moving = 0.0, t < len(speed)
        if moving:
            size = np.sqrt(speed[t, 0] ** 2 + speed[t, 1] ** 2 + speed[t, 2] ** 2) + 1e-9
        while begun < points and mode.begins[begun] <= t:
            begun += 1
        for x in range(axes):
            for c in range(begun):
                for y in range(3):
                    pushed, r = 0.0, 3 * c + y
                    if moving:
                        pushed = mode.drag * speed[t, x] * speed[t, y] / size * velocity[t, c]
                        if x == y:
                            pushed += acceleration[t, c] + mode.drag * size * velocity[t, c]
                    pushed *= mode.response
                    mean = 0.5 * (pushed + force[x, r])
                    force[x, r] = pushed
                    if t > 0:
                        place[x, r], rate[x, r] = _swung_on(
                            place[x, r], rate[x, r], mean, step, rule
                        )
                    rows[t, 1 + x, r] = mode.gain[t] * place[x, r]


@compiled
def weigh(
    rows: Floats3, moved: Floats2, weights: Floats2, crossed: Floats2, gradient: Floats1,
    mixed: Floats1,
) -> None:  # fmt: skip
    """Weigh ``rows`` (t, 1 + c, r) of a vector ``moved`` (t, c), so that their squares are the
    Gauss-Newton matrix of a function of its size; add to its ``gradient`` (r,).

    The ``weights`` (3, t) are slopes by half the square of the size, roots of the curvature, and
    roots of the slope. ``crossed`` (t, 1 + c) times the weighed rows is added to ``mixed`` (r,).
    """
    axes = moved.shape[1]
    for t in range(len(rows)):
        for r in range(rows.shape[2]):
            toward, cross = 0.0, 0.0
            for x in range(axes):
                toward += moved[t, x] * rows[t, 1 + x, r]
                rows[t, 1 + x, r] *= weights[2, t]
                cross += crossed[t, 1 + x] * rows[t, 1 + x, r]
            rows[t, 0, r] = weights[1, t] * toward
            gradient[r] += weights[0, t] * toward
            mixed[r] += cross + crossed[t, 0] * rows[t, 0, r]


@compiled
def respond(held: Floats2, lost: Floats2, response: Floats2) -> None:
    """Write ``response`` (t, k): the second of three states that columns of ``lost`` (t, k) drive.

    ``held`` (3, 4) advances the states, with the column, by a moment. The last three rows of
    ``response`` are memory: it has 3 more rows than ``lost``.
    """
    count, columns = lost.shape
    state = response[count:]
    for k in range(columns):
        state[0, k] = state[1, k] = state[2, k] = 0.0
    for t in range(count):
        for k in range(columns):
            a, b, c, d = state[0, k], state[1, k], state[2, k], lost[t, k]
            for row in range(3):
                state[row, k] = (
                    held[row, 0] * a + held[row, 1] * b + held[row, 2] * c + held[row, 3] * d
                )
            response[t, k] = state[1, k]


@compiled
def scatter(shares: Floats2, first: Ints1, weight: float, blocks: Floats4, band: Floats2) -> None:
    """Add to a band, as in :class:`Sums`, a weight times symmetric blocks (s, n, 3, 3) of vehicles.

    Splines from the ``first`` (s,) on move all of them by ``shares`` (s, 6).
    """
    moments, vehicles = blocks.shape[:2]
    for s in range(moments):
        for b in range(shares.shape[1]):
            for a in range(b, shares.shape[1]):
                factor = weight * shares[s, a] * shares[s, b]
                for column in range(3 * vehicles):
                    k, y = column // 3, column % 3
                    for x in range(y if a == b else 0, 3):
                        band[
                            (first[s] + b) * 3 * vehicles + column, (a - b) * 3 * vehicles + x - y
                        ] += factor * blocks[s, k, x, y]


@compiled
def scatter_products(
    products: Floats4, first: int, pair: Ints1, taper: Floats1, knot: int, band: Floats2
) -> None:
    """Add to a lower band (as in :class:`Sums`) products of vectors by control points of a pair.

    ``products`` (2, 2, a·3, b·3) are those of control points from the ``first`` on, of both
    vehicles, with themselves and later ones. ``taper`` (r,) multiplies those of control points
    that are so many apart; farther ones are left out. ``knot`` is 3n.
    """
    for p in range(products.shape[2] // 3):
        for u in range(2):
            for q in range(p, min(p + len(taper), products.shape[3] // 3)):
                for v in range(2):
                    column, row = (first + p) * knot + 3 * pair[u], (first + q) * knot + 3 * pair[v]
                    for y in range(3):
                        for x in range(3):
                            below = row + x - column - y
                            if below >= 0:
                                product = products[u, v, 3 * p + y, 3 * q + x]
                                band[column + y, below] += taper[q - p] * product


@compiled
def band_times(band: Floats2, vectors: Floats2, sums: Floats2) -> None:
    """Write to ``sums`` (v, c) a symmetric matrix, of its lower ``band`` (c, h), times vectors."""
    count, high = band.shape
    sums[:] = 0.0
    for v in range(len(vectors)):
        for column in range(count):
            here = vectors[v, column]
            total = band[column, 0] * here
            for below in range(1, min(high, count - column)):
                sums[v, column + below] += band[column, below] * here
                total += band[column, below] * vectors[v, column + below]
            sums[v, column] += total
