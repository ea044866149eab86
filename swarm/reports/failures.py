"""The failure tests of a plan: the verdict and a table; terminal and page.

A test is everywhere the JSON object that ``swarm failures --json`` prints.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from typing import Any, Final

from rich.console import Console

from swarm.planning import Plan
from swarm.reports.formatting import counted, number
from swarm.reports.result import Cell, Table, Verdict, Words, drawn, print_verdict
from swarm.simulation.failure_cases import SYSTEM_FAILURE_CASES

Document = Mapping[str, Any]

_WIDE: Final = 110
"""Columns from which the terminal has room for the responses."""

_NAMED: Final = 3
"""Failed tests that a verdict names; more would not fit into a line or two."""


def failures_verdict(tests: Sequence[Document]) -> Verdict:
    """Return how many failure tests passed, which failed, and strikes and losses in any of them."""
    failed = [test for test in tests if not test["passed"]]
    flights = sum(len(test["times"]) for test in tests)
    words = f"All {len(tests)} failure tests passed ({flights} flights)."
    if failed:
        words = f"{len(failed)} of {len(tests)} failure tests failed ({flights} flights): "
        names = dict.fromkeys(f"{test['case']} ({test['autopilots']})" for test in failed)
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        words += ", ".join(list(names)[:_NAMED]) + f"{more}."
    strikes = [test for test in tests if test["rotor_strikes"]]
    lost = _most_lost(tests)
    if strikes:
        total = sum(test["rotor_strikes"] for test in strikes)
        worst = max(strikes, key=lambda test: int(test["rotor_strikes"]))
        words += (
            f" {counted(total, 'rotor strike')} on cable, most in: {worst['case']} "
            f"({worst['autopilots']})."
        )
    if lost:
        words += f" At most {counted(lost, 'vehicle')} lost in one flight."
    return Verdict("bad" if failed else "warn" if strikes or lost else "good", words)


def _most_lost(tests: Sequence[Document]) -> int:
    return max((test["vehicles_lost"] for test in tests), default=0)


def _grouped(tests: Sequence[Document], key: str) -> list[tuple[str, list[Document]]]:
    return [(value, list(group)) for value, group in groupby(tests, key=lambda test: test[key])]


def print_failures(tests: Sequence[Document], console: Console, *, system_cases: bool) -> None:
    """Print verdict and failure tests; with ``system_cases`` also the cases tested elsewhere."""
    print_verdict(failures_verdict(tests), console)
    console.print()
    autopilots = list(dict.fromkeys(test["autopilots"] for test in tests))
    table = failures_table(tests, autopilots)
    wide = console.width >= _WIDE
    lines = drawn(table if wide else table.without(len(table.columns) - 1))
    for column in lines.columns[1 : 1 + len(autopilots)]:
        column.justify = "center"
    console.print(lines)
    if not wide:
        responses = [f" {case}: {_response(same)}" for case, same in _grouped(tests, "case")]
        for line in ("\n[dim]response and end[/dim]", *responses):
            console.print(line, highlight=False)
    for test in tests:
        for problem in test["problems"]:
            line = f"[red]{test['case']} ({test['autopilots']}): {problem}[/red]"
            console.print(line, highlight=False)
    if system_cases:
        console.print("\nTested over real sockets, files and processes:")
        for case in SYSTEM_FAILURE_CASES:
            references = f"[dim]({', '.join(case.tests)})[/dim]"
            line = f"  [bold]{case.name}[/bold]: {case.expected} {references}"
            console.print(line, highlight=False)


def failures_table(tests: Sequence[Document], autopilots: Sequence[str]) -> Table:
    """Return a table with a line per failure case: the worst result of all teams."""
    figures = ("detected\ns", "strands\nm", "chord", "rotor\nstrikes", "vehicles\nlost")
    columns = ("failure case", *autopilots, *figures, "response and end")
    rows: list[tuple[Words, ...]] = []
    for group, in_group in _grouped(tests, "group"):
        rows.append((Cell(group, "strong"), *[""] * (len(columns) - 1)))
        for case, same in _grouped(in_group, "case"):
            marks = {test["autopilots"]: _mark(test["passed"]) for test in same}
            cells = (
                _worst(same, "detected_after", max),
                _worst(same, "strand_distance", min),
                _worst(same, "chord_ratio", max),
                str(sum(test["rotor_strikes"] for test in same)),
                str(_most_lost(same)),
            )
            row = (marks.get(name, "") for name in autopilots)
            rows.append((f" {case}", *row, *cells, _response(same)))
    last = len(columns) - 1
    return Table(columns, rows, range(last - len(figures), last), range(1, last), gap=1)


def _worst(tests: Sequence[Document], key: str, worst: Callable[[list[float]], float]) -> str:
    values = [test[key] for test in tests if test[key] is not None]
    return number(worst(values) if values else None)


def _mark(passed: bool) -> Cell:
    return Cell("✓", "good") if passed else Cell("✗", "bad")


def _response(tests: Sequence[Document]) -> str:
    """Return the most frequent first response, and all ends."""
    first = [test["response"].partition(",")[0] for test in tests]
    response = max(dict.fromkeys(first), key=first.count)
    ends = " or ".join(dict.fromkeys(end for test in tests for end in test["end"].split(" or ")))
    return ends if response == "none" else f"{response} → {ends}"


def failures_report(plan: Plan, tests: Sequence[Document]) -> str:
    """Return the page of a plan's failure tests, and of the cases that are tested elsewhere."""
    from swarm.reports import pages  # noqa: PLC0415 - slow to import

    elsewhere = [
        (case.name, case.expected, tuple(Cell(test, "small") for test in case.tests))
        for case in SYSTEM_FAILURE_CASES
    ]
    sections = [
        *(
            pages.Section(group.capitalize(), [_tests_table(in_group)])
            for group, in_group in _grouped(tests, "group")
        ),
        pages.Section(
            "Tested over real sockets, files and processes",
            [Table(("Failure case", "Expected behaviour", "Tests"), elsewhere)],
        ),
    ]
    return pages.page(
        "Failures",
        plan.mission.name,
        "failure tests",
        failures_verdict(tests),
        sections,
        about=["Flights in virtual time, evaluated by the emulator's ground truth"],
        figures=[
            ("failure tests", len(tests)),
            ("flights", sum(len(test["times"]) for test in tests)),
            ("rotor strikes", sum(test["rotor_strikes"] for test in tests)),
            ("most vehicles lost in one flight", _most_lost(tests)),
        ],
        footer="Each test injects a fault into the planned flight at random times. Distances of "
        "strands and chords are evaluated while all vehicles hold the cable in the air. The table "
        "explains where the fault itself moves vehicles or cable beyond the certificate.",
    )


def _tests_table(tests: Sequence[Document]) -> Table:
    """Return a table with a line per test; a case is named once."""
    columns = (
        "", "Failure case", "Autopilots", "Detected (s)", "Response", "Strands (m)", "Chord",
        "Rotor strikes", "Vehicles lost", "End",
    )  # fmt: skip
    rows: list[tuple[Words, ...]] = []
    for case, same in _grouped(tests, "case"):
        for k, test in enumerate(same):
            name: Words = "" if k else case
            if test["explanation"] and not k:
                name = (case, Cell(test["explanation"], "small"))
            incidents = [
                Cell(str(count), "warn" if count else "")
                for count in (test["rotor_strikes"], test["vehicles_lost"])
            ]
            problems = [Cell(problem, "bad") for problem in test["problems"]]
            rows.append(
                (
                    _mark(test["passed"]),
                    name,
                    test["autopilots"],
                    number(test["detected_after"]),
                    test["response"],
                    number(test["strand_distance"]),
                    number(test["chord_ratio"]),
                    *incidents,
                    (test["end"], *problems),
                )
            )
    return Table(columns, rows, numbers=(3, 5, 6, 7, 8))
