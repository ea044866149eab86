"""The swinging cable: strands as lumped masses on inextensible links, their ends moved as given.

Each strand is cut into equal links with a mass at each inner joint (the lumped-mass model of
mooring lines; Walton and Polachek 1960); :mod:`.lumped_mass_kernel` steps them. Strands do not
touch each other, the floor or the vehicles, and do not act on the vehicles.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from swarm.geometry.distance import norms
from swarm.geometry.hanging_links import hung_strands
from swarm.geometry.lumped_mass_kernel import Drag, Steps, swing_each
from swarm.geometry.strays import strays_of
from swarm.jit import inner

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

AIR_DENSITY = 1.225
"""kg/m³ at sea level, 15 °C (ISO 2533)."""

NORMAL_DRAG = 1.1
"""Drag coefficient of a cylinder across the flow, at the Reynolds numbers of a cable (Hoerner 1965,
p. 3-9)."""

TANGENTIAL_DRAG = 0.02
"""Friction coefficient of a cable along the flow: assumed, of the order of rough surfaces'. Without
it, joints move by up to 3 mm in the fold of the default overhand, 5 mm in the figure-eight's."""

LINKS, STEP = 24, 0.01
"""Links of a strand and seconds: half the step changes the stray of the default missions' strands
by less than a centimetre."""


@dataclass(frozen=True)
class SwingModel:
    """Discretization and air of the lumped-mass model.

    ``links`` per strand; ``step`` of the integration in seconds; ``normal_drag`` and
    ``tangential_drag`` are ½ρ·C·d / μ in 1/m, the deceleration of the cable over the square of its
    speed across and along itself (d: diameter, μ: mass per length); ``wind`` in m/s, ENU.
    """

    links: int
    step: float
    normal_drag: float
    tangential_drag: float = 0.0
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0)


def cable_model(mass_per_length: float, diameter: float) -> SwingModel:
    """Return the model of a cable of kg/m and a diameter in metres, in still air."""
    pressure = 0.5 * AIR_DENSITY * diameter / mass_per_length
    return SwingModel(LINKS, STEP, pressure * NORMAL_DRAG, pressure * math.pi * TANGENTIAL_DRAG)


def swing(ends: Floats, lengths: Floats, model: SwingModel, every: int = 1) -> Floats:
    """Return the joints of swinging strands whose ends move as given.

    ``ends`` (k, n, 3) are the positions of n grip points, ENU metres, ``model.step`` seconds apart;
    ``lengths`` (n − 1,) belong to the strands between them. All strands begin at rest as
    catenaries. Returns (ceil(k / every), n − 1, links + 1, 3): each ``every``-th step.

    Raises :class:`swarm.geometry.catenary.OverStretched` where the first chord is longer than its
    strand; later, a strand that is pulled taut ends as NaN.
    """
    strands = Strands.whole_chain(lengths, model)
    found: Floats = strands.swing_on_each(strands.at_rest(ends[0])[None], ends[None], every)[0]
    return found


@dataclass(frozen=True, eq=False)
class Strands:
    """Strands (s,) of a chain of grip points with one model.

    ``segments`` (s,) are the numbers of the grip points at which they begin, ``lengths`` in metres.
    """

    segments: Ints
    lengths: Floats
    model: SwingModel

    @classmethod
    def whole_chain(cls, lengths: Floats, model: SwingModel) -> "Strands":
        """Return all strands of a chain, of lengths (n − 1,)."""
        return cls(np.arange(len(lengths)), lengths, model)

    def taken(self, where: Ints) -> "Strands":
        """Return some of the strands."""
        return Strands(self.segments[where], self.lengths[where], self.model)

    def refined(self) -> "Strands":
        """Return the strands with twice the links, and half the step."""
        links, step = 2 * self.model.links, 0.5 * self.model.step
        return replace(self, model=replace(self.model, links=links, step=step))

    def at_rest(self, ends: Floats) -> Floats:
        """Return the state (2, s, links + 1, 3) of strands that hang still at grip points (n, 3).

        A state holds the joints one step ago, and now. Raises
        :class:`swarm.geometry.catenary.OverStretched` where a chord is longer than its strand.
        """
        begin = self.segments
        joints = hung_strands(ends[begin], ends[begin + 1], self.lengths, self.model.links)
        return np.stack([joints, joints])

    def swing_on(self, state: Floats, ends: Floats, every: int = 1) -> Floats:
        """Return the states of strands that continue from a state, as :func:`swing` from rest.

        ``ends`` (k, n, 3) are the grip points, ``model.step`` seconds apart, beginning at the
        state's time. Returns (ceil(k / every), 2, s, links + 1, 3), the given state first.
        """
        found: Floats = self._swing(state[None], ends[None], every, 2)[0]
        return found

    def swing_on_each(self, states: Floats, ends: Floats, every: int = 1) -> Floats:
        """Return the joints of the strands from c states, each in its own motion.

        ``states`` (c, 2, s, links + 1, 3) and ``ends`` (c, k, n, 3) as for :meth:`swing_on`.
        Returns (c, ceil(k / every), s, links + 1, 3).
        """
        found: Floats = self._swing(states, ends, every, 1)[:, :, 0]
        return found

    def strays(self, joints: Floats, ends: Floats) -> Floats:
        """Return the distances (k, s) of :func:`stray` for joints (k, s, links + 1, 3) of these
        strands and grip points (k, n, 3)."""
        return _farthest(joints, ends, self.segments, self.lengths)

    def _swing(self, states: Floats, ends: Floats, every: int, parts: int) -> Floats:
        """Return the last ``parts`` of the states (c, ceil(k / every), …, s, links + 1, 3)."""
        model = self.model
        samples = (ends.shape[1] + every - 1) // every
        found = np.empty((len(states), samples, parts, *states.shape[2:]))
        found[:, 0] = states[:, 2 - parts :]
        drag = Drag(model.normal_drag, model.tangential_drag, *model.wind)
        # those of one grip point next to each other: others would fill the caches
        grips = np.ascontiguousarray(ends.swapaxes(1, 2))
        given = np.ascontiguousarray(states), grips, self.segments
        swing_each(given, self.lengths / model.links, Steps(model.step, every), drag, found)
        return found


def stray(joints: Floats, ends: Floats, lengths: Floats) -> Floats:
    """Return the largest distance of strands from their catenaries, in metres.

    ``joints`` (k, n − 1, links + 1, 3) of the strands, ``ends`` (k, n, 3) of the grip points at the
    same times; compared at equal arc length. Returns (k, n − 1), infinite for strands that are
    shorter than their chord at the time or were so before.
    """
    return _farthest(joints, ends, np.arange(len(lengths)), lengths)


def _farthest(joints: Floats, ends: Floats, segments: Ints, lengths: Floats) -> Floats:
    chords = np.linalg.norm(ends[:, segments + 1] - ends[:, segments], axis=2)
    distance: Floats = norms(strays_of(joints, ends, segments, lengths)).max(axis=-1)
    return np.where((chords > lengths) | np.isnan(distance), np.inf, distance)


@inner
def solve_tridiagonal(lower: Floats, diagonal: Floats, upper: Floats, right: Floats) -> None:
    """Solve a tridiagonal system in place (Thomas); ``right`` becomes the solution."""
    n = len(right)
    for j in range(1, n):
        factor = lower[j] / diagonal[j - 1]
        diagonal[j] -= factor * upper[j - 1]
        right[j] -= factor * right[j - 1]
    right[n - 1] /= diagonal[n - 1]
    for j in range(n - 2, -1, -1):
        right[j] = (right[j] - upper[j] * right[j + 1]) / diagonal[j]
