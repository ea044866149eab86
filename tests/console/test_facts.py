"""What the console shows of a team, from the snapshots that the terminal shows too."""

import json
from dataclasses import replace

import numpy as np
import pytest

from swarm.certification.findings import Finding
from swarm.certification.monitor import Clearances
from swarm.console.facts import (
    Rates,
    checked_facts,
    event_facts,
    fleet_facts,
    plan_facts,
    state_facts,
)
from swarm.flight.snapshot import Checked, Event
from swarm.flight.stages import CheckStep
from swarm.mission.fleet import emulated_fleet
from tests.console.flight import snapshot
from tests.network import Network, small_plan

PLAN = small_plan().plan


def facts(**changed):
    shown = snapshot(10.0, **changed)
    found = state_facts(PLAN, shown, Rates.first(shown))
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    return found


def test_a_team_that_follows_is_good():
    found = facts()
    assert [(row["number"], row["level"], row["why"]) for row in found["rows"]] == [
        (1, "good", ""), (2, "good", ""), (3, "good", ""),
    ]  # fmt: skip
    assert found["wait"] is None
    assert found["windows"] == [
        {"words": "land now", "level": "good"}, {"words": "release in 4 s", "level": "idle"},
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("changed", "level", "why"),
    [
        ({"link_age": [0.05, 1.5, 0.05]}, "warn", "no packet for 1.5 s"),
        ({"link_age": [0.05, 4.0, 0.05]}, "bad", "no packet for 4.0 s"),
        ({"link_age": [0.05, np.inf, 0.05]}, "bad", "never received"),
        ({"battery": [0.9, 0.25, 0.9]}, "warn", "battery 25%"),
        ({"battery": [0.9, 0.1, 0.9]}, "bad", "battery 10%"),
        ({"problems": ("", "gets no setpoints", "")}, "bad", "gets no setpoints"),
        (
            {"problems": ("", "no attitude", ""), "phase": "prepare", "armed": (False,) * 3},
            "warn",
            "no attitude",
        ),
    ],
)
def test_what_is_wrong_is_said_in_words(changed, level, why):
    arrays = {k: np.array(v) if isinstance(v, list) else v for k, v in changed.items()}
    row = facts(**arrays)["rows"][1]
    assert (row["level"], row["why"]) == (level, why)


@pytest.mark.parametrize(("off", "level"), [(0.07, "warn"), (0.2, "bad")])
def test_a_tracking_error_stands_beside_what_is_certified(off, level):
    setpoint = snapshot(0.0).position.copy()
    setpoint[2, 0] += off
    row = facts(setpoint=setpoint)["rows"][2]
    assert (row["level"], row["why"]) == (
        level, f"{off:.2f} m from its setpoint, 0.10 m allowed",
    )  # fmt: skip
    assert (row["error"], row["allowed"]) == (pytest.approx(off), 0.1)


def test_the_closest_pair_of_each_kind_stands_beside_its_limit():
    close = snapshot(0.0).position.copy()
    close[1] = close[0] + [0.9, 0.0, 0.0]
    seen = Clearances(np.inf, 0.9, 0.8, -0.1, "vehicle clearance")
    margins = facts(position=close, clearances=seen)["margins"]
    assert margins[0] == {
        "between": "vehicles 1 and 2", "distance": "0.90 m", "limit": "at least 1.00 m",
        "level": "bad",
    }  # fmt: skip
    assert [one["between"] for one in margins[1:]] == [
        "vehicle 1 and segment 2", "smallest margin (vehicle clearance)", "tautest segment",
    ]  # fmt: skip


def test_unknown_positions_are_left_out():
    unknown = np.full((3, 3), np.nan)
    found = facts(position=unknown, setpoint=unknown, gripped=(False,) * 3, fix=np.zeros(0))
    assert found["margins"] == []
    assert found["rows"][0]["height"] is None
    assert found["rows"][0]["place"] == [None, None, None]
    assert found["rows"][0]["fix"] == "position 0.1 s old"


def test_what_the_clock_waits_for_names_who_is_missing():
    found = facts(waiting_for="all vehicles to arm", missing=(2,), time_left=4.0)
    assert found["wait"] == {
        "words": "waiting for all vehicles to arm", "missing": [2], "left": 4.0, "then": "left",
    }  # fmt: skip
    held = facts(held="wind", time_left=3.0)["wait"]
    assert (held["words"], held["then"]) == ("hold: wind", "then all land together")


def test_go_and_refuse_are_shown_on_the_ground_only():
    assert not {"go", "refuse"} & facts()["commands"].keys()
    assert {"go", "refuse"} <= facts(phase="ready")["commands"].keys()


def test_findings_are_listed_errors_first_and_those_of_several_vehicles_once():
    found = checked_facts(
        Checked(
            (
                Finding("info", "health", "system 1: healthy"),
                Finding("warning", "battery", "system 2: 40 %"),
                Finding("info", "health", "system 2: healthy"),
                Finding("error", "ready", "system 1: no attitude"),
            )
        )
    )
    assert found["phases"] == []
    assert found["rows"] == [
        {"level": "bad", "check": "ready", "words": "system 1: no attitude"},
        {"level": "warn", "check": "battery", "words": "system 2: 40 %"},
        {"level": "idle", "check": "health", "words": "systems 1–2: healthy"},
    ]


def test_a_check_without_a_plan_has_rows_by_system_and_says_which_vehicle_to_move():
    fleet = emulated_fleet(3)
    named = fleet_facts(fleet)
    assert (named["name"], named["paths"], named["duration"]) == (fleet.name, None, None)
    shown = snapshot(
        10.0, phase=CheckStep.BODIES, numbers=(4, 5, 6), missing=(5,), armed=(False,) * 3,
        states=("moves its body", "move this one now", "leave it on the ground"),
        waiting_for="vehicle 5: turn it", problems=("not healthy", "", ""),
        position=np.full((3, 3), np.nan), setpoint=np.full((3, 3), np.nan),
        available={"go": (False, "nothing is asked now"), "interrupt": (True, "ends the check")},
    )  # fmt: skip
    found = state_facts(None, shown, Rates.first(shown))
    json.dumps(found, allow_nan=False)
    assert [(row["number"], row["level"]) for row in found["rows"]] == [
        (4, "idle"), (5, "warn"), (6, "idle"),
    ]  # fmt: skip
    assert found["wait"]["words"] == "vehicle 5: turn it"
    assert list(found["commands"]) == ["go", "interrupt"]
    assert (found["ground"], found["margins"], found["strands"]) == (True, [], [])


def test_rates_count_packets_over_two_seconds():
    first = snapshot(10.0)
    rates = Rates.first(first)
    assert rates.counted(snapshot(11.0)) is rates
    assert rates.counted(snapshot(12.0)).rate == pytest.approx([50.0] * 3)


def test_north_is_where_the_fleet_says():
    fleet = emulated_fleet(3)
    assert plan_facts(PLAN, fleet)["north"] == pytest.approx(np.pi / 2)
    assert (
        plan_facts(PLAN, fleet.model_copy(update={"emulated": None, "origin": None}))["north"]
        is None
    )
    json.dumps(plan_facts(PLAN, None), allow_nan=False)


def test_routine_events_are_left_out_as_on_the_terminal():
    assert event_facts(Event(1.0, "mode", "offboard", 2)) is None
    assert event_facts(Event(1.0, "text", "EKF3 active", 2)) is None
    shown = event_facts(Event(1.0, "failure", "silent", 2))
    assert (shown["words"], shown["level"]) == ("vehicle 2: silent", "bad")


@pytest.mark.slow
def test_a_flight_says_who_is_missing_when_all_have_landed_and_which_windows_are_open():
    """In virtual time: preparation, a gate, the fold, a hold."""
    flight = Network(small_plan())
    flight.once()
    seen = flight.conductor.snapshot(flight.now)
    assert seen.missing == (1, 2, 3)
    assert seen.problems[0] == "no heartbeat of a PX4 or ArduPilot"
    assert seen.landing is None
    flight.run(
        lambda: (
            flight.conductor.state.progress.waiting
            and flight.conductor.state.gate.condition == "gripped"
        )
    )
    # Vehicle 2's COMMAND_ACK (77) are lost: its grip is known later than that of the others.
    flight.downlink = lambda _now, system, data: system != 2 or bytes((77, 0, 0)) not in data
    flight.until_time(0.8)
    flight.downlink = lambda *_: True
    seen = flight.conductor.snapshot(flight.now)
    assert (seen.missing, seen.gripped) == ((2,), (True, False, True))
    flight.until_phase("fold", after=1.0)
    seen, at = flight.conductor.snapshot(flight.now), flight.now
    assert (seen.missing, seen.problems) == ((), ("", "", ""))
    assert seen.windows["release"] == 0.0
    assert seen.fix.tolist() == [6.0] * 3
    # a packet that comes between a tick and its snapshot is not older than nothing
    assert (flight.conductor.snapshot(flight.now - 0.5).link_age == 0.0).all()
    flight.conductor.request("hold", "Anna (console 1)")
    assert flight.conductor.snapshot(flight.now).landing is None
    (words,) = [e.message for e in flight.conductor.events() if e.kind == "operator"]
    assert words.startswith("hold by Anna (console 1): all stop along the path")
    flight.conductor.request("resume")
    flight.run()
    assert flight.now - at == pytest.approx(seen.landing, abs=5.0)


def test_a_slower_clock_says_what_for():
    assert facts()["slowed_by"] == ""
    flight = Network(small_plan())
    flight.until_phase("fold", 1.0)
    loss = flight.conductor.state.stream_loss
    flight.conductor.state.stream_loss = replace(loss, rates=np.full(len(loss.times), 0.3))
    flight.run(lambda: flight.conductor.clock.rate < 0.31)
    assert flight.conductor.snapshot(flight.now).slowed_by == "room for lost setpoints"
