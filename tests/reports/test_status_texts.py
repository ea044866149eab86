"""Vehicles' texts: each once on the screen, all of them in the record."""

import io
import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common
from rich.console import Console

from swarm.flight.conductor import Conductor
from swarm.flight.snapshot import Event
from swarm.ground.record import Record
from swarm.mavlink.packets import Encoder
from swarm.mission.fleet import emulated_fleet
from swarm.reports.terminal import WINDOW, FlightScreen, StatusTexts
from tests.network import small_plan
from tests.reports.synthetic import snapshot_at, trefoil_plan

PLAN = trefoil_plan()
FLIGHT_PLAN = small_plan(vehicles=9)
RECORDED = json.loads(Path(__file__).with_name("recorded_texts.json").read_text())
"""Texts of nine real autopilots each, as they came: time, system, severity, text, id."""


def replayed(rows: list[tuple[float, int, int, str, int]]) -> list[Event]:
    """Send recorded texts to a ground station, at their times; return the events that follow."""
    conductor = Conductor(FLIGHT_PLAN, emulated_fleet(9))
    encoders = {system: Encoder(system, 1) for system in range(1, 10)}
    heartbeat = common.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3)
    for system, encoder in encoders.items():
        conductor.receive("loopback", system, encoder.encode(heartbeat), 0.0)
    now, events = 0.0, []
    for time, system, severity, text, number in rows:
        while now + 0.05 < time:
            now += 0.05
            conductor.tick(now)
        text_message = common.MAVLink_statustext_message(severity, text.encode(), number, 0)
        conductor.receive("loopback", system, encoders[system].encode(text_message), time)
        conductor.tick(time)
        events += conductor.events()
    return events


def shown(events: list[Event], *, terminal: bool = False) -> list[str]:
    """Return the lines of the screen for events, with snapshots ten times a second."""
    console = Console(file=io.StringIO(), width=100, height=30, force_terminal=terminal)
    now = 0.0
    with FlightScreen(PLAN, console) as screen:
        for event in events:
            while now < event.time:
                screen.show(snapshot_at(PLAN, now))
                now += 0.1
            screen.event(event)
    lines = [line.split("\x1b")[0] for line in console.file.getvalue().splitlines()]
    return [line for line in lines if " phase " not in line]


@pytest.mark.parametrize(
    ("recording", "count", "lines"),
    [
        ("arducopter-4.6.2-overhand", 81, ["0:00.2 vehicles 1–9: GCS Failsafe Cleared"]),
        ("arducopter-4.6.2-one-vehicle-ends", 70, []),
        ("px4-1.16.0-takeoff-hold-land", 45, []),
    ],
)
def test_recorded_flights_do_not_flood_the_screen(recording, count, lines, tmp_path):
    """Each text was a line of its own: 81, 70 and 45 lines."""
    events = replayed(RECORDED[recording])
    texts = [event for event in events if event.kind.startswith("text")]
    assert len(texts) == len(RECORDED[recording]) == count
    assert shown(texts) == lines
    record = Record(tmp_path / "record", 0.0)
    for event in events:
        record.event(event)
    record.close()
    kept = list(map(json.loads, (tmp_path / "record" / "events.jsonl").read_text().splitlines()))
    kept = [one for one in kept if one["kind"].startswith("text")]
    assert [(one["vehicle"], one["message"]) for one in kept] == [
        (system, text.strip()) for _, system, _, text, _ in RECORDED[recording]
    ]
    assert [one["time"] for one in kept] == sorted(one["time"] for one in kept)


def test_a_text_is_shown_once_per_vehicle_and_a_later_one_separately():
    events = [
        Event(1.0, "text warning", "Low battery", 2),
        Event(1.5, "text warning", "Low battery", 3),
        Event(1.6, "text", "Disarming motors", 3),
        Event(2.0, "text warning", "Low battery", 2),
        Event(9.0, "text warning", "Low battery", 2),
        Event(9.5, "text warning", "Low battery", 1),
        Event(9.6, "text error", "Crash: Disarming", 1),
    ]
    assert shown(events) == [
        "0:01.0 vehicles 2–3: Low battery",
        "0:09.5 vehicle 1: Low battery",
        "0:09.6 vehicle 1: Crash: Disarming",
    ]


def test_the_error_text_of_a_vehicle_comes_before_the_failure():
    events = [
        Event(1.0, "text error", "GPS Glitch or Compass error", 2),
        Event(1.1, "failure", "left offboard: vehicle 2 left offboard mode by itself", 2),
    ]
    assert shown(events) == [
        "0:01.0 vehicle 2: GPS Glitch or Compass error",
        "0:01.1 left offboard: vehicle 2 left offboard mode by itself",
    ]


@given(
    st.lists(
        st.tuples(
            st.floats(0.0, 20.0), st.sampled_from("abc"), st.integers(1, 4),
            st.sampled_from(["text", "text warning", "text error"]),
        )
    )
)  # fmt: skip
def test_each_warning_of_each_vehicle_is_returned_once_and_in_time(drawn):
    texts, found = StatusTexts(), []
    events = [Event(t, kind, words, vehicle) for t, words, vehicle, kind in sorted(drawn)]
    for event in events:
        for group in texts.due(event.time):
            assert group[0].time <= event.time - WINDOW
            found += group
        texts.add(event)
    found += [event for group in texts.remaining() for event in group]
    expected = {(e.kind, e.message, e.vehicle) for e in events if e.kind != "text"}
    assert len(found) == len(expected)
    assert {(e.kind, e.message, e.vehicle) for e in found} == expected
