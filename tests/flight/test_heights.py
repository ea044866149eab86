"""Heights are compared on the levelled line, before the fold: altitude is what decides the knot."""

import re

import numpy as np
import pytest

from swarm.mavlink import vehicle as vehicle_module
from swarm.mission.fleet import emulated_fleet
from tests.network import Network, small_plan

PLAN = small_plan(vehicles=4)


def flown_to_the_line(**options) -> Network:
    flight = Network(PLAN, emulated_fleet(4, ("px4", "ardupilot")), no_cable=True, **options)
    flight.until_phase("takeoff", 1.0)
    return flight


@pytest.mark.slow
def test_heights_that_agree_are_reported_and_the_fold_begins():
    flight = flown_to_the_line()
    flight.until_phase("fold", 0.5)
    (words,) = flight.words("heights")
    reported, against = map(float, re.findall(r"([\d.]+) m", words))
    assert reported < 0.1
    assert against < 0.1


def test_a_vehicle_whose_height_has_drifted_holds_the_team_until_the_operator_says():
    flight = flown_to_the_line()
    vehicle = flight.conductor.flyers[2]
    drifted = vehicle.receive

    def receive(packet, now, *rest):
        before = vehicle.height_difference
        drifted(packet, now, *rest)
        vehicle.height_difference += 0.5 if vehicle.height_difference != before else 0.0

    vehicle.receive = receive
    flight.run(lambda: flight.conductor.holding is not None)
    assert flight.conductor.phase.name == "fold"
    assert flight.conductor.clock.time == PLAN.plan.phase("fold").start
    assert (
        "heights disagree with GPS before the fold: vehicle 3 by +0.5" in flight.conductor.holding
    )
    flight.until_time(5.0)
    assert flight.conductor.clock.time == PLAN.plan.phase("fold").start
    flight.conductor.request("resume")
    flight.until_phase("fold", 0.5)


def test_without_satellites_only_reports_are_compared(monkeypatch):
    flight = flown_to_the_line()
    for vehicle in flight.conductor.flyers:
        vehicle.height_difference = np.nan
    without_gps = {k: v for k, v in vehicle_module.HANDLERS.items() if k != 24}
    monkeypatch.setattr(vehicle_module, "HANDLERS", without_gps)
    flight.until_phase("fold", 0.5)
    (words,) = flight.words("heights")
    assert words.endswith("no GPS heights to compare")
