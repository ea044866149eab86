"""What ``swarm dry-run --failures`` does: let everything go wrong once, and print what follows."""

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from swarm import planner
from swarm.cli.inputs import print_json
from swarm.errors import InputError, Problem, Refused, reason
from swarm.files import write_text
from swarm.planning import Plan
from swarm.reports.failures_report import failures_report
from swarm.simulation.fault_injection import (
    FAILURE_CASES,
    SYSTEM_FAILURE_CASES,
    TEAM_AUTOPILOTS,
    FailureTest,
    TeamAutopilots,
    run_failure_tests,
)
from swarm.simulation.fault_injection.results_file import (
    CaseTrials,
    ResultsHeader,
    line,
    read_results,
    results_header,
)

TIMES = 2
"""Random times at which each thing goes wrong, with each autopilot."""
_LARGEST = 256 * 1024 * 1024


def run_failures(
    context: click.Context,
    planned: planner.PlanningResult,
    *,
    times: int | None,
    team: tuple[TeamAutopilots, ...],
    row: tuple[str, ...],
    seed: int,
    jobs: int | None,
    report: Path | None,
    results: Path | None,
    as_json: bool,
) -> None:
    """Fly the drills, print or write what they say, and end the command with its exit code."""
    console = Console(quiet=as_json)
    rows = [one for one in FAILURE_CASES if not row or any(part in one.name for part in row)]
    if not rows:
        names = ", ".join(one.name for one in FAILURE_CASES)
        raise InputError([Problem("--row", f"expected a part of one of: {names}")])
    rows = [one for one in rows if one.part in _parts(planned.plan)]
    if not rows:
        raise Refused("this mission folds no cable in the air: there is nothing to drill")
    teams = [one for one in TEAM_AUTOPILOTS if not team or one in team]
    drills = _fly(
        planned, rows=rows, personalities=teams, times=times or TIMES, seed=seed, jobs=jobs,
        known=_known(results, results_header(planned.plan, seed)) if results else (),
        keep=partial(_keep, results) if results else None,
    )  # fmt: skip
    told = [drill.document() for drill in drills]
    if report:
        write_text(report, failures_report(planned.plan, told, SYSTEM_FAILURE_CASES))
    if as_json:
        print_json({"failures": told})
    else:
        console.print(failures_table(told))
        console.print(_verdict(told), highlight=False)
        if not row:
            console.print("\nTested over real sockets, files and processes:")
            for words in cited_words():
                console.print(f"  {words}", highlight=False)
    context.exit(0 if all(one["passed"] for one in told) else 1)


def _parts(plan: Plan) -> set[str]:
    """Return the parts of a flight at which something can go wrong that this plan has."""
    if not any(phase.name == "fold" and phase.cable == "aloft" for phase in plan.phases):
        return set()
    conditions = {gate.condition for gate in plan.gates}
    parts = {"gripped": "grab", "released": "release"}
    return {"fold", *(part for gate, part in parts.items() if gate in conditions)}


def _known(path: Path, belongs: ResultsHeader) -> list[CaseTrials]:
    """Return the drills that a file of results holds; begin it where there is none."""
    try:
        with path.open("a+b") as file:
            file.seek(0)
            # a line without an end was cut off, and is flown again
            whole, end, _ = file.read(_LARGEST).rpartition(b"\n")
            known = read_results(whole.decode().splitlines(), belongs)
            file.truncate(len(whole + end))
            if not whole:
                file.write(line(belongs).encode())
        return known
    except OSError as error:
        said = reason(error)
    except UnicodeDecodeError:
        said = "line 1 is not a line of drills"
    except InputError as error:
        said = str(error)
    raise InputError([Problem(str(path), said)])


def _keep(path: Path, flown: CaseTrials) -> None:
    """Add drills to a file of results."""
    try:
        with path.open("a", encoding="utf-8", newline="\n") as file:
            file.write(line(flown))
    except OSError as error:
        raise InputError([Problem(str(path), reason(error))]) from None


def _fly(planned: planner.PlanningResult, **chosen: Any) -> tuple[FailureTest, ...]:
    console = Console(stderr=True)
    with Progress(
        TextColumn("drills"), BarColumn(bar_width=30), MofNCompleteColumn(), TimeRemainingColumn(),
        console=console, transient=True, disable=not console.is_terminal,
    ) as bar:  # fmt: skip
        task = bar.add_task("drills", total=None)

        def tell(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        return run_failure_tests(planned.certified(), tell=tell, **chosen)


def failures_table(told: Sequence[Mapping[str, Any]]) -> Table:
    """Return the table of drills for a terminal: a line for each thing that goes wrong, and the
    worst of what came of it with each kind of autopilot."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    kinds = list(dict.fromkeys(one["personality"] for one in told))
    table.add_column("what goes wrong")
    for kind in kinds:
        table.add_column(kind, justify="center")
    for name in ("noticed s", "strands m", "chord", "strikes", "lost"):
        table.add_column(name.replace(" ", "\n"), justify="right")
    table.add_column("answered as, and how it ended")
    for group, drills in groupby(told, key=lambda one: one["group"]):
        table.add_row(f"[bold]{group}[/bold]")
        for name, alike in groupby(drills, key=lambda one: one["row"]):
            ones = list(alike)
            marks = {one["personality"]: _mark(one["passed"]) for one in ones}
            table.add_row(
                f" {name}", *(marks.get(kind, "") for kind in kinds),
                _most(ones, "detected_after"), _number(_least(ones, "clearance")),
                _most(ones, "chord_ratio"), str(sum(one["strikes"] for one in ones)),
                str(max(one["lost"] for one in ones)), _course(ones),
            )  # fmt: skip
            for one in ones:
                for words in one["problems"]:
                    table.add_row(f"[red]  {one['personality']} {words}[/red]")
    return table


def cited_words() -> list[str]:
    """Return what goes wrong outside the bytes between station and vehicles, and what follows."""
    return [
        f"[bold]{one.name}[/bold]: {one.follows} [dim]({', '.join(one.tests)})[/dim]"
        for one in SYSTEM_FAILURE_CASES
    ]


def _mark(passed: bool) -> str:
    return "[green]✓[/green]" if passed else "[red]✗[/red]"


def _course(ones: Sequence[Mapping[str, Any]]) -> str:
    """As what it was answered, most often, and all ends."""
    first = [one["response"].partition(",")[0] for one in ones]
    named = max(dict.fromkeys(first), key=first.count)
    ends = " or ".join(dict.fromkeys(end for one in ones for end in one["end"].split(" or ")))
    return ends if named == "none" else f"{named} → {ends}"


def _least(ones: Sequence[Mapping[str, Any]], name: str) -> float | None:
    return min((one[name] for one in ones if one[name] is not None), default=None)


def _most(ones: Sequence[Mapping[str, Any]], name: str) -> str:
    return _number(max((one[name] for one in ones if one[name] is not None), default=None))


def _verdict(told: Sequence[Mapping[str, Any]]) -> str:
    failed = [one for one in told if not one["passed"]]
    trials = sum(len(one["times"]) for one in told)
    if not failed:
        return f"All {len(told)} drills ({trials} flights) went as asked."
    return f"{len(failed)} of {len(told)} drills ({trials} flights) did not go as asked."


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"
