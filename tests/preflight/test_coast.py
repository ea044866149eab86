"""What the ends of streams do to a team, against cases that can be worked out by hand."""

import numpy as np

from swarm.preflight.coast import RATES, Coasting, coast
from tests.network import small_plan
from tests.preflight.synthetic import moving, plan_of

LENGTH = 3.6


def line(x, gap=3.0, vehicles=3):
    return [[x + gap * k, 0.0, 5.0] for k in range(vehicles)]


def sideways(speed, gap=3.0, time=4.0):
    """A team in a line that moves across the line, all alike."""
    places = [[[gap * k, speed * t, 5.0] for k in range(3)] for t in (0.0, time)]
    return plan_of(moving([0.0, time], places), [LENGTH, LENGTH])


def test_a_team_that_loses_its_streams_as_one_stays_as_it_is():
    found = coast(sideways(0.05))
    assert (found.rates == 1.0).all()
    assert found.cap(1.0) == 1.0
    assert not len(found.hopeless)
    assert "clearances and chords survive" in found.findings()[0].message


def test_one_that_stops_while_the_others_go_on_bounds_the_rate():
    """Beside neighbours 3 m away on 3.6 m of cable, 1.9 m of lead is all that a chord bears."""
    fast = coast(sideways(1.2))
    assert fast.rates.min() < 1.0
    assert fast.worst.who in {1, 2, 3}
    slow = coast(sideways(0.3))
    assert slow.rates.min() > fast.rates.min()


def test_a_chord_bears_exactly_the_lead_that_geometry_says():
    plan = sideways(1.0, time=8.0)
    one = Coasting(px4=0.5, ardupilot=0.5, silence=1.0)
    found = coast(plan, one)
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
    short = coast(plan, Coasting(0.5, 0.5, 1.0))
    long = coast(plan, Coasting(1.0, 3.0, 1.0))
    assert (long.rates <= short.rates + 1e-9).all()


def test_the_clock_can_reach_every_cap_by_braking_along_the_path():
    plan = sideways(1.2)
    found = coast(plan)
    mission = plan.mission.vehicles
    steepest = mission.braking_acceleration / mission.max_speed
    squares = found.rates**2
    assert np.all(squares[:-1] - squares[1:] <= 2.0 * steepest * np.diff(found.times) + 1e-9)


def test_outside_the_fold_nothing_is_capped():
    plan = small_plan().plan
    found = coast(plan)
    assert found.cap(0.0) == 1.0
    assert found.cap(plan.duration) == 1.0


def test_where_even_the_slowest_clock_is_too_fast_it_is_said():
    taut = coast(plan_of(moving([0.0, 2.0], [line(0.0, 3.59), line(1.0, 3.59)]), [LENGTH, LENGTH]))
    assert len(taut.hopeless) == len(taut.times)
    assert taut.findings()[0].severity == "warning"
    assert taut.worst.margin <= 0.985 * LENGTH - 3.59 + 1e-9
