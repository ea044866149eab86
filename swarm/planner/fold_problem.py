"""The fold of a team as one problem: all vehicles' motions over time, with one cost for all limits.

Every vehicle moves along a quintic B-spline with evenly spaced knots, which rests at both ends. The
last place is its corner of the folded knot; the first one is on a level line, whose place, height
and heading are free. So are the other control points, and the duration.

The cost is a sum of barriers (:mod:`.team_terms`) at evenly spaced moments: of all distances that
must be kept, of speeds and accelerations, and of the swing of every strand. A strand swings as two
modes: the first is driven by the mean of its ends' acceleration and drag, the second by half of
their difference. Their size is corrected by strays of the strand's lumped masses.

What is measured at a motion is frozen while it is improved: needs by tracking errors, frequencies
and damping of the swing, and its correction (:class:`Frozen`).
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from swarm.certification.air import JET_DECAY, JET_WIDENING, sinking_step
from swarm.geometry.catenary import STANDARD_GRAVITY
from swarm.planner.team_terms import (
    RANGE,
    RELAXED,
    Derivatives,
    Found,
    Memory,
    Needs,
    Poses,
    Splines,
    Team,
    add_clearances,
    add_walls,
    gather,
    oscillate,
    respond,
    scatter,
    scatter_products,
)
from swarm.planning.shaping import PENDULUM, SETTLING
from swarm.threads import side_by_side

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

DEGREE = 5
"""Degree of the splines: their jerk is continuous, as the swing's oscillators need it."""

RESTING = 3
"""Control points at each end that are one place: velocity and acceleration are 0 there."""

_PER_KNOT = 5
"""Moments between two knots."""

_PIECES = 12
"""Pieces of a strand, of which all pairs are compared."""

_SECOND = 3.5
"""Square of the second mode's frequency over the first one's, of a strand that hangs by a third."""

_STEP_RESPONSE = 1.25
"""Movement of a strand's middle over that of its mean, in the first lateral mode: 4/π."""

_SMOOTH_PLACE, _SMOOTH_JERK = 1e-3, 1e-3
"""Weights of the squares of speed and of jerk over the fold, by which the cost has one minimum."""

LOSS_EVERY, _LOSS_RANGE, _LOSS_WEIGHT = 3, 0.3, 0.2
"""Every so many moments a loss of setpoints; metres of slack at which its barriers end, and their
weight: there are four poses for each vehicle."""

_LOSSES_TOGETHER = 15
"""Losses that are compared together: four parts for each of two cores, of 60 losses."""

_LEAST_LOST, _LEAST_SUNK = 0.01, 0.02
"""Acceleration, m/s², that is lost in a jet at least, and share of the limit by which a vehicle
sinks, for a pair to count."""

_COUPLED, _TOGETHER = 20.0, 8
"""Seconds beyond which control points that move the same swing do not count as coupled in the
matrix, by when it has decayed to a tenth (the gradient has all of it); and control points whose
products are computed together."""

RELAXED_SHARE = 0.005
"""Slack, of 1 less the square of a share of a limit, below which barriers are parabolas."""

_SWING_SOFTER = 8.0
"""How much more the swing's barriers are relaxed, in :data:`RELAXED_SHARE`: corrections by lumped
masses change its slack by some 0.05 from step to step (results of plans, optimised folds)."""

_STRETCH = 1e-5
"""Relative change of the duration for the swing's derivative by it."""


class Basis(NamedTuple):
    """Splines at s moments: ``values`` (derivatives, s, k), the six that are not 0 there
    (derivatives, s, 6), and the number (s,) of the first of them."""

    values: Floats
    local: Floats
    first: Ints


@cache
def _splines(count: int) -> tuple[scipy.interpolate.BSpline, ...]:
    """Return ``count`` clamped quintic B-splines on 0…1, and their first three derivatives."""
    inner = np.linspace(0.0, 1.0, count - DEGREE + 1)
    knots = np.concatenate([np.zeros(DEGREE), inner, np.ones(DEGREE)])
    spline = scipy.interpolate.BSpline(knots, np.eye(count), DEGREE)
    return (spline, *(spline.derivative(order) for order in range(1, 4)))


def basis(count: int, shares: Floats) -> Basis:
    """Return ``count`` clamped quintic B-splines on 0…1, with derivatives, at ``shares`` (s,)."""
    inside = np.clip(shares, 0.0, 1.0 - 1e-12)
    values = np.stack([spline(inside) for spline in _splines(count)])
    first = np.minimum((inside * (count - DEGREE)).astype(np.intp), count - DEGREE - 1)
    places = np.broadcast_to(first[:, None] + np.arange(DEGREE + 1), (4, len(shares), DEGREE + 1))
    return Basis(values, np.take_along_axis(values, places, axis=2), first)


@dataclass(frozen=True)
class Limits:
    """Largest speed, m/s, acceleration, m/s², swing as planned and sinking in jets, metres."""

    speed: float
    acceleration: float
    swing: float
    sinking: float


@dataclass(frozen=True, eq=False)
class Fold:
    """A motion: ``free`` control points (k − 6, n, 3), the line's x, y, z and heading, seconds."""

    free: Floats
    pose: Floats
    duration: float


@dataclass(frozen=True, eq=False)
class Coasting:
    """How far vehicles move on without setpoints: seconds (n,) at their velocity, and mission
    seconds (l,) by which the others advance until they stand, after losses at l moments; at least
    until the ``silence`` is detected. ``needs`` (l rows) are those after the losses."""

    lost: Floats
    others: Floats
    silence: float
    needs: Needs


@dataclass(frozen=True, eq=False)
class Frozen:
    """What is measured at a motion: needs, and for s moments and m strands the squared frequency
    of the first mode, its damping, and the factor of its size (s, m); without ``coasting`` no
    losses of setpoints count. Barriers are parabolas below ``soft`` times :data:`RELAXED_SHARE` or
    :data:`.RELAXED`."""

    needs: Needs
    squares: Floats
    damping: Floats
    gains: Floats
    coasting: Coasting | None
    soft: float = 1.0


@dataclass(eq=False)
class Slopes:
    """Derivatives of the cost by all control points, and by the logarithm of the duration.

    ``gradient`` (k, 3n) and the Gauss-Newton matrix (k·3n, k·3n) of the control points: what
    couples neighbouring ones in its lower ``band`` (k·3n, h), row r, column c in
    ``band[c, r − c]``; what a whole motion before a moment causes as ``remembered`` squares, of
    which ``near`` (k·3n, h) is an approximation in a band. Where a band is the whole matrix, it is
    both, and has all of it. ``by_duration``, its derivative ``mixed`` (k, 3n) by control points,
    and ``twice`` by the same again. ``pose`` (4,) and ``by_pose`` (4, 4) are gradient and matrix of
    what the pose of the line moves beside control points.
    """

    gradient: Floats
    band: Floats
    near: Floats
    remembered: "list[Squares]"
    by_duration: float
    mixed: Floats
    twice: float
    pose: Floats = field(default_factory=lambda: np.zeros(4))
    by_pose: Floats = field(default_factory=lambda: np.zeros((4, 4)))


class Part(NamedTuple):
    """Axes of a vector that a pair of vehicles moves: by the control points (k·3) of the second and
    ``sign`` times those of the first.

    ``moved`` (t, c) is the vector at t moments, metres; ``by`` (t, c, k·3) are its derivatives by
    these control points, and ``longer`` (t, c) by the logarithm of the duration.
    """

    sign: float
    moved: Floats
    by: Floats
    longer: Floats


class Squares(NamedTuple):
    """Derivatives of the cost (:func:`below`) of a vector that a ``pair`` of vehicles moves.

    Its Gauss-Newton matrix is the sum of the squares of ``rows``: of each part its sign, and
    (t, 1 + c, k·3) by its control points; the first rows of all parts together are one.
    ``gradient`` and ``mixed`` (2, k, 3) are by the control points of each vehicle; they,
    ``by_duration`` and ``twice`` are as in :class:`Slopes`.
    """

    pair: tuple[int, int]
    rows: tuple[tuple[float, Floats], ...]
    gradient: Floats
    mixed: Floats
    by_duration: float
    twice: float

    def times(self, vector: Floats, result: Floats) -> None:
        """Add to ``result`` (k, 3n) the matrix of the squares times a vector (k, 3n)."""
        first, second = (slice(3 * i, 3 * i + 3) for i in self.pair)
        shown = [
            rows @ (sign * vector[:, first] + vector[:, second]).reshape(-1)
            for sign, rows in self.rows
        ]
        together = np.sum([each[:, 0] for each in shown], axis=0)
        for (sign, rows), each in zip(self.rows, shown, strict=True):
            each[:, 0] = together
            moved = np.tensordot(each, rows, 2).reshape(-1, 3)
            result[:, first] += sign * moved
            result[:, second] += moved

    def products(self, after: int, first: slice, last: slice) -> Floats:
        """Return the matrix (2, 2, 3a, 3b) between ranges of control points of both vehicles, of
        the rows from a moment on."""
        matrix = np.zeros((2, 2, 3 * (first.stop - first.start), 3 * (last.stop - last.start)))
        left, right = (slice(3 * part.start, 3 * part.stop) for part in (first, last))
        for p, (sign, rows) in enumerate(self.rows):
            for q, (other, others) in enumerate(self.rows):
                if p == q:
                    each = here = rows[after:].reshape(-1, rows.shape[2])
                else:
                    each, here = rows[after:, 0], others[after:, 0]
                product = each[:, left].T @ here[:, right]
                for u, upper in enumerate((sign, 1.0)):
                    for v, lower in enumerate((other, 1.0)):
                        matrix[u, v] += upper * lower * product
        return matrix


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The cost of a motion, and what it shows.

    Largest ``speed``, ``acceleration``, ``swing`` and ``sinking`` are in m/s, m/s² and metres;
    ``missed`` and ``missed_after_losses`` the largest missed needs; ``swings`` (t, m) those of the
    oscillators.
    """

    cost: float
    found: Found
    missed_after_losses: float
    speed: float
    acceleration: float
    swing: float
    swings: Floats
    sinking: float

    @property
    def missed(self) -> float:
        """The largest missed need, metres."""
        return float(self.found.missed.max())


class _Moved(NamedTuple):
    """Poses of a team, and what gives the splines that move them, and their derivatives (s, n, 3)
    by the logarithm of the duration."""

    poses: Poses
    moved_by: Callable[[], tuple[Splines, Floats]]


class _Compared(NamedTuple):
    """Poses of a team, the cost of their clearances, what they show, and the derivatives."""

    moved: _Moved
    cost: float
    found: Found
    derivatives: Derivatives


def _add_poses(slopes: Slopes, compared: _Compared) -> None:
    """Add the derivatives of poses by control points and the duration."""
    (splines, longer), by = compared.moved.moved_by(), compared.derivatives
    longer = longer.reshape(len(longer), -1)
    gather(splines, by.gradient, slopes.gradient)
    scatter(splines, 1.0, by.matrix, slopes.band)
    if longer.any():
        pushed = np.einsum("sxy,sy->sx", by.matrix, longer)
        slopes.by_duration += float((by.gradient * longer).sum())
        gather(splines, pushed, slopes.mixed)
        slopes.twice += float((pushed * longer).sum())


def _chosen(alone: npt.NDArray[np.bool_], lost: Any, team: Any) -> Any:
    """Return values (s·w, n, …) of poses: for vehicles that are ``alone`` (w, n) those of ``lost``
    (s, n, …), for the others those of the ``team`` (s, n, …)."""
    here = alone.reshape(*alone.shape, *(1,) * (lost.ndim - 2))
    values = np.where(here, lost[:, None], team[:, None])
    return values.reshape(-1, *values.shape[2:])


@dataclass(frozen=True, eq=False)
class Problem:
    """What a fold is: its team, limits, the ``folded`` corners (n, 3), and the line.

    ``along`` (n,) are the places of vehicles on the line from its middle, metres, and ``before``
    (r, 4) those on the way there: along the line, aside of it (to its left for a knot on its
    right), their share of its height, and metres above that. ``count`` control points move each
    vehicle. ``after`` is the team after losses of setpoints, when all were exactly on the plan.
    ``drag`` is that of the cable, 1/m: acceleration by squared speed; ``jet`` the radius of a
    vehicle's jet, metres. Up to ``whole`` unknowns, all of the matrix is kept, and solved at once:
    for the overhand's 1,080 in 0.03 s instead of 0.16 s.
    """

    team: Team
    after: Team
    limits: Limits
    folded: Floats
    along: Floats
    before: Floats
    count: int
    drag: float
    jet: float
    whole: int = 2500

    @cached_property
    def moments(self) -> int:
        """Number of moments at which the cost is summed."""
        return _PER_KNOT * (self.count - DEGREE) + 1

    @cached_property
    def shares(self) -> Floats:
        """Shares (s,) of the duration at these moments."""
        return np.linspace(0.0, 1.0, self.moments)

    @cached_property
    def basis(self) -> Basis:
        """The splines at these moments."""
        return basis(self.count, self.shares)

    @cached_property
    def roughness(self) -> tuple[Floats, Floats]:
        """Matrices (k, k) of the mean squares of a spline's first and third derivative."""
        weight = np.full(self.moments, 1.0 / (self.moments - 1))
        weight[[0, -1]] *= 0.5
        first, third = self.basis.values[1], self.basis.values[3]
        return first.T @ (weight[:, None] * first), third.T @ (weight[:, None] * third)

    def line(self, pose: Floats) -> Floats:
        """Return the vehicles (n, 3) on the line."""
        x, y, z, heading = pose
        level = np.full(len(self.along), z)
        return np.stack(
            [x + self.along * math.cos(heading), y + self.along * math.sin(heading), level], axis=1
        )

    def by_pose(self, pose: Floats) -> Floats:
        """Return the derivative (k·3n, 4) of all control points by the pose of the line."""
        derivative = np.zeros((len(self.along), 3, 4))
        derivative[:, [0, 1, 2], [0, 1, 2]] = 1.0
        derivative[:, 0, 3] = -self.along * math.sin(pose[3])
        derivative[:, 1, 3] = self.along * math.cos(pose[3])
        return (self.following[:, None, None] * derivative.reshape(-1, 4)).reshape(-1, 4)

    @cached_property
    def following(self) -> Floats:
        """Shares (k,) of the line's movement by which control points follow it.

        From 1 at the beginning to 0 at the end: were only the first places moved, a turned line
        would need an acceleration of its vehicles that no derivative shows.
        """
        inner = np.linspace(0.0, math.pi, self.count - 2 * RESTING + 2)[1:-1]
        return np.concatenate([np.ones(RESTING), 0.5 * (1.0 + np.cos(inner)), np.zeros(RESTING)])

    def control(self, fold: Fold) -> Floats:
        """Return all control points (k, n, 3)."""
        points = self.following[:, None, None] * self.line(fold.pose)
        points[-RESTING:] = self.folded
        points[RESTING:-RESTING] += fold.free
        return points

    def states(self, fold: Fold, shares: Floats) -> tuple[Floats, Floats, Floats]:
        """Return position, velocity and acceleration (s, n, 3) at shares (s,) of the duration."""
        return self._states(self.control(fold), basis(self.count, shares), fold.duration)

    def _states(self, control: Floats, at: Basis, duration: float) -> tuple[Floats, Floats, Floats]:
        flat = control.reshape(self.count, -1)
        shape = len(at.first), *self.folded.shape
        place, first, second = (
            np.ascontiguousarray((at.values[d] @ flat).reshape(shape)) for d in range(3)
        )
        return place, first / duration, second / duration**2

    def fitted(self, places: Floats, pose: Floats, duration: float) -> Fold:
        """Return the motion closest to ``places`` (s, n, 3), evenly spaced in time."""
        empty = Fold(np.zeros((self.count - 2 * RESTING, *self.folded.shape)), pose, duration)
        values = basis(self.count, np.linspace(0.0, 1.0, len(places))).values[0]
        rest = places - np.einsum("sk,knx->snx", values, self.control(empty))
        inner = values[:, RESTING:-RESTING]
        normal = inner.T @ inner + 1e-6 * np.eye(inner.shape[1])
        free = np.linalg.solve(normal, inner.T @ rest.reshape(len(places), -1))
        return replace(empty, free=free.reshape(empty.free.shape))

    def derived(self, fold: Fold, frozen: Frozen) -> tuple[Evaluation, Slopes]:
        """Return the cost of a motion, and its derivatives."""
        knot = 3 * len(self.folded)
        high = knot * (self._reach(fold.duration, frozen.coasting) + 1)
        band = np.zeros((self.count * knot, high))
        near = band if high == len(band) else np.zeros_like(band)
        slopes = Slopes(
            np.zeros((self.count, knot)), band, near, [], 0.0, np.zeros((self.count, knot)), 0.0
        )
        return self.evaluate(fold, frozen, slopes), slopes

    def _reach(self, duration: float, coasting: Coasting | None) -> int:
        """Return over how many control points the matrix couples."""
        if 3 * len(self.folded) * self.count <= self.whole:
            return self.count - 1
        knot = duration / (self.count - DEGREE)
        ahead = 0.0 if coasting is None else float(coasting.others.max())
        reach = max(DEGREE + math.ceil(ahead / knot), math.ceil(_COUPLED / knot))
        return min(reach, self.count - 1)

    def evaluate(self, fold: Fold, frozen: Frozen, slopes: Slopes | None = None) -> Evaluation:
        """Return the cost of a motion; add its derivatives to ``slopes``."""
        control = self.control(fold)
        place, velocity, acceleration = self._states(control, self.basis, fold.duration)
        distances, record, missed = self._distances(
            control, place, velocity, fold.duration, frozen, slopes
        )
        motion = sum(
            self._bounded(order, state, limit, fold.duration, frozen.soft, slopes)
            for order, state, limit in (
                (1, velocity, self.limits.speed),
                (2, acceleration, self.limits.acceleration),
            )
        )
        swung, swings = self._swing(velocity, acceleration, fold.duration, frozen, slopes)
        sunk, sinking = self._sinking(place, fold.duration, frozen.soft, slopes)
        smooth = self._smoothness(control.reshape(self.count, -1), fold.duration, slopes)
        ahead = self._before_fold(fold.pose, frozen, record, slopes)
        cost = float(distances + motion + swung + sunk + smooth + ahead)
        return Evaluation(
            cost=cost,
            found=record,
            missed_after_losses=missed,
            speed=float(np.linalg.norm(velocity, axis=2).max()),
            acceleration=float(np.linalg.norm(acceleration, axis=2).max()),
            swing=float(swings.max()),
            swings=swings,
            sinking=sinking,
        )

    def way_to_line(self, pose: Floats) -> tuple[Floats, Floats]:
        """Return the places (r, 3) before the fold, and their derivatives (r, 3, 4) by the pose."""
        x, y, z, heading = pose
        ahead = np.array([math.cos(heading), math.sin(heading), 0.0])
        left = np.array([-ahead[1], ahead[0], 0.0])
        side = -1.0 if float(np.mean((self.folded - [x, y, 0.0]) @ left)) > 0.0 else 1.0
        along, aside, share, above = self.before.T[..., None]
        places = [x, y, 0.0] + along * ahead + side * aside * left
        places[:, 2:] += share * z + above
        by_pose = np.zeros((len(places), 3, 4))
        by_pose[:, [0, 1], [0, 1]] = 1.0
        by_pose[:, 2, 2] = share[:, 0]
        by_pose[:, :, 3] = along * left - side * aside * ahead
        return places, by_pose

    def _before_fold(
        self, pose: Floats, frozen: Frozen, record: Found, slopes: Slopes | None
    ) -> float:
        """Return the cost of vehicles and walls before the fold, and note the largest missed need
        at its first moment; add the derivatives."""
        places, by_pose = self.way_to_line(pose)
        r = len(places)
        rows, every = np.zeros(r, dtype=np.intp), np.full(r, -1)
        poses = Poses(places[:, None], rows, every, RANGE, 1.0, frozen.soft * RELAXED)
        by = Derivatives(np.zeros((r, 3)), np.zeros((r, 3, 3)), np.empty((4, 3)))
        cost = add_walls(poses, self.team, frozen.needs, record, by, slopes is not None)
        if slopes is not None:
            slopes.pose += np.einsum("rx,rxa->a", by.gradient, by_pose)
            slopes.by_pose += np.einsum("rxa,rxy,ryb->ab", by_pose, by.matrix, by_pose)
        return cost

    def _distances(
        self, control: Floats, place: Floats, velocity: Floats, duration: float, frozen: Frozen,
        slopes: Slopes | None,
    ) -> tuple[float, Found, float]:  # fmt: skip
        """Return the cost of all distances, what the motion itself shows, and the largest missed
        need after losses of setpoints, metres; add the derivatives."""
        coasting = frozen.coasting
        planned = self._planned(place, frozen.soft), self.team, frozen.needs
        lost: Iterator[_Moved] = iter(())
        if coasting is not None:
            lost = self._lost(control, place, velocity, duration, coasting, frozen.soft)

        def compared(task: tuple[_Moved, Team, Needs]) -> _Compared:
            return self._compared(*task, derive=slopes is not None)

        tasks = ((moved, self.after, coasting.needs) for moved in lost if coasting is not None)
        total, shown = 0.0, []
        for comparison in side_by_side(compared, chain([planned], tasks)):
            total += comparison.cost
            shown.append(comparison.found)
            if slopes is not None:
                _add_poses(slopes, comparison)
        after = max((float(record.missed.max()) for record in shown[1:]), default=0.0)
        return total, shown[0], after

    def shown_by(self, places: Floats, needs: Needs) -> Found:
        """Return what poses (s, n, 3) show with their needs; at most as many as the moments."""
        planned = self._planned(places, 1.0)
        return self._compared(planned, self.team, needs, derive=False).found

    def _planned(self, place: Floats, soft: float) -> _Moved:
        """Return the poses of the motion itself."""
        s = len(place)
        poses = Poses(place, np.arange(s), np.full(s, -1), RANGE, 1.0, soft * RELAXED)
        return _Moved(poses, lambda: (self._splines(0, s), np.zeros_like(place)))

    def _splines(self, order: int, moments: int) -> Splines:
        """Return a derivative of the splines at the first moments, the same for all vehicles."""
        at, n = self.basis, len(self.folded)
        shape = moments, n, DEGREE + 1
        return Splines(
            np.ascontiguousarray(np.broadcast_to(at.local[order][:moments, None], shape)),
            np.ascontiguousarray(np.broadcast_to(at.first[:moments, None], shape[:2])),
        )

    def _lost(
        self, control: Floats, place: Floats, velocity: Floats, duration: float, coasting: Coasting,
        soft: float,
    ) -> Iterator[_Moved]:  # fmt: skip
        """Yield the poses after losses of setpoints, of all vehicles and of each one.

        When they have moved half of what they do, and all; the others advance meanwhile as little
        and as far as they may.
        """
        n, at, some = len(self.folded), self.basis, slice(0, None, LOSS_EVERY)
        count = len(self.shares[some])

        def after(share: float, who: Ints, advance: Floats) -> Iterator[_Moved]:
            seconds, ahead = share * coasting.lost, self.shares[some] + advance / duration
            lost = place[some] + seconds[:, None] * velocity[some]
            there = basis(self.count, ahead)
            team, moving, _ = self._states(control, there, duration)
            # Without setpoints: the vehicle of a pose, or all.
            alone = (who[:, None] == np.arange(n)) | (who[:, None] < 0)

            def moved(now: slice) -> _Moved:
                def each(lost: Any, team: Any) -> Any:
                    return _chosen(alone, lost[now], team[now])

                def moved_by() -> tuple[Splines, Floats]:
                    lost_shares = (
                        at.local[0][some, None]
                        + (seconds / duration)[:, None] * at.local[1][some, None]
                    )
                    team_shares = np.broadcast_to(there.local[0][:, None], lost_shares.shape)
                    first = np.broadcast_to(at.first[some, None], (count, n))
                    team_first = np.broadcast_to(there.first[:, None], (count, n))
                    lost_longer = -seconds[:, None] * velocity[some]
                    inside = (ahead < 1.0)[:, None, None]
                    team_longer = -advance[:, None, None] * inside * moving
                    splines = Splines(each(lost_shares, team_shares), each(first, team_first))
                    return splines, each(lost_longer, team_longer)

                rows = np.arange(count)[now]
                poses = Poses(
                    each(lost, team), np.repeat(rows, len(who)), np.tile(who, len(rows)),
                    _LOSS_RANGE, _LOSS_WEIGHT, soft * RELAXED,
                )  # fmt: skip
                return _Moved(poses, moved_by)

            for first in range(0, count, _LOSSES_TOGETHER):
                yield moved(slice(first, first + _LOSSES_TOGETHER))

        every, least = np.arange(n), min(coasting.silence, float(coasting.lost.min()))
        for share in (0.5, 1.0):
            yield from after(share, np.append(-1, every), np.full(count, share * least))
            yield from after(share, every, share * coasting.others)

    def _compared(self, moved: _Moved, team: Team, needs: Needs, *, derive: bool) -> _Compared:
        """Return the cost of all clearances of poses, what they show, and the derivatives."""
        s, n, _ = moved.poses.places.shape
        m, rows = n - 1, len(needs.floor)
        record = Found(
            np.zeros((rows, m, m)), np.zeros((rows, n, m)), np.zeros((rows, m)),
            np.zeros((rows, m)), np.zeros((rows, m, m)), np.zeros((rows, m)), np.zeros(rows),
        )  # fmt: skip
        memory = Memory(
            np.empty((m, _PIECES + 1, 3)), np.empty((m, _PIECES + 1, 5)), np.empty((m, 6)),
            np.empty(m), np.empty(m, dtype=np.int64),
        )  # fmt: skip
        blocks = np.zeros((s if derive else 1, 3 * n, 3 * n))
        derivatives = Derivatives(np.zeros((s, 3 * n)), blocks, np.empty((4, 3)))
        cost = add_clearances(moved.poses, team, needs, record, memory, derivatives, derive)
        return _Compared(moved, cost, record, derivatives)

    def _bounded(
        self, order: int, state: Floats, limit: float, duration: float, soft: float,
        slopes: Slopes | None,
    ) -> float:  # fmt: skip
        """Return the cost of a derivative of the motion and its limit; add its own derivatives."""
        s, n, _ = state.shape
        slack = 1.0 - (state**2).sum(axis=2) / limit**2
        value, slope, curvature = logarithmic(slack, soft)
        if slopes is None:
            return float(value.sum())
        by = -2.0 / limit**2 * state
        scale = duration**-order
        values = self.basis.values[order]
        slopes.gradient += scale * (values.T @ (slope[..., None] * by).reshape(s, -1))
        # velocities shrink with the duration, accelerations with its square
        longer = 2.0 * order * (1.0 - slack)
        slopes.by_duration += float((slope * longer).sum())
        crossed = curvature * longer - 2.0 * order * slope
        slopes.mixed += scale * (values.T @ (crossed[..., None] * by).reshape(s, -1))
        slopes.twice += float((curvature * longer**2 - 2.0 * order * slope * longer).sum())
        blocks = np.zeros((s, n, 3, n, 3))
        each = np.arange(n)
        blocks[:, each, :, each, :] = (
            curvature[..., None, None] * by[..., :, None] * by[..., None, :]
            - (2.0 / limit**2 * slope)[..., None, None] * np.eye(3)
        ).transpose(1, 0, 2, 3)
        scatter(self._splines(order, s), scale**2, blocks.reshape(s, 3 * n, 3 * n), slopes.band)
        return float(value.sum())

    def _swing(
        self, velocity: Floats, acceleration: Floats, duration: float, frozen: Frozen,
        slopes: Slopes | None,
    ) -> tuple[float, Floats]:  # fmt: skip
        """Return the cost of all strands' swing, and the swings (t, m); add the derivatives."""
        s, n, _ = velocity.shape
        after = math.ceil(SETTLING / (duration / (s - 1)))
        swings = np.empty((s + after, n - 1))

        def strand(i: int) -> tuple[float, Squares | None]:
            parts = self._strand_swing(
                i, velocity, acceleration, duration, frozen, after, derive=slopes is not None
            )
            swings[:, i] = np.linalg.norm(np.concatenate([p.moved for p in parts], axis=1), axis=1)
            pair = (i, i + 1) if slopes is not None else None
            return below(parts, self.limits.swing, frozen.soft + _SWING_SOFTER, pair)

        total = 0.0
        for value, squares in side_by_side(strand, range(n - 1)):
            total += value
            if slopes is not None and squares is not None:
                self._add(slopes, squares)
        return total, swings

    def _add(self, slopes: Slopes, squares: Squares) -> None:
        """Add the derivatives of the cost of a vector that two vehicles move."""
        slopes.by_duration += squares.by_duration
        slopes.twice += squares.twice
        for u, i in enumerate(squares.pair):
            slopes.gradient[:, 3 * i : 3 * i + 3] += squares.gradient[u]
            slopes.mixed[:, 3 * i : 3 * i + 3] += squares.mixed[u]
        knot = 3 * len(self.folded)
        reach = slopes.band.shape[1] // knot
        if slopes.near is not slopes.band:
            slopes.remembered.append(squares)
        taper = localised(reach) if reach < self.count else np.ones(reach)
        for first in range(0, self.count, _TOGETHER):
            last = min(first + _TOGETHER, self.count)
            # A control point moves nothing before the spline's pieces that it is part of.
            products = squares.products(
                max(0, _PER_KNOT * (first - DEGREE)), slice(first, last),
                slice(first, min(last + reach - 1, self.count)),
            )  # fmt: skip
            scatter_products(products, first, np.array(squares.pair), taper, knot, slopes.near)

    def _strand_swing(
        self, i: int, velocity: Floats, acceleration: Floats, duration: float, frozen: Frozen,
        after: int, *, derive: bool,
    ) -> list[Part]:  # fmt: skip
        """Return both modes of a strand: what they swing (t, 2) and (t, 3), without ``derive`` with
        no derivatives by control points."""
        s = len(velocity)
        step = duration / (s - 1)
        held = np.concatenate([np.arange(s), np.full(after, s - 1)])
        gain, square, damping = (
            np.ascontiguousarray(each[held, i])
            for each in (frozen.gains, frozen.squares, frozen.damping)
        )
        parts = []
        for sign, axes, squares in ((1.0, 2, square), (-1.0, 3, _SECOND * square)):
            speed = 0.5 * (velocity[:, i + 1] + sign * velocity[:, i])
            pushed = 0.5 * (acceleration[:, i + 1] + sign * acceleration[:, i])
            size = np.linalg.norm(speed, axis=1) + 1e-9
            force = np.zeros((len(held), axes))
            force[:s] = _STEP_RESPONSE * (pushed + self.drag * size[:, None] * speed)[:, :axes]
            mode = Mode(axes, squares, speed, size, gain, damping, step)
            moved = mode.swung(force)
            # A longer duration makes forces smaller by its square, and steps longer.
            stretched = replace(mode, step=step * (1.0 + _STRETCH))
            later = stretched.swung(force / (1.0 + _STRETCH) ** 2)
            by = mode.by_ends(self, duration) if derive else np.empty((0, 0, 0))
            parts.append(Part(sign, moved, by, (later - moved) / _STRETCH))
        return parts

    def _sinking(
        self, place: Floats, duration: float, soft: float, slopes: Slopes | None
    ) -> tuple[float, float]:
        """Return the cost of sinking in jets, and the largest one, metres; add the derivatives.

        As :func:`swarm.certification.air.sinkings`, for each pair of vehicles alone, and with no
        limit of the lost lift, where its derivative would be 0.
        """
        s, n, _ = place.shape
        step, total = duration / (s - 1), 0.0
        held, stretched = sinking_step(step), sinking_step(step * (1.0 + _STRETCH))
        lower, upper = np.nonzero(~np.eye(n, dtype=np.bool_))
        lost, by_place = self._lost_lift(place[:, upper] - place[:, lower])
        lost[:, lost.max(axis=0) < _LEAST_LOST] = 0.0
        depths, later = responded(held, lost), responded(stretched, lost)
        for k in np.flatnonzero(depths.max(axis=0) >= _LEAST_SUNK * self.limits.sinking):
            depth, sunk, by = depths[:, k : k + 1], depths[:, k : k + 1] > 0.0, np.empty((0, 0, 0))
            if slopes is not None:
                force = by_place[:, k, None] * self.basis.values[0][:, :, None]
                by = (responded(held, force.reshape(s, -1)) * sunk)[:, None]
            longer = (later[:, k : k + 1] - depth) / _STRETCH * sunk
            value, squares = below(
                [Part(-1.0, depth * sunk, by, longer)], self.limits.sinking, soft,
                None if slopes is None else (int(lower[k]), int(upper[k])),
            )  # fmt: skip
            total += value
            if slopes is not None and squares is not None:
                self._add(slopes, squares)
        return total, float(depths.max())

    def _lost_lift(self, apart: Floats) -> tuple[Floats, Floats]:
        """Return the acceleration (s, p) that vehicles lose in jets, and its derivative (s, p, 3)
        by the places ``apart`` (s, p, 3) of the others from them."""
        depth = np.maximum(apart[..., 2], 1e-3)
        width = self.jet + JET_WIDENING * depth
        decay = JET_DECAY * 2.0 * self.jet / depth
        aside = (apart[..., :2] ** 2).sum(axis=-1)
        lost = STANDARD_GRAVITY * np.minimum(decay, 1.0) * np.exp(-0.5 * aside / width**2)
        lost = np.where(apart[..., 2] > 0.0, lost, 0.0)
        by = np.empty_like(apart)
        by[..., :2] = -(lost / width**2)[..., None] * apart[..., :2]
        by[..., 2] = lost * (
            aside * JET_WIDENING / width**3 - np.where(decay < 1.0, 1.0 / depth, 0.0)
        )
        return lost, by

    def _smoothness(self, flat: Floats, duration: float, slopes: Slopes | None) -> float:
        """Return the cost of the mean squares of speed and jerk; add its derivatives."""
        cost = 0.0
        for weight, rough, power in zip(
            (_SMOOTH_PLACE, _SMOOTH_JERK), self.roughness, (1, 5), strict=True
        ):
            scaled = weight / duration**power * rough
            pushed = scaled @ flat
            cost += 0.5 * float((flat * pushed).sum())
            if slopes is not None:
                slopes.gradient += pushed
                size = flat.shape[1]
                for apart in range(DEGREE + 1):
                    diagonal = np.repeat(np.diag(scaled, -apart), size)
                    slopes.band[: len(diagonal), apart * size] += diagonal
        return cost


@dataclass(frozen=True, eq=False)
class Mode:
    """A mode of a strand: driven by the mean or half the difference of its ends.

    Along ``axes``; with squared frequencies, size factors and damping (t,), that ``speed`` of the
    ends (s, 3) and its ``size`` (s,), and ``step`` seconds between moments.
    """

    axes: int
    squares: Floats
    speed: Floats
    size: Floats
    gain: Floats
    damping: Floats
    step: float

    def swung(self, force: Floats) -> Floats:
        """Return the swing (t, k) by columns of force (t, k)."""
        moved = np.empty((len(force) + 2, force.shape[1]))
        oscillate(np.ascontiguousarray(force), self.squares, self.damping, self.step, moved)
        swung: Floats = moved[:-2] * self.gain[:, None]
        return swung

    def by_ends(self, problem: Problem, duration: float) -> Floats:
        """Return the derivative (t, axes, k·3) of its swing by control points of the far end."""
        t, s, count = len(self.squares), len(self.speed), problem.count
        first = problem.basis.values[1] / duration
        second = problem.basis.values[2] / duration**2
        force = np.zeros((t, self.axes, count, 3))
        for x in range(self.axes):
            force[:s, x, :, x] += second + problem.drag * self.size[:, None] * first
            for y in range(3):
                along = problem.drag * self.speed[:, x] * self.speed[:, y] / self.size
                force[:s, x, :, y] += along[:, None] * first
        return self.swung(0.5 * _STEP_RESPONSE * force.reshape(t, -1)).reshape(t, self.axes, -1)


def below(
    parts: list[Part], limit: float, soft: float, pair: tuple[int, int] | None
) -> tuple[float, Squares | None]:
    """Return the cost of vectors that stay shorter than a limit; of a pair, with its derivatives.

    The barrier is that of 1 − (size / limit)²; the ``parts`` have the axes of the vectors.
    """
    slack = 1.0 - sum((part.moved**2).sum(axis=1) for part in parts) / limit**2
    value, slope, curvature = logarithmic(slack, soft)
    if pair is None:
        return float(value.sum()), None
    inward = -2.0 / limit**2
    longer = inward * sum((part.moved * part.longer).sum(axis=1) for part in parts)
    steep, scaled = np.sqrt(curvature), np.sqrt(inward * slope)
    twice, all_rows = float(curvature @ longer**2), []
    count = parts[0].by.shape[2] // 3
    gradient, mixed = np.zeros((2, 2, count, 3))
    for part in parts:
        t, axes, size = part.by.shape
        toward = inward * (part.moved[:, None] @ part.by)[:, 0]
        rows = np.empty((t, 1 + axes, size))
        rows[:, 0] = steep[:, None] * toward
        rows[:, 1:] = scaled[:, None, None] * part.by
        crossed = np.column_stack([steep * longer, scaled[:, None] * part.longer])
        all_rows.append((part.sign, rows))
        twice += float((crossed[:, 1:] ** 2).sum())
        for total, product in (
            (gradient, slope @ toward), (mixed, crossed.reshape(-1) @ rows.reshape(-1, size))
        ):  # fmt: skip
            by_ends = product.reshape(-1, 3)
            total += [part.sign * by_ends, by_ends]
    by_duration = float(slope @ longer)
    return float(value.sum()), Squares(pair, tuple(all_rows), gradient, mixed, by_duration, twice)


def localised(reach: int) -> Floats:
    """Return factors (r,) for couplings of control points that are 0 to r − 1 apart.

    A matrix without negative eigenvalues has none after it either (Gaspari and Cohn 1999,
    eq. 4.10, with c = r/2; Schur's product theorem).
    """
    z = 2.0 * np.arange(reach) / reach
    near = 1.0 + z**2 * (-5.0 / 3.0 + z * (0.625 + z * (0.5 - 0.25 * z)))
    far = 4.0 + z * (-5.0 + z * (5.0 / 3.0 + z * (0.625 + z * (-0.5 + z / 12.0))))
    far -= 2.0 / (3.0 * np.maximum(z, 1.0))
    return np.where(z <= 1.0, near, far)


def responded(held: Floats, lost: Floats) -> Floats:
    """Return how far (t, k) a vehicle sinks that loses accelerations (t, k)."""
    depth = np.empty((len(lost) + 3, lost.shape[1]))
    respond(np.ascontiguousarray(held), np.ascontiguousarray(lost), depth)
    return depth[:-3]


def logarithmic(slack: Floats, soft: float) -> tuple[Floats, Floats, Floats]:
    """Return value, slope and curvature of −log(slack), and of a parabola for smaller slack than
    ``soft`` times :data:`RELAXED_SHARE`."""
    relaxed = soft * RELAXED_SHARE
    held, below = np.maximum(slack, relaxed), np.minimum(slack - relaxed, 0.0)
    curvature = 1.0 / held**2
    slope = -1.0 / held + curvature * below
    value = -np.log(held) - below / held + 0.5 * curvature * below**2
    return value, slope, curvature


def modes(sags: Floats) -> tuple[Floats, Floats]:
    """Return squared frequency and damping of the first mode of strands with sags, metres."""
    squares = STANDARD_GRAVITY / (PENDULUM * np.maximum(sags, 0.25))
    return squares, 0.06 * np.sqrt(squares) + 0.3
