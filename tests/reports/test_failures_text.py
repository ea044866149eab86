"""The table of failure tests in terminals of 80 and 120 columns."""

import io
from typing import Any

import pytest
from rich.console import Console

from swarm.reports.failures import print_failures


def failure_test(case: str, autopilots: str, **changed: Any) -> dict[str, Any]:
    return {
        "case": case, "group": "one vehicle", "autopilots": autopilots, "times": [60.0],
        "detected_after": 0.2, "strand_distance": 0.61, "chord_ratio": 0.93, "rotor_strikes": 1,
        "vehicles_lost": 1, "response": "falling → release fallen, land here",
        "end": "released and landed", "passed": True, "problems": [], **changed,
    }  # fmt: skip


def printed(width: int) -> list[str]:
    tests = [
        failure_test("gripper sticks shut at release", team, **changed)
        for team, changed in (
            ("px4", {}),
            (
                "ardupilot",
                {"passed": False, "problems": ["detected after 1.00 s, not within 0.5 s"]},
            ),
            ("mixed", {}),
        )
    ]
    console = Console(file=io.StringIO(), width=width)
    print_failures(tests, console, system_cases=False)
    # the verdict is wrapped by the terminal itself
    return [line.rstrip() for line in console.file.getvalue().splitlines()[1:]]


@pytest.mark.parametrize("width", [80, 120])
def test_no_word_of_the_table_is_cut_off(width):
    lines = printed(width)
    assert max(map(len, lines)) <= width
    text = "\n".join(lines)
    assert "…" not in text
    for word in ("ardupilot", "detected", "strands", "strikes", "vehicles", "response and end"):
        assert word in text


@pytest.mark.parametrize("width", [80, 120])
def test_a_problem_has_a_line_of_its_own(width):
    assert " ".join(printed(width)).endswith(
        " gripper sticks shut at release (ardupilot): detected after 1.00 s, not within 0.5 s"
    )
