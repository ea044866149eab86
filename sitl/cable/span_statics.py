"""Compiled statics of spans: catenaries, forces, stretch, positions of samples.

The formulae are those of `sitl.cable.spans`. The loops run over spans: for eight spans, some sixty
small array operations would take twenty times as long.
"""

import math

import numpy as np
from numpy.typing import NDArray

from swarm.jit import compiled

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Flags = NDArray[np.bool_]

TAUT, FLAT = 0.03, 0.01
LEAST, MOST = 1e-4, 1e4
TABLE_Z = np.geomspace(TAUT, 40.0, 3000)
TABLE_RATIO = np.log(np.sinh(TABLE_Z) / TABLE_Z - 1.0)
TABLE_LOG_Z = np.log(TABLE_Z)
TAUT_RATIO = float(np.sinh(TAUT) / TAUT)
_SETTLED, _TRIES = 1e-6, 12

ACROSS, UPWARD, A, LOW, HIGH, USED, STRETCH = range(7)
FIGURES = 7
"""What is worked out of each span, as in `sitl.cable.spans.Hung`."""


@compiled
def hang(
    start: Array, stop: Array, lengths: Array, down: Array, floor: float, still: bool,
    guess: Array, flat: Array, figures: Array, resting: Flags,
) -> bool:  # fmt: skip
    """Solve the catenaries between ``start`` and ``stop`` (m, 3); tell whether any rests.

    Results go to ``flat`` (m, 3), ``figures`` (FIGURES, m) and ``resting`` (m,); ``guess`` (m,) are
    the parameters of spans that rested last, renewed here.
    """
    rests = False
    for i in range(len(start)):
        for k in range(3):
            flat[i, k] = stop[i, k] - start[i, k]
        if still:
            upward = flat[i, 2]
            flat[i, 2] = 0.0
        else:
            upward = -(flat[i, 0] * down[0] + flat[i, 1] * down[1] + flat[i, 2] * down[2])
            for k in range(3):
                flat[i, k] += upward * down[k]
        across = math.sqrt(flat[i, 0] ** 2 + flat[i, 1] ** 2 + flat[i, 2] ** 2)
        across = max(across, 1e-4)
        shortest = math.hypot(upward, across * TAUT_RATIO)
        length = max(lengths[i], shortest)
        ratio = math.sqrt(length * length - upward * upward) / across
        z = math.exp(_log_z(math.log(ratio - 1.0)))
        a = 0.5 * across / z
        tilt = upward / math.tanh(z)
        low, high = 0.5 * (length - tilt), 0.5 * (length + tilt)
        lowest = min(start[i, 2], stop[i, 2])
        if low > 0.0 and high > 0.0:
            lowest = start[i, 2] - (math.hypot(low, a) - a)
        resting[i] = lowest < floor - 1e-9
        if resting[i]:
            rests = True
            first = max(start[i, 2] - floor, 1e-6)
            last = max(stop[i, 2] - floor, 1e-6)
            slack = max(lengths[i] - across, (TAUT_RATIO - 1.0) * across)
            a, low, high = _on_floor(first, last, across, slack, guess[i])
            if a > LEAST:
                guess[i] = a
        figures[ACROSS, i], figures[UPWARD, i] = across, upward
        figures[A, i], figures[LOW, i], figures[HIGH, i] = a, low, high
        figures[USED, i], figures[STRETCH, i] = length, shortest - lengths[i]
    return rests


@compiled
def _log_z(ratio: float) -> float:
    """Look up log z for ``log (sinh z / z − 1)``, linearly, within the table."""
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


@compiled
def _on_floor(
    first: float, last: float, across: float, slack: float, guess: float
) -> tuple[float, float, float]:
    """Two half catenaries that come down to the floor: parameter and the arcs that hang.

    ``first`` and ``last`` are the ends' heights. Where there is more slack than the ends are high,
    the ends just hang down; a taut span is left to its elasticity, as one in the air is.
    """
    both = first + last
    if slack >= 0.999 * both or both < FLAT:
        return LEAST, first, last
    a = min(_floor_parameter(first, last, slack, guess), across / (2.0 * TAUT))
    return a, math.sqrt(first**2 + 2.0 * first * a), math.sqrt(last**2 + 2.0 * last * a)


@compiled
def _floor_parameter(first: float, last: float, slack: float, guess: float) -> float:
    """The catenary parameter of a span whose ends come down to the floor.

    ``L − h = Σ (s_i − x_i)`` with ``s = √(H² + 2Ha)``, ``x = a acosh(1 + H/a)`` fixes ``a``; Newton
    in ``log a`` against ``log (L − h)`` from the last step's root.
    """
    a = min(max(guess, LEAST), MOST)
    target = math.log(max(slack, 1e-9))
    for _ in range(_TRIES):
        arc, other = math.sqrt(first * (first + 2.0 * a)), math.sqrt(last * (last + 2.0 * a))
        angle, turn = math.acosh(1.0 + first / a), math.acosh(1.0 + last / a)
        value = max(arc - a * angle + other - a * turn, 1e-12)
        slope = min((2.0 * first / arc - angle + 2.0 * last / other - turn) * a, -1e-12)
        update = (target - math.log(value)) * value / slope
        a = a * math.exp(min(max(update, -1.5), 1.5))
        a = min(max(a, LEAST), MOST)
        if abs(update) < _SETTLED:
            break
    return a


@compiled
def pulls(load: Array, down: Array, flat: Array, figures: Array, force: Array) -> float:
    """Forces on all starts and then all stops (2 m, 3), newtons, into ``force``.

    Returns more than the largest tension in a slack span: that at its lowest point and its whole
    weight. ``load`` (m,) is the weight of a metre of each span.
    """
    count, most = len(load), 0.0
    for i in range(count):
        level = load[i] * figures[A, i] / figures[ACROSS, i]
        for k in range(3):
            force[i, k] = load[i] * figures[LOW, i] * down[k] + level * flat[i, k]
            force[count + i, k] = load[i] * figures[HIGH, i] * down[k] - level * flat[i, k]
        most = max(most, load[i] * (figures[A, i] + figures[USED, i]))
    return most


@compiled
def stretch(
    start: Array, stop: Array, starts: Indices, stops: Indices, lengths: Array, figures: Array,
    velocity: Array, stiff: tuple[float, float, float, float], force: Array, elastic: Array,
) -> None:  # fmt: skip
    """Add the elastic pulls (m,) of over-stretched spans to ``force`` (2 m, 3), and note them.

    ``velocity`` (n, 3) is of all holders, of which ``starts`` and ``stops`` (m,) hold the spans;
    ``stiff`` are the cable's axial stiffness in newtons, the stiffest that a span is taken for in
    N/m, its damping ratio and the mass in kg at its ends.
    """
    axial, stiffest, ratio, mass = stiff
    count = len(lengths)
    along = np.empty(3)
    for i in range(count):
        chord = max(math.hypot(figures[ACROSS, i], figures[UPWARD, i]), 1e-9)
        opening = 0.0
        for k in range(3):
            along[k] = (stop[i, k] - start[i, k]) / chord
            opening += (velocity[stops[i], k] - velocity[starts[i], k]) * along[k]
        stiffness = min(axial / lengths[i], stiffest)
        damping = 2 * ratio * math.sqrt(stiffness * mass)
        pull = max(stiffness * figures[STRETCH, i] + damping * opening, 0.0)
        elastic[i] = pull if figures[STRETCH, i] > 0 else 0.0
        for k in range(3):
            force[i, k] += elastic[i] * along[k]
            force[count + i, k] -= elastic[i] * along[k]


@compiled
def end(target: Array, samples: Indices, away: Array, grip: Array, floor: float) -> None:
    """Hang a loose end straight down from its ``grip`` (3,): its ``samples``, that are ``away``
    from there along the cable (k,), in ``target`` (m, 3) of all samples.

    What does not hang lies where it lay, or is drawn along: nothing is farther from the grip than
    the cable between reaches.
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
def points(
    span_of: Indices, along: Array, lengths: Array, start: Array, flat: Array, figures: Array,
    resting: Flags, floor: float, down: Array, target: Array, samples: Indices,
) -> None:  # fmt: skip
    """Put the samples of solved spans where they are, into ``target`` at ``samples`` (m,).

    ``span_of`` (m,) is whose they are, and ``along`` (m,) how far from its start.
    """
    for m in range(len(samples)):
        j, place = span_of[m], target[samples[m]]
        a, low, across = figures[A, j], figures[LOW, j], figures[ACROSS, j]
        if resting[j]:
            high = figures[HIGH, j]
            sideways, height = _lying(along[m], lengths[j], across, a, low, high)
            for k in range(3):
                place[k] = start[j, k] + sideways / across * flat[j, k]
            place[2] = floor + height
            continue
        s = along[m] * figures[USED, j] / lengths[j] - low
        sideways = a * (math.asinh(s / a) + math.asinh(low / a))
        drop = math.hypot(low, a) - math.hypot(s, a)
        for k in range(3):
            place[k] = start[j, k] + sideways / across * flat[j, k] + drop * down[k]


@compiled
def _lying(
    along: float, length: float, across: float, a: float, low: float, high: float
) -> tuple[float, float]:
    """Where a place of a span that rests is: how far from its start, and above the floor.

    Down one end, along the floor, up the other.
    """
    curved = a > LEAST
    first = a * math.asinh(low / a) if curved else 0.0
    last = a * math.asinh(high / a) if curved else 0.0
    ground = max(across - first - last, 0.0)
    lies = max(length - low - high, 1e-9)
    place = first + min(max((along - low) / lies, 0.0), 1.0) * ground
    height = 0.0
    for end in range(2):
        s = low - along if end == 0 else high - (length - along)
        if s > 0.0:
            height = max(height, math.hypot(s, a) - a if curved else s)
            out = a * math.asinh(s / a) if curved else 0.0
            place = first - out if end == 0 else across - last + out
    return place, height
