"""The estimate of the cable's swing in flight, against the emulator's own chain."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sitl.cable.swinging import SwingingRope
from sitl.physics.dynamics import STEP
from sitl.world import CableSpec
from swarm.certification.clearances import PlanChecks
from swarm.certification.excitation import allowed_swing, modes, variances_along
from swarm.certification.monitor import SLOWEST, Monitor
from swarm.flight.swinging import (
    RECENT,
    GripReports,
    Swing,
    SwingEstimator,
    flown_swing,
    largest_stray,
    lean,
)
from swarm.geometry.catenary import STANDARD_GRAVITY, solve_catenaries
from swarm.geometry.chain import polyline
from swarm.geometry.lumped_mass import cable_model
from tests.network import Network, small_plan

PLAN = small_plan(vehicles=4).plan
LINE = PLAN.layout.corners
ESTIMATOR = SwingEstimator.of(PLAN)
EVERY = round(0.1 / STEP)
"""Steps of the emulator between two reports."""


def reports(
    now: float, place: np.ndarray, velocity: np.ndarray | None = None, **other
) -> GripReports:
    still = np.zeros_like(place)
    given = {"lean": still, "fresh": np.ones(len(place), dtype=bool), **other}
    return GripReports(now, place, still if velocity is None else velocity, **given)


def moved(places: np.ndarray, vehicle: int, east: float) -> np.ndarray:
    found = places.copy()
    found[vehicle, 0] += east
    return found


def test_a_cable_at_rest_does_not_swing():
    swing = ESTIMATOR.follow(None, reports(0.0, LINE))
    for k in range(1, 60):
        swing = ESTIMATOR.follow(swing, reports(0.1 * k, LINE))
    assert len(swing.recent) == round(RECENT / 0.1)
    # a polygon of 24 links hangs within a part of a link's own sag of the curve
    assert swing.amplitude.max() < 0.005


def _hung() -> SwingingRope:
    """The emulated cable at rest between the vehicles."""
    curve = polyline(LINE, PLAN.layout.lengths, 200)
    rope = SwingingRope(CableSpec(points=curve.tolist()), -100.0, np.zeros(3))
    arcs = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1)))
    for vehicle, arc in enumerate(arcs[::200]):
        rope.attach(vehicle, float(arc))
    return rope


def _true_strays(rope: SwingingRope, grips: np.ndarray) -> list[float]:
    """Distances of the emulated chain's strands from their catenaries."""
    arcs, found = [arc for arc, _ in rope.grips], []
    for k, length in enumerate(np.diff(arcs)):
        inside = (rope.arc > arcs[k]) & (rope.arc < arcs[k + 1])
        still = solve_catenaries(grips[k], grips[k + 1], length)
        points = still.points((rope.arc[inside] - arcs[k]) / length)
        found.append(float(np.linalg.norm(points - rope.shape[inside], axis=1).max()))
    return found


def _swung(estimator: SwingEstimator, *, leaning: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return true and estimated strays (k, 3) of vehicles that sway, with noisy positions."""
    rope = _hung()
    rng, rate, offset = np.random.default_rng(1), 2.0 * math.pi * 0.4, 0.6
    way = np.array([[0.05, 0.1, 0.0], [0.0, -0.1, 0.02], [-0.05, 0.1, 0.0], [0.0, 0.0, 0.0]])
    true, found, error = [], [], np.zeros_like(LINE)
    swing: Swing | None = None
    for k in range(round(16.0 / STEP)):
        now = k * STEP
        ramp = min(1.0, now / 3.0) ** 3
        aside = ramp * math.sin(rate * now) * way
        velocity = ramp * rate * math.cos(rate * now) * way
        # a vehicle leans as it accelerates, and its dropper with it
        swept = ramp * rate**2 * math.sin(rate * now) * way / STANDARD_GRAVITY * offset
        swept[:, 2] = 0.0
        grips = LINE + aside + swept
        if k % EVERY == 0:
            error += -error * 0.1 / 4.0 + rng.normal(0.0, 0.0034, LINE.shape)
            tilt = swept if leaning else np.zeros_like(swept)
            given = reports(now, LINE + aside + error, velocity, lean=tilt)
            swing = estimator.follow(swing, given)
            rope.update(grips, 0.0)
            true.append(_true_strays(rope, grips))
            found.append(swing.stray)
        rope.forces(grips, np.zeros_like(grips))
    return np.array(true[5:]), np.array(found[5:])


def test_it_estimates_the_swing_of_the_emulated_cable():
    true, found = _swung(ESTIMATOR, leaning=True)
    assert true.max() > 0.15, "it swings"
    gap = np.abs(found - true)
    # positions with 1.5 cm of slow noise, read ten times a second
    assert gap.max() < 0.05
    assert gap.mean() < 0.01
    without = np.abs(_swung(ESTIMATOR, leaning=False)[1] - true)
    assert without.mean() > 1.5 * gap.mean(), "the lean of the vehicles is a part of it"


def test_droppers_lean_with_their_vehicles():
    rng = np.random.default_rng(2)
    attitude = rng.uniform(-0.6, 0.6, (5, 3)) * [1.0, 1.0, 5.0]
    turn = Rotation.from_rotvec(rng.normal(size=(5, 3))).as_matrix()
    below = Rotation.from_euler("ZYX", attitude[:, ::-1]).apply([0.0, 0.0, 0.6]) - [0.0, 0.0, 0.6]
    expected = np.einsum("nij,nj->ni", turn, below)
    assert lean(attitude, turn, 0.6) == pytest.approx(expected, abs=1e-12)
    assert (lean(np.full((5, 3), np.nan), turn, 0.6) == 0.0).all()


def test_a_silent_vehicle_moves_as_commanded_and_a_jump_does_not_swing():
    swing = ESTIMATOR.follow(None, reports(0.0, LINE))
    stale = np.array([True, False, True, True])
    old = moved(LINE, 1, 3.0)
    for k in range(1, 20):
        swing = ESTIMATOR.follow(swing, reports(0.1 * k, old, fresh=stale))
    assert swing.grips == pytest.approx(LINE)
    near = moved(LINE, 1, 0.05)
    for k in range(20, 60):
        swing = ESTIMATOR.follow(swing, reports(0.1 * k, near))
    assert swing.grips == pytest.approx(near, abs=0.01)
    assert swing.amplitude.max() < 0.02


def test_the_estimate_begins_again_after_a_gap_and_after_a_straight_strand():
    swing = ESTIMATOR.follow(None, reports(0.0, LINE))
    swing = ESTIMATOR.follow(swing, reports(5.0, LINE + 1.0))
    assert swing.recent.shape == (1, 3)
    assert swing.grips == pytest.approx(LINE + 1.0)
    far, pulled = moved(LINE, 3, 1.0), moved(np.zeros_like(LINE), 3, 2.0)
    for k in range(1, 6):
        share = min(1.0, 0.2 * k)
        place = LINE + 1.0 + share * (far - LINE)
        swing = ESTIMATOR.follow(swing, reports(5.0 + 0.1 * k, place, pulled))
    assert swing.stray[2] == 0.0
    assert np.isfinite(swing.recent).all()
    for k in range(6, 30):
        swing = ESTIMATOR.follow(swing, reports(5.0 + 0.1 * k, LINE + 1.0))
    assert np.isfinite(swing.recent).all()


def test_the_clock_slows_where_swinging_strands_come_near_each_other():
    monitor = Monitor(PLAN)
    crossed = np.array([[0, 0, 5], [3, 0, 5], [2.2, 2.2, 5.6], [1.5, -0.8, 5.6]], dtype=float)
    (seen,) = monitor.clearances(crossed[None], "aloft")
    margin = seen.cable - PLAN.mission.clearance.cable
    assert margin > 0.2
    rates = [
        monitor.swinging_rate(crossed[None], np.array([0.5, 0.0, 0.5]) * both)
        for both in (0.0, margin - 0.15, margin - 0.05, margin + 0.1)
    ]
    assert rates[:2] == [1.0, 1.0]
    # half of the margin that slows, less the bows of sampled pieces, of up to a centimetre
    assert 0.4 < rates[2] <= 0.5
    assert rates[3] == SLOWEST
    # neighbours are not compared
    assert monitor.swinging_rate(crossed[None], np.array([0.0, 2.0, 0.0])) == 1.0


def test_strands_may_swing_as_far_as_tube_and_budget_say():
    tube, fold = PlanChecks.of(PLAN).tube, PLAN.phase("fold")
    times = np.linspace(fold.start, fold.end, 50)
    radius = np.array([tube.all_changes.strands(time) for time in times])
    allowed = allowed_swing(PLAN, tube, times)
    assert (allowed >= radius).all()
    strand = solve_catenaries(LINE[:1], LINE[1:2], PLAN.layout.lengths[:1])
    drag = cable_model(PLAN.mission.cable.mass_per_length, PLAN.mission.cable.diameter).normal_drag
    still = variances_along(modes(strand), (0.5, np.array([0.0, 1.0, 0.0])), 0.1, drag, np.empty(0))
    # in the wind of the motion strands swing less than in a long hold
    assert 0.02 < (allowed - radius).max() < 3.0 * math.sqrt(still.held)
    vehicles = PLAN.mission.vehicles.model_copy(update={"tracking": 0.0})
    exact = replace(PLAN, mission=PLAN.mission.model_copy(update={"vehicles": vehicles}))
    assert allowed_swing(exact, tube, times) == pytest.approx(radius)


@pytest.mark.slow
def test_a_flight_records_the_swing_while_the_cable_is_aloft():
    flown = Network(small_plan(vehicles=4)).in_fold(1.0)
    shown = flown.conductor.snapshot(flown.now)
    assert shown.stray.shape == (3,)
    assert shown.cable.shape[::2] == (3, 3)
    assert flown.run().word == "done"
    trace = flown.conductor.trace()
    aloft = np.isin(np.array(trace.phase), ["fold", "hold"])
    assert np.isfinite(trace.stray[aloft][1:]).all()
    plan, at = flown.conductor.plan, np.array(trace.mission_time)
    elsewhere = (at < plan.phase("fold").start) | (at > plan.phase("hold").end)
    # at the end of the hold, the cable is held until the gate opens
    assert np.isnan(trace.stray[elsewhere & ~aloft]).all()
    found = flown_swing(flown.conductor.plan, trace)
    assert 0.01 < found.estimated < 0.3
    assert 0.0 < found.planned < found.allowed
    assert found.within == 1.0
    # all strands swing together here, as the line moves aside and back, unshaped
    farther = flown_swing(flown.conductor.plan, replace(trace, stray=2.5 * trace.stray))
    assert 0.7 < farther.within < 1.0
    for within, words in ((1.0, "at all moments"), (0.9996, "at 99 % of the moments")):
        assert replace(found, within=within).words.endswith(f"up to {found.allowed:.2f} m, {words}")
    silent = replace(trace, stray=np.full_like(trace.stray, np.nan))
    assert largest_stray(silent) is flown_swing(flown.conductor.plan, silent) is None
    assert flown.conductor.snapshot(flown.now).stray is None
