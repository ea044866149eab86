"""Speed of the catenaries: a batch solved and sampled, against a loop over SciPy's brentq.

Run ``python tests/bench/catenary.py``; prints seconds and the ratio of the two per strand.
"""

import time

import numpy as np
from scipy.optimize import brentq

from swarm.cable.catenary import hang

STRANDS, POINTS, LOOPED = 100_000, 16, 1_000


def main() -> None:
    rng = np.random.default_rng(1)
    start, end = rng.uniform(-5.0, 5.0, (2, STRANDS, 3))
    slack = 10.0 ** rng.uniform(-6.0, 3.0, STRANDS)
    length = np.linalg.norm(end - start, axis=1) * (1.0 + slack)
    fractions = np.linspace(0.0, 1.0, POINTS)

    hang(start, end, length).points(fractions)
    batch = min(_timed(lambda: hang(start, end, length).points(fractions)) for _ in range(5))
    looped = _timed(
        lambda: [
            _by_brentq(a, b, ell, fractions)
            for a, b, ell in zip(start[:LOOPED], end[:LOOPED], length[:LOOPED], strict=True)
        ]
    )
    ratio = looped / LOOPED / (batch / STRANDS)
    print(f"{STRANDS} catenaries at {POINTS} points: {batch:.3f} s (at most 0.5 s)")
    print(f"brentq, one by one: {looped / LOOPED * STRANDS:.1f} s for as many")
    print(f"ratio: {ratio:.0f} (at least 100)")


def _by_brentq(start, end, length, fractions):  # type: ignore[no-untyped-def]
    """One strand as one would write it with SciPy: solve, then sample with NumPy."""
    across = end[:2] - start[:2]
    span, rise = float(np.hypot(*across)), float(end[2] - start[2])
    ratio = float(np.sqrt(length**2 - rise**2)) / span
    x = brentq(lambda x: np.sinh(x) / x - ratio, 1e-6, 50.0, xtol=1e-14)
    a = span / (2.0 * x)
    first = np.sinh(np.arctanh(rise / length) - x)
    slope = first + fractions * length / a
    along = a * (np.arcsinh(slope) - np.arcsinh(first))
    up = a * (np.sqrt(1.0 + slope**2) - np.sqrt(1.0 + first**2))
    return np.column_stack([start[:2] + np.outer(along, across / span), start[2] + up])


def _timed(work) -> float:  # type: ignore[no-untyped-def]
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


if __name__ == "__main__":
    main()
