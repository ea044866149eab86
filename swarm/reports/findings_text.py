"""Findings on the terminal: the verdict first, the worst findings last."""

from collections import Counter
from collections.abc import Sequence
from typing import Final

from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from swarm.certification.findings import Finding
from swarm.reports.formatting import seconds
from swarm.reports.verdicts import Verdict, counted, findings_verdict

SEVERITY_STYLES: Final = {"info": "dim", "warning": "yellow", "error": "bold red"}
"""Styles of severities, the worst last: the end of the output is what stays on the screen."""

LEVEL_STYLES: Final = {"good": "green", "warn": "yellow", "bad": "bold red"}

LISTED: Final = 3
"""Findings of one check and severity that are listed without ``--verbose``; a plan far outside its
limits has dozens that differ in time and vehicle only."""


def print_verdict(verdict: Verdict, console: Console, *, verbose: bool = False) -> None:
    """Print a verdict: wrapped at words on a terminal, one line in a pipe.

    With ``verbose`` its details too, in lines of their own.
    """
    wrapped = console.is_terminal
    console.print(Text(verdict.words, LEVEL_STYLES[verdict.level]), soft_wrap=not wrapped)
    if verbose and verdict.details:
        console.print(verdict.details, soft_wrap=not wrapped, highlight=False)


def print_findings(findings: Sequence[Finding], console: Console) -> None:
    """Print the verdict on findings that belong to no plan, then all of them."""
    print_verdict(findings_verdict(findings), console)
    if findings:
        console.print(Padding(findings_table(findings), (1, 0, 0, 2), expand=False))


def findings_table(findings: Sequence[Finding]) -> Table:
    """Return a table of findings, remarks before warnings before errors."""
    order = list(SEVERITY_STYLES)
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("Finding", no_wrap=True)
    table.add_column("check", no_wrap=True)
    table.add_column("message", ratio=1)
    table.add_column("at", justify="right", no_wrap=True)
    for finding in sorted(findings, key=lambda finding: order.index(finding.severity)):
        when = "" if finding.at_time is None else seconds(finding.at_time)
        severity = Text(finding.severity, SEVERITY_STYLES[finding.severity])
        table.add_row(severity, finding.check, Text(finding.message), when)
    return table


def shortened(findings: Sequence[Finding]) -> list[Finding]:
    """Return at most :data:`LISTED` findings of a check and severity, and the number of the others.

    The number is the message of a finding of its own.
    """
    kinds = Counter((finding.severity, finding.check) for finding in findings)
    shown: Counter[tuple[str, str]] = Counter()
    listed = []
    for finding in findings:
        kind = finding.severity, finding.check
        shown[kind] += 1
        left = kinds[kind] - LISTED
        if shown[kind] <= LISTED:
            listed.append(finding)
        elif shown[kind] == LISTED + 1:
            words = f"and {counted(left, 'more ' + finding.severity)} of this check (--verbose)"
            listed.append(Finding(finding.severity, finding.check, words))
    return listed
