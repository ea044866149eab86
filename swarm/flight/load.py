"""What the cable pulls on every vehicle, so that the setpoints can carry it.

An autopilot holds its place against a steady pull only as well as its integrator does: with the
usual gains a newton on a vehicle of 1.5 kg moves it by some tenths of a metre for seconds. The pull
is known in the cable model, so it goes into the acceleration setpoint as feed-forward.
"""

import numpy as np
import numpy.typing as npt

from swarm.cable.floor import rest_on_floor

Floats = npt.NDArray[np.float64]

_TAUT = 0.99
"""Chords nearer to taut count as this share: a pull without bound is no use as feed-forward."""


def cable_pull(grip_points: Floats, lengths: Floats, mass_per_length: float) -> Floats:
    """Return the force (n, 3) in newtons, ENU, of a held cable on its n vehicles.

    ``grip_points`` (n, 3) in metres above the floor at z = 0, ``lengths`` (n − 1,) of the segments
    between them. Parts that reach the floor lie on it and pull with what is lifted.
    """
    above = np.maximum(grip_points, [-np.inf, -np.inf, 0.0])
    chords = np.linalg.norm(np.diff(above, axis=0), axis=-1)
    strands = rest_on_floor(above[:-1], above[1:], np.maximum(lengths, chords / _TAUT))
    on_start, on_end = strands.end_forces(mass_per_length)
    pull = np.zeros_like(above)
    pull[:-1] += on_start
    pull[1:] += on_end
    return pull
