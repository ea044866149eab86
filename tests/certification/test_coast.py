"""What the ends of streams do to a team, against cases that can be worked out by hand."""

import numpy as np
import pytest

from swarm.certification.monitor import Monitor
from swarm.certification.stream_loss import BRAKING, RATES, StreamLossModel, certify_stream_loss
from swarm.certification.stream_loss_bound import TOLERANCE
from tests.certification.synthetic import moving, plan_of
from tests.network import small_plan

LENGTH = 3.6


def line(x, gap=3.0, vehicles=3):
    return [[x + gap * k, 0.0, 5.0] for k in range(vehicles)]


def sideways(speed, gap=3.0, time=4.0):
    """A team in a line that moves across the line, all alike."""
    places = [[[gap * k, speed * t, 5.0] for k in range(3)] for t in (0.0, time)]
    return plan_of(moving([0.0, time], places), [LENGTH, LENGTH])


def test_a_team_that_loses_its_streams_as_one_stays_as_it_is():
    found = certify_stream_loss(sideways(0.05))
    assert (found.rates == 1.0).all()
    assert found.cap(1.0) == 1.0
    assert not len(found.infeasible)
    assert "clearances and chords are kept" in found.findings()[0].message


def test_one_that_stops_while_the_others_go_on_bounds_the_rate():
    """Beside neighbours 3 m away on 3.6 m of cable, 1.9 m of lead is all that a chord bears."""
    fast = certify_stream_loss(sideways(1.2))
    assert fast.rates.min() < 1.0
    assert fast.worst.vehicle in {1, 2, 3}
    slow = certify_stream_loss(sideways(0.3))
    assert slow.rates.min() > fast.rates.min()


def test_a_chord_bears_exactly_the_lead_that_geometry_says():
    plan = sideways(1.0, time=8.0)
    one = StreamLossModel((0.5,), silence=1.0)
    found = certify_stream_loss(plan, one)
    middle = int(np.argmin(np.abs(found.times - 4.0)))
    speed = np.linalg.norm(plan.motion.at(4.0)[1][0])
    rate = found.rates[middle]
    mission = plan.mission.vehicles
    steepest = mission.braking_acceleration / mission.max_speed

    def lead(r):
        later = plan.motion.at(4.0 + r * one.silence + 0.5 * r**2 / steepest)[0][0, 1]
        return later - plan.motion.at(4.0)[0][0, 1] - 0.8 * r * speed

    bears = np.sqrt((0.985 * LENGTH) ** 2 - 9.0)
    assert lead(rate) <= bears + 1e-6
    if rate < 1.0:
        faster = RATES[RATES.index(rate) - 1]
        assert lead(faster) > bears - 0.3


def test_a_longer_timeout_never_allows_a_faster_clock():
    plan = small_plan().plan
    short = certify_stream_loss(plan, StreamLossModel((0.5,), 1.0))
    long = certify_stream_loss(plan, StreamLossModel((1.0, 3.0, 1.0), 1.0))
    assert (long.rates <= short.rates + 1e-9).all()


def test_the_clock_can_reach_every_cap_by_braking_along_the_path():
    plan = sideways(1.2)
    found = certify_stream_loss(plan)
    mission = plan.mission.vehicles
    steepest = mission.braking_acceleration / mission.max_speed
    squares = found.rates**2
    assert np.all(squares[:-1] - squares[1:] <= 2.0 * steepest * np.diff(found.times) + 1e-9)


def test_outside_the_fold_nothing_is_capped():
    plan = small_plan().plan
    found = certify_stream_loss(plan)
    assert found.cap(0.0) == 1.0
    assert found.cap(plan.duration) == 1.0


def test_where_even_the_slowest_clock_is_too_fast_it_is_said():
    taut = certify_stream_loss(
        plan_of(moving([0.0, 2.0], [line(0.0, 3.59), line(1.0, 3.59)]), [LENGTH, LENGTH])
    )
    assert len(taut.infeasible) == len(taut.times)
    assert taut.findings()[0].severity == "warning"
    assert taut.worst.margin <= 0.985 * LENGTH - 3.59 + 1e-9


def after_loss(plan, coasting, who, time, rate, elapsed):
    """Where everybody is, ``elapsed`` seconds after a loss, by following clocks and speeds."""
    vehicles = plan.mission.vehicles
    steepest = vehicles.braking_acceleration / vehicles.max_speed
    end = next(phase.end for phase in plan.phases if phase.name == "fold")
    heard = min(elapsed, coasting.silence)
    braking = min(max(elapsed - coasting.silence, 0.0), rate / steepest)
    gone = rate * (heard + braking) - 0.5 * steepest * braking**2
    places = plan.motion.at(min(time + gone, end))[0].copy()
    position, velocity, _ = plan.motion.at(time)
    after = np.broadcast_to(coasting.after, len(position))
    for k in range(len(position)) if who == 0 else [who - 1]:
        slowing = min(max(elapsed - after[k], 0.0), 2.0 * BRAKING)
        seconds = min(elapsed, after[k]) + slowing - slowing**2 / (4.0 * BRAKING)
        places[k] = position[k] + rate * seconds * velocity[k]
    planned = plan.motion.at(min(time + (rate * elapsed if who == 0 else gone), end))[0]
    return places, np.linalg.norm(places - planned, axis=1).max()


@pytest.mark.parametrize(
    "after",
    [(0.5,), (0.5, 0.2, 0.1) * 3, pytest.param((0.1,), marks=pytest.mark.full)],
)
def test_at_no_time_is_anything_lost_that_is_promised(overhand, overhand_assessed, after):
    """Random losses at random times and rates, between the moments that were looked at too."""
    coasting, found = StreamLossModel(after, 1.0), overhand_assessed.stream_loss
    if found.model != coasting:
        found = certify_stream_loss(overhand, coasting)
    monitor, rng = Monitor(overhand), np.random.default_rng(7)
    ball = overhand.mission.vehicles.tracking
    looked_at = []
    for _ in range(1500):
        time = rng.uniform(found.times[0], found.times[-1])
        begun = found.times[np.searchsorted(found.times, time, side="right") - 1]
        later = found.times[min(np.searchsorted(found.times, time), len(found.times) - 1)]
        if begun in found.infeasible or later in found.infeasible:
            continue
        rate = found.cap(time) * rng.choice([1.0, rng.uniform(0.0, 1.0)])
        who = int(rng.integers(overhand.vehicles + 1))
        places, off = after_loss(overhand, coasting, who, time, rate, rng.uniform(0.0, 4.0))
        if off > ball:
            looked_at.append(places)
    assert len(looked_at) > 50
    seen = monitor.clearances(np.array(looked_at), "aloft")
    assert min(one.margin for one in seen) >= -TOLERANCE - 1e-3


def test_a_loss_between_the_moments_that_are_looked_at_counts():
    """A vehicle that is fast for a moment only, a quarter of a second after the last look."""
    places = [line(0.0), line(0.0), line(0.0)]
    places[1][1][1] = 0.55
    plan = plan_of(moving([0.0, 0.5, 1.0], places), [LENGTH, LENGTH])
    found = certify_stream_loss(plan)
    _, off = after_loss(plan, found.model, 2, 0.25, found.cap(0.25), 2.0)
    lost, _ = after_loss(plan, found.model, 2, 0.25, found.cap(0.25), 1.1)
    assert off > 0.1
    assert np.linalg.norm(np.diff(lost, axis=0), axis=1).max() <= 0.985 * LENGTH + TOLERANCE
    assert found.cap(0.25) < 1.0
