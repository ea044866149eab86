"""A simulated rope on the terminal."""

import io
from typing import Any

import pytest
from rich.console import Console

from swarm.reports.rope import print_rope
from tests.reports.synthetic import trefoil_plan

PLAN = trefoil_plan()


def document(**changed: Any) -> dict[str, Any]:
    return {
        "trajectory": "this plan", "computing_time": 20.0, "simulated": 130.0, "links": 400,
        "knot": {"type": "3_1", "chirality": "right", "as_planned": True}, "invalid": [],
        "tightened": False, "end_distance": 12.0, "smallest_distance": 0.4,
        "smallest_distance_of_quasi_static_cable": 0.61,
        "penetration": {"radii": 0.2, "limit": 1.5}, "stretch": {"share": 0.004, "limit": 0.01},
        "speed": {"metres_per_second": 1.5, "limit": 12.0},
        "deviation": {
            "largest": 0.29, "segment": 2, "time": 40.0, "allowed_swing": 0.17,
            "beyond_models": {"share": 0.1, "by": 0.12},
        },
        **changed,
    }  # fmt: skip


def printed(run: dict[str, Any]) -> str:
    console = Console(file=io.StringIO(), width=200)
    print_rope(run, PLAN, console)
    return console.file.getvalue()  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("changed", "line"),
    [
        ({}, "Knot of the rope: 3_1 right-handed (planned: 3_1 right-handed)"),
        ({}, "0.29 m, segment 2 at 40 s; the budget's models of sway and a stop allow 0.17 m"),
        ({}, "it exceeds these models by up to 0.12 m, at 10% of moments and segments"),
        ({}, "0.40 m (quasi-static cable: 0.61 m)"),
        ({"tightened": True}, "tightened until its ends were 12.00 m apart"),
        ({"invalid": ["contact is disabled"]}, "The run is invalid:\n  contact is disabled\n"),
    ],
)
def test_each_result_of_a_rope_has_its_line(changed: dict[str, Any], line: str) -> None:
    assert line in printed(document(**changed))


def test_a_rope_without_distances_has_no_line_of_them() -> None:
    assert "smallest distance" not in printed(document(smallest_distance=None))
