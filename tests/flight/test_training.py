"""Training flights: the faults of a scenario, their detection, and the operator's reactions."""

import hashlib
import json
from dataclasses import replace

import pytest

from swarm.errors import InputError, Refused
from swarm.flight.requests import ABSENCE
from swarm.flight.snapshot import Event
from swarm.flight.training import (
    InjectedFault,
    Training,
    reactions,
    require_emulated,
    training_object,
)
from swarm.mission.fleet import emulated_fleet
from swarm.reports.flight import training_table
from swarm.simulation.loop import Callbacks, simulate_flight
from swarm.simulation.training import read_training
from tests.network import small_plan

SCENARIO = """\
schema: 1
faults:
  - {at: 25.0, kind: link, vehicle: 2, loss: 1.0, duration: 0.9}
  - {at: 35.0, kind: leave_offboard, vehicle: 3}
  - {at: 900.0, kind: motor_loss, vehicle: [1, 3]}
"""


def scenario(tmp_path, text=SCENARIO):
    path = tmp_path / "faults.yaml"
    path.write_text(text)
    return path


def flown(tmp_path, commands):
    """Fly the scenario in virtual time; an operator gives commands at their times."""
    read = read_training(scenario(tmp_path))
    waiting = sorted(commands)

    def on_step(conductor, _emulator, now):
        while waiting and waiting[0][0] <= now:
            conductor.request(waiting.pop(0)[1], "terminal")

    result = simulate_flight(small_plan(), faults=read.faults, callbacks=Callbacks(on_step=on_step))
    return replace(result, training=read.training(emulated_fleet(3).systems))


def test_the_team_and_the_operator_react_to_faults_in_virtual_time(tmp_path):
    result = flown(tmp_path, [(37.0, "hold"), (40.0, "land")])
    link, left, motor = reactions(result.training, result.events)
    assert 0.7 <= link.detected.time - 25.0 <= 1.2
    assert link.detected.message.startswith("silent: vehicle 2")
    assert link.team[0].message.startswith("holding: vehicle 2")
    assert (link.request, link.reaction_time) == (None, None)
    assert left.detected.message.startswith("left offboard: vehicle 3")
    assert left.team[0].message.startswith("holding: vehicle 3")
    assert not any("operator command" in event.message for event in left.team)
    assert left.request.message.startswith("hold by terminal: already holding")
    assert left.reaction_time == pytest.approx(37.0 - left.detected.time, abs=0.06)
    assert not motor.began
    assert (motor.detected, motor.team, motor.request) == (None, (), None)
    rows = training_table(training_object(result.training, result.events)).rows
    assert [row[0] for row in rows] == [
        "vehicle 2: link (loss 1, for 0.9 s)",
        "vehicle 3: leave offboard",
        "vehicles 1, 3: motor loss",
    ]
    assert rows[1][4][0].startswith("hold, 1.9 s after detection")
    assert rows[2][1:] == ("not begun", "", "", "")


@pytest.mark.slow
def test_json_has_digest_faults_and_reaction_times(tmp_path):
    result = flown(tmp_path, [(26.0, "hold")])
    document = json.loads(json.dumps(training_object(result.training, result.events)))
    assert document["scenario"] == "faults.yaml"
    assert document["digest"] == hashlib.sha256(SCENARIO.encode()).hexdigest()
    link = document["faults"][0]
    assert (link["kind"], link["vehicles"], link["time"], link["began"]) == ("link", [2], 25, True)
    operator = link["operator"]
    assert (operator["request"], operator["author"]) == ("hold", "terminal")
    assert operator["after"] == pytest.approx(1.0, abs=0.06)
    assert operator["since"] == "detection"
    assert operator["reaction_time"] == pytest.approx(1.0 - link["detected"]["after"], abs=0.06)
    assert training_object(None, result.events) is None


def fault(time, *vehicles, kind="link"):
    return InjectedFault(time, kind, "", vehicles, None)


def training(*faults):
    return Training("faults.yaml", "0" * 64, faults, {})


def test_a_request_counts_for_the_last_fault_before_it_and_a_failure_for_its_vehicle():
    events = [
        Event(10.5, "failure", "silent: vehicle 1", 1),
        Event(12.4, "failure", "silent: vehicle 2", 2),
        Event(12.4, "hold", "holding: vehicle 2"),
        Event(13.0, "failure", "silent: vehicle 1, again", 1),
        Event(14.0, "operator", "land by Ann at a browser: all descend"),
        Event(14.0, "contingency", "landing together: operator command: land"),
        Event(30.0, "outcome", "interrupted"),
    ]
    first, second = reactions(training(fault(12.0, 2), fault(10.0, 1)), events)
    assert first.fault.time == 10.0
    assert first.detected.time == 10.5
    assert (first.team, first.request) == ((), None)
    assert second.detected.time == 12.4
    assert [event.time for event in second.team] == [12.4]
    assert second.reaction_time == pytest.approx(1.6)


def test_a_fault_that_is_seen_before_it_is_detected_counts_from_its_beginning():
    events = [
        Event(11.0, "operator", "hold by terminal: all stop along the path"),
        Event(11.0, "hold", "holding: operator command"),
        Event(13.0, "failure", "height drift: vehicle 1", 1),
    ]
    (seen,) = reactions(training(fault(10.0, 1)), events)
    assert (seen.reaction_time, seen.warned, seen.team) == (1.0, False, ())


@pytest.mark.parametrize(
    "message",
    [
        f"hold by {ABSENCE}: all stop along the path",
        "command handed over by Ann: to Ben",
        "kill: cancelled; nothing was stopped",
    ],
)
def test_what_no_operator_asks_for_is_no_reaction(message):
    (after,) = reactions(training(fault(10.0, 1)), [Event(11.0, "operator", message)])
    assert after.request is None


def test_any_failure_is_a_detection_of_a_fault_of_the_world():
    events = [Event(12.0, "failure", "standstill: vehicle 2", 2), Event(20.0, "outcome", "done")]
    (wind,) = reactions(training(fault(10.0, kind="wind")), events)
    assert wind.detected is events[0]


def test_only_emulated_vehicles_are_trained_with():
    require_emulated(None)
    require_emulated(emulated_fleet(3))
    real = emulated_fleet(3).model_copy(update={"emulated": None, "name": "nine"})
    with pytest.raises(Refused, match="the vehicles of fleet nine are not emulated"):
        require_emulated(real)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("schema: 1\nfaults: []\n", "expected at least one fault"),
        ("schema: 1\nspread: {failing: 0.0}\n", "expected at least one fault"),
        ("schema: 1\nfaults: [{at: 1, kind: gusts}]\n", "kind"),
        ("schema: 1\nfaults: [{at: 1, kind: freeze, vehicle: 7}]\n", "vehicles 1, 2, 3, got 7"),
    ],
)
def test_a_scenario_that_cannot_be_flown_is_refused(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        read_training(scenario(tmp_path, text)).training((1, 2, 3))


def test_the_spread_of_a_scenario_is_known_to_be_left_out(tmp_path):
    assert not read_training(scenario(tmp_path)).spreads
    assert read_training(scenario(tmp_path, SCENARIO + "spread: {failing: 0.0}\n")).spreads
