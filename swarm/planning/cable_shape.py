"""The shape of the cable in a plan: held by vehicles, on the floor, or undefined."""

import numpy as np
import numpy.typing as npt

from swarm.errors import InputError, Problem
from swarm.geometry.catenary import rest_on_floor
from swarm.planning.plan import Phase, Plan

Floats = npt.NDArray[np.float64]

_TO_FLOOR = np.array([1.0, 1.0, 0.0])
"""Factors that move a point straight down to the floor at z = 0."""


def cable_shape(plan: Plan, times: npt.ArrayLike, points: int) -> Floats:
    """Return the cable at mission times (…,) in seconds: (…, n − 1, points, 3), ENU metres.

    Points are spaced evenly along each of the n − 1 segments, both ends included. A held segment
    is the catenary of its length in still air, and lies on the floor (z = 0) where it reaches it;
    slack cable on the floor is drawn straight between its ends. Before the grip, and after the
    release on the floor, the cable lies there straight. NaN where the plan does not define the
    shape (phases with the cable state ``free``: released aloft, or held at both ends only). Without
    cable the result is (…, 0, points, 3).

    Raises :class:`InputError` for times that are not finite and for fewer than 2 points, and
    :class:`swarm.geometry.catenary.OverStretched` where a chord is longer than its cable, which
    does not occur in a cleared plan.
    """
    given = np.asarray(times, dtype=np.float64)
    problems = []
    if not np.isfinite(given).all():
        problems.append(Problem("time", "expected finite seconds, got NaN or infinity"))
    if points < 2:
        problems.append(Problem("points", f"expected at least 2, got {points}"))
    if problems:
        raise InputError(problems)
    flat, lengths = given.reshape(-1), plan.layout.lengths
    cable = np.full((len(flat), len(lengths), points, 3), np.nan)
    defined = np.array([plan.phase_at(time).cable != "free" for time in flat.tolist()], dtype=bool)
    if len(lengths) and defined.any():
        grips = _grip_points(plan, flat[defined])
        strands = rest_on_floor(grips[:, :-1], grips[:, 1:], lengths)
        cable[defined] = strands.points(np.linspace(0.0, 1.0, points))
    return cable.reshape(*given.shape, *cable.shape[1:])


def _grip_points(plan: Plan, times: Floats) -> Floats:
    """Return the grip points (k, n, 3) of the cable at times (k,): at their vehicles or laid."""
    begins, ends = grip_interval(plan)
    places = plan.motion.at(times)[0]
    places[times < begins] = laid_grip_points(plan)
    if np.isfinite(ends):
        places[times >= ends] = plan.motion.at(ends)[0] * _TO_FLOOR
    return places


def laid_grip_points(plan: Plan) -> Floats:
    """Return the grip points (n, 3) of the laid cable before the grip, ENU metres."""
    grab = _phase(plan, "grab")
    if grab is None:
        return plan.motion.at(plan.phases[0].start)[0]
    places: Floats = plan.motion.at(grab.end)[0] * _TO_FLOOR
    return places


def folded_back(plan: Plan) -> tuple[Floats, npt.NDArray[np.intp]]:
    """Return by how many metres each segment (n − 1,) of cable that is laid with its slack is
    folded back on itself in its middle, and how often: by at most half of the distance of its ends.
    """
    chords = np.linalg.norm(np.diff(laid_grip_points(plan), axis=0), axis=1)
    slack = plan.layout.lengths - chords
    times = np.maximum(np.ceil(slack / chords), 1.0).astype(np.intp)
    return 0.5 * slack / times, times


def laid_cable(plan: Plan) -> Floats:
    """Return the points (k, 3) at which the laid cable is bent before the grip, ENU metres.

    Laid straight, it is bent sideways in the middle of each segment by the little slack that it has
    there; with its slack, it is folded back.
    """
    grips, lengths = laid_grip_points(plan), plan.layout.lengths
    chords = np.diff(grips, axis=0)
    middles, distance = 0.5 * (grips[:-1] + grips[1:]), np.linalg.norm(chords, axis=1)
    if plan.mission.lay == "straight":
        aside = 0.5 * np.sqrt(np.maximum(lengths**2 - distance**2, 0.0))
        across = np.stack([-chords[:, 1], chords[:, 0], np.zeros(len(chords))], axis=1)
        bent = [each[None] for each in middles + across * (aside / distance)[:, None]]
    else:
        back, times = folded_back(plan)
        half = (0.5 * back / distance)[:, None] * chords
        bent = [
            middle + np.tile([[1.0], [-1.0]], (count, 1)) * reach
            for middle, reach, count in zip(middles, half, times, strict=True)
        ]
    pieces = [np.vstack([start, between]) for start, between in zip(grips, bent, strict=False)]
    return np.vstack([*pieces, grips[-1]])


def grip_interval(plan: Plan) -> tuple[float, float]:
    """Return the mission times in seconds at which all vehicles have gripped and released.

    −∞ for a cable that is tied on from the start, ∞ for a plan without release.
    """
    grab = _phase(plan, "grab")
    released = [gate.time for gate in plan.gates if gate.condition == "released"]
    return grab.end if grab else -np.inf, max(released, default=np.inf)


def planned_grip(plan: Plan, times: Floats) -> npt.NDArray[np.bool_]:
    """Return whether the cable is gripped in the plan at mission times (k,): (k,)."""
    begins, ends = grip_interval(plan)
    return (times >= begins) & (times < ends)


def _phase(plan: Plan, name: str) -> Phase | None:
    return next((phase for phase in plan.phases if phase.name == name), None)
