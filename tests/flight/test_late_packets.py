"""Flights on links whose packets come late, or come again: they end as on a perfect one."""

import numpy as np
import pytest

from swarm.mission.fleet import emulated_fleet
from tests.network import Network, small_plan

PLAN = small_plan()
KINDS = pytest.mark.parametrize("kind", ["px4", "ardupilot"])


def flown(kind, **link):
    """The flight, and the largest tracking error of its fold in metres."""
    flight = Network(PLAN, emulated_fleet(3, (kind,)), no_cable=True, **link)
    outcome = flight.run()
    assert outcome is not None
    trace = flight.conductor.trace()
    fold = np.array(trace.phase) == "fold"
    error = np.linalg.norm(trace.position - trace.setpoint, axis=2)[fold]
    return outcome, flight, float(error.max())


@KINDS
@pytest.mark.parametrize("lateness", [0.3, 3.2, 25.0])
def test_copies_that_come_late_change_no_flight(kind, lateness):
    outcome, flight, _ = flown(kind, copied=0.02, lateness=lateness)
    assert (outcome.word, flight.words("rebooted"), flight.words("failure")) == ("done", [], [])


@KINDS
def test_delays_do_not_enlarge_the_tracking_error(kind):
    _, _, alone = flown(kind)
    outcome, _, delayed = flown(kind, late=0.15, lateness=0.12)
    assert outcome.word == "done"
    assert delayed < 1.25 * alone + 0.01


@KINDS
def test_a_burst_from_an_hour_ago_is_no_reboot(kind):
    """A buffer is emptied whose packets are from the vehicle's first seconds, on the ground."""
    flight = Network(PLAN, emulated_fleet(3, (kind,)), no_cable=True)
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
