"""Compiled statics of spans: catenaries, forces, stretch, positions of samples.

The formulae are those of `sitl.cable.rope`. The loops run over spans: for eight spans, some sixty
small array operations would take twenty times as long.
"""

import math

import numpy as np
from numpy.typing import NDArray

from swarm.jit import allocates, compiled, inner
from swarm.signatures import Columns2, Floats1, Floats2, Ints1, Ints2

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

TAUT, FLAT = 0.03, 0.01
LEAST, MOST = 1e-4, 1e4
TABLE_Z = np.geomspace(TAUT, 40.0, 3000)
TABLE_RATIO = np.log(np.sinh(TABLE_Z) / TABLE_Z - 1.0)
TABLE_LOG_Z = np.log(TABLE_Z)
TAUT_RATIO = float(np.sinh(TAUT) / TAUT)
_CONVERGED, _ITERATIONS = 1e-6, 12

DISTANCE, RISE, PARAMETER, START_ARC, STOP_ARC, USED, STRETCH, LENGTH, RESTING = range(9)
ROWS = 9
"""Rows of a solution (ROWS, m); `sitl.cable.rope.SolvedSpans` explains them."""


@compiled
def solve(
    ends: Floats2, lengths: Floats1, bottom: tuple[Floats1, float], guess: Floats1, flat: Floats2,
    solution: Floats2,
) -> None:  # fmt: skip
    """Solve the catenaries of m spans; write ``flat`` (m, 3) and ``solution`` (ROWS, m).

    ``ends`` (2 m, 3) are all starts, then all stops; ``bottom`` is the direction (3,) of the
    weight, and the height of the floor; ``guess`` (m,) are the parameters of the last solution on
    the floor, updated here.
    """
    down, floor = bottom
    count = len(lengths)
    still = down[0] == 0.0 and down[1] == 0.0
    for i in range(count):
        start, stop = ends[i], ends[count + i]
        for k in range(3):
            flat[i, k] = stop[k] - start[k]
        if still:
            rise = flat[i, 2]
            flat[i, 2] = 0.0
        else:
            rise = -(flat[i, 0] * down[0] + flat[i, 1] * down[1] + flat[i, 2] * down[2])
            for k in range(3):
                flat[i, k] += rise * down[k]
        distance = math.sqrt(flat[i, 0] ** 2 + flat[i, 1] ** 2 + flat[i, 2] ** 2)
        distance = max(distance, 1e-4)
        shortest = math.hypot(rise, distance * TAUT_RATIO)
        length = max(lengths[i], shortest)
        ratio = math.sqrt(length * length - rise * rise) / distance
        z = math.exp(_log_z(math.log(ratio - 1.0)))
        a = 0.5 * distance / z
        tilt = rise / math.tanh(z)
        start_arc, stop_arc = 0.5 * (length - tilt), 0.5 * (length + tilt)
        lowest = min(start[2], stop[2])
        if start_arc > 0.0 and stop_arc > 0.0:
            lowest = start[2] - (math.hypot(start_arc, a) - a)
        resting = lowest < floor - 1e-9
        if resting:
            first = max(start[2] - floor, 1e-6)
            last = max(stop[2] - floor, 1e-6)
            slack = max(lengths[i] - distance, (TAUT_RATIO - 1.0) * distance)
            a, start_arc, stop_arc = _on_floor(first, last, distance, slack, guess[i])
            if a > LEAST:
                guess[i] = a
        solution[DISTANCE, i], solution[RISE, i], solution[PARAMETER, i] = distance, rise, a
        solution[START_ARC, i], solution[STOP_ARC, i] = start_arc, stop_arc
        solution[USED, i], solution[STRETCH, i] = length, shortest - lengths[i]
        solution[LENGTH, i], solution[RESTING, i] = lengths[i], 1.0 if resting else 0.0


@inner
def _log_z(ratio: float) -> float:
    """Return log z for ``ratio = log(sinh z / z − 1)``, by linear interpolation in the table."""
    low, high = 0, len(TABLE_RATIO) - 1
    if ratio <= TABLE_RATIO[low]:
        return float(TABLE_LOG_Z[low])
    if ratio >= TABLE_RATIO[high]:
        return float(TABLE_LOG_Z[high])
    while high - low > 1:
        middle = (low + high) // 2
        if TABLE_RATIO[middle] <= ratio:
            low = middle
        else:
            high = middle
    slope = (TABLE_LOG_Z[high] - TABLE_LOG_Z[low]) / (TABLE_RATIO[high] - TABLE_RATIO[low])
    return float(slope * (ratio - TABLE_RATIO[low]) + TABLE_LOG_Z[low])


@inner
def _on_floor(
    first: float, last: float, distance: float, slack: float, guess: float
) -> tuple[float, float, float]:
    """Return the parameter and the two hanging arcs of a span that reaches the floor.

    Two half catenaries descend to the floor; ``first`` and ``last`` are the heights of the ends.
    With more slack than the sum of the heights, the ends hang straight down. The parameter of a
    taut span is limited; its elasticity takes the rest of the load, as in the air.
    """
    both = first + last
    if slack >= 0.999 * both or both < FLAT:
        return LEAST, first, last
    a = min(_floor_parameter(first, last, slack, guess), distance / (2.0 * TAUT))
    return a, math.sqrt(first**2 + 2.0 * first * a), math.sqrt(last**2 + 2.0 * last * a)


@inner
def _floor_parameter(first: float, last: float, slack: float, guess: float) -> float:
    """Return the catenary parameter of a span whose two ends descend to the floor.

    ``L − h = Σ (s_i − x_i)`` with ``s = √(H² + 2Ha)``, ``x = a acosh(1 + H/a)`` determines ``a``;
    Newton in ``log a`` against ``log (L − h)``, from the root of the last step.
    """
    a = min(max(guess, LEAST), MOST)
    target = math.log(max(slack, 1e-9))
    for _ in range(_ITERATIONS):
        arc, other = math.sqrt(first * (first + 2.0 * a)), math.sqrt(last * (last + 2.0 * a))
        angle, turn = math.acosh(1.0 + first / a), math.acosh(1.0 + last / a)
        value = max(arc - a * angle + other - a * turn, 1e-12)
        slope = min((2.0 * first / arc - angle + 2.0 * last / other - turn) * a, -1e-12)
        update = (target - math.log(value)) * value / slope
        a = a * math.exp(min(max(update, -1.5), 1.5))
        a = min(max(a, LEAST), MOST)
        if abs(update) < _CONVERGED:
            break
    return a


@compiled
def end_forces(
    load: Floats1, down: Floats1, flat: Floats2, solution: Floats2, force: Floats2
) -> float:
    """Write the forces on all starts and then all stops, newtons, into ``force`` (2 m, 3).

    ``load`` (m,) is the weight per metre of each span. Returns an upper bound of the tension in a
    slack span: the tension at its lowest point plus its whole weight.
    """
    count, most = len(load), 0.0
    for i in range(count):
        level = load[i] * solution[PARAMETER, i] / solution[DISTANCE, i]
        for k in range(3):
            force[i, k] = load[i] * solution[START_ARC, i] * down[k] + level * flat[i, k]
            force[count + i, k] = load[i] * solution[STOP_ARC, i] * down[k] - level * flat[i, k]
        most = max(most, load[i] * (solution[PARAMETER, i] + solution[USED, i]))
    return most


@compiled
@allocates
def add_elastic_forces(
    ends: Floats2, holders: Ints1, velocity: Columns2, solution: Floats2,
    constants: tuple[float, float, float, float], forces: tuple[Floats2, Floats1],
) -> None:  # fmt: skip
    """Write the elastic forces of overstretched spans, and add them to the forces on their ends.

    ``forces`` are those on the ends (2 m, 3) and the elastic ones (m,), in newtons. ``holders``
    (2 m,) hold the starts, then the stops; ``velocity`` (n, 3) is of all holders.
    ``constants`` are the axial stiffness of the cable in newtons, the largest stiffness of a span
    in N/m, the damping ratio and the mass at an end in kg.
    """
    (axial, stiffest, ratio, mass), (force, elastic) = constants, forces
    count = len(elastic)
    along = np.empty(3)
    for i in range(count):
        chord = max(math.hypot(solution[DISTANCE, i], solution[RISE, i]), 1e-9)
        opening = 0.0
        for k in range(3):
            along[k] = (ends[count + i, k] - ends[i, k]) / chord
            opening += (velocity[holders[count + i], k] - velocity[holders[i], k]) * along[k]
        stiffness = min(axial / solution[LENGTH, i], stiffest)
        damping = 2 * ratio * math.sqrt(stiffness * mass)
        pull = max(stiffness * solution[STRETCH, i] + damping * opening, 0.0)
        elastic[i] = pull if solution[STRETCH, i] > 0 else 0.0
        for k in range(3):
            force[i, k] += elastic[i] * along[k]
            force[count + i, k] -= elastic[i] * along[k]


@compiled
def place_loose_end(
    target: Floats2, samples: Ints1, away: Floats1, grip: Floats1, floor: float
) -> None:
    """Place the samples of a loose end vertically below its ``grip`` (3,), in ``target`` (m, 3).

    ``away`` (k,) are the distances of ``samples`` (k,) from the grip along the cable. The part that
    reaches the floor stays at its place, but no sample is farther from the grip than the length of
    cable between them.
    """
    height = max(grip[2] - floor, 0.0)
    for j in range(len(samples)):
        place = target[samples[j]]
        east, north = place[0] - grip[0], place[1] - grip[1]
        reach = max(away[j] - height, 0.0)
        share = min(1.0, reach / max(math.hypot(east, north), 1e-9))
        place[0], place[1] = grip[0] + share * east, grip[1] + share * north
        place[2] = max(grip[2] - away[j], floor)


@compiled
def place_samples(
    samples: tuple[Ints2, Floats1], ends: Floats2, flat: Floats2, solution: Floats2,
    bottom: tuple[Floats1, float], target: Floats2,
) -> None:  # fmt: skip
    """Place the samples of solved spans in ``target`` (n, 3) of all samples.

    ``samples`` are numbers (2, m) of samples and their spans, and the distances (m,) from the
    spans' starts; ``bottom`` is the direction (3,) of the weight, and the height of the floor.
    """
    (index, along), (down, floor) = samples, bottom
    for m in range(len(along)):
        j, place = index[1, m], target[index[0, m]]
        a, start_arc, distance = (
            solution[PARAMETER, j],
            solution[START_ARC, j],
            solution[DISTANCE, j],
        )
        if solution[RESTING, j] > 0.0:
            sideways, height = _resting_point(along[m], solution[:, j])
            for k in range(3):
                place[k] = ends[j, k] + sideways / distance * flat[j, k]
            place[2] = floor + height
            continue
        s = along[m] * solution[USED, j] / solution[LENGTH, j] - start_arc
        sideways = a * (math.asinh(s / a) + math.asinh(start_arc / a))
        drop = math.hypot(start_arc, a) - math.hypot(s, a)
        for k in range(3):
            place[k] = ends[j, k] + sideways / distance * flat[j, k] + drop * down[k]


@inner
def _resting_point(along: float, span: Array) -> tuple[float, float]:
    """Return distance from the start and height above the floor of a point of a resting span.

    ``span`` (ROWS,) is the solution: down one end, along the floor, up the other end.
    """
    distance, a = span[DISTANCE], span[PARAMETER]
    start_arc, stop_arc, length = span[START_ARC], span[STOP_ARC], span[LENGTH]
    curved = a > LEAST
    first = a * math.asinh(start_arc / a) if curved else 0.0
    last = a * math.asinh(stop_arc / a) if curved else 0.0
    ground = max(distance - first - last, 0.0)
    lies = max(length - start_arc - stop_arc, 1e-9)
    place = first + min(max((along - start_arc) / lies, 0.0), 1.0) * ground
    height = 0.0
    for end in range(2):
        s = start_arc - along if end == 0 else stop_arc - (length - along)
        if s > 0.0:
            height = max(height, math.hypot(s, a) - a if curved else s)
            out = a * math.asinh(s / a) if curved else 0.0
            place = first - out if end == 0 else distance - last + out
    return place, height
