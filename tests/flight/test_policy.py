"""The policy, cell by cell: each failure in each stage, under each combination of open windows.

The cells come from the table itself, so a cell without a test is an error of the build: a kind of
failure without a row, a response or an end without a check fails here.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from swarm.certification.contingency_windows import ContingencyWindows
from swarm.flight import contingency
from swarm.flight.contingency import LONGEST_HOVER
from swarm.flight.failures import (
    ENDS,
    End,
    Failure,
    FailureKind,
    HoldCause,
    Response,
    Windows,
    response_rows,
)
from swarm.flight.responding import available, request, respond
from swarm.flight.stages import Stage, Step
from swarm.flight.state import FlightState, Timing
from swarm.simulation.stepped_simulation import branch, lasting
from tests.network import Network, small_plan

PLAN = small_plan(vehicles=5)


class Cell(NamedTuple):
    """One cell of the whole table."""

    failure: FailureKind
    stage: Stage
    windows: Windows
    response: Response
    end: End


def cells(kind: FailureKind) -> Iterator[Cell]:
    """The responses to a failure: stage in flight × open windows."""
    for stage in (Stage.EXECUTE, Stage.CONTINGENCY):
        response = kind.response(stage)
        for windows in Windows:
            yield Cell(kind, stage, windows, response, ENDS[response][windows])


VICTIM, NEIGHBOURS, FAR = 1, {0, 2}, {3, 4}
WORDS = "for the test"
GOLDENS = Path(__file__).parents[1] / "golden" / "failures"


@pytest.fixture(scope="module")
def folding():
    """A team in its fold whose clock is at rest."""
    flight = Network(PLAN).in_fold(3.0)
    flight.conductor.request("hold")
    flight.run(lambda: flight.conductor.clock.stopped, most=10.0)
    flight.conductor.request("resume")
    return flight.conductor


def standing(conductor, windows: Windows, stage: Stage) -> FlightState:
    """A copy of the team in a stage, where the plan opens these windows all the time.

    Outside the plan, it moves along it for some seconds more.
    """
    flight = branch(conductor, lasting(conductor)).state
    time = np.arange(0.0, PLAN.plan.duration, 0.25)
    land = np.full(len(time), windows in {Windows.BOTH, Windows.LAND})
    release = np.full(len(time), windows in {Windows.BOTH, Windows.RELEASE})
    flight.setup = replace(flight.setup, windows=ContingencyWindows(time, land, release, release))
    if stage is Stage.CONTINGENCY:
        contingency.leave_the_plan(flight, Response.LAND_HERE, WORDS)
        later = flight.clock.time + 3.0
        flight.contingency = replace(flight.contingency, target=later)
    flight.recorder.take_events()
    return flight


def come_to_rest(flight: FlightState) -> None:
    """Let a contingency bring the clock to rest, and begin what it does there.

    All vehicles are received, and hover: one without setpoints is waited for, T and some seconds.
    """
    longest = flight.now + flight.setup.fleet.limits.hold + LONGEST_HOVER + 5.0
    while flight.now < longest:
        if flight.contingency is None or flight.contingency.step is not Step.APPROACH:
            return
        now = flight.now + 0.05
        for vehicle in flight.roster.vehicles:
            vehicle.received_at = now
        flight.timing = Timing(now, flight.now, flight.timing.moving + 0.05)
        contingency.tick(flight)
    raise AssertionError("the clock does not come to rest")


def opened(flight: FlightState) -> set[int]:
    """The vehicles whose grippers are commanded to open."""
    vehicles = flight.roster.vehicles
    return {k for k, vehicle in enumerate(vehicles) if vehicle.commands.contains("release")}


def goes_on(flight: FlightState, cell: Cell) -> None:
    assert flight.stage is cell.stage
    assert not flight.holds.causes
    assert not opened(flight)
    if flight.contingency is not None:
        assert flight.contingency.response is Response.LAND_HERE
        assert flight.contingency.target is not None
        assert not flight.streams.fallen


def holds(flight: FlightState, cell: Cell) -> None:
    system = flight.roster.systems[VICTIM]
    assert flight.stage is Stage.EXECUTE
    assert flight.holds.causes == {HoldCause(cell.failure, system): WORDS}


def lands(flight: FlightState, cell: Cell) -> None:
    assert flight.contingency.step is Step.DESCEND
    assert flight.guidance.descending
    assert not opened(flight)
    assert flight.contingency.cornered == (cell.windows is Windows.NEITHER)


def releases(flight: FlightState, _cell: Cell) -> None:
    assert flight.contingency.step is Step.RELEASE
    assert opened(flight) == {VICTIM, *NEIGHBOURS, *FAR}


def releases_fallen(flight: FlightState, cell: Cell) -> None:
    releases(flight, cell)
    assert flight.streams.fallen == {VICTIM}
    assert not flight.streams.active[VICTIM]
    (words,) = (e.message for e in flight.recorder.take_events() if e.kind == "release")
    assert words.endswith("vehicles 2, 1, 3, 4, 5")


def releases_beside(flight: FlightState, _cell: Cell) -> None:
    assert flight.contingency.step is Step.RELEASE
    assert opened(flight) == {VICTIM, *NEIGHBOURS}
    assert flight.streams.fallen == {VICTIM}


CHECKS: dict[End, Callable[[FlightState, Cell], None]] = {
    End.GO_ON: goes_on,
    End.HOLD: holds,
    End.LAND: lands,
    End.RELEASE: releases,
    End.RELEASE_FALLEN: releases_fallen,
    End.RELEASE_BESIDE: releases_beside,
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", FailureKind)
def test_the_team_responds_as_every_cell_of_the_table_says(folding, kind):
    for cell in cells(kind):
        flight = standing(folding, cell.windows, cell.stage)
        respond(flight, Failure(kind, WORDS, VICTIM))
        assert (flight.ending.failure == WORDS) == kind.responses.irreversible, cell
        assert bool(flight.streams.active[VICTIM]) == (
            not kind.responses.ends_stream and cell.response is not Response.RELEASE_FALLEN
        ), cell
        if cell.end not in {End.GO_ON, End.HOLD}:
            stopped = flight.clock.time
            come_to_rest(flight)
            assert abs(flight.clock.time - stopped) < 0.1, cell
        CHECKS[cell.end](flight, cell)


def holding(flight: FlightState) -> set[int]:
    """The vehicles that hold the cable, and whose grippers are not commanded to open."""
    vehicles = enumerate(flight.roster.vehicles)
    return {k for k, vehicle in vehicles if vehicle.gripped} - opened(flight)


@pytest.mark.parametrize("kind", FailureKind)
@pytest.mark.parametrize("answered", [True, False])
def test_a_second_report_makes_no_response_to_a_fall_less_safe(folding, kind, answered):
    """In every step, and at a vehicle beside the first one or farther away."""
    for windows in Windows:
        flight = standing(folding, windows, Stage.EXECUTE)
        respond(flight, Failure(FailureKind.FALLING, WORDS, VICTIM))
        for k in opened(flight) if answered else ():
            flight.roster.vehicles[k].gripped = False
            flight.roster.vehicles[k].commands.clear()
        for step in (Step.RELEASE, Step.SEPARATE, Step.DESCEND):
            for second in (2, 3):
                later = branch(flight, (flight.setup, *lasting(folding)))
                later.contingency = replace(later.contingency, step=step)
                before = holding(later)
                respond(later, Failure(kind, WORDS, second))
                case = windows, step, second
                assert holding(later) <= before, case
                assert later.contingency.step in {step, Step.RELEASE}, case
                assert later.contingency.target is None, case
                assert VICTIM in later.streams.fallen, case
                assert later.ending.failure == WORDS
                if kind.loses_a_vehicle:
                    near = {second - 1, second, min(second + 1, 4)}
                    assert not holding(later) & near, case
                    open_ = windows in {Windows.BOTH, Windows.RELEASE}
                    assert not (open_ and holding(later)), case


def test_a_team_on_its_way_to_a_release_that_must_stop_drops_no_cable_on_a_rotor(folding):
    for windows in Windows:
        flight = standing(folding, windows, Stage.EXECUTE)
        contingency.leave_the_plan(flight, Response.RELEASE, WORDS)
        flight.contingency = replace(flight.contingency, target=flight.clock.time + 3.0)
        respond(flight, Failure(FailureKind.BATTERY_CRITICAL, WORDS, VICTIM))
        come_to_rest(flight)
        open_ = windows in {Windows.BOTH, Windows.RELEASE}
        assert flight.contingency.step is (Step.RELEASE if open_ else Step.DESCEND)
        assert bool(opened(flight)) == open_


def beside_an_obstacle(conductor) -> FlightState:
    """A team where cable falls on no rotor, but an obstacle is below at every moment."""
    flight = standing(conductor, Windows.NEITHER, Stage.EXECUTE)
    windows = flight.setup.windows
    windows = replace(windows, falls=np.ones_like(windows.falls))
    flight.setup = replace(flight.setup, windows=windows)
    return flight


@pytest.mark.parametrize(
    "kind", [FailureKind.FALLING, FailureKind.POSITION_LOST, FailureKind.BATTERY_CRITICAL]
)
def test_an_obstacle_below_keeps_no_cable_on_a_team_that_cannot_land(folding, kind):
    flight = beside_an_obstacle(folding)
    respond(flight, Failure(kind, WORDS, VICTIM))
    come_to_rest(flight)
    releases(
        flight, Cell(kind, Stage.EXECUTE, Windows.RELEASE, kind.responses.execute, End.RELEASE)
    )


def test_commands_beside_an_obstacle_say_so_and_release(folding):
    flight = beside_an_obstacle(folding)
    effects = available(flight)
    assert effects["release"].words.startswith("an obstacle is above or below a vehicle: moves to")
    words = "releases the cable here, separates as far as obstacles allow and lands"
    assert effects["abort"].words == words
    request(flight, "abort")
    come_to_rest(flight)
    assert opened(flight) == {VICTIM, *NEIGHBOURS, *FAR}


def test_a_release_moves_to_where_no_obstacle_is_or_else_to_where_cable_falls_on_no_rotor(folding):
    flight = beside_an_obstacle(folding)
    windows, now = flight.setup.windows, flight.clock.time
    falls = windows.time > now + 1.0
    for clear, expected in (
        (falls & (windows.time > now + 2.0), now + 2.0),
        (~falls & falls, now + 1.0),
    ):
        changed = replace(windows, release=clear, falls=falls)
        flight.setup = replace(flight.setup, windows=changed)
        moment = contingency.nearest_open(flight, Response.RELEASE)
        assert expected < moment <= expected + 0.25


def test_the_failure_for_which_the_team_already_holds_is_the_first_cause(folding):
    flight = standing(folding, Windows.BOTH, Stage.EXECUTE)
    respond(flight, Failure(FailureKind.SILENT, "vehicle 3 is silent", 2))
    respond(flight, Failure(FailureKind.LEFT_OFFBOARD, "vehicle 2 left", VICTIM))
    assert flight.ending.failure == "vehicle 3 is silent; vehicle 2 left"
    flight = standing(folding, Windows.BOTH, Stage.EXECUTE)
    respond(flight, Failure(FailureKind.SILENT, "vehicle 2 is silent", VICTIM))
    respond(flight, Failure(FailureKind.LOST, "vehicle 2 is lost", VICTIM))
    assert flight.ending.failure == "vehicle 2 is lost"


def test_the_table_is_complete():
    assert set(ENDS) == set(Response)
    assert all(set(ends) == set(Windows) for ends in ENDS.values())
    assert set(CHECKS) == set(End)
    assert len(response_rows()) == 1 + 2 * len(FailureKind)


def test_before_the_flight_every_failure_is_only_reported():
    for stage in (Stage.PREPARE, Stage.READY, Stage.RESUME, Stage.FINISHED):
        assert {kind.response(stage) for kind in FailureKind} == {Response.REPORT}


def test_no_response_returns_to_launch_and_a_fall_is_irreversible():
    words = " ".join([*Response, *End])
    assert not re.search(r"return|launch|home", words)
    assert all(kind.responses.irreversible for kind in FailureKind if kind.loses_a_vehicle)


ELSEWHERE = {
    FailureKind.RETURNING: "test_detect.py",
    FailureKind.TRACKING_ERROR: "test_detect.py",
    FailureKind.GATE_TIMEOUT: "test_detect.py",
}
"""Failures that no transcript shows, and the files whose tests detect them."""


@pytest.mark.parametrize("kind", FailureKind)
def test_every_failure_is_detected_in_a_test(kind):
    shown = any(f"failure: {kind}: " in path.read_text() for path in GOLDENS.iterdir())
    if kind not in ELSEWHERE:
        assert shown
    else:
        assert f"FailureKind.{kind.name}" in (Path(__file__).parent / ELSEWHERE[kind]).read_text()
