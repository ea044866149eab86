"""Release and separation of a team whose vehicles are not at their planned positions."""

from types import SimpleNamespace

import numpy as np
import pytest

from swarm.certification.findings import Finding
from swarm.errors import Refused
from swarm.flight import contingency
from swarm.flight.flight_plan import Audit, go
from tests.network import small_plan

PLAN = small_plan(vehicles=3)


def may_release(off, *, streaming=False, dead=(), may_fall=True):
    """Whether all may let go where the second of three vehicles is ``off`` its place."""
    time = PLAN.plan.phase("fold").start + 1.0
    setpoint = PLAN.plan.motion.at(time)[0]
    position = setpoint.copy()
    position[1] += off
    windows = SimpleNamespace(may_fall=lambda _: may_fall)
    active = np.array([True, streaming, True])
    flight = SimpleNamespace(
        setup=SimpleNamespace(plan=PLAN.plan, windows=windows),
        streams=SimpleNamespace(setpoint=setpoint, active=active, fallen=frozenset(dead)),
        observation=SimpleNamespace(position=position),
        clock=SimpleNamespace(time=time),
    )
    return contingency.may_release(flight)


def under_the_strand():
    """From the second vehicle's place to below the middle of the strand from the first to it."""
    place = PLAN.plan.motion.at(PLAN.plan.phase("fold").start + 1.0)[0]
    return 0.5 * (place[0] + place[1]) - place[1] - [0.0, 0.0, 4.0]


def test_no_release_while_cable_would_fall_on_a_vehicle_that_does_not_follow():
    below = under_the_strand()
    assert may_release(np.zeros(3))
    assert may_release(np.array([0.0, 0.0, 0.3]))
    assert not may_release(below)
    # one that follows is where the plan has it but for its tracking, and one that falls is let go of
    assert may_release(below, streaming=True)
    assert may_release(below, dead=[1])
    assert not may_release(np.zeros(3), may_fall=False)


def test_what_is_wrong_with_many_vehicles_is_refused_in_one_line_each():
    wrong = [
        Finding("error", "parameters", f"system {k}: GUID_TIMEOUT is 3, should be 0.5")
        for k in (1, 2, 3)
    ]
    other = Finding("error", "placement", "vehicle 2 stands 1.20 m from its pad")
    fine = Finding("info", "battery", "system 1: 100 %")
    with pytest.raises(Refused) as refused:
        go(PLAN, Audit((1, 2, 3), (*wrong, other, fine)))
    assert str(refused.value).splitlines() == [
        "parameters: systems 1–3: GUID_TIMEOUT is 3, should be 0.5",
        "placement: vehicle 2 stands 1.20 m from its pad",
        "swarm check MISSION --fleet FLEET --fix asks, and sets parameters",
    ]
