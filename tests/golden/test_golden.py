"""Plans, certificates, flights and answers to failures are what they were.

Where one of these fails and the change is meant: ``python -m tests.golden renew NAMES``, and judge
the differences that it shows.
"""

import json
import re
import zlib

import pytest

from tests.golden import failures, flights, plans
from tests.golden.cases import CASES, left_over
from tests.golden.environment import environment, environment_of
from tests.shared import drawn_by_program

FAILURES = [case for case in CASES if case.name.startswith("failures/")]


def _parameters():
    for case in CASES:
        how = "to the last bit" if case.exact else "within tolerances"
        marks = () if case.quick and case not in FAILURES else (pytest.mark.full,)
        yield pytest.param(case, id=f"{case.name}, {how}", marks=marks)


@pytest.mark.parametrize("case", list(_parameters()))
def test_it_is_what_it_was(case):
    assert case.check() == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "case", [case for case in FAILURES if case.quick], ids=lambda case: case.name
)
def test_a_failure_of_a_drawn_team_is_what_it_was(case):
    """Of each kind of failure; ``-m full`` flies each with both teams."""
    name = case.name.removeprefix("failures/")
    team = failures.TEAMS[zlib.crc32(name.encode(), drawn_by_program()) % len(failures.TEAMS)]
    kept = failures.of_team(case.kept(), team)
    assert case.compared(kept, failures.make(name, [team])) == []


def test_the_goldens_were_made_in_this_environment():
    """Says in the summary which goldens were compared within tolerances only, and why."""
    others = {environment_of(case.kept() or "") for case in CASES if not case.exact}
    if others:
        pytest.skip(f"made with {'; '.join(sorted(others))}; this is {environment()}")


def test_there_is_one_file_for_each_case_and_no_other():
    assert left_over() == []
    assert [case.name for case in CASES if case.kept() is None] == []


PLAN = json.dumps(
    {
        "mission": "3_1", "digest": "0" * 64, "cleared": True, "knot": "3_1 right", "vehicles": 9,
        "figures": {"cable, m": 32.0, "fold, s": 40.0, "duration, s": 95.0}, "phases": {"fold": 40.0},
    }
)  # fmt: skip
FLIGHT = """outcome done
ended 76.05 s
setpoints 4272
takeoff   vehicle 1    207 packets 975afb0f
  27.0 lift      |   -7.539    2.010   -2.372 |   25.686   15.960   -1.374
"""
FAILURE = """# team px4 · vehicle 2 · fold, mission time 30.21 s
<<    0.25  event     failure: falling: vehicle 2 falls: going down at 1.0 m/s · of 2
<<    6.20  command   MAV_CMD_DO_GRIPPER(1) · to 1–3
== landed · noticed after 0.25 s
"""


@pytest.mark.parametrize(
    ("kind", "kept", "old", "near", "far"),
    [
        (plans, PLAN, "32.0", "32.6", "32.7"),
        (plans, PLAN, "95.0", "99.7", "99.8"),
        (plans, PLAN, '"digest": "0', '"digest": "1', None),
        (plans, PLAN, "3_1 right", None, "3_1 left"),
        (plans, PLAN, '"vehicles": 9', None, '"vehicles": 10'),
        (flights, FLIGHT, "25.686", "25.980", "25.990"),
        (flights, FLIGHT, "76.05", "76.50", "76.60"),
        (flights, FLIGHT, "975afb0f", "975afb0e", None),
        (flights, FLIGHT, "takeoff", None, "grab"),
        (failures, FAILURE, "0.25  event", "0.75  event", "0.80  event"),
        (failures, FAILURE, "at 1.0 m/s", "at 1.1 m/s", "at all"),
        (failures, FAILURE, "to 1–3", None, "to 1, 3"),
        (failures, FAILURE, "== landed", None, "== released and landed"),
    ],
)
def test_another_cpu_may_change_a_little_and_a_renewal_shows_all_of_it(kind, kept, old, near, far):
    assert kind.differences(kept, kept) == kind.disagreements(kept, kept) == []
    assert old in kept
    if near is not None:
        assert kind.differences(kept, kept.replace(old, near))
        assert kind.disagreements(kept, kept.replace(old, near)) == []
    if far is not None:
        assert kind.differences(kept, kept.replace(old, far))
        assert kind.disagreements(kept, kept.replace(old, far))


def test_a_renewal_states_differences_of_setpoints_in_metres():
    moved = re.sub(r"25\.686   15\.960", "25.689   15.964", FLIGHT)
    assert flights.differences(FLIGHT, moved) == ["setpoints: largest difference 0.005 m, at 27 s"]


def test_a_renewal_counts_lines_of_a_transcript():
    shorter = FAILURE.replace("<<    6.20  command   MAV_CMD_DO_GRIPPER(1) · to 1–3\n", "")
    first, line = failures.differences(FAILURE, shorter)
    assert first == "lines: 1 removed, 0 added"
    assert line.startswith("-<<    6.20  command")
