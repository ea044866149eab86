"""The cable's pull on every vehicle, as feed-forward in the acceleration setpoints.

An autopilot resists a steady pull by its integrator alone: with the usual gains a newton on a
vehicle of 1.5 kg moves it by some tenths of a metre for seconds. The cable model gives the pull.
ArduPilot cannot use it: see :class:`swarm.mavlink.autopilots.Autopilot`.
"""

import numpy as np
import numpy.typing as npt

from swarm.geometry import catenary
from swarm.geometry.catenary import STANDARD_GRAVITY, rest_on_floor
from swarm.jit import allocates, inner
from swarm.planning import Plan
from swarm.signatures import Floats1, Floats2

Floats = npt.NDArray[np.float64]

STEP = 0.5
"""Seconds of mission time between the moments at which a plan's pull is computed."""

TAUT = 0.99
"""Chords nearer to taut count as this share: a pull without bound is no use as feed-forward."""


def cable_pull(grip_points: Floats, lengths: Floats, mass_per_length: float) -> Floats:
    """Return the force (…, n, 3) in newtons, ENU, of a held cable on its n vehicles.

    ``grip_points`` (…, n, 3) in metres above the floor at z = 0, ``lengths`` (n − 1,) of the
    segments between them. Parts that reach the floor lie on it, and only the lifted part pulls.
    Without segments the pull is 0.
    """
    if not len(lengths):
        return np.zeros_like(grip_points)
    above = np.maximum(grip_points, [-np.inf, -np.inf, 0.0])
    start, end = above[..., :-1, :], above[..., 1:, :]
    chords = np.linalg.norm(end - start, axis=-1)
    strands = rest_on_floor(start, end, np.maximum(lengths, chords / TAUT))
    on_start, on_end = strands.end_forces(mass_per_length)
    pull = np.zeros_like(above)
    pull[..., :-1, :] += on_start
    pull[..., 1:, :] += on_end
    return pull


@inner
@allocates
def end_forces(
    start: Floats2, end: Floats2, lengths: Floats1, mass_per_length: float
) -> tuple[Floats, Floats]:
    """Return the forces (n, 3) of n strands on their starts and ends; newtons, ENU.

    ``start`` and ``end`` (n, 3) in metres above the floor at z = 0, no farther apart than
    ``lengths`` (n,). What :func:`swarm.geometry.catenary.rest_on_floor` has, quickly enough for
    flight.
    """
    on_start, on_end = np.empty(start.shape), np.empty(start.shape)
    weight = STANDARD_GRAVITY * mass_per_length
    for strand in range(len(lengths)):
        catenary.end_forces(
            start[strand], end[strand], lengths[strand], weight, on_start[strand], on_end[strand]
        )
    return on_start, on_end


class PlannedPull:
    """The cable's pull along a plan while all vehicles hold it, computed once."""

    def __init__(self, plan: Plan) -> None:
        at = {gate.condition: gate.time for gate in reversed(plan.gates)}
        self._start = at.get("gripped", 0.0)
        held = max(at.get("released", plan.duration) - self._start, STEP)
        times = self._start + np.arange(0.0, held + 2.0 * STEP, STEP)
        grips = plan.motion.at(times)[0]
        self._pull = cable_pull(grips, plan.layout.lengths, plan.mission.cable.mass_per_length)
        self._change = np.diff(self._pull, axis=0)
        self._zero = np.zeros_like(self._pull[0])

    def at(self, time: float) -> Floats:
        """Return the pull (n, 3) in newtons, ENU, at a mission time."""
        before, change, share = self.around(time)
        pull: Floats = before + change * share
        return pull

    def around(self, time: float) -> tuple[Floats, Floats, float]:
        """Return the pull at the sample before, its change to the next, and the share of that."""
        place = min(max((time - self._start) / STEP, 0.0), len(self._pull) - 1.001)
        before = int(place)
        return self._pull[before], self._change[before], place - before

    def none(self) -> tuple[Floats, Floats, float]:
        """Return a pull of 0, as `around`."""
        return self._zero, self._zero, 0.0
