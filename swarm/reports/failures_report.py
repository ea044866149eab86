"""The page of the failure tests of a plan."""

from collections.abc import Sequence
from itertools import groupby

from swarm.planning import Plan
from swarm.reports.rendering import render
from swarm.reports.verdicts import FailureTestDocument, failures_verdict
from swarm.simulation.fault_injection import SystemFailureCase


def failures_report(
    plan: Plan,
    tests: Sequence[FailureTestDocument],
    system_cases: Sequence[SystemFailureCase] = (),
) -> str:
    """Return the page of a plan's failure tests.

    ``tests`` are the JSON objects that ``swarm failures --json`` prints. The tests of
    ``system_cases`` run elsewhere, over real sockets, files and processes.
    """
    most_lost = max((test["vehicles_lost"] for test in tests), default=0)
    return render(
        "failures.html.j2",
        mission=plan.mission,
        verdict=failures_verdict(tests),
        figures=[
            ("failure tests", len(tests)),
            ("flights", sum(len(test["times"]) for test in tests)),
            ("rotor strikes", sum(test["rotor_strikes"] for test in tests)),
            ("most vehicles lost in one flight", most_lost),
        ],
        groups=[
            (group, list(cases)) for group, cases in groupby(tests, key=lambda test: test["group"])
        ],
        system_cases=system_cases,
    )
