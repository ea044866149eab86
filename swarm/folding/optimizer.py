"""Relaxation of a team's motion as an elastic band: vehicles move aside where margins are missed.

The lattice paths of segments along γ keep strands on their sides of each other; they need not keep
all margins. So vehicles leave γ in all directions, by offsets that miss margins least and bend the
paths little. Offsets are smooth over time; a quasi-Newton method finds them, as elastic bands
(Quinlan and Khatib 1993) and CHOMP (Ratliff et al. 2009) do for rigid bodies. Offsets vanish at the
beginning and the end.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from swarm.folding.crossing_constraints import CrossingSigns
from swarm.folding.margins import Penalty
from swarm.folding.neighbour_clearance import empty_margin_cache
from swarm.folding.penalty import ExtraMargins, TeamGeometry

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

_STIFFNESS = 1.0
"""Curvature of the cost of an offset of a metre at a stage, over that of a bend of a metre."""

_FIXED, _FIXED_STIFFNESS = 3, 1e4
"""Stages at the ends of a window whose offsets do not change, and their stiffness."""

_NEGLIGIBLE = 1e-6
"""Share of the largest weight below which weights are dropped."""

_ASIDE = 12
"""Stages before and after a moment that misses margins in which vehicles may move for it."""

_WORTH = 0.05
"""Missed margins of a moment, squared, for which vehicles move aside."""

_WORTH_OF_EXTRA = 0.1
"""Share of these for which they do where extra margins are required."""

_PREFERENCE_COST = 0.0005
"""Cost of a variable of size 1 at a stage, over that of a missed unit of margin."""

_ROUNDS = 4
"""Largest number of choices of windows."""

_TOO_SLOW = 0.7
"""Share of the missed margins that a round may leave if another one is to follow."""

_NO_BEND = 1e-9
"""Square metres of bend that count as 0."""

BEYOND_REPAIR = 1.0
"""Units of missed margin at the worst moment that a finer relaxation does not repair."""


@dataclass(frozen=True)
class _Settings:
    """Settings of one relaxation: at most ``steps`` of the quasi-Newton method.

    ``bending`` is the cost of second differences (c, n, 3) of the paths, in metres, over that of a
    missed unit of margin; ``measure`` returns their size and half its derivative. A step that
    lowers the cost by less than a share ``settled`` is the last.
    """

    steps: int
    bending: float
    settled: float
    measure: Callable[[Floats], tuple[float, Floats]]


def _square(bends: Floats) -> tuple[float, Floats]:
    """Return the sum of the squared bends of all vehicles, and half its derivative."""
    return float((bends**2).sum()), bends


def _sharpest(bends: Floats) -> tuple[float, Floats]:
    """Return the bends of every stage, squared, and half their derivative.

    Vehicles that bend most count most: they limit the speed.
    """
    square = (bends**2).sum(axis=2, keepdims=True)
    size = np.sqrt((square**2).sum(axis=1, keepdims=True)) + _NO_BEND
    return float(size.sum()), square / size * bends


RELAXING = _Settings(steps=30, bending=0.3, settled=3e-3, measure=_square)
_STRAIGHTENING = _Settings(steps=100, bending=2.0, settled=1e-3, measure=_sharpest)


@dataclass(frozen=True, eq=False)
class Relaxed:
    """Offsets (c, n, 3) of all vehicles at control points, and the missed margins (s,)."""

    offsets: Floats
    missed: Floats


def relax(band: "ElasticBand", offsets: Floats) -> Relaxed:
    """Return offsets with which a team misses its margins and extra margins least.

    ``offsets`` (c, n, 3) are the start.
    """
    stages = band.weights.argmax(axis=1)
    missed, kept = band.missed(offsets, np.arange(len(stages)))
    worth = np.where(band.extra.present, _WORTH_OF_EXTRA * _WORTH, _WORTH)
    for done in range(_ROUNDS):
        tight = np.unique(stages[missed > worth])
        if not len(tight):
            break
        before = missed.sum()
        windows = _windows(tight, len(offsets), _ASIDE * (1 + done))
        for window in windows:
            offsets = band.relaxed(offsets, window, RELAXING)
        moved = band.moments(windows)
        missed[moved], kept[moved] = band.missed(offsets, moved)
        if missed.sum() > _TOO_SLOW * before:
            break
    return Relaxed(offsets, kept)


def straighten(band: "ElasticBand", offsets: Floats) -> Floats:
    """Return offsets (c, n, 3) with which all of the motion is straighter; see :func:`relax`.

    Vehicles that need not move aside any more cut corners, and the fold takes less time.
    """
    return band.relaxed(offsets, slice(0, len(offsets)), _STRAIGHTENING)


def _windows(tight: npt.NDArray[np.intp], stages: int, aside: int) -> list[slice]:
    """Return runs of stages around tight ones."""
    wanted = np.zeros(stages + 1, dtype=bool)
    for stage in tight:
        wanted[max(stage - aside, 0) : stage + aside] = True
    wanted[-1] = False
    edges = np.flatnonzero(np.diff(wanted, prepend=False))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


@dataclass(frozen=True, eq=False)
class ElasticBand:
    """A team's motion at s moments, several in each stage.

    ``positions`` (s, n, 3) are without offsets; ``signs`` and ``extra`` are the constraints of the
    moments. ``weights`` (s, c) are the weights of control points, one per stage, at the moments,
    which include all stages. ``paths`` (c, n, 3) are the positions without offsets at the stages,
    whose bends cost: a motion that is shaped is nowhere on its paths.
    """

    team: TeamGeometry
    paths: Floats
    positions: Floats
    signs: CrossingSigns
    extra: ExtraMargins
    weights: "scipy.sparse.csr_array"

    @property
    def density(self) -> int:
        """Moments per stage, where every moment is there once."""
        moments, stages = self.weights.shape
        return int((moments - 1) // (stages - 1))

    def moved(self, offsets: Floats) -> Floats:
        """Return positions (s, n, 3) with offsets."""
        flat: Floats = self.weights @ offsets.reshape(len(offsets), -1)
        return self.positions + flat.reshape(self.positions.shape)

    def moments(self, windows: Sequence[slice]) -> Ints:
        """Return the moments that depend on the offsets in windows of stages."""
        inside = [np.diff(self.weights[:, window].indptr) for window in windows]
        changed: Ints = np.flatnonzero(np.any(inside, axis=0))
        return changed

    def penalty(self, offsets: Floats, moments: slice = slice(None)) -> Penalty:
        """Return the missed margins with offsets, at some moments or all, without preferences."""
        positions = self.moved(offsets)[moments]
        return self.team.penalty(
            positions, self.signs[moments], self.extra[moments], preferences=False
        )

    def missed(self, offsets: Floats, moments: Ints) -> tuple[Floats, Floats]:
        """Return the missed margins (m,) at moments (m,), with preferences and without."""
        positions = self.moved(offsets)[moments]
        return self.team.missed(positions, self.signs[moments], self.extra[moments])

    def relaxed(self, offsets: Floats, window: slice, settings: _Settings) -> Floats:
        """Return offsets of lower cost, changed within a window of stages."""
        smooth = _smoothing(window.stop - window.start, settings.bending)
        moments = self.moments([window])
        weights = scipy.sparse.csr_array(self.weights[moments][:, window] @ smooth)
        back, smooth_back = scipy.sparse.csr_array(weights.T), scipy.sparse.csr_array(smooth.T)
        base = self.moved(offsets)[moments]
        signs, extra = self.signs[moments], self.extra[moments]
        cache = empty_margin_cache(len(moments), len(self.team.lengths))
        paths = (self.paths + offsets)[window].reshape(smooth.shape[0], -1)

        def cost(flat: Floats) -> tuple[float, Floats]:
            variables = flat.reshape(weights.shape[1], -1)
            positions = base + (weights @ variables).reshape(base.shape)
            penalty = self.team.penalty(positions, signs, extra, cache=cache)
            slope = 2.0 * penalty.gradient.reshape(len(base), -1)
            bends = np.diff(paths + smooth @ variables, 2, axis=0)
            size, by_bends = settings.measure(bends.reshape(len(bends), -1, 3))
            total = penalty.missed.sum() + settings.bending * size
            total = total + _PREFERENCE_COST * (variables**2).sum()
            by_paths = _second_differences_back(by_bends.reshape(bends.shape))
            gradient = back @ slope + 2.0 * settings.bending * (smooth_back @ by_paths)
            return float(total), (gradient + 2.0 * _PREFERENCE_COST * variables).ravel()

        begin = np.zeros(weights.shape[1] * base[0].size)
        minimum = scipy.optimize.minimize(
            cost,
            begin,
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": settings.steps, "maxcor": 12, "ftol": settings.settled},
        )
        changed = offsets.copy()
        change = smooth @ minimum.x.reshape(weights.shape[1], -1)
        changed[window] += change.reshape(changed[window].shape)
        return changed


def _second_differences_back(bends: Floats) -> Floats:
    """Return the transpose of second differences, applied to bends."""
    slope = np.zeros((len(bends) + 2, bends.shape[1]))
    slope[:-2] += bends
    slope[1:-1] -= 2.0 * bends
    slope[2:] += bends
    return slope


def _smoothing(stages: int, bending: float) -> "scipy.sparse.csr_array":
    """Return weights (stages, stages) of smooth offsets for variables; almost 0 at both ends.

    Variables of one size give offsets of about the same cost, whether these are long or short: with
    the cost's curvature LᵀL, offsets are L⁻¹ of the variables (as in CHOMP's covariant gradient),
    so that few steps smooth a bend over many stages.
    """
    ends = np.minimum(np.arange(stages), np.arange(stages)[::-1]) < _FIXED
    second = np.diff(np.eye(stages), 2, axis=0)
    curvature = bending * (second.T @ second + _STIFFNESS * np.eye(stages))
    curvature = curvature + np.diag(_FIXED_STIFFNESS * ends)
    smooth = scipy.linalg.solve_triangular(scipy.linalg.cholesky(curvature), np.eye(stages))
    smooth[ends] = 0.0
    largest = np.abs(smooth).max()
    return scipy.sparse.csr_array(np.where(np.abs(smooth) > _NEGLIGIBLE * largest, smooth, 0.0))
