"""Brute force with its own catenaries: shares no code with the certificate."""

import numpy as np


def catenary(start, end, length, count=60):
    """Points (…, count, 3) of strands between ends (…, 3), by bisection on the parameter."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    length = np.broadcast_to(length, start.shape[:-1])
    across = end - start
    rise = across[..., 2]
    span = np.hypot(across[..., 0], across[..., 1])
    # Solve 2a·sinh(span / 2a) = √(length² − rise²) for u = span / 2a.
    wanted = np.sqrt(length**2 - rise**2) / span
    low, high = np.full_like(span, 1e-9), np.full_like(span, 60.0)
    for _ in range(80):
        middle = 0.5 * (low + high)
        slack = np.sinh(middle) / middle < wanted
        low, high = np.where(slack, middle, low), np.where(slack, high, middle)
    a = span / (low + high)
    # z = a·cosh((x − x₀)/a) + z₀ through both ends.
    x0 = 0.5 * span - a * np.arctanh(rise / length)
    x = span[..., None] * np.linspace(0.0, 1.0, count)
    z = a[..., None] * np.cosh((x - x0[..., None]) / a[..., None])
    z += start[..., 2, None] - z[..., :1]
    share = (x / span[..., None])[..., None]
    plan = start[..., None, :2] + share * across[..., None, :2]
    return np.concatenate([plan, z[..., None]], axis=-1)


def displaced(rng, place, radius):
    """Places (…, 3) with errors of exactly the radius in random directions."""
    error = rng.normal(size=place.shape)
    return place + radius * error / np.linalg.norm(error, axis=-1, keepdims=True)


def closest(first, second):
    """Smallest distance (…,) of the points of polylines (…, k, 3) and (…, m, 3)."""
    apart = np.linalg.norm(first[..., :, None, :] - second[..., None, :, :], axis=-1)
    return apart.min(axis=(-2, -1))
