"""The page of the failure tests of a plan."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from swarm.planning import Plan
from swarm.reports.rendering import render
from swarm.simulation.fault_injection import SystemFailureCase


def failures_report(
    plan: Plan,
    tests: Sequence[Mapping[str, Any]],
    system_cases: Sequence[SystemFailureCase] = (),
) -> str:
    """Return the page of a plan's failure tests.

    ``tests`` are the JSON objects that ``swarm dry-run --failures --json`` prints; ``system_cases``
    are tested elsewhere, over real sockets, files and processes.
    """
    return render(
        "failures.html.j2",
        mission=plan.mission,
        tests=tests,
        trials=sum(len(test["times"]) for test in tests),
        failed=sum(not test["passed"] for test in tests),
        figures=[
            ("drills", len(tests)),
            ("flights", sum(len(test["times"]) for test in tests)),
            ("rotor strikes", sum(test["strikes"] for test in tests)),
            ("most vehicles lost at once", max((test["lost"] for test in tests), default=0)),
        ],
        groups=[
            (group, list(cases)) for group, cases in groupby(tests, key=lambda test: test["group"])
        ],
        system_cases=system_cases,
    )
