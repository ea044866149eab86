"""Strands that partly lie on the floor, in batches.

Where its catenary would pass below the floor, a strand comes down as part of a catenary that meets
the floor tangentially, lies straight, and rises again as part of a catenary with the same
horizontal tension (no friction, quasi-static). With surplus cable the horizontal tension vanishes:
both ends hang straight down and the surplus lies loose on the floor. Each strand is solved by
:func:`swarm.geometry.catenary_kernel.solve_on_floor`.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from swarm.geometry.catenary import STANDARD_GRAVITY, Catenaries, solve_catenaries
from swarm.geometry.catenary_kernel import solve_on_floor
from swarm.jit import compiled
from swarm.signatures import Floats1, Floats2

Floats = NDArray[np.float64]

_NEGLIGIBLE = 1e-12
"""Share of the length below which a height or a length on the floor counts as 0: rounding."""

_BELOW_FLOOR = 1e-9
"""Metres by which an end may be below the floor: rounding of coordinates."""


@dataclass(frozen=True, eq=False)
class FloorStrands:
    """A batch of strands, in the air or partly on the floor; from :func:`rest_on_floor`.

    Vectors are (…, 3), scalars (…,), metres, z up. Fields other than ``free`` hold where
    ``touching``; elsewhere the strand is the catenary ``free``.
    """

    free: Catenaries
    """The catenaries without a floor."""
    floor: Floats
    touching: NDArray[np.bool_]
    """Whether some of the strand lies on the floor."""
    parameter: Floats
    """a, metres: horizontal tension over the weight of a metre; 0 where cable lies loose."""
    lifted_start: Floats
    """Arc length from the start to the point where the strand touches the floor."""
    lifted_end: Floats
    loose: Floats
    """Surplus cable, which lies loose somewhere about the line between the ends."""

    @property
    def lying(self) -> Floats:
        """Arc length (…,) on the floor, with the loose cable; 0 where nothing touches the floor."""
        return np.where(self.touching, self.free.length - self.lifted_start - self.lifted_end, 0.0)

    @cached_property
    def _heights(self) -> tuple[Floats, Floats]:
        return _heights(self.free, self.floor)

    def points(self, fractions: ArrayLike) -> Floats:
        """Return points at the given fractions (k,) of the arc length of every strand: (…, k, 3).

        Loose cable is drawn evenly along the straight line on the floor.
        """
        fractions = np.asarray(fractions, dtype=np.float64)
        arc = fractions * self.free.length[..., None]
        first, last = self.lifted_start[..., None], self.lifted_end[..., None]
        from_end = self.free.length[..., None] - arc
        a = self.parameter[..., None]
        down_start, up_start = _branch(a, np.maximum(first - arc, 0.0))
        down_end, up_end = _branch(a, np.maximum(last - from_end, 0.0))
        reach_start, reach_end = _branch(a, first)[0], _branch(a, last)[0]
        lying = np.maximum(self.lying, _NEGLIGIBLE * self.free.length)[..., None]
        run = np.clip((arc - first) / lying, 0.0, 1.0)
        flat = self.free.span[..., None] - reach_start - reach_end
        along = reach_start - down_start + run * flat + down_end
        height = self.floor[..., None] + up_start + up_end
        plan = self.free.start[..., None, :2] + along[..., None] * self.free.heading[..., None, :2]
        resting = np.concatenate([plan, height[..., None]], axis=-1)
        return np.where(self.touching[..., None, None], resting, self.free.points(fractions))

    def tension(
        self, mass_per_length: ArrayLike, gravity: ArrayLike = STANDARD_GRAVITY
    ) -> tuple[Floats, Floats, Floats]:
        """Return tensions (…,) in newtons: the horizontal part, at the start, and at the end."""
        weight = np.asarray(mass_per_length, dtype=np.float64) * np.asarray(gravity)
        low, high = self._heights
        resting = self.parameter, self.parameter + low, self.parameter + high
        hanging = self.free.tension(mass_per_length, gravity)
        horizontal, at_start, at_end = (
            np.where(self.touching, weight * on_floor, aloft)
            for on_floor, aloft in zip(resting, hanging, strict=True)
        )
        return horizontal, at_start, at_end

    def end_forces(
        self, mass_per_length: ArrayLike, gravity: ArrayLike = STANDARD_GRAVITY
    ) -> tuple[Floats, Floats]:
        """Return the forces (…, 3) of each strand on the holders of its start and end; newtons.

        Their sum is the weight of the cable off the floor.
        """
        weight = np.asarray(mass_per_length, dtype=np.float64) * np.asarray(gravity)
        heading, down = self.free.heading, self.free.down
        pull = (weight * self.parameter)[..., None] * heading
        at_start = pull + (weight * self.lifted_start)[..., None] * down
        at_end = -pull + (weight * self.lifted_end)[..., None] * down
        free_start, free_end = self.free.end_forces(mass_per_length, gravity)
        touching = self.touching[..., None]
        return np.where(touching, at_start, free_start), np.where(touching, at_end, free_end)


def rest_on_floor(
    start: ArrayLike, end: ArrayLike, length: ArrayLike, floor: ArrayLike = 0.0
) -> FloorStrands:
    """Return the strands of cables between ends above a level floor, on which cable may lie.

    ``start`` and ``end`` are (…, 3), z up, ``length`` and ``floor`` (the floor's z) are (…,); they
    broadcast; metres. Ends may be on the floor, not below it.

    Raises :class:`swarm.geometry.catenary.OverStretched`, and :class:`ValueError` for ends below
    the floor.
    """
    free = solve_catenaries(start, end, length)
    floor = np.broadcast_to(np.asarray(floor, dtype=np.float64), free.length.shape)
    low, high = _heights(free, floor)
    touching = free.lowest()[..., 2] < floor - _NEGLIGIBLE * free.length
    surplus = free.length - free.span
    solved = np.zeros((3, touching.sum()))
    _solve_all(low[touching], high[touching], surplus[touching], solved)
    resting = np.zeros((3, *touching.shape))
    resting[:, touching] = solved
    parameter, lifted_start, lifted_end = resting
    return FloorStrands(
        free=free,
        floor=floor,
        touching=touching,
        parameter=parameter,
        lifted_start=lifted_start,
        lifted_end=lifted_end,
        loose=np.where(touching, np.maximum(surplus - low - high, 0.0), 0.0),
    )


@compiled
def _solve_all(first: Floats1, last: Floats1, surplus: Floats1, solved: Floats2) -> None:
    """Write parameters and the two lifted lengths (3, q) of strands that reach the floor."""
    for q in range(len(first)):
        solved[0, q], solved[1, q], solved[2, q] = solve_on_floor(first[q], last[q], surplus[q])


def _heights(free: Catenaries, floor: Floats) -> tuple[Floats, Floats]:
    """Return the heights of both ends above the floor; negligible ones are 0."""
    low, high = free.start[..., 2] - floor, free.end[..., 2] - floor
    if np.any(np.minimum(low, high) < -_BELOW_FLOOR):
        raise ValueError("an end of a strand is below the floor")
    negligible = _NEGLIGIBLE * free.length
    return np.where(low > negligible, low, 0.0), np.where(high > negligible, high, 0.0)


def _branch(a: Floats, arc: Floats) -> tuple[Floats, Floats]:
    """Return how far and how high a point is from the touching point, at an arc length from it."""
    safe = np.where(a > 0.0, a, 1.0)
    across = np.where(a > 0.0, safe * np.arcsinh(arc / safe), 0.0)
    total = np.hypot(arc, a) + a
    up = np.where(total > 0.0, arc / np.where(total > 0.0, total, 1.0) * arc, 0.0)
    return across, up
