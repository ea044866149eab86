"""The result of a ground check, and fetched logs, on the terminal."""

from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from swarm.certification.findings import in_common, numbers, of_systems
from swarm.flight.parameters import ParameterResult
from swarm.ground.commissioning.check import CheckReport
from swarm.ground.commissioning.survey import LogDownload

STYLES = {"error": "bold red", "warning": "yellow", "info": "green"}


def print_check(report: CheckReport, console: Console) -> None:
    """Print the parameters that were set, those that are wrong, the findings, and go or no-go."""
    _print_changes(report.parameters_set, console)
    wrong = [row for vehicle in report.vehicles for row in vehicle.deviations]
    if wrong:
        console.print(parameter_table(wrong))
    table = _table("", "check", "finding")
    # parameters have a table of their own
    findings = [finding for finding in report.findings if finding.check != "parameters"]
    for severity, check, words in in_common(findings):
        table.add_row(Text(severity, STYLES[severity]), check, words)
    console.print(table)
    console.print()
    table = Table(box=None, padding=(0, 2, 0, 0), show_header=False)
    for item in report.checklist():
        mark = Text("GO", "bold green") if item.go else Text("NO-GO", "bold red")
        table.add_row(mark, item.subject, item.message)
    console.print(table)
    if report.passed:
        console.print(Text("GO for flight", "bold green"))
    else:
        console.print(Text("NO-GO: do not arm", "bold red"))


def parameter_table(rows: Iterable[ParameterResult]) -> Table:
    """Return a table of parameters; vehicles with the same value share a line."""
    table = _table("systems", "parameter", "value", "expected", "reason")
    for (name, value, words, why, severity), systems in _merged(rows).items():
        now = "missing" if value is None else f"{value:g}"
        table.add_row(numbers(systems), Text(name, STYLES[severity]), now, words, why)
    return table


def logs_table(logs: Sequence[LogDownload]) -> Table:
    """Return a table with the path of each vehicle's log, or why it was not fetched."""
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for heading in ("system", "date", "size", "log"):
        table.add_column(heading, justify="right" if heading in {"system", "size"} else "left")
    for log in logs:
        size = f"{log.size / 1e6:.2f} MB" if log.size else ""
        where = Text(str(log.path)) if log.path else Text(log.problem, "bold red")
        table.add_row(str(log.system), log.date, size, where)
    return table


def _table(*headings: str) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for heading in headings:
        table.add_column(heading)
    return table


def _merged(
    rows: Iterable[ParameterResult],
) -> dict[tuple[str, float | None, str, str, str], list[int]]:
    merged: dict[tuple[str, float | None, str, str, str], list[int]] = {}
    for row in rows:
        key = (row.name, row.value, row.words, row.why, row.severity)
        merged.setdefault(key, []).append(row.system)
    return merged


def _print_changes(changed: Iterable[str], console: Console) -> None:
    merged: dict[str, list[int]] = {}
    for line in changed:
        system, words = line.removeprefix("system ").split(": ", 1)
        merged.setdefault(words, []).append(int(system))
    for words, systems in merged.items():
        console.print(f"set {of_systems(systems)}{words}", highlight=False)
