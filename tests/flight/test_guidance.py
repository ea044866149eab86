"""The mission clock and the setpoints: smooth whatever is asked of them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm.flight.guidance import Guidance, MissionClock, Sampler
from swarm.geometry.motion import concatenate, leg, through_states
from swarm.planning.clock_limits import ORDINARY, ClockLimits, clock_limits

LINE = np.array([[0.0, 0.0, 4.0], [3.0, 0.0, 4.0], [6.0, 0.0, 5.0]])
THERE = LINE + np.array([0.0, 4.0, 1.0])
MOTION = concatenate(leg(LINE, THERE, 1.0, 0.7), leg(THERE, LINE, 1.5, 0.7))
LIMITS = ClockLimits(0.0, np.array([0.5]))


@given(
    st.lists(st.tuples(st.floats(-1, 1), st.integers(1, 60)), min_size=1, max_size=8),
    st.sampled_from([0.01, 0.02, 0.05, 0.1]),
    st.booleans(),
)
@settings(max_examples=100)
def test_the_rate_is_c1_bounded_and_does_not_overshoot(wishes, step, urgent):
    clock = MissionClock(LIMITS, urgent=urgent)
    steepest, follows = (0.5, 32.0) if urgent else (ORDINARY, 8.0)
    low = high = 0.0
    for target, count in wishes:
        low, high = min(low, target), max(high, target)
        for _ in range(count):
            clock.target = target
            rate, slope = clock.rate, clock.slope
            clock.advance(step, -1e9, 1e9)
            assert abs(clock.slope) <= steepest + 1e-9
            assert abs(clock.slope - slope) <= min(1.0, follows * step) * 2.0 * steepest + 1e-3
            assert abs(clock.rate - rate) <= steepest * step + 2e-3
            assert low - 0.02 <= clock.rate <= high + 0.02


@given(st.floats(0.5, 16.0), st.floats(0.05, 1.0), st.sampled_from([0.02, 0.05]))
@settings(max_examples=60, deadline=None)
def test_an_urgent_stop_keeps_the_reserve_and_ends_where_it_is_stated(start, rate, step):
    """Whatever the tick: no vehicle brakes by more than 1 m/s², none flies on for longer."""
    limits = clock_limits(MOTION, 1.0)
    clock = MissionClock(limits, start, rate, target=0.0, urgent=True)
    times = np.array([start])
    farthest = start + float(limits.advance(times, np.array([rate]), 0.0)[0])
    for _ in range(round(4.0 / step)):
        clock.advance(step, -1e9, 1e9)
        fastest = np.linalg.norm(MOTION.at(clock.time)[1], axis=1).max()
        assert abs(clock.slope) * fastest <= 1.0 + 0.05
    assert clock.stopped
    assert clock.time <= farthest + 0.5 * step


def test_a_stop_leads_farther_where_the_team_is_fast():
    limits = clock_limits(MOTION, 0.5)
    speed = np.linalg.norm(MOTION.at(np.linspace(0.0, 20.0, 400))[1], axis=2).max(axis=1)
    fastest = 0.05 * int(np.argmax(speed))
    slow, fast = limits.advance(np.array([0.1, fastest]), np.ones(2), 0.0)
    assert slow < fast
    assert limits.at(fastest, urgent=True) < limits.at(0.1, urgent=True)
    assert limits.at(fastest, urgent=False) <= ORDINARY


def test_it_comes_to_rest_and_stays():
    clock = MissionClock(LIMITS)
    clock.set_running()
    for _ in range(200):
        clock.target = 0.0
        clock.advance(0.05, -1e9, 1e9)
    assert clock.stopped
    at = clock.time
    clock.advance(1.0, -1e9, 1e9)
    assert clock.time == at


def test_bounds_of_mission_time_stop_it():
    clock = MissionClock(LIMITS, time=9.99)
    clock.set_running()
    clock.advance(0.05, 0.0, 10.0)
    assert (clock.time, clock.stopped) == (10.0, True)


@given(st.floats(-3.0, 20.0))
def test_the_sampler_is_the_motion(time):
    ours = Sampler(MOTION).at(time)
    theirs = MOTION.at(time)
    for one, other in zip(ours, theirs, strict=True):
        assert one == pytest.approx(other, abs=1e-9)


@given(st.floats(0.1, 6.0), st.floats(-1.0, 1.0))
@settings(max_examples=40, deadline=None)
def test_a_rejoining_vehicle_begins_at_its_position_and_ends_in_the_plan(start, off):
    guidance = Guidance(MOTION)
    clock = MissionClock(LIMITS, time=start, rate=0.5, target=0.5)
    here = MOTION.at(start)[0][1] + off
    guidance.join(1, here, start, now=100.0)
    assert guidance.state(clock, 100.0).position[1] == pytest.approx(here)
    step, now, last = 1e-3, 100.0, guidance.state(clock, 100.0)
    for _ in range(200):
        now += step
        clock.time += clock.rate * step
        state = guidance.state(clock, now)
        change = (state.position - last.position) / step
        assert change == pytest.approx(0.5 * (state.velocity + last.velocity), abs=1e-4)
        last = state
    after = guidance.state(clock, 200.0)
    assert after.position == pytest.approx(MOTION.at(clock.time)[0])


def test_backwards_is_forwards_with_other_signs():
    guidance = Guidance(MOTION)
    forth = guidance.state(MissionClock(LIMITS, time=2.0, rate=0.7, slope=0.1), 0.0)
    back = guidance.state(MissionClock(LIMITS, time=2.0, rate=-0.7, slope=-0.1), 0.0)
    assert back.position == pytest.approx(forth.position)
    assert back.velocity == pytest.approx(-forth.velocity)
    curve = MOTION.at(2.0)[2]
    assert forth.acceleration == pytest.approx(0.49 * curve + 0.1 * MOTION.at(2.0)[1])


def test_going_down_together_keeps_levels_until_the_floor():
    guidance = Guidance(MOTION)
    guidance.descend(LINE, 0.5, now=10.0)
    clock = MissionClock(LIMITS)
    last = guidance.state(clock, 10.0)
    assert last.position == pytest.approx(LINE)
    for now in np.arange(10.02, 30.0, 0.02):
        guidance.go_down(float(now), 1.0)
        state = guidance.state(clock, float(now))
        assert state.position[:, :2] == pytest.approx(LINE[:, :2])
        aloft = state.position[:, 2] > 0.0
        levels = LINE[:, 2] - state.position[:, 2]
        if aloft.all():
            assert np.ptp(levels) < 1e-9
        assert np.all(last.position[:, 2] - state.position[:, 2] <= 0.5 * 0.02 + 1e-9)
        last = state
    assert last.position[:, 2] == pytest.approx(0.0)
    assert not last.velocity.any()


def test_a_descent_pauses_and_goes_on_without_a_jump():
    guidance, clock = Guidance(MOTION), MissionClock(LIMITS)
    assert guidance.at_rest
    guidance.descend(LINE + np.array([0.0, 0.0, 10.0]), 0.5, now=0.0)
    last = guidance.state(clock, 0.0)
    for now in np.arange(0.02, 12.0, 0.02):
        guidance.go_down(float(now), 0.0 if 4.0 < now < 8.0 else 1.0)
        state = guidance.state(clock, float(now))
        change = (state.position - last.position) / 0.02
        assert change == pytest.approx(0.5 * (state.velocity + last.velocity), abs=1e-9)
        if not 4.9 < now < 5.1:
            assert guidance.at_rest == (5.0 < now < 8.0)
        assert np.abs(state.velocity - last.velocity).max() <= 0.5 * 0.02 + 1e-9
        last = state
    # 0.5 s of a second's ramp are lost at each of three changes
    assert LINE[:, 2] + 10.0 - last.position[:, 2] == pytest.approx(
        0.5 * (11.98 - 4.0 - 0.5), abs=0.02
    )


def test_a_vehicle_rests_in_a_descent_where_it_hangs_while_another_goes_down():
    guidance, clock = Guidance(MOTION), MissionClock(LIMITS)
    guidance.descend(LINE + np.array([0.0, 0.0, 10.0]), 0.5, now=0.0)
    for now in np.arange(0.02, 4.01, 0.02):
        guidance.go_down(float(now), 1.0)
    before = guidance.state(clock, 4.0).position
    guidance.rest(1, before[1, 2] + 0.4)
    state = guidance.state(clock, 4.0)
    assert state.position - before == pytest.approx(np.outer(np.eye(len(LINE))[1], [0, 0, 0.4]))
    assert not state.velocity[1].any()
    descends = np.eye(len(LINE))[0]
    for now in np.arange(4.02, 8.01, 0.02):
        guidance.go_down(float(now), descends)
    sunk = state.position[:, 2] - guidance.state(clock, 8.0).position[:, 2]
    # Those that stop sink for another half of a second's ramp.
    assert sunk == pytest.approx([2.0, 0.0, *[0.25] * (len(LINE) - 2)], abs=0.01)
    assert guidance.state(clock, 8.0).velocity[:, 2] == pytest.approx(-0.5 * descends)
    guidance.rest(2, 1e3)
    assert guidance.state(clock, 8.0).position[2, 2] == LINE[2, 2] + 10.0


def test_a_detour_runs_in_real_time():
    guidance = Guidance(MOTION)
    way = through_states(
        np.array([0.0, 4.0]), np.stack([LINE, THERE]), np.zeros((2, 3, 3)), np.zeros((2, 3, 3))
    )
    guidance.follow(way, now=50.0)
    assert guidance.duration == 4.0
    assert guidance.state(MissionClock(LIMITS, time=1.0), 52.0).position == pytest.approx(
        0.5 * (LINE + THERE)
    )
