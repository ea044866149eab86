"""The rest of a fold from where its vehicles are, as the start of an optimisation."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from swarm.certification.assessment import clearance_findings
from swarm.certification.clearances import violations
from swarm.certification.distances import Samples, closest_neighbours, closest_segments
from swarm.errors import Refused
from swarm.geometry.motion import Motion, at_rest, through_states
from swarm.planner.shortening import SAMPLE
from swarm.planning import Plan
from swarm.planning.assembly import beginning_with, fold_of

Floats = npt.NDArray[np.float64]

_LONGER, _MORE = 1.25, 2.0
"""Of the time that is left as planned, and seconds more: a start at rest, which need not keep its
limits. 91 of 97 led to cleared plans (results of plans, the rest of a fold)."""

_MOMENT = 0.1
"""Seconds of a plan in which vehicles only stay where they are: any."""

_ASIDE = 64
"""Poses between the planned places and those of the vehicles: 2 cm apart for 1.2 m."""


def rest_of_fold_from(plan: Plan, time: float, places: Floats) -> Plan:
    """Return the plan that begins with the rest of a fold, from vehicles at rest.

    They are at ``places`` (n, 3), ENU metres, and hold the cable, about where they are planned at
    a ``time`` of the fold. They go to the same knot; the plan after the fold is the same. The
    motion need not keep limits or distances.

    Raises :class:`swarm.errors.Refused` at other times, where vehicles and cable do not keep their
    distances at these places, and where strands come so near each other on the straight way from
    the planned ones that either may have passed the other.
    """
    phase = plan.phase_at(time)
    if phase.name != "fold":
        raise Refused(f"the rest of a fold: expected a time in the fold, got {time:.1f} s")
    planned = plan.motion.at(np.array([time]))[0][0]
    if words := [*_too_near(plan, places), *_may_have_passed(plan, planned, places)]:
        raise Refused("\n".join(words))
    since = time - phase.start
    motion = _from_rest(fold_of(plan), since, places - planned)
    note = (
        f"the rest of the fold from {since:.1f} s of it, from vehicles up to "
        f"{np.linalg.norm(places - planned, axis=1).max():.2f} m beside their places"
    )
    return replace(beginning_with(plan, motion), notes=(note,))


def _too_near(plan: Plan, places: Floats) -> list[str]:
    """Return what does not keep its distance at places (n, 3) for tracking errors, in words."""
    phase = replace(plan.phase("fold"), start=0.0, end=_MOMENT)
    still = replace(plan, motion=at_rest(places, _MOMENT), phases=(phase,), gates=())
    findings = clearance_findings(still, violations(still, swinging=False))
    return [f"{finding.check}: {finding.message}" for finding in findings]


def _may_have_passed(plan: Plan, planned: Floats, places: Floats) -> list[str]:
    """Return which strands come near each other on straight ways to places (n, 3), in words."""
    shares = np.linspace(0.0, 1.0, _ASIDE)[:, None, None]
    samples = Samples(plan, planned + shares * (places - planned), np.arange(float(_ASIDE)))
    return [
        f"{' and '.join(nearest.between)} come within {nearest.distance:.2f} m of each other on "
        "the straight way from their places in the plan to where they are, "
        f"{nearest.required:g} m required: either may have passed the other"
        for nearest in (closest_segments(samples), closest_neighbours(samples))
        if nearest is not None and nearest.distance < nearest.required
    ]


def _from_rest(fold: Motion, since: float, aside: Floats) -> Motion:
    """Return a fold from a moment on, from rest, its vehicles first ``aside`` (n, 3) of it.

    The share of the fold's time grows as u²·(2 − u), from rest at u = 0; what is aside of it ends
    as a quintic, at rest at both ends.
    """
    left = float(fold.times[-1]) - since
    duration = _LONGER * left + _MORE
    u = np.linspace(0.0, 1.0, int(np.ceil(duration / SAMPLE)) + 1)[:, None, None]
    share, rate, change = u**2 * (2.0 - u), u * (4.0 - 3.0 * u), 4.0 - 6.0 * u
    place, velocity, acceleration = fold.at(since + left * share[:, 0, 0])[:3]
    still = 1.0 - u**3 * (10.0 - u * (15.0 - 6.0 * u))
    slope, bend = -30.0 * (u * (1.0 - u)) ** 2, -60.0 * u * (1.0 - u) * (1.0 - 2.0 * u)
    place = place + still * aside
    moving = left * rate * velocity + slope * aside
    turning = (left * rate) ** 2 * acceleration + left * change * velocity + bend * aside
    moving[[0, -1]] = turning[[0, -1]] = 0.0
    return through_states(u[:, 0, 0] * duration, place, moving / duration, turning / duration**2)
