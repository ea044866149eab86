"""Which body of motion capture each vehicle moves, while a person lifts one after the other.

A vehicle knows how it leans from its own sensors, whatever poses it gets. :class:`Identification`
compares that with the attitudes of all bodies: bodies that are swapped, mirrored, turned on their
vehicles, frozen, lost or flipping are found before take-off. No clock, no sockets: what has come
goes in, words and findings come out.

Attitudes are compared as rotations since rest, in the axes of the vehicle (forward, right, down):
they do not depend on where north is. Mirrored horizontal axes of positions alone are not found, for
no sensor of a vehicle on the ground shows them.
"""

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from swarm.certification.findings import Finding
from swarm.flight.bodies import UNSEEN, Body
from swarm.mavlink.telemetry_table import Vector

Floats = npt.NDArray[np.float64]

REST = 1.0
"""Seconds without motion after which a vehicle has been put down."""
STILL = 0.05
"""Radians that a vehicle turns at rest at most: twice the noise of estimators on the ground."""
MOVES = 0.15
"""Radians from which a vehicle is in a person's hands: three times those at rest."""
ENOUGH = 0.35
"""Radians about each axis that show which body moves, and how: seven times those at rest."""
LIFTED = 0.1
"""Metres by which a body shows which way is up: a hundred times the noise of a system."""
_LIKE, _SMALLEST, _LARGEST = 0.85, 0.6, 1.6
"""The least cosine between the courses of two rotations that are one motion, and the range of the
ratio of their sizes. One motion has 1 and 1, less what noise and gaps change; motions at other
times have a cosine near 0, since delays up to 0.4 s are taken out."""
_FLIP = 1.0
"""Radians that a body jumps from one moment to the next, beyond its vehicle: a hand turns 0.3."""
_ROUND = 2.5
"""Radians up to which rotations are compared: at half a turn their axes change sides."""
_DELAY = 0.4
"""Seconds by which poses and attitudes may be apart in time: two slow radios."""
_APART, _TILTED = math.radians(20.0), math.radians(15.0)
"""Differences of heading and of level at rest that are errors: a compass near motors errs by 10."""
_SEEN = 0.8
"""Share of the moments at which a body must be seen."""
_AXES = ("roll", "pitch", "heading")
# East, north, up as north, east, down.
_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_FRD = np.diag([1.0, -1.0, -1.0])
"""Forward, left, up as forward, right, down."""


def attitude_matrix(roll: float, pitch: float, yaw: float) -> Floats:
    """Return the rotation (3, 3) from forward, right, down to NED."""
    matrix: Floats = Rotation.from_euler("ZYX", (yaw, pitch, roll)).as_matrix()
    return matrix


def pose_matrix(attitude: Sequence[float]) -> Floats:
    """Return the rotation (3, 3) of a pose (quaternion, FLU to ENU) from FRD to NED."""
    turned: Floats = _NED @ Rotation.from_quat(attitude, scalar_first=True).as_matrix() @ _FRD
    return turned


def rotation_vector(matrix: Floats) -> Floats:
    """Return the axis of a rotation (3, 3) times its angle in radians (3,)."""
    # SciPy's takes eight times as long for one matrix (97 and 12 µs), and each step has hundreds
    twice = matrix - matrix.T
    axis = 0.5 * np.array([twice[2, 1], twice[0, 2], twice[1, 0]])
    sine, cosine = float(np.linalg.norm(axis)), 0.5 * (float(np.trace(matrix)) - 1.0)
    angle = math.atan2(sine, cosine)
    if sine > 1e-6:
        return axis * (angle / sine)
    if cosine > 0.0:
        return axis
    # half a turn: the axis is the largest column of matrix + 1
    both = matrix + np.eye(3)
    column: Floats = both[:, int(np.argmax(np.diag(both)))]
    return column * (angle / float(np.linalg.norm(column)))


def _angle(first: Floats, second: Floats) -> float:
    """Return the angle between two rotations, radians."""
    return float(np.linalg.norm(rotation_vector(first.T @ second)))


@dataclass(frozen=True)
class _Moment:
    """Attitudes of vehicles and bodies (3, 3), FRD to NED; what has come of the bodies."""

    time: float
    vehicles: Mapping[int, Floats]
    turned: Mapping[int, Floats]
    bodies: Mapping[int, Body]


@dataclass(frozen=True)
class Identified:
    """What was seen while vehicle ``system`` was moved: the body that moved with it, if any."""

    system: int
    body: int | None
    problems: tuple[Finding, ...] = ()

    @property
    def own(self) -> bool:
        """Whether its own body moved with it, and nothing was wrong."""
        return self.body == self.system and not any(p.severity == "error" for p in self.problems)


@dataclass
class Identification:
    """Asks for one vehicle after the other, and watches it and all bodies.

    ``asked`` is the vehicle to move now, None before all are at rest and at the end; ``results``
    has those that were moved.
    """

    systems: Sequence[int]
    asked: int | None = None
    results: dict[int, Identified] = field(default_factory=dict)
    _recent: "deque[_Moment]" = field(default_factory=deque)
    _first: _Moment | None = None
    _start: _Moment | None = None
    _moved: list[_Moment] = field(default_factory=list)
    _most: Floats = field(default_factory=lambda: np.zeros(3))
    _others: set[int] = field(default_factory=set)

    @property
    def done(self) -> bool:
        """Whether all vehicles were moved."""
        return len(self.results) == len(self.systems)

    @property
    def remaining(self) -> tuple[str, ...]:
        """What is to be done with the vehicle that is asked for, in words."""
        ways = ("lean it to its right", "lift its nose", "turn it")
        return tuple(w for w, most in zip(ways, self._most, strict=True) if most < ENOUGH) or (
            "put it back",
        )

    def step(
        self, now: float, attitudes: Mapping[int, Vector], bodies: Mapping[int, Body]
    ) -> list[str]:
        """Take attitudes (roll, pitch, yaw, radians) and bodies at ``now``; return what to say."""
        moment = _Moment(
            now,
            {system: attitude_matrix(*angles) for system, angles in attitudes.items()},
            {system: pose_matrix(body.pose.attitude) for system, body in bodies.items()},
            bodies,
        )
        self._recent.append(moment)
        while now - self._recent[0].time > REST + _DELAY:
            self._recent.popleft()
        if self.done:
            return []
        if self.asked is None:
            return self._ask(moment)
        return self._watch(moment, self.asked)

    def _ask(self, moment: _Moment) -> list[str]:
        """Ask for the next vehicle once all are at rest."""
        if not all(self._rests(system) for system in self.systems):
            return []
        self.asked = next(system for system in self.systems if system not in self.results)
        self._first = self._start = moment
        self._moved, self._most = [], np.zeros(3)
        self._others.clear()
        return [
            f"vehicle {self.asked}: lift it, lean it to its right, lift its nose, turn it by a "
            "quarter, and put it back"
        ]

    def _rests(self, system: int) -> bool:
        """Return whether a vehicle has not turned for REST seconds."""
        newest = self._recent[-1]
        own = newest.vehicles.get(system)
        if own is None or newest.time - self._recent[0].time < REST:
            return False
        since = [m.vehicles.get(system) for m in self._recent if newest.time - m.time <= REST]
        return all(then is not None and _angle(then, own) < STILL for then in since)

    def _watch(self, moment: _Moment, asked: int) -> list[str]:
        first, start = self._first, self._start
        own = moment.vehicles.get(asked)
        if first is None or start is None or own is None:
            return []
        if not self._moved and self._rests(asked):
            # other vehicles may be moved and put back before it: only heights begin with the first.
            # the oldest moment: poses may be ahead of attitudes
            self._start = next(then for then in self._recent if asked in then.vehicles)
            return self._note_others(moment, first, asked)
        turned = rotation_vector(start.vehicles[asked].T @ own)
        if not self._moved and float(np.linalg.norm(turned)) < MOVES:
            return []
        self._moved.append(moment)
        self._most = np.maximum(self._most, np.abs(turned))
        if self._most.min() < ENOUGH or not self._rests(asked):
            return []
        result = judge(asked, first, start, self._moved)
        self.results[asked], self.asked = result, None
        return [finding.message for finding in _told(result)]

    def _note_others(self, moment: _Moment, first: _Moment, asked: int) -> list[str]:
        """Say once of each other vehicle that it moves."""
        said = []
        for system in self.systems:
            own, before = moment.vehicles.get(system), first.vehicles.get(system)
            if system in (asked, *self._others) or own is None or before is None:
                continue
            if _angle(before, own) > ENOUGH:
                self._others.add(system)
                said.append(
                    f"vehicle {system} moves, and vehicle {asked} was asked for: put it back; if "
                    f"it is labelled {asked}, its system id is wrong"
                )
        return said

    def findings(self) -> tuple[Finding, ...]:
        """Return the findings so far; bodies that are exchanged have one together."""
        return conclusions(self.results.values())


def _told(result: Identified) -> list[Finding]:
    """Return what is said of one vehicle at once."""
    system, body = result.system, result.body
    if result.own and not result.problems:
        words = f"vehicle {system} moves body {body}: attitude, heading and height agree"
        return [Finding("info", "bodies", words)]
    if body is not None and body != system:
        words = f"vehicle {system} moves body {body}, not body {system}"
        return [Finding("error", "bodies", words), *result.problems]
    return list(result.problems)


def conclusions(results: Iterable[Identified]) -> tuple[Finding, ...]:
    """Return the findings of several vehicles; bodies that are exchanged have one together."""
    given = {result.system: result for result in results}
    findings: list[Finding] = []
    named: set[int] = set()
    for system, result in given.items():
        if result.body is None or result.body == system:
            findings += _told(result)
            continue
        ring = _ring(system, given)
        if len(ring) == 2:
            words = f"vehicle {ring[0]} moves body {ring[1]}: bodies {ring[0]} and {ring[1]} are "
            words += "swapped"
        elif ring:
            pairs = [f"vehicle {s} moves body {given[s].body}" for s in ring]
            listed = ", ".join(map(str, sorted(ring)))
            words = f"{', '.join(pairs)}: bodies {listed} are exchanged"
        else:
            words = f"vehicle {system} moves body {result.body}, not body {system}"
        if not named.intersection(ring):
            findings.append(Finding("error", "bodies", words))
        named.update(ring)
        findings += result.problems
    return tuple(findings)


def _ring(system: int, given: Mapping[int, Identified]) -> list[int]:
    """Return the vehicles from one on, each of which moves the body of the next; [] if open."""
    ring = [system]
    while True:
        result = given.get(ring[-1])
        following = result.body if result is not None else None
        if following == system:
            return ring
        if following is None or following in ring:
            return []
        ring.append(following)


def judge(system: int, first: _Moment, start: _Moment, moved: Sequence[_Moment]) -> Identified:
    """Return which body moved with a vehicle from ``start`` on, at rest; and what is wrong.

    All vehicles stood at the ``first`` moment.
    """
    stood = start.vehicles[system]
    kept = [
        moment
        for moment in moved
        if system in moment.vehicles and _angle(stood, moment.vehicles[system]) < _ROUND
    ]
    own = np.array([rotation_vector(stood.T @ m.vehicles[system]) for m in kept])
    flips = [body for body in start.turned if _flips(body, system, kept)]
    problems = []
    if system in flips:
        words = f"body {system} flips: its attitude jumps while vehicle {system} turns smoothly"
        problems.append(_error(words))
    steps = np.diff([moment.time for moment in kept])
    shifts = int(_DELAY / max(float(np.median(steps)), 1e-3)) if len(steps) else 0
    likeness: dict[int, float] = {}
    courses: dict[int, tuple[Floats, Floats]] = {}
    for body, reference in start.turned.items():
        seen = sum(_is_seen(body, moment) for moment in kept)
        if body in flips or seen < _SEEN * len(kept):
            continue
        course = np.array(
            [rotation_vector(reference.T @ m.turned.get(body, reference)) for m in kept]
        )
        like, *pair = _aligned(own, course, shifts)
        if like >= _LIKE:
            likeness[body], courses[body] = like, (pair[0], pair[1])
    if not likeness:
        if system not in flips:
            problems.append(_error(_why_none(system, kept)))
        return Identified(system, None, tuple(problems))
    body = max(likeness, key=lambda each: (round(likeness[each], 2), each == system))
    problems += _axes(system, body, start, *courses[body])
    problems += _height(system, body, first, kept)
    return Identified(system, body, tuple(problems))


def _error(words: str) -> Finding:
    return Finding("error", "bodies", words)


def _is_seen(body: int, moment: _Moment) -> bool:
    return body in moment.bodies and moment.bodies[body].age <= UNSEEN


def _likeness(own: Floats, course: Floats) -> float:
    """Return the cosine between the sizes (n,) of two courses of rotations, 0 for other sizes."""
    first, second = np.linalg.norm(own, axis=1), np.linalg.norm(course, axis=1)
    size, other = float(np.linalg.norm(first)), float(np.linalg.norm(second))
    if not size or not _SMALLEST <= other / size <= _LARGEST:
        return 0.0
    return float(first @ second) / (size * other)


def _aligned(own: Floats, course: Floats, shifts: int) -> tuple[float, Floats, Floats]:
    """Return the likeness of two courses of rotations (n, 3), and both, at the best delay.

    One is at most ``shifts`` moments later than the other.
    """
    best: tuple[float, Floats, Floats] = 0.0, own, course
    for shift in range(-shifts, shifts + 1):
        first = own[max(0, -shift) : len(own) - max(0, shift)]
        second = course[max(0, shift) : len(course) - max(0, -shift)]
        like = _likeness(first, second)
        if like > best[0]:
            best = like, first, second
    return best


def _flips(body: int, system: int, moved: Sequence[_Moment]) -> bool:
    """Return whether a body jumps from one moment to the next, beyond what its vehicle turns."""
    for k in range(1, len(moved)):
        before, now = moved[k - 1], moved[k]
        if body not in before.turned or body not in now.turned:
            continue
        jump = _angle(before.turned[body], now.turned[body])
        if jump < _FLIP:
            continue
        around = [m for m in moved if before.time - _DELAY <= m.time <= now.time + _DELAY]
        first = around[0].vehicles[system]
        if jump - max(_angle(first, m.vehicles[system]) for m in around) > _FLIP:
            return True
    return False


def _why_none(system: int, moved: Sequence[_Moment]) -> str:
    """Return why no body moves with a vehicle."""
    seen = [moment.bodies[system] for moment in moved if _is_seen(system, moment)]
    if len(seen) < _SEEN * len(moved):
        return f"body {system} is lost while vehicle {system} moves"
    if seen and seen[-1].unchanged > 0.5 * (moved[-1].time - moved[0].time):
        return f"body {system} is frozen: no digit of its pose changes while vehicle {system} moves"
    return f"no body moves with vehicle {system}"


def _axes(system: int, body: int, start: _Moment, own: Floats, course: Floats) -> list[Finding]:
    """Return what is wrong with a body's axes, by its rotations (n, 3) and its vehicle's.

    The least squares of course = own · m.T show how each axis of the vehicle appears.
    """
    m = np.linalg.lstsq(own, course, rcond=None)[0].T
    about = math.atan2(m[1, 0] - m[0, 1], m[0, 0] + m[1, 1])
    cos, sin = math.cos(about), math.sin(about)
    upright = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    signs = np.sign(np.diag(m))
    name = f"body {body} on vehicle {system}"
    if np.abs(m - np.diag(signs)).max() < 0.5:
        reversed_axes = [axis for axis, sign in zip(_AXES, signs, strict=True) if sign < 0.0]
        if reversed_axes and reversed_axes != ["roll", "pitch"]:
            listed = " and ".join(reversed_axes)
            many = "go" if len(reversed_axes) > 1 else "goes"
            return [_error(f"{name} is mirrored: {listed} {many} the other way")]
    if np.abs(m - upright).max() >= 0.5:
        return [_error(f"the axes of {name} do not fit the vehicle's")]
    rest = start.vehicles[system].T @ start.turned[body]
    heading = math.atan2(rest[1, 0], rest[0, 0])
    tilt = math.acos(min(1.0, max(-1.0, float(rest[2, 2]))))
    if abs(about) > _APART:
        # where north agrees, rest shows it best
        same = abs(math.remainder(about + heading, 2.0 * math.pi)) < _APART
        degrees = abs(math.degrees(heading if same else about))
        words = f"{name} is turned by {degrees:.0f} degrees about the vertical: define its "
        return [_error(words + "axes anew in the motion capture system, x forwards, y to the left")]
    problems = []
    if abs(heading) > _APART:
        problems.append(
            _error(
                f"{name}: headings differ by {abs(math.degrees(heading)):.0f} degrees at rest: "
                "turn the axes of the laboratory, or the vehicle's north"
            )
        )
    if tilt > _TILTED:
        words = f"{name} leans by {math.degrees(tilt):.0f} degrees against it at rest"
        problems.append(_error(words))
    return problems


def _height(system: int, body: int, first: _Moment, moved: Sequence[_Moment]) -> Iterable[Finding]:
    """Yield an error for a body that sinks while its vehicle is lifted; a remark if it was not."""
    floor = first.bodies[body].pose.position[2]
    rises = [m.bodies[body].pose.position[2] - floor for m in moved if _is_seen(body, m)]
    if max(rises) < LIFTED:
        if min(rises) <= -LIFTED:
            yield _error(f"body {body} on vehicle {system} sinks when it is lifted: up is mirrored")
        else:
            words = f"vehicle {system} was lifted by less than {LIFTED:g} m: heights not compared"
            yield Finding("warning", "bodies", words)
