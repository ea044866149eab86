"""The certificate of stream losses, against cases with an analytic answer and simulated losses."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm.certification.monitor import Monitor
from swarm.certification.stream_loss import (
    RATES,
    STEP,
    StreamLossModel,
    _reachable,
    certify_stream_loss,
)
from swarm.flight.guidance import MissionClock
from swarm.geometry.motion import reverse
from swarm.planning.clock_limits import ClockLimits, clock_limits
from tests.certification.synthetic import moving, plan_of
from tests.network import small_plan

LENGTH = 3.6


def line(x, gap=3.0, vehicles=3):
    return [[x + gap * k, 0.0, 5.0] for k in range(vehicles)]


def sideways(speed, gap=3.0, time=4.0):
    """A team in a line that moves across the line, all vehicles alike."""
    places = [[[gap * k, speed * t, 5.0] for k in range(3)] for t in (0.0, time)]
    return plan_of(moving([0.0, time], places), [LENGTH, LENGTH])


def test_a_loss_of_all_streams_keeps_the_formation():
    found = certify_stream_loss(sideways(0.05))
    assert (found.rates == 1.0).all()
    assert found.rate_limit(1.0) == 1.0
    assert not len(found.infeasible)
    (finding,) = found.findings()
    assert finding.message.startswith(
        "vehicles stay within the tracking radius after a stream loss"
    )
    assert finding.severity == "info"


def test_one_vehicle_that_stops_while_the_others_advance_limits_the_rate():
    """With neighbours 3 m away and 3.6 m of cable, the chord allows a lead of 1.9 m."""
    fast = certify_stream_loss(sideways(1.2))
    assert fast.rates.min() < 1.0
    assert fast.worst.vehicle in {1, 2, 3}
    slow = certify_stream_loss(sideways(0.3))
    assert slow.rates.min() > fast.rates.min()


def test_a_chord_allows_exactly_the_lead_of_the_geometry():
    plan = sideways(1.0, time=40.0)
    model = StreamLossModel((0.5,), silence=2.0)
    shares = []
    found = certify_stream_loss(plan, model, progress=shares.append)
    # a fold without a way back: one direction is half of both
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 0.5)
    middle = int(np.argmin(np.abs(found.times - 20.0)))
    speed = np.linalg.norm(plan.motion.at(20.0)[1][0])
    rate = found.rates[middle]

    def lead(r):
        later = plan.motion.at(20.0 + stopping(plan, model, 20.0, r, 9.0))[0][0, 1]
        return later - plan.motion.at(20.0)[0][0, 1] - (0.85 + 0.12 * speed) * r * speed

    allowed = np.sqrt((0.985 * LENGTH) ** 2 - 9.0)
    assert lead(rate) <= allowed + 1e-6
    faster = RATES[RATES.index(rate) - 1]
    assert lead(faster) > allowed - 0.3


@pytest.mark.slow
def test_a_longer_timeout_never_allows_a_faster_clock():
    plan = small_plan().plan
    short = certify_stream_loss(plan, StreamLossModel((0.5,), 1.0))
    long = certify_stream_loss(plan, StreamLossModel((1.0, 3.0, 1.0), 1.0))
    assert (long.rates <= short.rates + 1e-9).all()


@pytest.mark.slow
@given(
    limits=st.lists(
        st.tuples(st.floats(15.0, 55.0), st.floats(0.5, 8.0), st.sampled_from(RATES)),
        min_size=1, max_size=7,
    ),
    steepest=st.sampled_from([1.0, 0.3, 0.2, 0.12]),
)  # fmt: skip
@settings(max_examples=40)
def test_the_clock_of_the_flight_keeps_every_limit_by_ordinary_braking(limits, steepest):
    clock = MissionClock(ClockLimits(0.0, np.full(2000, steepest)), rate=1.0)
    times = np.arange(0.0, 70.0, STEP)
    rates = np.ones(len(times))
    for start, duration, rate in limits:
        rates[(times >= start) & (times <= start + duration)] = rate
    asked = replace(
        certify_stream_loss(sideways(0.05)),
        times=times, rates=_reachable(clock.limits, times, rates),
    )  # fmt: skip
    certified = replace(asked, rates=rates)
    while clock.time < 70.0:
        clock.target = asked.rate_limit(clock.time)
        clock.advance(0.02, 0.0, 80.0)
        assert clock.rate <= certified.rate_limit(clock.time) + 1e-3


def test_the_rate_is_not_limited_outside_the_fold():
    plan = small_plan().plan
    found = certify_stream_loss(plan)
    assert found.rate_limit(0.0) == 1.0
    assert found.rate_limit(plan.duration) == 1.0


@pytest.mark.parametrize("descent", [0.1, 0.42])
def test_a_descent_beside_wide_margins_does_not_slow_the_clock(descent):
    """The chords have 0.4 m left, and get 3 cm longer where one of them lands alone."""
    for speed in (0.3, 0.6):
        slow = certify_stream_loss(sideways(speed), StreamLossModel(descent=(descent,)))
        assert (slow.rates == 1.0).all()
    # and hardly where they are nearly taut: as without a descent
    fast = certify_stream_loss(sideways(1.2), StreamLossModel(descent=(descent,)))
    assert fast.rates.min() == certify_stream_loss(sideways(1.2)).rates.min()


def test_a_plan_without_margin_at_the_slowest_rate_gets_a_warning():
    taut = certify_stream_loss(
        plan_of(moving([0.0, 2.0], [line(0.0, 3.59), line(1.0, 3.59)]), [LENGTH, LENGTH])
    )
    # at rest in the beginning and in the end, none leaves the tracking radius
    assert taut.infeasible == pytest.approx(taut.times[1:-1])
    assert taut.findings()[0].severity == "warning"
    assert taut.findings()[0].message.startswith("-0.23 m margin for clearances and chords")


@pytest.mark.parametrize("returns", [False, True])
def test_the_largest_advance_after_a_loss_contains_those_of_all_moments_and_rates(returns):
    """At the end of the coasting, and where a vehicle has returned: there the team stands as well."""
    plan = small_plan().plan
    overrun = StreamLossModel((0.5,), 0.7, returns=(returns,)).overrun(plan)
    fold = plan.phase("fold")
    rng = np.random.default_rng(5)
    count = 400
    start = np.arange(fold.start, fold.end - 0.5, 0.5)
    which = rng.integers(0, len(start), count)
    advances = overrun.largest_advances(start, start + 0.5)[which]
    first, last = np.sort(start[which] + 0.5 * rng.random((2, count)), axis=0)
    time, rate = first + rng.random(count) * (last - first), rng.random(count)
    vehicle = rng.integers(0, plan.vehicles, count)
    coast = rate * overrun.rest_time[vehicle]
    stopped = rate * overrun.coast_time[vehicle]
    if not returns:
        stopped += rate * overrun.braking_time[vehicle]
    exact = np.maximum(overrun.advance(time, rate), stopped)
    fastest = np.ones(count)
    within = overrun.largest_advance((first, last), vehicle, coast, fastest, advances)
    assert (within >= exact - 1e-9).all()
    at_once = overrun.largest_advance((time, time), vehicle, coast, fastest, advances)
    assert at_once == pytest.approx(exact, abs=1e-9), "no slack for a moment"


def stopping(plan, model, time, rate, elapsed):
    """Mission seconds that pass in ``elapsed`` seconds of the clock's real law, in ticks of 20 ms.

    The clock of the flight: it runs until the silence is detected, and then stops urgently.
    """
    limits = clock_limits(plan.motion, plan.mission.vehicles.braking_acceleration)
    clock = MissionClock(limits, time, rate, target=rate)
    for tick in range(round(elapsed / 0.02)):
        if tick * 0.02 >= model.silence:
            clock.target, clock.urgent = 0.0, True
        clock.advance(0.02, -1e9, 1e9)
    return clock.time - time


def after_loss(plan, model, vehicle, time, rate, elapsed):
    """Positions (n, 3) ``elapsed`` seconds after a loss, and the largest distance from the plan.

    Integrates the flight's clock and velocities, without code of the certificate.
    """
    end = next(phase.end for phase in plan.phases if phase.name == "fold")
    advance = stopping(plan, model, time, rate, elapsed)
    reached = plan.motion.at(min(time + advance, end))[0].copy()
    position, velocity, _ = plan.motion.at(time)
    timeout = np.broadcast_to(model.timeout, len(position))
    returns = np.broadcast_to(model.returns, len(position))
    phase = next(phase for phase in plan.phases if phase.name == "fold")
    moments = np.linspace(phase.start, phase.end, 2000)
    fastest = np.linalg.norm(plan.motion.at(moments)[1], axis=2).max()
    turning, stopping_time = 0.45 + 0.15 * fastest, 0.35 + 0.12 * fastest
    for k in range(len(position)) if vehicle == 0 else [vehicle - 1]:
        braking = turning if returns[k] else stopping_time
        slowing = min(max(elapsed - timeout[k], 0.0), 2.0 * braking)
        seconds = min(elapsed, timeout[k]) + slowing - slowing**2 / (4.0 * braking)
        if returns[k]:
            back = max(elapsed - timeout[k] - 2.0 * braking, 0.0)
            seconds -= braking * (1.0 - np.exp(-2.0 * back))
        reached[k] = position[k] + rate * seconds * velocity[k]
    planned = plan.motion.at(min(time + (rate * elapsed if vehicle == 0 else advance), end))[0]
    return reached, np.linalg.norm(reached - planned, axis=1).max()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("timeout", "returns", "descent", "losses"),
    [
        ((0.5,), (False,), (0.0,), 250),
        ((0.5, 0.2, 0.1) * 3, (False,), (0.42, 0.0, 0.3) * 3, 250),
        ((0.5,), (True,), (0.0,), 250),
        pytest.param((0.5,), (False,), (0.0,), 3000, marks=pytest.mark.full),
        pytest.param(
            (0.5, 0.2, 0.1) * 3, (False, True, False) * 3, (0.0,), 3000, marks=pytest.mark.full
        ),
        pytest.param((0.1,), (False,), (0.0,), 3000, marks=pytest.mark.full),
        pytest.param((0.5,), (True, False, False) * 3, (0.0,), 3000, marks=pytest.mark.full),
        pytest.param((0.5,), (False,), (0.42,), 3000, marks=pytest.mark.full),
    ],
)
def test_random_losses_keep_every_certified_margin(
    overhand, overhand_assessed, timeout, returns, descent, losses
):
    """Random losses at random times and rates, also between the certificate's samples.

    A vehicle that lands alone may be anywhere in its descent.
    """
    model, found = StreamLossModel(timeout, 1.0, descent, returns), overhand_assessed.stream_loss
    if found.model != model:
        found = certify_stream_loss(overhand, model)
    monitor, rng = Monitor(overhand), np.random.default_rng(7)
    ball = overhand.mission.vehicles.tracking
    states = []
    for _ in range(losses):
        time = rng.uniform(found.times[0], found.times[-1])
        before = found.times[np.searchsorted(found.times, time, side="right") - 1]
        after = found.times[min(np.searchsorted(found.times, time), len(found.times) - 1)]
        if before in found.infeasible or after in found.infeasible:
            continue
        rate = found.rate_limit(time) * rng.choice([1.0, rng.uniform(0.0, 1.0)])
        vehicle = int(rng.integers(overhand.vehicles + 1))
        reached, off = after_loss(overhand, model, vehicle, time, rate, rng.uniform(0.0, 6.0))
        if vehicle:
            sunk = rng.uniform() * np.broadcast_to(descent, overhand.vehicles)[vehicle - 1]
            reached[vehicle - 1, 2] -= sunk
            off = max(off, sunk)
        if off > ball:
            states.append(reached)
    assert len(states) > 50
    clearances = monitor.clearances(np.array(states), "aloft")
    assert min(one.margin for one in clearances) > -0.01


def test_a_rewind_has_limits_of_its_own():
    """On the way to the line a vehicle may fly on beyond it; on the way back a chord gets too long."""
    aside = line(0.0)
    aside[1][1] = 1.0
    motion = moving([0.0, 1.0], [aside, line(0.0)])
    plan = plan_of(motion, [LENGTH, LENGTH], reversible=True)
    found = certify_stream_loss(plan)
    assert (found.rates == 1.0).all()
    assert found.rate_limit(0.5, backwards=True) < 1.0
    turned = certify_stream_loss(plan_of(reverse(motion), [LENGTH, LENGTH]))
    assert found.rewind_rates == pytest.approx(turned.rates[::-1])
    for time in np.linspace(0.0, 1.0, 21):
        limit = found.rate_limit(time, backwards=True)
        reached, velocity, _ = plan.motion.at(time)
        reached[1] -= 0.8 * limit * velocity[1]
        assert np.linalg.norm(np.diff(reached, axis=0), axis=1).max() <= 0.985 * LENGTH


def test_a_loss_between_two_samples_counts():
    """A vehicle that is fast for a moment only, a quarter of a second after the last sample."""
    places = [line(0.0), line(0.0), line(0.0)]
    places[1][1][1] = 0.55
    plan = plan_of(moving([0.0, 0.5, 1.0], places), [LENGTH, LENGTH])
    found = certify_stream_loss(plan)
    limit = found.rate_limit(0.25)
    _, off = after_loss(plan, found.model, 2, 0.25, limit, 2.0)
    reached, _ = after_loss(plan, found.model, 2, 0.25, limit, 1.1)
    assert off > 0.1
    assert np.linalg.norm(np.diff(reached, axis=0), axis=1).max() <= 0.985 * LENGTH
    assert limit < 1.0
