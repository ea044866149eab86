"""Ranges of times, places and lengths in motion files, plan files and records.

Beyond them, floating-point numbers are too coarse for a certificate. Missions have ranges of their
own (:mod:`swarm.mission.mission`).
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from swarm.errors import Problem, shown
from swarm.geometry.motion import LEAST_STEP, Motion

Floats = npt.NDArray[np.float64]

LARGEST = 1e4
"""Largest coordinate, speed, acceleration and length."""

LATEST = 1e6
"""Farthest mission time from 0, seconds, eleven days: there, times are rounded to 0.1 ns."""

LONGEST = 14_400.0
"""Longest motion in seconds: four hours."""


def time_problems(times: Sequence[float], place: str) -> list[Problem]:
    """Return the errors in the times of a motion, two or more."""
    wrong = []
    for before, after in pairwise(times):
        if after <= before:
            message = f"expected times to increase, got {after:g} s after {before:g} s"
        elif after - before < LEAST_STEP * (1.0 - 1e-6):
            message = f"expected {LEAST_STEP:g} s or more between times, got {before} and {after}"
        else:
            continue
        wrong.append(Problem(place, message))
    wrong += [
        Problem(place, f"expected times within ±{LATEST:g} s, got {time:g} s")
        for time in times
        if not abs(time) <= LATEST
    ][:1]
    if times[-1] - times[0] > LONGEST:
        lasts = times[-1] - times[0]
        wrong.append(Problem(place, f"expected at most {LONGEST:g} s of motion, got {lasts:g} s"))
    return wrong


def motion_problems(motion: Motion, place: str) -> list[Problem]:
    """Return the errors in the times and the places of a motion."""
    wrong = time_problems(motion.times.tolist(), f"{place}: times")
    powers = np.diff(motion.times)[:, None] ** np.arange(6)
    terms = np.abs(motion.coefficients * powers[:, :, None, None]).max(axis=(0, 1, 3))
    wrong += [
        Problem(f"{place}: vehicle {vehicle}", f"expected at most ±{LARGEST:g} m, got {term:g} m")
        for vehicle, term in enumerate(terms.tolist(), start=1)
        if not term <= LARGEST
    ]
    return wrong


def place_problems(points: Floats, place: str) -> list[Problem]:
    """Return the errors in the coordinates of points."""
    wrong = points[~(np.abs(points) <= LARGEST)]
    message = f"expected coordinates within ±{LARGEST:g} m, got "
    return [Problem(place, f"{message}{value:g} m") for value in wrong[:1].tolist()]


def length_problems(lengths: Sequence[object], place: str) -> list[Problem]:
    """Return the errors in the lengths of segments, in order along the cable."""
    return [
        Problem(
            f"{place}: segment {number}",
            f"expected a length > 0 and <= {LARGEST:g} in metres, got {shown(length)}",
        )
        for number, length in enumerate(lengths, start=1)
        if isinstance(length, bool)
        or not isinstance(length, int | float | np.integer)
        or not 0.0 < length <= LARGEST
    ]
