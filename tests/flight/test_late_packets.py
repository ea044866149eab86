"""Flights on links whose packets come late, or come again: they end as on a perfect one."""

import numpy as np
import pytest

from swarm.mission.fleet import emulated_fleet
from tests.network import Network, small_plan

PLAN = small_plan()
FLEET = emulated_fleet(3, ("px4", "ardupilot"))


def flown(**link):
    """The flight, and the largest tracking error of its fold in metres."""
    flight = Network(PLAN, FLEET, no_cable=True, **link)
    outcome = flight.run()
    assert outcome is not None
    trace = flight.conductor.trace()
    fold = np.array(trace.phase) == "fold"
    error = np.linalg.norm(trace.position - trace.setpoint, axis=2)[fold]
    return outcome, flight, float(error.max())


@pytest.mark.parametrize(
    "lateness", [3.2, *(pytest.param(t, marks=pytest.mark.full) for t in (0.3, 25.0, 60.0))]
)
def test_copies_that_come_late_change_no_flight(lateness):
    outcome, flight, _ = flown(copied=0.02, lateness=lateness)
    assert (outcome.word, flight.words("rebooted"), flight.words("failure")) == ("done", [], [])


@pytest.mark.slow
def test_delays_do_not_enlarge_the_tracking_error():
    _, _, alone = flown()
    outcome, _, delayed = flown(late=0.15, lateness=0.12)
    assert outcome.word == "done"
    assert delayed < 1.25 * alone + 0.01


def test_a_burst_from_an_hour_ago_is_no_reboot():
    """A buffer is emptied whose packets are from the vehicle's first seconds, on the ground."""
    flight = Network(PLAN, FLEET, no_cable=True)
    early = []
    flight.downlink = lambda _now, system, data: early.append((system, data)) or True
    flight.until_time(4.0)
    first = list(early)
    flight.downlink = lambda *_: True
    flight.until_phase("fold", 1.0)
    for system, data in first:
        flight.conductor.receive("loopback", system, data, flight.now)
    outcome = flight.run()
    assert outcome.word == "done", flight.words("failure")
