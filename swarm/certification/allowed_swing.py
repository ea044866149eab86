"""How far strands of a flown cable may swing by the tube of all changes and the budget together.

The tube is for vehicles exactly on the plan. Those of a flight err within the tracking radius, and
so excite the strands: the budget counts that swing too.
"""

import numpy as np
import numpy.typing as npt

from swarm.certification.excitation import (
    DEVIATIONS,
    STEP,
    largest_deviation,
    modal_variances,
    modes,
    speeds_across,
)
from swarm.certification.swing_tube import SwingTube
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.lumped_mass import cable_model
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]

_APART, _MOST = 2.5, 40
"""Seconds between the moments whose excited swing is computed, at least, and their largest number:
the places of the strands and their speeds decide it, which change within several seconds. A moment
of nineteen vehicles takes 0.05 s."""

_PAST = 60.0
"""Seconds of the motion before a moment that count: with 2 % of critical damping at 0.4 Hz they
leave a four-hundredth of the variance."""


def allowed_swing(plan: Plan, tube: SwingTube, times: Floats) -> Floats:
    """Return how far strands may swing at mission times (k,), metres (k, n − 1).

    The radius of the tube, and three standard deviations of the swing that tracking errors of the
    plan's tracking radius excite, in any direction, at the joint that swings farthest.
    """
    first, last = float(tube.times[0]), float(tube.times[-1])
    count = int(np.clip((last - first) / _APART, 1, _MOST))
    moments = np.linspace(first, last, count + 1)
    excited = DEVIATIONS * np.array([_deviations(plan, tube.start, t) for t in moments.tolist()])
    radius = np.array([tube.all_changes.strands(time) for time in times.tolist()])
    between = [np.interp(times, moments, strand) for strand in excited.T]
    allowed: Floats = radius.reshape(len(times), -1) + np.stack(between, axis=1)
    return allowed


def _deviations(plan: Plan, since: float, time: float) -> Floats:
    """Return the largest standard deviation of each strand's excited swing (n − 1,), metres."""
    cable, lengths = plan.mission.cable, plan.layout.lengths
    drag = cable_model(cable.mass_per_length, cable.diameter).normal_drag
    place, velocity, _ = plan.motion.at(np.arange(max(since, time - _PAST), time, STEP))
    now = plan.motion.at(time)[0]
    found = np.empty(len(lengths))
    for k, length in enumerate(lengths.tolist()):
        strand = modes(solve_catenaries(now[k][None], now[k + 1][None], np.array([length])))
        speeds = speeds_across(place[:, k : k + 2], velocity[:, k : k + 2])
        moving, _ = modal_variances(strand, plan.mission.vehicles.tracking, drag, speeds)
        found[k] = largest_deviation(strand, moving)
    return found
