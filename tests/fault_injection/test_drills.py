"""What the team does when something goes wrong, row by row, judged by ground truth.

In the default run a small team flies a slice of the table; ``-m full`` flies every row at twenty
random times with every personality, tying a knot.
"""

import ast
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from swarm import planner
from swarm.certification.stream_loss import StreamLossCertificate, StreamLossModel, WorstLoss
from swarm.flight.modes.contingency import leave_the_plan, release_fallen
from swarm.flight.policy import LOSES_A_VEHICLE, TABLE, Response
from swarm.mission import mission_for_knot
from swarm.planning import digest
from swarm.simulation.fault_injection import (
    FAILURE_CASES,
    SYSTEM_FAILURE_CASES,
    TEAM_AUTOPILOTS,
    FaultTrial,
    evaluation,
    run_failure_tests,
)
from swarm.simulation.fault_injection.stepped_simulation import (
    SteppedSimulation,
    failure_test_fleet,
)
from swarm.simulation.loop import Fault
from tests.network import small_plan

PLAN = small_plan(vehicles=3)
SLICE = {
    "px4": ("motor lost", "pilot takes over"),
    "ardupilot": ("killed",),
    "mixed": (
        "disarms", "position jumps", "two-way gap of 10 s, one", "gripper sticks shut at release"
    ),
}  # fmt: skip
LARGER_SLICE = {
    "px4": ("position lost", "starved of CPU for 1 s", "killed"),
    "ardupilot": ("motor lost",),
    "mixed": ("reboots", "one ACK lost at the release"),
}
BY_NAME = {row.name: row for row in FAILURE_CASES}


@pytest.mark.parametrize(
    ("personality", "names"),
    [
        *SLICE.items(),
        *(pytest.param(*case, marks=pytest.mark.full) for case in LARGER_SLICE.items()),
    ],
)
def test_the_team_answers_as_the_table_of_drills_asks(personality, names):
    rows = [BY_NAME[name] for name in names]
    drills = run_failure_tests(PLAN, rows=rows, personalities=[personality], times=1, jobs=1)
    failed = [drill.document() for drill in drills if not drill.passed]
    assert not failed


@pytest.fixture(scope="module")
def overhand():
    return planner.plan(mission_for_knot("overhand", ())).certified()


@pytest.mark.full
@pytest.mark.parametrize("row", FAILURE_CASES, ids=lambda row: row.name)
def test_every_failure_of_a_team_that_ties_a_knot(overhand, row):
    drills = run_failure_tests(overhand, rows=[row], times=20, jobs=1, seed=3)
    assert [drill.personality for drill in drills] == list(TEAM_AUTOPILOTS)
    failed = [drill.document() for drill in drills if not drill.passed]
    assert not failed


def judged(row, flight_plan=PLAN, left=False, **found):
    """What is wrong with a trial of a row that went well but for ``found``; the team has ``left``
    its plan where it can neither land nor let go."""
    fine = FaultTrial(50.0, 3, 1.0, "", np.inf, np.inf, 0.5, 0, 0, BY_NAME[row].ends[0], ())
    conductor = SimpleNamespace(
        state=SimpleNamespace(contingency=SimpleNamespace(cornered=True) if left else None)
    )
    flight = SimpleNamespace(flight_plan=flight_plan, conductor=conductor)
    return evaluation._problems(flight, BY_NAME[row], replace(fine, **found))


def test_what_falls_with_the_fault_is_no_fault_of_the_teams_and_what_follows_is():
    assert judged("gripper slips", strikes=1, falling=1) == ()
    assert judged("gripper slips", strikes=2, falling=1) == ("1 rotor strikes",)
    assert judged("pilot takes over", strikes=1) == ("noticed after 1.00 s, not within 0.5 s",
                                                     "1 rotor strikes")  # fmt: skip


def test_who_cannot_follow_may_cost_a_rotor_only_where_nothing_else_is_left():
    assert judged("leaves offboard", left=True, noticed=0.2, strikes=1) == ()
    assert judged("leaves offboard", left=True, noticed=0.2, strikes=2) == ("2 rotor strikes",)
    assert judged("leaves offboard", noticed=0.2, strikes=1) == ("1 rotor strikes",)
    assert judged("battery low", left=True, noticed=0.2, strikes=1) == ("1 rotor strikes",)


def test_who_coasts_keeps_what_is_certified_of_coasting():
    """Which is the mission's clearance (here 1 m), and less than what the plan keeps elsewhere."""
    kept = replace(PLAN.assessment, vehicle=replace(PLAN.assessment.vehicle, distance=1.2))
    nothing = np.zeros(0)
    worst = WorstLoss(0.0, 0.0, 1)
    stream_loss = StreamLossCertificate(
        nothing, nothing, worst, nothing, StreamLossModel(), digest(PLAN.plan)
    )
    without = SimpleNamespace(plan=PLAN.plan, assessment=replace(kept, stream_loss=None))
    coasting = SimpleNamespace(plan=PLAN.plan, assessment=replace(kept, stream_loss=stream_loss))
    near = 1.1
    words = (f"vehicles {near:.2f} m apart",)
    assert judged("two-way gap of 2 s, one", coasting, apart=near) == ()
    assert judged("two-way gap of 2 s, one", coasting, apart=0.9) == ("vehicles 0.90 m apart",)
    assert judged("two-way gap of 2 s, one", without, apart=near) == words
    assert judged("telemetry gap of 2 s, one", coasting, apart=near) == words


def test_a_slip_counts_from_when_it_shows_and_is_asked_for_only_where_it_does():
    assert judged("gripper slips", noticed=14.0, hidden=6.0) == ()
    assert judged("gripper slips", noticed=14.0, hidden=2.0) == (
        "noticed after 12.00 s, not within 10 s",
    )
    assert judged("gripper slips", noticed=None, hidden=30.0, shown=4.0) == ()
    assert judged("gripper slips", noticed=None, hidden=3.0, shown=12.0) == (
        "noticed never, not within 10 s",
    )
    assert judged("motor lost", noticed=None) == ("noticed never, not within 0.3 s",)


def test_a_copy_of_a_flight_in_mid_air_flies_on_exactly_as_the_original():
    flight = SteppedSimulation.of(PLAN, failure_test_fleet(3, "mixed"), seed=2)
    while flight.conductor.clock.time < PLAN.plan.phase("fold").start + 2.0 or not flight.quiet:
        flight.step()
    copied = flight.copy()
    for _ in range(100):
        flight.step()
    before = flight.emulator.truth()
    for _ in range(100):
        copied.step()
    after = copied.emulator.truth()
    assert np.array_equal(before.position, after.position)
    assert np.array_equal(before.tension, after.tension)
    assert flight.conductor.clock.time == copied.conductor.clock.time


def test_the_survivors_of_a_lost_motor_let_go_in_order():
    flight = SteppedSimulation.of(PLAN, failure_test_fleet(3, "px4"), seed=2)
    while flight.conductor.clock.time < PLAN.plan.phase("fold").start + 2.0:
        flight.step()
    release_fallen(flight.conductor.state, 1, "for the test")
    while flight.conductor.finished is None:
        flight.step()
    (order,) = [event.message for event in flight.events if event.kind == "release"]
    assert order == "letting go, in this order: vehicles 2, 1, 3"
    assert not flight.emulator.truth().gripped.any()


def test_who_has_not_answered_lately_lets_go_first():
    flight = SteppedSimulation.of(PLAN, failure_test_fleet(3, "px4"), seed=2)
    while flight.conductor.clock.time < PLAN.plan.phase("fold").start + 2.0:
        flight.step()
    system, began = flight.conductor.flyers[1].system, flight.now
    deaf = {"kind": "link", "vehicle": system, "loss": 1.0, "direction": "up", "duration": 5.0}
    flight.emulator.inject(Fault.model_validate({"at": began, **deaf}))
    while flight.now < began + 3.5:
        flight.step()
    leave_the_plan(flight.conductor.state, Response.RELEASE, "for the test", move=False)
    while flight.emulator.truth().gripped.any():
        flight.step()
    first, then = [event.message for event in flight.events if event.kind == "release"]
    assert first == "releasing first, who has not answered lately: vehicle 2"
    assert then == "releasing all together"


def test_the_answers_are_the_groups_and_nobody_is_sent_home():
    assert not any("return" in response or "launch" in response for response in Response)
    assert {"falling", "disarmed", "rebooted"} <= LOSES_A_VEHICLE
    assert all(TABLE[kind].irreversible for kind in LOSES_A_VEHICLE)


def test_a_drill_tells_what_a_program_wants_to_know_and_the_same_seed_the_same():
    (drill,), (again,) = (
        run_failure_tests(
            PLAN, rows=[BY_NAME["interrupted once"]], personalities=["mixed"], times=1, seed=5,
            jobs=1,
        )
        for _ in range(2)
    )  # fmt: skip
    assert drill == again
    told = drill.document()
    wanted = {"row", "personality", "times", "detected_after", "response", "clearance",
              "chord_ratio", "strikes", "lost", "end", "passed"}  # fmt: skip
    assert wanted <= told.keys()
    assert told["end"] == "landed"
    assert told["passed"]


def test_the_tests_that_the_table_cites_are_there():
    root = Path(__file__).parents[2]
    assert {"disk full", "viewer hangs"} <= {one.name for one in SYSTEM_FAILURE_CASES}
    for test in (test for one in SYSTEM_FAILURE_CASES for test in one.tests):
        file, _, name = test.partition("::")
        tree = ast.parse((root / file).read_text(encoding="utf-8"))
        names = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        assert name in names if name else any(one.startswith("test_") for one in names), test
