"""How much worse than planned it may be: e*, the tracking error, and w*, the steady wind."""

import math
from collections.abc import Callable

from swarm.cable.catenary import STANDARD_GRAVITY
from swarm.plans import Plan
from swarm.preflight.certificate import STILL_AIR, Place, certified

MOST_TRACKING = 1.0
TRACKING_STEP = 0.005
MOST_WIND = 15.0
WIND_STEP = 0.1
DIRECTIONS = 8

AIR_DENSITY = 1.225
DRAG_COEFFICIENT = 1.1
"""Of a cylinder across the flow, at the Reynolds numbers of a cable (Hoerner 1965, p. 3-9)."""


def wind_down(plan: Plan, speed: float, heading: float) -> Place:
    """Return the unit vector of a cable's effective gravity in a steady wind.

    ``speed`` in m/s blows towards ``heading`` (radians from east to north). The drag is that of
    strands across the wind, ½ρ·c·d·v² per metre, and so an upper bound for the others.
    """
    cable = plan.mission.cable
    drag = 0.5 * AIR_DENSITY * DRAG_COEFFICIENT * cable.diameter * speed * speed
    weight = cable.mass_per_length * STANDARD_GRAVITY
    size = math.hypot(drag, weight)
    return (drag / size * math.cos(heading), drag / size * math.sin(heading), -weight / size)


def largest_tracking(plan: Plan) -> float | None:
    """Return e*, metres: the largest tracking ball for which the certificate holds.

    Found by bisection from below to TRACKING_STEP, so it does hold there; None where the
    certificate does not even hold for exact tracking. At most MOST_TRACKING.
    """
    return _largest(
        lambda error: certified(plan, tracking=error, down=STILL_AIR), MOST_TRACKING, TRACKING_STEP
    )


def largest_wind(plan: Plan) -> float | None:
    """Return w*, m/s: the largest steady wind from any direction for which the certificate holds.

    All strands tilt with their drag, at the mission's tracking ball; DIRECTIONS directions are
    tried. None where the certificate does not hold in still air. At most MOST_WIND.
    """
    headings = _headings()

    def holds(speed: float) -> bool:
        worst = _failing_heading(plan, speed, headings)
        if worst is not None:
            # The wind that broke it last is the likeliest to break it again: try it first.
            headings.remove(worst)
            headings.insert(0, worst)
        return worst is None

    return _largest(holds, MOST_WIND, WIND_STEP)


def holds_in_wind(plan: Plan, speed: float) -> bool:
    """Whether the certificate holds with the strands tilted by a steady wind, m/s.

    At the mission's tracking ball, for DIRECTIONS directions.
    """
    return _failing_heading(plan, speed, _headings()) is None


def _headings() -> list[float]:
    return [2.0 * math.pi * k / DIRECTIONS for k in range(DIRECTIONS)]


def _failing_heading(plan: Plan, speed: float, headings: list[float]) -> float | None:
    tracking = plan.mission.vehicles.tracking
    for heading in headings if speed > 0.0 else headings[:1]:
        if not certified(plan, tracking=tracking, down=wind_down(plan, speed, heading)):
            return heading
    return None


def _largest(ok: Callable[[float], bool], most: float, step: float) -> float | None:
    if not ok(0.0):
        return None
    if ok(most):
        return most
    good, bad = 0.0, most
    while bad - good > step:
        middle = 0.5 * (good + bad)
        good, bad = (middle, bad) if ok(middle) else (good, middle)
    return good
