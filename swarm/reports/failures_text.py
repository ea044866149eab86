"""The failure tests of a plan on the terminal."""

from collections.abc import Sequence
from itertools import groupby

from rich.console import Console
from rich.table import Table

from swarm.reports.findings_text import print_verdict
from swarm.reports.formatting import number
from swarm.reports.verdicts import FailureTestDocument, failures_verdict
from swarm.simulation.fault_injection import SYSTEM_FAILURE_CASES


def print_failures(
    tests: Sequence[FailureTestDocument], console: Console, *, system_cases: bool
) -> None:
    """Print verdict and failure tests; with ``system_cases`` also the cases tested elsewhere."""
    print_verdict(failures_verdict(tests), console)
    console.print()
    console.print(failures_table(tests))
    if system_cases:
        console.print("\nTested over real sockets, files and processes:")
        for case in SYSTEM_FAILURE_CASES:
            references = f"[dim]({', '.join(case.tests)})[/dim]"
            line = f"  [bold]{case.name}[/bold]: {case.expected} {references}"
            console.print(line, highlight=False)


def failures_table(tests: Sequence[FailureTestDocument]) -> Table:
    """Return a table with a line per failure case: the worst result of all teams."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    autopilots = list(dict.fromkeys(test["autopilots"] for test in tests))
    table.add_column("failure case")
    for name in autopilots:
        table.add_column(name, justify="center")
    for name in ("detected s", "strands m", "chord", "rotor strikes", "vehicles lost"):
        table.add_column(name.replace(" ", "\n"), justify="right")
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
                str(max(test["vehicles_lost"] for test in same)), _response_and_end(same),
            )  # fmt: skip
            for test in same:
                for problem in test["problems"]:
                    table.add_row(f"[red]  {test['autopilots']} {problem}[/red]")
    return table


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
