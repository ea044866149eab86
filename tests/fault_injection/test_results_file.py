"""Drills that are kept as they are flown: a run that was interrupted goes on where it was."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarm.errors import InputError
from swarm.simulation.fault_injection import (
    FAILURE_CASES,
    TEAM_AUTOPILOTS,
    FaultTrial,
    run_failure_tests,
)
from swarm.simulation.fault_injection.results_file import (
    CaseTrials,
    append_results,
    line,
    open_results,
    read_results,
    results_header,
)
from tests.network import small_plan

PLAN = small_plan(vehicles=3)
HEADING = results_header(PLAN.plan, 1)
numbers = st.floats(0.0, 1e3)
trials = st.builds(
    FaultTrial,
    at=numbers,
    vehicle=st.integers(1, 9),
    noticed=st.none() | numbers,
    response=st.text(),
    clearance=numbers | st.just(np.inf),
    apart=numbers | st.just(np.inf),
    chord=numbers,
    strikes=st.integers(0, 5),
    lost=st.integers(0, 2),
    end=st.text(),
    problems=st.lists(st.text(), max_size=3).map(tuple),
    hidden=numbers,
    shown=numbers,
    falling=st.integers(0, 2),
)
drills = st.builds(
    CaseTrials,
    row=st.sampled_from([row.name for row in FAILURE_CASES]),
    personality=st.sampled_from(TEAM_AUTOPILOTS),
    seeds=st.tuples(*[st.integers(0, 2**31)] * 3),
    trials=st.lists(trials, max_size=3).map(tuple),
)


@given(st.lists(drills, max_size=3))
def test_drills_are_read_as_they_were_written_in_lines_of_plain_json(flown):
    lines = [line(one) for one in (HEADING, *flown)]
    assert all(one.count("\n") == 1 and one.endswith("\n") for one in lines)
    for one in lines:
        json.loads(one, parse_constant=pytest.fail)
    assert read_results([one[:-1] for one in lines], HEADING) == flown


def flown_rows(known=()):
    kept = []
    rows = [row for row in FAILURE_CASES if row.name in {"disarms", "interrupted twice"}]
    found = run_failure_tests(
        PLAN, rows=rows, personalities=["px4"], times=2, jobs=1, known=known, keep=kept.append
    )
    return found, kept


def test_a_run_that_was_interrupted_goes_on_where_it_was(tmp_path):
    path = tmp_path / "drills.jsonl"
    assert open_results(path, HEADING) == []
    whole, kept = flown_rows()
    assert [one.row for one in kept] == ["disarms", "interrupted twice"]
    for one in kept:
        append_results(path, one)
    # killed while it wrote the second
    path.write_bytes(path.read_bytes()[:-30])
    known = open_results(path, HEADING)
    assert known == kept[:1]
    again, more = flown_rows(known)
    assert [one.row for one in more] == ["interrupted twice"]
    assert again == whole
    append_results(path, more[0])
    assert open_results(path, HEADING) == kept


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (line(replace(HEADING, seed=2)), "it holds drills of 3_1 with seed 2, plan "),
        (line(replace(HEADING, plan="another")), "plan another and swarm "),
        ("schema: 1\nname: mine\n", "line 1 is not a line of drills"),
        (line(HEADING) + "{}\n", "line 2 is not a line of drills"),
        ("\xff\xfe\n\x00", "line 1 is not a line of drills"),
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
    with pytest.raises(InputError, match="nowhere/drills: no such file or directory"):
        open_results(tmp_path / "nowhere" / "drills", HEADING)
