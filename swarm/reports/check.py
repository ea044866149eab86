"""The result of a ground check, and fetched logs: JSON and terminal; times in seconds."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

from swarm.certification.findings import in_common, numbers, of_systems
from swarm.exports import finding_object
from swarm.flight.parameters import ParameterResult
from swarm.ground.commissioning.check import CheckReport, VehicleAudit
from swarm.ground.commissioning.survey import LogDownload
from swarm.ground.hop import HopResult
from swarm.ground.ladder import STEPS, PassedStep, Step
from swarm.reports.mocap import poses_object, poses_table
from swarm.reports.result import SEVERITIES, Cell, Table, drawn


def check_object(
    report: CheckReport,
    hop: HopResult | None,
    folder: Path,
    measured: Path | None = None,
    steps: Sequence[PassedStep] | None = None,
) -> dict[str, Any]:
    """Return the go/no-go list, vehicles, links, findings and the hover errors of a check.

    Battery and loss are shares. ``measured`` is the fleet file with the tracking error of the hop,
    ``steps`` are the first tests that the fleet has passed (None: it is emulated).
    """
    return {
        "go": report.passed,
        "checklist": [
            {"check": item.check, "subject": item.subject, "go": item.go, "message": item.message}
            for item in report.checklist()
        ],
        "vehicles": [_vehicle(vehicle) for vehicle in report.vehicles],
        "links": [
            {
                "system": link.system,
                "rate": link.rate,
                "longest_gap": link.longest_gap,
                "unanswered": link.unanswered,
                "loss": link.loss,
                "round_trip": link.round_trip if link.round_trip >= 0.0 else None,
            }
            for link in report.links
        ],
        "poses": poses_object(report.poses),
        "pose_sender": report.sender or None,
        "parameters_set": list(report.parameters_set),
        "order": list(report.order),
        "findings": [finding_object(finding) for finding in report.findings],
        "record": str(folder),
        "hop": hop_object(hop) if hop else None,
        "measured_fleet": str(measured) if measured else None,
        "first_tests": None if steps is None else _steps_object(steps),
    }


def hop_object(hop: HopResult) -> dict[str, Any]:
    """Return the hover errors of a hop, and the tracking error to plan with, in metres."""
    return {
        "recommended_tracking": hop.tracking,
        "vehicles": [asdict(hover) for hover in hop.hovers],
    }


def _vehicle(vehicle: VehicleAudit) -> dict[str, Any]:
    return {
        "system": vehicle.system,
        "firmware": vehicle.firmware,
        "health": dict(vehicle.health),
        "battery": vehicle.battery if vehicle.battery >= 0.0 else None,
        "problems": list(vehicle.problems),
        "parameters": [
            {
                "name": row.name,
                "value": row.value,
                "expected": row.words,
                "reason": row.why,
                "severity": row.severity,
            }
            for row in (*vehicle.deviations, *vehicle.correct)
        ],
    }


def logs_object(logs: Sequence[LogDownload]) -> dict[str, Any]:
    """Return the logs that were fetched from the autopilots."""
    return {
        "logs": [
            {
                "system": log.system,
                "path": str(log.path) if log.path else None,
                "size": log.size or None,
                "date": log.date or None,
                "problem": log.problem or None,
            }
            for log in logs
        ]
    }


def print_check(report: CheckReport, console: Console) -> None:
    """Print the parameters that were set, those that are wrong, the findings, and go or no-go."""
    _print_changes(report.parameters_set, console)
    wrong = [row for vehicle in report.vehicles for row in vehicle.deviations]
    if wrong:
        console.print(drawn(parameter_table(wrong)))
    if report.poses:
        console.print(report.sender, soft_wrap=True, highlight=False, markup=False)
        console.print(drawn(poses_table(report.poses)))
    # parameters and poses have tables of their own
    tables = {"parameters", "poses"}
    findings = [finding for finding in report.findings if finding.check not in tables]
    rows = [
        (Cell(finding.severity, SEVERITIES[finding.severity]), finding.check, finding.message)
        for finding in in_common(findings)
    ]
    console.print(drawn(Table(("", "check", "finding"), rows)))
    console.print()
    checklist = Grid(box=None, padding=(0, 2, 0, 0), show_header=False)
    for item in report.checklist():
        mark = Text("GO", "bold green") if item.go else Text("NO-GO", "bold red")
        checklist.add_row(mark, item.subject, item.message)
    console.print(checklist)
    if report.passed:
        console.print(Text("GO for flight", "bold green"))
    else:
        console.print(Text("NO-GO: do not arm", "bold red"))


def steps_table(steps: Sequence[PassedStep]) -> Table:
    """Return the first tests, and the last flight with the most vehicles that passed each."""
    rows: list[tuple[str | Cell, ...]] = []
    for step, (words, how) in STEPS.items():
        passed = _of(step, steps)
        if not passed:
            rows.append((words, Cell("not passed", "dim"), "", Cell(how, "dim")))
            continue
        best = max(passed, key=lambda row: (row.vehicles, row.date))
        date = datetime.fromisoformat(best.date).astimezone()
        rows.append((words, f"{date:%Y-%m-%d %H:%M}", str(best.vehicles), Cell(best.record)))
    return Table(("first test", "passed", "vehicles", "record"), rows, numbers=(2,), whole=(1,))


def _steps_object(steps: Sequence[PassedStep]) -> list[dict[str, Any]]:
    return [{"step": step, "passed": [asdict(row) for row in _of(step, steps)]} for step in STEPS]


def _of(step: Step, steps: Iterable[PassedStep]) -> list[PassedStep]:
    return [row for row in steps if row.step == step]


def parameter_table(parameters: Iterable[ParameterResult]) -> Table:
    """Return a table of parameters; vehicles with the same value share a line."""
    merged: dict[tuple[str, float | None, str, str, str], list[int]] = {}
    for row in parameters:
        key = (row.name, row.value, row.words, row.why, row.severity)
        merged.setdefault(key, []).append(row.system)
    rows = [
        (
            numbers(systems),
            Cell(name, SEVERITIES[severity]),
            "missing" if value is None else f"{value:g}",
            words,
            why,
        )
        for (name, value, words, why, severity), systems in merged.items()
    ]
    return Table(("systems", "parameter", "value", "expected", "reason"), rows)


def logs_table(logs: Sequence[LogDownload]) -> Table:
    """Return a table with the path of each vehicle's log, or why it was not fetched."""
    rows = [
        (
            str(log.system),
            log.date,
            f"{log.size / 1e6:.2f} MB" if log.size else "",
            Cell(str(log.path)) if log.path else Cell(log.problem, "bad"),
        )
        for log in logs
    ]
    return Table(("system", "date", "size", "log"), rows, numbers=(0, 2))


def _print_changes(changed: Iterable[str], console: Console) -> None:
    merged: dict[str, list[int]] = {}
    for line in changed:
        system, words = line.removeprefix("system ").split(": ", 1)
        merged.setdefault(words, []).append(int(system))
    for words, systems in merged.items():
        console.print(f"set {of_systems(systems)}{words}", highlight=False)
