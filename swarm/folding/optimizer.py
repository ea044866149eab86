"""A team's motion eased out of tight spots, as an elastic band: everybody gives way a little.

The ways that segments find along γ keep strands on their sides of each other; they need not keep
all margins. So vehicles leave γ, in all directions, by offsets that miss margins least and bend the
paths little, smooth over time and found by a quasi-Newton method: as elastic bands (Quinlan and
Khatib 1993) and CHOMP (Ratliff et al. 2009) do, with strands for bodies. Offsets vanish at the
beginning and the end.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import minimize
from scipy.sparse import csr_array

from swarm.folding.crossing_constraints import CrossingSigns
from swarm.folding.penalty import ExtraMargins, Penalty, TeamGeometry
from swarm.folding.strand_clearance import empty_margin_cache

Floats = npt.NDArray[np.float64]

_LOOSE = 1.0
"""Curvature of the cost of giving way by a metre at a stage, next to that of bending by a metre."""

_HELD, _HOLD = 3, 1e4
"""Stages at the ends of a window in which offsets stay, and how stiffly."""

_NOTHING = 1e-6
"""Share of the largest weight below which weights are left out."""

_ASIDE = 12
"""Stages before and after a moment that misses margins in which vehicles may give way for it."""

_STRAINED = 0.05
"""Missed margins of a moment, squared, that are worth giving way for."""

_ASKED = 0.1
"""Share of these that is worth it where more is asked for than margins."""

_LAZY = 0.0005
"""Cost of a wish of size 1 to give way at a stage, next to a missed unit of margin."""

_ROUNDS = 4
"""How often windows are chosen anew."""

_TOO_SLOW = 0.7
"""What a round may leave of missed margins if there is to be another one."""


BEYOND_REPAIR = 1.0
"""Units of missed margin at the worst moment that looking closer will not mend."""


@dataclass(frozen=True)
class _Effort:
    """How a motion is changed for the better: ``steps`` of the quasi-Newton method at most.

    ``bending`` is the cost of second differences (c, n, 3) of vehicles' paths, in metres, next to a
    missed unit of margin, by ``measure``, which also gives half its slope. A step which lowers the
    cost by less than a share ``settled`` is the last.
    """

    steps: int
    bending: float
    settled: float
    measure: Callable[[Floats], tuple[float, Floats]]


def _square(bent: Floats) -> tuple[float, Floats]:
    """Everybody's bends, squared."""
    return float((bent**2).sum()), bent


def _sharpest(bent: Floats) -> tuple[float, Floats]:
    """The bends at every stage, squared, of those above all who bend most: they set the pace."""
    square = (bent**2).sum(axis=2, keepdims=True)
    size = np.sqrt((square**2).sum(axis=1, keepdims=True)) + _NO_BEND
    return float(size.sum()), square / size * bent


_NO_BEND = 1e-9
"""Square metres of bend that count as none."""

RELAXING = _Effort(steps=30, bending=0.3, settled=3e-3, measure=_square)
_STRAIGHTENING = _Effort(steps=100, bending=2.0, settled=1e-3, measure=_sharpest)


@dataclass(frozen=True, eq=False)
class Relaxed:
    """Offsets (c, n, 3) of all vehicles at control points, and what is missed (s,) with them."""

    offsets: Floats
    missed: Floats


def relax(band: "ElasticBand", offsets: Floats) -> Relaxed:
    """Find offsets with which a team misses its margins, and what is asked beyond them, least.

    ``offsets`` (c, n, 3) are what to begin with.
    """
    stages = band.sampled.argmax(axis=1)
    missed = band.strain(offsets).missed
    worth = np.where(band.more.asked, _ASKED * _STRAINED, _STRAINED)
    for done in range(_ROUNDS):
        strained = np.unique(stages[missed > worth])
        if not len(strained):
            break
        before = missed.sum()
        for window in _windows(strained, len(offsets), _ASIDE * (1 + done)):
            offsets = band.relaxed(offsets, window, RELAXING)
        missed = band.strain(offsets).missed
        if missed.sum() > _TOO_SLOW * before:
            break
    return Relaxed(offsets, band.strain(offsets, wishes=False).missed)


def straighten(band: "ElasticBand", offsets: Floats) -> Floats:
    """Offsets (c, n, 3) with which all of the motion is straighter: arguments as for :func:`relax`.

    Who need not give way any more cuts corners, and the fold gets quicker.
    """
    return band.relaxed(offsets, slice(0, len(offsets)), _STRAIGHTENING)


def _windows(strained: npt.NDArray[np.intp], stages: int, aside: int) -> list[slice]:
    """Runs of stages around those that are strained."""
    wanted = np.zeros(stages + 1, dtype=bool)
    for stage in strained:
        wanted[max(stage - aside, 0) : stage + aside] = True
    wanted[-1] = False
    edges = np.flatnonzero(np.diff(wanted, prepend=False))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


@dataclass(frozen=True, eq=False)
class ElasticBand:
    """A team's motion to give way in, looked at at s moments, some in each stage.

    ``places`` (s, n, 3) are without offsets; ``sides`` and ``more`` are to be kept at these
    moments. ``sampled`` (s, c) are the weights of control points, one per stage, at them; they
    include all stages.
    """

    crew: TeamGeometry
    places: Floats
    sides: CrossingSigns
    more: ExtraMargins
    sampled: csr_array

    @property
    def density(self) -> int:
        """Moments per stage."""
        moments, stages = self.sampled.shape
        return int((moments - 1) // (stages - 1))

    def moved(self, offsets: Floats) -> Floats:
        """Places (s, n, 3) with offsets."""
        flat: Floats = self.sampled @ offsets.reshape(len(offsets), -1)
        return self.places + flat.reshape(self.places.shape)

    def strain(
        self, offsets: Floats, moments: slice = slice(None), *, wishes: bool = True
    ) -> Penalty:
        """What the team misses with offsets, at some moments or all."""
        places, sides, more = self.moved(offsets)[moments], self.sides[moments], self.more[moments]
        return self.crew.strain(places, sides, more, wishes=wishes)

    def relaxed(self, offsets: Floats, window: slice, effort: _Effort) -> Floats:
        """Offsets changed for the better within a window of stages."""
        smooth = _smoothing(window.stop - window.start, effort.bending)
        inside = self.sampled[:, window]
        moments = np.flatnonzero(np.diff(inside.indptr))
        weights = csr_array(inside[moments] @ smooth)
        back, smooth_back = csr_array(weights.T), csr_array(smooth.T)
        base = self.moved(offsets)[moments]
        sides, more = self.sides[moments], self.more[moments]
        calm = empty_margin_cache(len(moments), len(self.crew.lengths))
        paths = (self.places[:: self.density] + offsets)[window].reshape(smooth.shape[0], -1)

        def cost(flat: Floats) -> tuple[float, Floats]:
            wishes = flat.reshape(weights.shape[1], -1)
            places = base + (weights @ wishes).reshape(base.shape)
            strain = self.crew.strain(places, sides, more, calm=calm)
            slope = 2.0 * strain.slopes.reshape(len(base), -1)
            bent = np.diff(paths + smooth @ wishes, 2, axis=0)
            bends, straighten = effort.measure(bent.reshape(len(bent), -1, 3))
            total = strain.missed.sum() + effort.bending * bends + _LAZY * (wishes**2).sum()
            straighten = _unbent(straighten.reshape(bent.shape))
            gradient = back @ slope + 2.0 * effort.bending * (smooth_back @ straighten)
            return float(total), (gradient + 2.0 * _LAZY * wishes).ravel()

        begin = np.zeros(weights.shape[1] * base[0].size)
        found = minimize(
            cost,
            begin,
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": effort.steps, "maxcor": 12, "ftol": effort.settled},
        )
        changed = offsets.copy()
        change = smooth @ found.x.reshape(weights.shape[1], -1)
        changed[window] += change.reshape(changed[window].shape)
        return changed


def _unbent(bent: Floats) -> Floats:
    """The transpose of taking second differences."""
    slope = np.zeros((len(bent) + 2, bent.shape[1]))
    slope[:-2] += bent
    slope[1:-1] -= 2.0 * bent
    slope[2:] += bent
    return slope


def _smoothing(stages: int, bending: float) -> csr_array:
    """Weights (stages, stages) that make offsets of wishes: smooth, and next to none at both ends.

    Wishes of one size make offsets that cost about the same, whether they are long or short: with
    the cost's curvature LᵀL they are L⁻¹ of the wishes (as CHOMP's covariant gradient has it), so
    that few steps even out what is bent over many stages.
    """
    ends = np.minimum(np.arange(stages), np.arange(stages)[::-1]) < _HELD
    second = np.diff(np.eye(stages), 2, axis=0)
    curvature = bending * (second.T @ second + _LOOSE * np.eye(stages)) + np.diag(_HOLD * ends)
    smooth = solve_triangular(cholesky(curvature), np.eye(stages))
    smooth[ends] = 0.0
    return csr_array(np.where(np.abs(smooth) > _NOTHING * np.abs(smooth).max(), smooth, 0.0))
