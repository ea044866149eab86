"""The fold of a team as one problem: all vehicles' motions over time, with one cost for all limits.

Every vehicle moves along a quintic B-spline with evenly spaced knots, which rests at both ends. The
last place is its corner of the folded knot; the first one is on a level line, whose place, height
and heading are free, or where the vehicle is now. Free are the other control points, too, and the
duration.

The cost is a sum of barriers (:mod:`.team_terms`) at evenly spaced moments: of all distances that
must be kept, of speeds and accelerations, and of the swing of every strand. A strand swings as two
modes: the first is driven by the mean of its ends' acceleration and drag, the second by half of
their difference. Their size is corrected by strays of the strand's lumped masses.

What is measured at a motion is frozen while it is improved: needs by tracking errors, frequencies
and damping of the swing, and its correction (:class:`Frozen`).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
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
    Memory,
    Mode,
    Needs,
    Poses,
    ShownNeeds,
    Splines,
    Sums,
    Team,
    add_clearances,
    add_walls,
    oscillate,
    oscillate_by_points,
    respond,
    scatter,
    scatter_products,
    weigh,
)
from swarm.planning.shaping import PENDULUM, SETTLING
from swarm.threads import both

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
weight: there are two poses for each vehicle."""

_LOSSES_TOGETHER = 15
"""Losses that are compared together: eight parts for each of two cores, of 60 losses."""

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
def _derivatives(count: int) -> Floats:
    """Return the derivatives (6, pieces, 6) of orders 0 to 5 of the clamped quintic B-splines that
    are not 0 on each piece between knots on 0…1, at its beginning."""
    inner = np.linspace(0.0, 1.0, count - DEGREE + 1)
    knots = np.concatenate([np.zeros(DEGREE), inner, np.ones(DEGREE)])
    spline = scipy.interpolate.BSpline(knots, np.eye(count), DEGREE)
    orders = [spline, *(spline.derivative(order) for order in range(1, DEGREE + 1))]
    places = np.arange(count - DEGREE)[:, None] + np.arange(DEGREE + 1)
    return np.stack([np.take_along_axis(each(inner[:-1]), places, axis=1) for each in orders])


def basis(count: int, shares: Floats) -> Basis:
    """Return ``count`` clamped quintic B-splines on 0…1, with derivatives, at ``shares`` (s,)."""
    inside, pieces = np.clip(shares, 0.0, 1.0), count - DEGREE
    first = np.minimum((inside * pieces).astype(np.intp), pieces - 1)
    orders = np.arange(DEGREE + 1)
    powers = (inside - first / pieces)[:, None] ** orders / scipy.special.factorial(orders)
    at_knots = _derivatives(count)[:, first]
    local = np.stack(
        [np.einsum("sm,msa->sa", powers[:, : len(orders) - d], at_knots[d:]) for d in range(4)]
    )
    values = np.zeros((4, len(shares), count))
    places = np.broadcast_to(first[:, None] + orders, local.shape)
    np.put_along_axis(values, places, local, axis=2)
    return Basis(values, local, first)


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
    of the first mode, its damping, the factor of its size, and the share of the limit of the swing
    that it may use (s, m); without ``coasting`` no setpoints are lost. Barriers are parabolas below
    ``soft`` times :data:`RELAXED_SHARE` or :data:`.RELAXED`."""

    needs: Needs
    squares: Floats
    damping: Floats
    gains: Floats
    allowed: Floats
    coasting: Coasting | None
    soft: float = 1.0


def held_on(values: Floats, count: int) -> Floats:
    """Return values (s,) with the last of them held on, ``count`` in all."""
    return np.concatenate([values, np.full(count - len(values), values[-1])])


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

    @staticmethod
    def zeros(control_points: int, coordinates: int, high: int) -> "Slopes":
        """Return derivatives of a cost of 0, whose matrix is kept in a band (k·3n, ``high``)."""
        shape = control_points, coordinates
        band = np.zeros((control_points * coordinates, high))
        near = band if high == len(band) else np.zeros_like(band)
        return Slopes(np.zeros(shape), band, near, [], 0.0, np.zeros(shape), 0.0)

    def zeros_like(self) -> "Slopes":
        """Return derivatives of a cost of 0, of the same shapes."""
        control_points, coordinates = self.gradient.shape
        return Slopes.zeros(control_points, coordinates, self.band.shape[1])

    def add(self, other: "Slopes") -> None:
        """Add the derivatives of another cost."""
        self.gradient += other.gradient
        self.band += other.band
        if self.near is not self.band:
            self.near += other.near
        self.remembered += other.remembered
        self.by_duration += other.by_duration
        self.mixed += other.mixed
        self.twice += other.twice


Term = Callable[[Slopes | None], tuple[float, Any]]
"""Returns a part of the cost and what it shows, and adds its derivatives."""


def in_two_sums(terms: Sequence[Term], slopes: Slopes | None) -> list[tuple[float, Any]]:
    """Return what terms of a cost return; add their derivatives to ``slopes``.

    Every other term adds its own to a second sum, side by side: two, however many cores there are,
    because the last bits depend on the order.
    """
    other = None if slopes is None else slopes.zeros_like()

    def every_other(first: int, to: Slopes | None) -> list[tuple[float, Any]]:
        return [term(to) for term in terms[first::2]]

    halves = both(partial(every_other, 0, slopes), partial(every_other, 1, other))
    if slopes is not None and other is not None:
        slopes.add(other)
    return [halves[k % 2][k // 2] for k in range(len(terms))]


class Part(NamedTuple):
    """Axes of a vector that a pair of vehicles moves: by the control points (k·3) of the second and
    ``sign`` times those of the first.

    ``moved`` (t, c) is the vector at t moments, metres; ``rows`` (t, 1 + c, k·3) have its
    derivatives by these control points, and before them room for that of its size; ``longer``
    (t, c) are those by the logarithm of the duration.
    """

    sign: float
    moved: Floats
    rows: Floats
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
    ``missed_after_losses`` is the largest missed need then, and ``unavoidable`` what is missed
    where vehicles begin at given places; ``swings`` (t, m) are those of the oscillators.
    """

    cost: float
    needs: ShownNeeds
    missed_after_losses: float
    unavoidable: float
    speed: float
    acceleration: float
    swing: float
    swings: Floats
    sinking: float

    @property
    def missed(self) -> float:
        """The largest missed need, metres, beyond what is unavoidable."""
        return max(float(self.needs.missed.max()) - self.unavoidable, 0.0)


class _Moved(NamedTuple):
    """Poses of a team, and the splines that move them."""

    poses: Poses
    splines: Splines


@dataclass(frozen=True, eq=False)
class Problem:
    """What a fold is: its team, limits, the ``folded`` corners (n, 3), and the line.

    With ``given`` places (n, 3) vehicles begin there, and not on a line: its pose moves nothing.
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
    given: Floats | None = None
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

    def first(self, pose: Floats) -> Floats:
        """Return the first places (n, 3): on the line, or those that are given."""
        if self.given is not None:
            return self.given
        x, y, z, heading = pose
        level = np.full(len(self.along), z)
        return np.stack(
            [x + self.along * math.cos(heading), y + self.along * math.sin(heading), level], axis=1
        )

    def by_pose(self, pose: Floats) -> Floats:
        """Return the derivative (k·3n, 4) of all control points by the pose of the line."""
        derivative = np.zeros((len(self.along), 3, 4))
        if self.given is None:
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
        points = self.following[:, None, None] * self.first(fold.pose)
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
        slopes = Slopes.zeros(self.count, knot, high)
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
        control, soft = self.control(fold), frozen.soft
        place, velocity, acceleration = self._states(control, self.basis, fold.duration)
        strands = len(self.folded) - 1
        compared = self._to_compare(control, place, velocity, fold.duration, frozen)
        terms: list[Term] = [
            *(partial(self._clearances, *each) for each in compared),
            *(
                partial(self._swing, i, velocity, acceleration, fold.duration, frozen)
                for i in range(strands)
            ),
            partial(self._bounded, 1, velocity, self.limits.speed, fold.duration, soft),
            partial(self._bounded, 2, acceleration, self.limits.acceleration, fold.duration, soft),
            partial(self._sinking, place, fold.duration, soft),
            partial(self._smoothness, control.reshape(self.count, -1), fold.duration),
        ]
        costs, shown = zip(*in_two_sums(terms, slopes), strict=True)
        records, (fastest, hardest, sinking, _) = shown[: len(compared)], shown[-4:]
        swings = np.stack(shown[len(compared) : -4], axis=1)
        ahead = self._before_fold(fold.pose, frozen, records[0], slopes)
        return Evaluation(
            cost=float(sum(costs)) + ahead,
            needs=records[0],
            missed_after_losses=max(
                (float(each.missed.max()) for each in records[1:]), default=0.0
            ),
            unavoidable=0.0 if self.given is None else float(records[0].missed[0]),
            speed=fastest,
            acceleration=hardest,
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
        self, pose: Floats, frozen: Frozen, record: ShownNeeds, slopes: Slopes | None
    ) -> float:
        """Return the cost of vehicles and walls before the fold, and note the largest missed need
        at its first moment; add the derivatives."""
        places, by_pose = self.way_to_line(pose)
        gradient, matrix = np.zeros((len(places), 3)), np.zeros((len(places), 3, 3))
        relaxed = frozen.soft * RELAXED
        cost = add_walls(
            places, self.team, frozen.needs, record, relaxed, Derivatives.zeros(1, 0), gradient,
            matrix,
        )  # fmt: skip
        if slopes is not None:
            slopes.pose += np.einsum("rx,rxa->a", gradient, by_pose)
            slopes.by_pose += np.einsum("rxa,rxy,ryb->ab", by_pose, matrix, by_pose)
        return cost

    def _to_compare(
        self, control: Floats, place: Floats, velocity: Floats, duration: float, frozen: Frozen
    ) -> list[tuple[_Moved, Team, Needs]]:
        """Return the poses of the motion and those after losses of setpoints, with their needs."""
        coasting = frozen.coasting
        compared = [(self._planned(place, frozen.soft), self.team, frozen.needs)]
        if coasting is not None:
            lost = self._lost(control, place, velocity, duration, coasting, frozen.soft)
            compared += [(moved, self.after, coasting.needs) for moved in lost]
        return compared

    def _clearances(
        self, moved: _Moved, team: Team, needs: Needs, slopes: Slopes | None
    ) -> tuple[float, ShownNeeds]:
        """Return the cost of all clearances of poses, and what they show; add the derivatives."""
        n, m, rows = len(self.folded), len(self.folded) - 1, len(needs.floor)
        record = ShownNeeds(
            np.zeros((rows, m, m)), np.zeros((rows, n, m)), np.zeros((rows, m)),
            np.zeros((rows, m)), np.zeros((rows, m, m)), np.zeros((rows, m)), np.zeros(rows),
        )  # fmt: skip
        memory = Memory(
            np.empty((n, 3)), np.empty(n, dtype=np.int64), np.empty((m, _PIECES + 1, 3)),
            np.empty((m, _PIECES + 1, 5)), np.empty((m, 6)), np.empty(m),
            np.empty(m, dtype=np.int64),
        )  # fmt: skip
        to = slopes or Slopes.zeros(0, 0, 0)
        by_duration = np.zeros(2)
        cost = add_clearances(
            moved.poses, team, needs, record, memory, moved.splines,
            Sums(to.gradient, to.band, to.mixed, by_duration), Derivatives.zeros(n, DEGREE + 1),
            Derivatives.zeros(n, DEGREE + 1), slopes is not None,
        )  # fmt: skip
        to.by_duration += float(by_duration[0])
        to.twice += float(by_duration[1])
        return cost, record

    def shown_by(self, places: Floats, needs: Needs) -> ShownNeeds:
        """Return what poses (s, n, 3) show with their needs; at most as many as the moments."""
        return self._clearances(self._planned(places, 1.0), self.team, needs, None)[1]

    def _planned(self, place: Floats, soft: float) -> _Moved:
        """Return the poses of the motion itself."""
        s, n, _ = place.shape
        at, still, all_ = self.basis, np.zeros_like(place), np.array([-1])
        shares, first = at.local[0, :s], at.first[:s]
        of_each = np.ascontiguousarray(np.broadcast_to(shares[:, None], (s, n, DEGREE + 1)))
        return _Moved(
            Poses(place, place, all_, np.arange(s), RANGE, 1.0, soft * RELAXED),
            Splines(shares, first, still, of_each, first, still),
        )

    def _lost(
        self, control: Floats, place: Floats, velocity: Floats, duration: float, coasting: Coasting,
        soft: float,
    ) -> Iterator[_Moved]:  # fmt: skip
        """Yield the poses after losses of setpoints, of all vehicles and of each one.

        When they have moved as far as they do; the others advance meanwhile as little and as far as
        they may. Poses on the way there changed no fold (results of plans, optimised folds).
        """
        at, some, every = self.basis, slice(0, None, LOSS_EVERY), np.arange(len(self.folded))
        seconds, rows = coasting.lost, np.arange(len(coasting.others))
        lost, lost_longer = (
            place[some] + seconds[:, None] * velocity[some], -seconds[:, None] * velocity[some]
        )  # fmt: skip
        lost_shares = (
            at.local[0][some, None] + (seconds / duration)[:, None] * at.local[1][some, None]
        )
        lost_first = np.ascontiguousarray(at.first[some])
        least = np.full(len(rows), min(coasting.silence, float(seconds.min())))
        for who, advance in ((np.append(-1, every), least), (every, coasting.others)):
            ahead = self.shares[some] + advance / duration
            there = basis(self.count, ahead)
            team, moving, _ = self._states(control, there, duration)
            longer = -(advance * (ahead < 1.0))[:, None, None] * moving
            for begin in range(0, len(rows), _LOSSES_TOGETHER):
                now = slice(begin, begin + _LOSSES_TOGETHER)
                yield _Moved(
                    Poses(
                        team[now], lost[now], who, rows[now], _LOSS_RANGE, _LOSS_WEIGHT,
                        soft * RELAXED,
                    ),
                    Splines(
                        there.local[0][now], there.first[now], longer[now], lost_shares[now],
                        lost_first[now], lost_longer[now],
                    ),
                )  # fmt: skip

    def _bounded(
        self, order: int, state: Floats, limit: float, duration: float, soft: float,
        slopes: Slopes | None,
    ) -> tuple[float, float]:  # fmt: skip
        """Return the cost of a derivative of the motion and its limit, and its largest size; add
        its own derivatives."""
        s = len(state)
        squares = (state**2).sum(axis=2)
        slack, largest = 1.0 - squares / limit**2, float(np.sqrt(squares.max()))
        value, slope, curvature = logarithmic(slack, soft)
        if slopes is None:
            return float(value.sum()), largest
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
        blocks = curvature[..., None, None] * by[..., :, None] * by[..., None, :] - (
            2.0 / limit**2 * slope
        )[..., None, None] * np.eye(3)
        scatter(self.basis.local[order], self.basis.first, scale**2, blocks, slopes.band)
        return float(value.sum()), largest

    def _swing(
        self, i: int, velocity: Floats, acceleration: Floats, duration: float, frozen: Frozen,
        slopes: Slopes | None,
    ) -> tuple[float, Floats]:  # fmt: skip
        """Return the cost of a strand's swing, and the swing (t,); add the derivatives."""
        parts = self._strand_swing(
            i, velocity, acceleration, duration, frozen, derive=slopes is not None
        )
        pair = (i, i + 1) if slopes is not None else None
        soft = frozen.soft + _SWING_SOFTER
        value, squares = below(parts, self.limits.swing, soft, pair)
        if slopes is not None and squares is not None:
            self._add(slopes, squares)
        swing = np.linalg.norm(np.concatenate([part.moved for part in parts], axis=1), axis=1)
        return value, swing * held_on(frozen.allowed[:, i], len(swing))

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
        self, i: int, velocity: Floats, acceleration: Floats, duration: float, frozen: Frozen, *,
        derive: bool,
    ) -> list[Part]:  # fmt: skip
        """Return both modes of a strand: what they swing (t, 2) and (t, 3), without ``derive`` with
        no derivatives by control points."""
        s = len(velocity)
        step = duration / (s - 1)
        count = s + math.ceil(SETTLING / step)
        gain, square, damping = (
            held_on(each, count)
            for each in (
                frozen.gains[:, i] / frozen.allowed[:, i],
                frozen.squares[:, i],
                frozen.damping[:, i],
            )
        )
        begins = _PER_KNOT * np.maximum(np.arange(self.count) - DEGREE, 0)
        first, second = (self.basis.values[d] / duration**d for d in (1, 2))
        parts = []
        for sign, axes, squares in ((1.0, 2, square), (-1.0, 3, _SECOND * square)):
            speed = 0.5 * (velocity[:, i + 1] + sign * velocity[:, i])
            pushed = 0.5 * (acceleration[:, i + 1] + sign * acceleration[:, i])
            size = np.linalg.norm(speed, axis=1) + 1e-9
            force = np.zeros((count, axes))
            force[:s] = _STEP_RESPONSE * (pushed + self.drag * size[:, None] * speed)[:, :axes]
            mode = Mode(squares, damping, gain, 0.5 * _STEP_RESPONSE, self.drag, begins)
            moved = swung(mode, force, step)
            # A longer duration makes forces smaller by its square, and steps longer.
            later = swung(mode, force / (1.0 + _STRETCH) ** 2, step * (1.0 + _STRETCH))
            rows = np.zeros((count if derive else 0, 1 + axes, 3 * self.count))
            if derive:
                memory = np.zeros((3, axes, 3 * self.count))
                oscillate_by_points(first, second, speed, mode, step, rows, memory)
            parts.append(Part(sign, moved, rows, (later - moved) / _STRETCH))
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
            depth, sunk = depths[:, k : k + 1], depths[:, k : k + 1] > 0.0
            rows = np.zeros((0 if slopes is None else s, 2, 3 * self.count))
            if slopes is not None:
                force = by_place[:, k, None] * self.basis.values[0][:, :, None]
                rows[:, 1] = responded(held, force.reshape(s, -1)) * sunk
            longer = (later[:, k : k + 1] - depth) / _STRETCH * sunk
            value, squares = below(
                [Part(-1.0, depth * sunk, rows, longer)], self.limits.sinking, soft,
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

    def _smoothness(
        self, flat: Floats, duration: float, slopes: Slopes | None
    ) -> tuple[float, None]:
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
        return cost, None


def swung(mode: Mode, force: Floats, step: float) -> Floats:
    """Return the swing (t, c) by columns of force (t, c), with ``step`` seconds between moments."""
    moved = np.empty((len(force) + 2, force.shape[1]))
    oscillate(np.ascontiguousarray(force), mode.squares, mode.damping, step, moved)
    swings: Floats = moved[:-2] * mode.gain[:, None]
    return swings


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
    weights = np.stack([inward * slope, inward * steep, scaled])
    twice, by_ends = float(curvature @ longer**2), np.zeros((2, 2, parts[0].rows.shape[2]))
    for part in parts:
        crossed = np.column_stack([steep * longer, scaled[:, None] * part.longer])
        twice += float((crossed[:, 1:] ** 2).sum())
        of_part = np.zeros((2, part.rows.shape[2]))
        weigh(part.rows, np.ascontiguousarray(part.moved), weights, crossed, *of_part)
        by_ends += of_part[:, None] * np.array([part.sign, 1.0])[:, None]
    gradient, mixed = by_ends.reshape(2, 2, -1, 3)
    rows = tuple((part.sign, part.rows) for part in parts)
    by_duration = float(slope @ longer)
    return float(value.sum()), Squares(pair, rows, gradient, mixed, by_duration, twice)


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
