"""Strands that swing from rest, for tests that need no more of :mod:`swarm.geometry.lumped_mass`."""

import numpy as np

from swarm.geometry.lumped_mass import Strands, SwingModel


def swing(ends: np.ndarray, lengths: np.ndarray, model: SwingModel, every: int = 1) -> np.ndarray:
    """Joints (ceil(k / every), n − 1, links + 1, 3) of all strands of grip points (k, n, 3)."""
    strands = Strands.whole_chain(lengths, model)
    return strands.swing_on_each(strands.at_rest(ends[0])[None], ends[None], every)[0]


def stray(joints: np.ndarray, ends: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Largest distances (k, n − 1) of all strands of grip points (k, n, 3) from their catenaries."""
    still = SwingModel(joints.shape[2] - 1, 1.0, 0.0)
    return Strands.whole_chain(lengths, still).strays(joints, ends)
