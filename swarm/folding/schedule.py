"""The whole team's motion: ways of all segments, chained, evened out, and eased.

Each segment gets a way of its own through its possible states, clear of all that others may do; the
ways are chained from the leader back along the cable, and their lattice is smoothed by a B-spline
over a common *stage* variable. Where the team then misses margins, its vehicles give way beside γ.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import csr_array

from swarm.folding.crossing_constraints import CrossingSigns, crossing_signs
from swarm.folding.hopping import basin_hopping
from swarm.folding.lane_assignment import assign_lanes
from swarm.folding.lattice import LatticePath, append_follower
from swarm.folding.layout import KnotLayout
from swarm.folding.margins import Margins
from swarm.folding.optimizer import BEYOND_REPAIR, ElasticBand, relax, straighten
from swarm.folding.path import FoldPath, Guide
from swarm.folding.penalty import ExtraMargins, TeamGeometry, no_extra_margins

Floats = npt.NDArray[np.float64]

_EVENED = 3.0
"""Stages over which a vehicle's progress is evened out."""

_DENSITIES = (1, 4)
"""Moments per stage at which the team is looked at, while it is eased."""

_AROUND = 2
"""Stages before and after strands cross in which vehicles that pass them keep the side."""

_CROOKED = 2.5
"""Units of missed margin at the worst moment that straightening will not mend."""

_STUCK = 0.5
"""Units of missed margin at the worst moment from which on the team counts as stuck."""

_FINE = 0.3
"""Units of missed margin at the worst moment that straightening may leave for mending."""

_NEAR = 2.5
"""Stages around a moment for which more is asked."""

_REST = 4
"""Stages at the end in which the spline comes to rest."""


@dataclass(frozen=True, eq=False)
class Schedule:
    """Progress of n vehicles along γ over a common stage variable, and offsets from it; C².

    ``progress`` (c, n) and ``offsets`` (c, n, 3) are control points, one per stage. ``sides`` says,
    of as many moments per stage as are ever looked at, on which sides of each other strands pass
    along γ; offsets do not change that. ``missed`` (m,) is how much margins are missed from moment
    to moment, squared, in units of a margin; ``extra`` is what the stages (c,) should keep beyond
    the margins.
    """

    path: FoldPath
    crew: TeamGeometry
    progress: Floats
    offsets: Floats
    sides: CrossingSigns
    missed: Floats
    extra: ExtraMargins

    @property
    def last_stage(self) -> float:
        """The stage at which all vehicles rest."""
        return float(len(self.progress) - 1)

    @property
    def worst(self) -> float:
        """How much margins are missed at the worst moment, in units; 0 where none is."""
        return float(np.sqrt(self.missed.max()))

    @property
    def cost(self) -> float:
        """How much the whole motion misses its margins."""
        return float(self.missed.sum())

    def at(self, stages: Floats) -> tuple[Floats, Floats, Floats]:
        """Places (k, n, 3) of all vehicles at stages (k,), and their two derivatives by stage."""
        progress, aside = _spline(self.progress), _spline(self.offsets)
        along, rate, bend = (progress(stages, nu=k) for k in range(3))
        places, slopes, bends = (aside(stages, nu=k) for k in range(3))
        for i in range(along.shape[1]):
            place, tangent, curved = self.path.at(i, along[:, i])
            places[:, i] += place
            slopes[:, i] += tangent * rate[:, i, None]
            bends[:, i] += curved * rate[:, i, None] ** 2 + tangent * bend[:, i, None]
        return places, slopes, bends


def make_schedule(layout: KnotLayout, guide: Guide, margins: Margins, step: float) -> Schedule:
    """Plan the motion of all vehicles.

    ``step`` is the lattice's step in metres of progress: what a vehicle flies in a stage at most.
    """
    found = assign_lanes(layout, guide, margins, step)
    ticks = _chained(found.ways, step)
    margin = int(4 * _EVENED) + _REST
    ticks = np.concatenate([ticks, np.repeat(ticks[-1:], margin, axis=0)])
    progress = np.stack([_evened(lattice) for lattice in ticks.T], axis=1)
    offsets = np.zeros((*progress.shape, 3))
    crew = TeamGeometry(layout.lengths, margins)
    more = no_extra_margins(len(progress))
    along = _places(found.path, _sampled(len(progress), _DENSITIES[-1]) @ progress)
    sides = crossing_signs(crew.hung(along), _AROUND * _DENSITIES[-1])
    plan = Schedule(found.path, crew, progress, offsets, sides, np.zeros(1), more)
    plan = improve(plan)
    if plan.worst > _CROOKED:
        return plan
    plan = straighten_schedule(plan)
    if plan.worst <= _STUCK:
        return plan
    offsets = basin_hopping(_looked_at(plan, _DENSITIES[-1]), plan.offsets)
    if offsets is plan.offsets:
        return plan
    return straighten_schedule(improve(replace(plan, offsets=offsets)))


def improve(plan: Schedule) -> Schedule:
    """Let vehicles give way beside γ where the team misses margins."""
    for density in _DENSITIES:
        found = relax(_looked_at(plan, density), plan.offsets)
        plan = replace(plan, offsets=found.offsets, missed=found.missed)
        if plan.worst > BEYOND_REPAIR:
            break
    return plan


def straighten_schedule(plan: Schedule) -> Schedule:
    """Straighten the whole motion, looked at coarsely; then let vehicles give way again.

    Where that misses more than before, and more than may be mended, all stays as it is.
    """
    offsets = straighten(_looked_at(plan, _DENSITIES[0]), plan.offsets)
    quicker = improve(replace(plan, offsets=offsets))
    return quicker if quicker.worst <= max(plan.worst, _FINE) else plan


def _looked_at(plan: Schedule, density: int) -> ElasticBand:
    """The team and what it is to keep, at so many moments per stage."""
    sampled = _sampled(len(plan.progress), density)
    places = _places(plan.path, sampled @ plan.progress)
    moments = np.arange(len(places))
    sides = plan.sides[moments * (_DENSITIES[-1] // density)]
    return ElasticBand(plan.crew, places, sides, plan.extra[moments // density], sampled)


def _places(path: FoldPath, progress: Floats) -> Floats:
    """Places (m, n, 3) of all vehicles on γ at progress (m, n)."""
    return np.stack([path.at(i, along)[0] for i, along in enumerate(progress.T)], axis=1)


def require_extra(plan: Schedule, margin: str, stages: Floats, metres: Floats) -> Schedule:
    """Require ``metres`` (k,) more of a margin around stages (k,).

    ``margin`` is the name of a field of :class:`ExtraMargins`.

    The plan keeps that once it is improved.
    """
    near = np.abs(np.arange(len(plan.progress))[:, None] - stages) <= _NEAR
    asked = getattr(plan.extra, margin) + (near * metres).max(axis=1)
    return replace(plan, extra=replace(plan.extra, **{margin: asked}))


def _chained(ways: tuple[LatticePath, ...], step: float) -> Floats:
    """Join the ways of all segments, from the leader's back: progress (ticks, n) of all vehicles.

    In a tick a vehicle moves by one step or waits. Where a segment wants the vehicle ahead to wait
    longer than it does, everybody ahead waits.
    """
    ticks: Floats = ways[-1].table.ahead[:, None]
    for way in reversed(ways):
        ticks = append_follower(ticks, way, step)
    return ticks


def _evened(controls: Floats) -> Floats:
    """Progress evened out over some stages, from the same begin to the same rest, monotone."""
    margin = int(4 * _EVENED) + 1
    before = controls[0] - (controls[1] - controls[0]) * np.arange(margin, 0, -1)
    after = np.full(margin, controls[-1])
    padded = np.concatenate([before, controls, after])
    even: Floats = gaussian_filter1d(padded, _EVENED)[margin:-margin]
    even = np.maximum.accumulate(even)
    even += (controls[0] - even[0]) * np.maximum(1.0 - np.arange(len(even)) / margin, 0.0)
    rest = min(int(np.argmax(controls >= controls[-1] - 1e-9)) + margin, len(even) - 1)
    even[rest:] = controls[-1]
    result: Floats = np.maximum.accumulate(np.minimum(even, controls[-1]))
    return result


def _extended(controls: Floats) -> Floats:
    """Control points with a straight run before and a rest after, for the spline's borders."""
    first, second = controls[:1], controls[1:2]
    return np.concatenate(
        [3.0 * first - 2.0 * second, 2.0 * first - second, controls, controls[-1:], controls[-1:]]
    )


def _knots(controls: int) -> Floats:
    return np.arange(controls + 10.0) - 5.0


def _spline(controls: Floats) -> BSpline:
    return BSpline(_knots(len(controls)), _extended(controls), 5)


def _sampled(controls: int, density: int) -> csr_array:
    """Weights (density·(c − 1) + 1, c) of control points, at so many moments per stage."""
    stages = np.arange(density * (controls - 1) + 1) / density
    weights = BSpline.design_matrix(stages, _knots(controls), 5)
    return csr_array(weights @ csr_array(_extended(np.eye(controls))))


def team_path(plan: Schedule, per_stage: int = 8) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the whole team's path over one parameter: parameter (k,), places and derivatives.

    Places and their two derivatives are (k, n, 3). Over the first two units of the parameter the
    stage eases in from rest, after that the parameter runs one ahead of the stage.
    """
    parameter = np.arange(round((plan.last_stage + 1.0) * per_stage) + 1) / per_stage
    share = np.minimum(parameter / 2.0, 1.0)
    easing = share < 1.0
    # Quintic from rest at 0 to rate 1 at stage 1, over two units of the parameter.
    stage = np.where(easing, 2.0 * (share**3 - 0.5 * share**4), parameter - 1.0)
    rate = np.where(easing, 3.0 * share**2 - 2.0 * share**3, 1.0)[:, None, None]
    bend = np.where(easing, (6.0 * share - 6.0 * share**2) / 2.0, 0.0)[:, None, None]
    places, slopes, bends = plan.at(stage)
    return parameter, places, slopes * rate, bends * rate**2 + slopes * bend
