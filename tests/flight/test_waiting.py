"""What a flight waits for, the time that is left, and why a rewind ends."""

import pytest

from swarm.mission.fleet import emulated_fleet
from tests.network import Network, small_plan

PLAN = small_plan()


def network(*, no_cable: bool = True) -> Network:
    return Network(PLAN, emulated_fleet(PLAN.plan.vehicles), no_cable=no_cable)


def shown(flight):
    return flight.conductor.snapshot(flight.now)


@pytest.mark.slow
def test_every_wait_of_a_flight_is_a_sentence_with_its_gate_and_the_time_left():
    flight = network(no_cable=False)
    waits, left = {}, []

    def watch():
        now = shown(flight)
        waits.setdefault(now.waiting_for)
        if now.waiting_for is not None and "gate" in now.waiting_for:
            left.append(now.time_left)
        return False

    assert flight.run(watch).word == "done"
    assert [words for words in waits if words] == [
        "heartbeats of vehicles 1–3",
        "vehicles 1–3 to be ready",
        "all vehicles to be ready",
        "all vehicles to arm (gate before takeoff)",
        "all vehicles to grip the cable (gate before contract)",
        "all vehicles to come to rest at their setpoints (gate before lift)",
        "all vehicles to come to rest at their setpoints (gate before fold)",
        "all vehicles to come to rest at their setpoints (gate before hold)",
        "all vehicles to release the cable (gate before finish)",
        "all vehicles to land and disarm (gate at the end)",
    ]
    assert all(seconds > 0.0 for seconds in left)


def test_a_hold_has_its_cause_and_the_time_until_the_landing():
    flight = network().in_fold(2.0)
    before = shown(flight)
    assert (before.held, before.time_left, before.waiting_for) == (None, None, None)
    assert before.remaining >= PLAN.plan.duration - before.mission_time
    flight.conductor.request("hold")
    flight.until_time(2.0)
    held = shown(flight)
    assert held.held == "operator command"
    assert held.time_left == pytest.approx(emulated_fleet(3).limits.hold - 2.0, abs=0.2)
    flight.conductor.request("land")
    flight.until_time(0.2)
    landing = shown(flight)
    assert (landing.held, landing.time_left, landing.remaining) == (None, None, None)
    assert landing.waiting_for == "the clock to stop where all can come down"


def test_a_rewind_ends_where_errors_were_large_and_says_so():
    flight = network().in_fold(3.0)
    limit = flight.conductor.state.progress.error_kept_since = flight.conductor.clock.time
    flight.until_time(3.0)
    why = "tracking errors were too large there"
    assert flight.conductor.request("rewind") == (
        f"rewinds along the path by up to {flight.conductor.clock.time - limit:.0f} s, to "
        f"{limit:.1f} s ({why}), then holds"
    )
    flight.run(lambda: flight.conductor.holding is not None, most=30.0)
    assert flight.conductor.holding == f"rewound to {limit:.1f} s: {why}"
    assert flight.conductor.request("rewind") == f"cannot rewind beyond {limit:.1f} s: {why}"
