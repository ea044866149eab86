"""The failure tests of a plan on the terminal."""

from collections.abc import Sequence
from itertools import groupby

from rich.console import Console
from rich.table import Table

from swarm.reports.findings_text import print_verdict
from swarm.reports.formatting import number
from swarm.reports.verdicts import FailureTestDocument, failures_verdict
from swarm.simulation.fault_injection import SYSTEM_FAILURE_CASES

_WIDE = 110
"""Columns from which the table has room for the responses."""


def print_failures(
    tests: Sequence[FailureTestDocument], console: Console, *, system_cases: bool
) -> None:
    """Print verdict and failure tests; with ``system_cases`` also the cases tested elsewhere."""
    print_verdict(failures_verdict(tests), console)
    console.print()
    wide = console.width >= _WIDE
    console.print(failures_table(tests, with_responses=wide))
    for line in ([] if wide else _responses(tests)) + _problems(tests):
        console.print(line, highlight=False)
    if system_cases:
        console.print("\nTested over real sockets, files and processes:")
        for case in SYSTEM_FAILURE_CASES:
            references = f"[dim]({', '.join(case.tests)})[/dim]"
            line = f"  [bold]{case.name}[/bold]: {case.expected} {references}"
            console.print(line, highlight=False)


def failures_table(tests: Sequence[FailureTestDocument], *, with_responses: bool) -> Table:
    """Return a table with a line per failure case: the worst result of all teams."""
    table = Table(box=None, padding=(0, 1, 0, 0), header_style="dim")
    autopilots = list(dict.fromkeys(test["autopilots"] for test in tests))
    table.add_column("failure case")
    for name in autopilots:
        table.add_column(name, justify="center", no_wrap=True)
    for name in ("detected s", "strands m", "chord", "rotor strikes", "vehicles lost"):
        table.add_column(name.replace(" ", "\n"), justify="right", no_wrap=True)
    if with_responses:
        table.add_column("response and end")
    for group, in_group in groupby(tests, key=lambda test: test["group"]):
        table.add_row(f"[bold]{group}[/bold]")
        for case, of_case in groupby(in_group, key=lambda test: test["case"]):
            same = list(of_case)
            marks = {test["autopilots"]: _mark(test["passed"]) for test in same}
            table.add_row(
                f" {case}", *(marks.get(name, "") for name in autopilots),
                number(max(_values(same, "detected_after"), default=None)),
                number(min(_values(same, "strand_distance"), default=None)),
                number(max(_values(same, "chord_ratio"), default=None)),
                str(sum(test["rotor_strikes"] for test in same)),
                str(max(test["vehicles_lost"] for test in same)),
                *([_response_and_end(same)] if with_responses else []),
            )  # fmt: skip
    return table


def _responses(tests: Sequence[FailureTestDocument]) -> list[str]:
    """Return a heading and a line per failure case with the response and all ends."""
    return [
        "\n[dim]response and end[/dim]",
        *(
            f" {case}: {_response_and_end(list(of_case))}"
            for case, of_case in groupby(tests, key=lambda test: test["case"])
        ),
    ]


def _problems(tests: Sequence[FailureTestDocument]) -> list[str]:
    """Return a line for everything that was not as required."""
    return [
        f"[red]{test['case']} ({test['autopilots']}): {problem}[/red]"
        for test in tests
        for problem in test["problems"]
    ]


def _values(tests: Sequence[FailureTestDocument], name: str) -> list[float]:
    return [test[name] for test in tests if test[name] is not None]


def _mark(passed: bool) -> str:
    return "[green]✓[/green]" if passed else "[red]✗[/red]"


def _response_and_end(tests: Sequence[FailureTestDocument]) -> str:
    """Return the most frequent first response, and all ends."""
    first = [test["response"].partition(",")[0] for test in tests]
    response = max(dict.fromkeys(first), key=first.count)
    ends = " or ".join(dict.fromkeys(end for test in tests for end in test["end"].split(" or ")))
    return ends if response == "none" else f"{response} → {ends}"
