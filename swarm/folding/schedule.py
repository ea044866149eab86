"""The motion of the whole team: lattice paths of all segments, joined, smoothed and relaxed.

Every segment has a lattice path of its own, clear of what others may do. The paths are joined from
the leader back along the cable, and smoothed by a B-spline over a common *stage* variable. Where
the team then misses margins, its vehicles move aside from γ.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy

from swarm.folding.crossing_constraints import CrossingSigns, crossing_signs
from swarm.folding.hopping import basin_hopping
from swarm.folding.lane_assignment import assign_lanes
from swarm.folding.lattice import LatticePath, append_follower
from swarm.folding.layout import KnotLayout
from swarm.folding.margins import Margins
from swarm.folding.optimizer import BEYOND_REPAIR, ElasticBand, relax, straighten
from swarm.folding.path import Guide, TeamPaths
from swarm.folding.penalty import ExtraMargins, TeamGeometry, no_extra_margins

Floats = npt.NDArray[np.float64]

_SMOOTHED = 3.0
"""Standard deviation in stages of the Gaussian that smooths a vehicle's progress."""

_DENSITIES = (1, 4)
"""Moments per stage at which the team is sampled while it is relaxed, one after the other."""

_AROUND = 2
"""Stages before and after a crossing in which vehicles that pass the strand keep their side."""

_BEYOND_STRAIGHTENING = 2.5
"""Units of missed margin at the worst moment that straightening does not repair."""

_LOCAL_MINIMUM = 0.5
"""Units of missed margin at the worst moment above which the team counts as in a local minimum."""

_AFTER_STRAIGHTENING = 0.3
"""Units of missed margin at the worst moment that straightening may leave to later repair."""

_NEAR = 2.5
"""Stages around a moment to which an extra margin applies."""

REST = 4
"""Stages at the end in which the spline comes to rest."""


@dataclass(frozen=True, eq=False)
class Schedule:
    """Progress of n vehicles along their paths over a common stage variable, and offsets; C².

    ``progress`` (c, n) and ``offsets`` (c, n, 3) are control points, one per stage. ``signs`` are
    those of the strands along γ at the finest sampling; offsets keep them. ``missed`` (m,) are the
    missed margins from moment to moment, squared, in units of a margin; ``extra`` is required
    beyond the margins at the stages (c,).
    """

    path: TeamPaths
    team: TeamGeometry
    progress: Floats
    offsets: Floats
    signs: CrossingSigns
    missed: Floats
    extra: ExtraMargins

    @property
    def last_stage(self) -> float:
        """The stage at which all vehicles rest."""
        return float(len(self.progress) - 1)

    @property
    def worst(self) -> float:
        """The missed margin at the worst moment, in units; 0 where none is missed."""
        return float(np.sqrt(self.missed.max()))

    @property
    def cost(self) -> float:
        """The missed margins of the whole motion, squared and summed."""
        return float(self.missed.sum())

    def at(self, stages: Floats) -> tuple[Floats, Floats, Floats]:
        """Return positions (k, n, 3) at stages (k,), and their two derivatives by stage."""
        progress, aside = stage_spline(self.progress), stage_spline(self.offsets)
        along, rate, bend = (progress(stages, nu=k) for k in range(3))
        positions, slopes, bends = (aside(stages, nu=k) for k in range(3))
        for i in range(along.shape[1]):
            position, tangent, curved = self.path.at(i, along[:, i])
            positions[:, i] += position
            slopes[:, i] += tangent * rate[:, i, None]
            bends[:, i] += curved * rate[:, i, None] ** 2 + tangent * bend[:, i, None]
        return positions, slopes, bends


@dataclass(frozen=True, eq=False)
class Flown:
    """How a schedule is flown: shaped, as the mean of the team at several stages.

    ``stages`` (m, k) of m moments from the beginning to the end, with ``shares`` (k,), which sum
    to 1.
    """

    stages: Floats
    shares: Floats

    def at(self, stages: Floats) -> Floats:
        """Return the stages (q, k) whose mean is at given stages (q,)."""
        mean = self.stages @ self.shares
        return np.stack([np.interp(stages, mean, each) for each in self.stages.T], axis=1)


def make_schedule(layout: KnotLayout, guide: Guide, margins: Margins, step: float) -> Schedule:
    """Return the motion of all vehicles to the corners of a layout.

    ``step`` is the lattice's step in metres of progress: the largest progress in a stage.
    """
    assignment = assign_lanes(layout, guide, margins, step)
    ticks = _joined(assignment.paths, step)
    margin = int(4 * _SMOOTHED) + REST
    ticks = np.concatenate([ticks, np.repeat(ticks[-1:], margin, axis=0)])
    progress = np.stack([_smoothed(lattice) for lattice in ticks.T], axis=1)
    return relaxed_schedule(assignment.path, TeamGeometry(layout.lengths, margins), progress)


def relaxed_schedule(path: TeamPaths, team: TeamGeometry, progress: Floats) -> Schedule:
    """Return the motion of a team with progress (c, n) along its paths, relaxed and straightened.

    Strands keep the sides of each other that they have along the paths.
    """
    offsets = np.zeros((*progress.shape, 3))
    extra = no_extra_margins(len(progress))
    along = _positions(path, _weights(len(progress), _DENSITIES[-1]) @ progress)
    signs = crossing_signs(team.outlines(along), _AROUND * _DENSITIES[-1])
    schedule = improve(Schedule(path, team, progress, offsets, signs, np.zeros(1), extra))
    if schedule.worst > _BEYOND_STRAIGHTENING:
        return schedule
    schedule = straighten_schedule(schedule)
    if schedule.worst <= _LOCAL_MINIMUM:
        return schedule
    offsets = basin_hopping(_elastic_band(schedule, _DENSITIES[-1]), schedule.offsets)
    if offsets is schedule.offsets:
        return schedule
    return straighten_schedule(improve(replace(schedule, offsets=offsets)))


def improve(schedule: Schedule, flown: Flown | None = None) -> Schedule:
    """Return the schedule with vehicles moved aside from γ where the team misses margins.

    Margins are those of the motion as it is ``flown``, where that is known.
    """
    for density in _DENSITIES:
        relaxed = relax(_elastic_band(schedule, density, flown), schedule.offsets)
        schedule = replace(schedule, offsets=relaxed.offsets, missed=relaxed.missed)
        if schedule.worst > BEYOND_REPAIR:
            break
    return schedule


def straighten_schedule(schedule: Schedule) -> Schedule:
    """Return the schedule straightened at the coarse sampling, then improved again.

    Return it unchanged where that misses more than before, and more than may be repaired later.
    """
    offsets = straighten(_elastic_band(schedule, _DENSITIES[0]), schedule.offsets)
    straight = improve(replace(schedule, offsets=offsets))
    return straight if straight.worst <= max(schedule.worst, _AFTER_STRAIGHTENING) else schedule


def _elastic_band(schedule: Schedule, density: int, flown: Flown | None = None) -> ElasticBand:
    """Return the team and its constraints at so many moments per stage.

    As it is ``flown`` too, where that is known: not alone, because its timing changes with its
    path, and only a path that keeps the margins itself is within them at every timing.
    """
    weights = _weights(len(schedule.progress), density)
    positions = _positions(schedule.path, weights @ schedule.progress)
    paths, moments = positions[::density], np.arange(len(positions))
    signs = schedule.signs[moments * (_DENSITIES[-1] // density)]
    extra = schedule.extra[moments // density]
    if flown is not None:
        both = np.tile(moments, 2)
        signs, extra = signs[both], extra[both]
        shaped, shares = _as_flown(schedule, flown, moments / density)
        positions = np.concatenate([positions, shaped])
        weights = scipy.sparse.csr_array(scipy.sparse.vstack([weights, shares]))
    return ElasticBand(schedule.team, paths, positions, signs, extra, weights)


def _as_flown(
    schedule: Schedule, flown: Flown, stages: Floats
) -> "tuple[Floats, scipy.sparse.csr_array]":
    """Return positions (m, n, 3) on γ, and weights (m, c), at moments with these mean stages."""
    single = flown.at(stages)
    weights = _weights_at(len(schedule.progress), single.ravel())
    along = _positions(schedule.path, weights @ schedule.progress)
    mean = scipy.sparse.kron(scipy.sparse.eye_array(len(stages)), flown.shares, format="csr")
    positions = np.asarray(mean @ along.reshape(len(along), -1)).reshape(len(stages), -1, 3)
    return positions, scipy.sparse.csr_array(mean @ weights)


def _positions(path: TeamPaths, progress: Floats) -> Floats:
    """Return positions (m, n, 3) of all vehicles on γ at progress (m, n)."""
    return np.stack([path.places(i, along) for i, along in enumerate(progress.T)], axis=1)


def require_extra(schedule: Schedule, margin: str, stages: Floats, metres: Floats) -> Schedule:
    """Return the schedule with ``metres`` (k,) more of a margin required around stages (k,).

    ``margin`` is the name of a field of :class:`ExtraMargins`. :func:`improve` applies it.
    """
    near = np.abs(np.arange(len(schedule.progress))[:, None] - stages) <= _NEAR
    required = getattr(schedule.extra, margin) + (near * metres).max(axis=1)
    return replace(schedule, extra=replace(schedule.extra, **{margin: required}))


def _joined(paths: tuple[LatticePath, ...], step: float) -> Floats:
    """Return the progress (ticks, n) of all vehicles: the paths joined from the leader back.

    In a tick a vehicle moves by one step or waits. Where a path needs the vehicle ahead to wait
    longer than it does, all vehicles ahead wait.
    """
    ticks: Floats = paths[-1].costs.ahead[:, None]
    for path in reversed(paths):
        ticks = append_follower(ticks, path, step)
    return ticks


def _smoothed(controls: Floats) -> Floats:
    """Return progress smoothed over several stages, with the same start and rest; monotone."""
    margin = int(4 * _SMOOTHED) + 1
    before = controls[0] - (controls[1] - controls[0]) * np.arange(margin, 0, -1)
    after = np.full(margin, controls[-1])
    padded = np.concatenate([before, controls, after])
    even: Floats = scipy.ndimage.gaussian_filter1d(padded, _SMOOTHED)[margin:-margin]
    even = np.maximum.accumulate(even)
    even += (controls[0] - even[0]) * np.maximum(1.0 - np.arange(len(even)) / margin, 0.0)
    rest = min(int(np.argmax(controls >= controls[-1] - 1e-9)) + margin, len(even) - 1)
    even[rest:] = controls[-1]
    result: Floats = np.maximum.accumulate(np.minimum(even, controls[-1]))
    return result


def _extended(controls: Floats) -> Floats:
    """Return control points with a straight run before and a rest after, for the spline's ends."""
    first, second = controls[:1], controls[1:2]
    return np.concatenate(
        [3.0 * first - 2.0 * second, 2.0 * first - second, controls, controls[-1:], controls[-1:]]
    )


def _knots(controls: int) -> Floats:
    """Return the knots of a uniform quintic spline with one control point per stage."""
    return np.arange(controls + 10.0) - 5.0


def stage_spline(controls: Floats) -> "scipy.interpolate.BSpline":
    """Return the quintic spline of control points, one per stage."""
    return scipy.interpolate.BSpline(_knots(len(controls)), _extended(controls), 5)


def _weights(controls: int, density: int) -> "scipy.sparse.csr_array":
    """Return weights (density·(c − 1) + 1, c) of control points, at so many moments per stage."""
    return _weights_at(controls, np.arange(density * (controls - 1) + 1) / density)


def _weights_at(controls: int, stages: Floats) -> "scipy.sparse.csr_array":
    """Return weights (m, c) of control points at stages (m,)."""
    weights = scipy.interpolate.BSpline.design_matrix(stages, _knots(controls), 5)
    return scipy.sparse.csr_array(weights @ scipy.sparse.csr_array(_extended(np.eye(controls))))


def team_path(schedule: Schedule, per_stage: int = 8) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the team's path: the parameter (k,), positions and their two derivatives (k, n, 3).

    Over the first two units of the parameter the stage starts from rest; after that the parameter
    is the stage plus 1.
    """
    parameter = np.arange(round((schedule.last_stage + 1.0) * per_stage) + 1) / per_stage
    share = np.minimum(parameter / 2.0, 1.0)
    starting = share < 1.0
    # Quartic from rest at 0 to rate 1 at stage 1, over two units of the parameter.
    stage = np.where(starting, 2.0 * (share**3 - 0.5 * share**4), parameter - 1.0)
    rate = np.where(starting, 3.0 * share**2 - 2.0 * share**3, 1.0)[:, None, None]
    bend = np.where(starting, (6.0 * share - 6.0 * share**2) / 2.0, 0.0)[:, None, None]
    positions, slopes, bends = schedule.at(stage)
    return parameter, positions, slopes * rate, bends * rate**2 + slopes * bend
