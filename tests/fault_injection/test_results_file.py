"""Results of failure tests are written as they complete; an interrupted run is continued."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarm.errors import InputError
from swarm.simulation.failure_cases import FAILURE_CASES
from swarm.simulation.failure_tests import (
    CaseTrials,
    FailureTestSettings,
    FaultTrial,
    append_results,
    line,
    open_results,
    read_results,
    results_header,
    run_failure_tests,
)
from swarm.simulation.stepped_simulation import TEAM_AUTOPILOTS
from tests.network import small_plan

PLAN = small_plan(vehicles=3)
HEADING = results_header(PLAN.plan, 1)
numbers = st.floats(0.0, 1e3)
trials = st.builds(
    FaultTrial,
    mission_time=numbers,
    vehicle=st.integers(1, 9),
    detected_after=st.none() | numbers,
    response=st.text(),
    strand_distance=numbers | st.just(np.inf),
    vehicle_distance=numbers | st.just(np.inf),
    chord_ratio=numbers,
    rotor_strikes=st.integers(0, 5),
    vehicles_lost=st.integers(0, 2),
    end=st.text(),
    problems=st.lists(st.text(), max_size=3).map(tuple),
    hidden_time=numbers,
    visible_time=numbers,
    exempt_strikes=st.integers(0, 2),
)
case_trials = st.builds(
    CaseTrials,
    case=st.sampled_from([case.name for case in FAILURE_CASES]),
    autopilots=st.sampled_from(TEAM_AUTOPILOTS),
    seeds=st.tuples(*[st.integers(0, 2**31)] * 3),
    trials=st.lists(trials, max_size=3).map(tuple),
)


@given(st.lists(case_trials, max_size=3))
def test_results_are_read_as_they_were_written_in_lines_of_plain_json(flown):
    lines = [line(one) for one in (HEADING, *flown)]
    assert all(one.count("\n") == 1 and one.endswith("\n") for one in lines)
    for one in lines:
        json.loads(one, parse_constant=pytest.fail)
    assert read_results([one[:-1] for one in lines], HEADING) == flown


def run_two_cases(earlier_results=()):
    new_results = []
    cases = [case for case in FAILURE_CASES if case.name in {"disarms", "interrupted twice"}]
    tests = run_failure_tests(
        PLAN,
        FailureTestSettings(cases, ["px4"], times=1),
        jobs=1,
        earlier_results=earlier_results,
        on_result=new_results.append,
    )
    return tests, new_results


@pytest.mark.slow
def test_an_interrupted_run_is_continued(tmp_path):
    path = tmp_path / "results.jsonl"
    assert open_results(path, HEADING) == []
    whole, kept = run_two_cases()
    assert [one.case for one in kept] == ["disarms", "interrupted twice"]
    for one in kept:
        append_results(path, one)
    # killed while it wrote the second
    path.write_bytes(path.read_bytes()[:-30])
    known = open_results(path, HEADING)
    assert known == kept[:1]
    again, more = run_two_cases(known)
    assert [one.case for one in more] == ["interrupted twice"]
    assert again == whole
    append_results(path, more[0])
    assert open_results(path, HEADING) == kept


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (line(replace(HEADING, seed=2)), "got 3_1 with seed 2, plan "),
        (line(replace(HEADING, plan="another")), "plan another and swarm "),
        ("schema: 1\nname: mine\n", "line 1: expected results of failure tests"),
        (line(HEADING) + "{}\n", "line 2: expected results of failure tests"),
        ("\xff\xfe\n\x00", "line 1: expected results of failure tests"),
    ],
    ids=["another seed", "another plan", "a mission", "a damaged line", "bytes"],
)
def test_a_file_of_something_else_is_refused_and_left_as_it_is(tmp_path, text, words):
    path = tmp_path / "mine"
    path.write_text(text + "without an end", encoding="latin-1")
    before = path.read_bytes()
    with pytest.raises(InputError, match="mine: .*" + words):
        open_results(path, HEADING)
    assert path.read_bytes() == before


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match="nowhere/results: no such file or directory"):
        open_results(tmp_path / "nowhere" / "results", HEADING)
