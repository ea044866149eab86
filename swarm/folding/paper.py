"""The trajectory of the paper, as printed: for comparison; the certificate refuses it.

Waypoints are the corners p_i and, between them, q_i half way along and (2 − (−1)^i)/2 · h_max
below (section IV of the paper); quintics from rest to rest join them into γ. Vehicle i follows γ
with (n − i) constant delays and stops at its own corner. The paper does not define how waiting
vehicles reach the first corner: here they advance along the line, one place per delay.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SampledStates:
    """Positions, velocities and accelerations (k, n, 3) of the team at times (k,)."""

    times: Floats
    position: Floats
    velocity: Floats
    acceleration: Floats


def edge_dips(count: int, deepest_sag: float) -> Floats:
    """Return the depth (count,) of the path below the corners half way along each edge; metres."""
    i = np.arange(1.0, count + 1.0)
    depth: Floats = 0.5 * (2.0 - (-1.0) ** i) * deepest_sag
    return depth


def waypoints(corners: Floats, deepest_sag: float) -> Floats:
    """Return the points p_1, q_1, p_2, …, p_n of γ: (2n − 1, 3) metres."""
    between = 0.5 * (corners[:-1] + corners[1:])
    between[:, 2] -= edge_dips(len(between), deepest_sag)
    points = np.empty((2 * len(corners) - 1, 3))
    points[::2], points[1::2] = corners, between
    return points


def paper_motion(
    corners: Floats,
    lengths: Floats,
    deepest_sag: float,
    delay: float | None,
    *,
    max_speed: float,
    max_acceleration: float,
) -> SampledStates:
    """Return the printed trajectory, with every quintic as fast as the limits allow.

    ``corners`` (n, 3), ``lengths`` (n − 1,) and ``deepest_sag`` in metres; ``delay`` in seconds,
    by default the mean time for an edge. Between two times of the result every vehicle is on one
    quintic.
    """
    count = len(corners)
    points = waypoints(corners, deepest_sag)
    distance = np.linalg.norm(np.diff(points, axis=0), axis=1)
    duration = _durations(distance, max_speed, max_acceleration)
    arrival = np.concatenate([[0.0], np.cumsum(duration)])
    place = 0.9 * float(lengths.min())
    quickest = float(_durations(np.array([place]), max_speed, max_acceleration)[0])
    if delay is None:
        delay = float(arrival[-1]) / (count - 1)
    delay = max(delay, quickest)
    heading = corners[1] - corners[0]
    heading = heading * [1.0, 1.0, 0.0] / np.hypot(heading[0], heading[1])

    behind = np.arange(count - 1, -1, -1)
    starts, ends, begins, durations = [], [], [], []
    for i in range(count):
        waiting = corners[0] - place * np.arange(behind[i], -1, -1)[:, None] * heading
        route = np.concatenate([waiting, points[1 : 2 * i + 1]])
        moments = np.concatenate(
            [delay * np.arange(behind[i] + 1), behind[i] * delay + arrival[1 : 2 * i + 1]]
        )
        starts.append(route[:-1])
        ends.append(route[1:])
        begins.append(moments[:-1])
        durations.append(np.diff(moments))
    pairs = zip(begins, durations, strict=True)
    every = np.concatenate([np.concatenate([begin, begin + time]) for begin, time in pairs])
    times = np.unique(np.concatenate([[0.0], every]).round(9))
    states = np.zeros((3, len(times), count, 3))
    for i in range(count):
        states[:, :, i] = _on_legs(times, starts[i], ends[i], begins[i], durations[i])
    return SampledStates(times, states[0], states[1], states[2])


def _durations(distance: Floats, max_speed: float, max_acceleration: float) -> Floats:
    """Return the shortest rest-to-rest durations; see :func:`swarm.geometry.motion.leg`."""
    by_speed = 1.875 * distance / max_speed
    by_acceleration = np.sqrt(10.0 / np.sqrt(3.0) * distance / max_acceleration)
    least: Floats = 1.001 * np.maximum(by_speed, by_acceleration)
    return least


def _on_legs(times: Floats, start: Floats, end: Floats, begin: Floats, durations: Floats) -> Floats:
    """Return position, velocity and acceleration (3, k, 3) on consecutive rest-to-rest quintics."""
    leg = np.clip(np.searchsorted(begin, times, side="right") - 1, 0, len(begin) - 1)
    share = np.clip((times - begin[leg]) / durations[leg], 0.0, 1.0)[:, None]
    step, time = end[leg] - start[leg], durations[leg][:, None]
    return np.stack(
        [
            start[leg] + step * share**3 * (10.0 - 15.0 * share + 6.0 * share**2),
            step * 30.0 * share**2 * (1.0 - share) ** 2 / time,
            step * 60.0 * share * (1.0 - share) * (1.0 - 2.0 * share) / time**2,
        ]
    )
