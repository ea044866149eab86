"""Speed of the catenaries: a batch solved and sampled, against a loop over SciPy's brentq.

Run ``python tests/bench/catenary.py``; prints seconds of processor time, the best of
some rounds, and their ratio.
"""

import time

import numpy as np
from scipy.optimize import brentq

from swarm.geometry.catenary import solve_catenaries

STRANDS, POINTS, LOOPED, ROUNDS = 100_000, 16, 500, 30


def main() -> None:
    rng = np.random.default_rng(1)
    start, end = rng.uniform(-5.0, 5.0, (2, STRANDS, 3))
    slack = 10.0 ** rng.uniform(-6.0, 3.0, STRANDS)
    length = np.linalg.norm(end - start, axis=1) * (1.0 + slack)
    fractions = np.linspace(0.0, 1.0, POINTS)

    def batch() -> None:
        solve_catenaries(start, end, length).points(fractions)

    def one_by_one() -> None:
        for a, b, ell in zip(start[:LOOPED], end[:LOOPED], length[:LOOPED], strict=True):
            _by_brentq(a, b, ell, fractions)

    ours = min(_timed(batch) for _ in range(ROUNDS))
    theirs = min(_timed(one_by_one) for _ in range(ROUNDS)) * STRANDS / LOOPED
    print(f"{STRANDS} catenaries at {POINTS} points: {ours:.3f} s (at most 0.5 s)")
    print(f"brentq, one by one: {theirs:.1f} s for as many, from {LOOPED}")
    print(f"ratio: {theirs / ours:.0f} (at least 100)")


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
    begin = time.process_time()
    work()
    return time.process_time() - begin


if __name__ == "__main__":
    main()
