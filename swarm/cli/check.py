"""``swarm check``: the vehicles on the ground, before anything is armed."""

import sys
from collections.abc import Callable, Iterable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.table import Table
from rich.text import Text

from swarm import planner
from swarm.certification.certificate import CertifiedPlan
from swarm.certification.findings import Finding
from swarm.cli.hop import Hopped, fly_hop
from swarm.cli.inputs import JSON, SET, Shown, print_json, progress_bar
from swarm.cli.logs import fetch
from swarm.errors import InputError, Problem
from swarm.exports import finding_object
from swarm.files import write_text
from swarm.flight.parameters import Row
from swarm.flight.words import in_common, numbers, of_systems
from swarm.front.files import load_fleet, load_mission
from swarm.ground.commissioning.check import CheckReport, Wanted
from swarm.ground.commissioning.check import check as check_fleet
from swarm.mission.fleet import Fleet, emulated_fleet
from swarm.reports.layout_sheet import layout_sheet

STYLES = {"error": "bold red", "warning": "yellow", "info": "green"}


@click.command()
@click.argument("mission", required=False)
@SET
@JSON
@click.option(
    "--fleet",
    "fleet_file",
    type=click.Path(dir_okay=False, path_type=Path),
    help="The vehicles and their links; without it, the built-in emulator.",
)
@click.option("--fix", is_flag=True, help="Ask, then set the parameters that are wrong.")
@click.option(
    "--restore",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="Put parameters back as an earlier check or flight saved them in FOLDER.",
)
@click.option(
    "--soak",
    type=click.FloatRange(0.0, 3600.0),
    default=0.0,
    metavar="SECONDS",
    help="Measure rates, gaps and loss of every link for so long.",
)
@click.option(
    "--hop",
    "with_hop",
    is_flag=True,
    help="Fly a test hop, measure hover errors, and tell which vehicles.tracking to plan with.",
)
@click.option(
    "--sheet",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write a lay-out sheet to print (HTML): cable, marks, pads, labels, parameters.",
)
@click.option(
    "--logs",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="Check nothing: fetch every vehicle's newest log into FOLDER, after a flight.",
)
@click.option(
    "--record",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for saved parameters and the hop; the default is a new one below checks/.",
)
@click.option(
    "--speed",
    type=click.FloatRange(0.1, 50.0),
    default=1.0,
    show_default=True,
    help="Times real time of the hop; for emulated vehicles only.",
)
@click.option("--yes", is_flag=True, help="Do not ask; never passes an error.")
@click.pass_context
def check(
    context: click.Context,
    mission: str | None,
    overrides: tuple[str, ...],
    as_json: bool,
    fleet_file: Path | None,
    fix: bool,
    restore: Path | None,
    soak: float,
    with_hop: bool,
    sheet: Path | None,
    logs: Path | None,
    record: Path | None,
    speed: float,
    yes: bool,
) -> None:
    """Check a fleet on the ground, against MISSION (a file or a knot's name) where one is given.

    Looks at who is on the links, firmware, health, battery, positions, parameters, origins, clocks
    and whether Hold can be had; the parameters are saved first. Nothing is armed but by --hop.
    With --logs it fetches logs instead. Exit code 0 for a go, 1 for a no-go, 3 when vehicles or
    links are missing, or logs.
    """
    if logs is not None:
        if mission or fix or restore or soak or with_hop or sheet or record:
            raise click.UsageError("--logs goes with --fleet and --json alone")
        context.exit(fetch(fleet_file, logs, as_json=as_json))
    if mission is None and (with_hop or sheet or overrides):
        what = "--hop" if with_hop else "--sheet" if sheet else "--set"
        raise InputError([Problem(what, "expected a MISSION to go with it")])
    fleet = load_fleet(fleet_file) if fleet_file else None
    flight_plan = _proven(mission, overrides) if mission is not None else None
    if fleet is None:
        fleet = emulated_fleet(flight_plan.plan.vehicles if flight_plan else 9)
    console = Console(quiet=as_json)
    folder = record or Path("checks") / f"{datetime.now().astimezone():%Y-%m-%dT%H-%M-%S}"
    console.print(f"{fleet.name}: {len(fleet.vehicles)} vehicles listed", highlight=False)
    with progress_bar(Console(stderr=True), f"listening to {fleet.name}") as shown:
        wanted = Wanted(soak, _asker(console, shown, yes=yes) if fix else None, restore, shown)
        report = check_fleet(fleet, folder, flight_plan, wanted)
    if flight_plan is not None:
        report = report.having(_of_plan(flight_plan))
    hopped = None
    if flight_plan is not None and with_hop:
        hopped = _hop(report, flight_plan, fleet, folder / "hop", speed, console, yes=yes)
        report = report.having(*hopped.findings)
    if sheet and flight_plan is not None:
        write_text(sheet, layout_sheet(flight_plan.plan, fleet, report.order))
    if as_json:
        print_json({**_object(report, folder), "hop": hopped.document() if hopped else None})
    else:
        _show(report, console)
        console.print(f"Parameters saved in {folder}", soft_wrap=True, highlight=False)
    context.exit(0 if report.passed else 1)


def _proven(mission: str, overrides: tuple[str, ...]) -> CertifiedPlan:
    with progress_bar(Console(stderr=True)) as progress:
        return planner.plan(load_mission(mission, overrides), progress).certified()


def _of_plan(flight_plan: CertifiedPlan) -> Finding:
    plan, limit = flight_plan.plan, flight_plan.assessment.robustness.tracking
    words = f"{plan.mission.name}, {plan.vehicles} vehicles, certified for tracking errors of "
    words += f"{plan.mission.vehicles.tracking:g} m"
    return Finding("info", "plan", words + (f", holds {limit:.2f} m" if limit is not None else ""))


def _asker(console: Console, shown: Shown, *, yes: bool) -> Callable[[Sequence[Row]], bool]:
    def ask(rows: Sequence[Row]) -> bool:
        with shown.away():
            console.print(parameter_table(rows))
            if yes:
                return True
            if not sys.stdin.isatty():
                return False
            return click.confirm(f"Set these {len(rows)} parameters?", err=True)

    return ask


def _hop(
    report: CheckReport,
    flight_plan: CertifiedPlan,
    fleet: Fleet,
    folder: Path,
    speed: float,
    console: Console,
    *,
    yes: bool,
) -> Hopped:
    """Fly the hop, unless something speaks against it; return what came of it."""
    if not report.passed and fleet.emulated is None:
        return Hopped((Finding("warning", "hop", "not flown: first mend what is a no-go"),))
    return fly_hop(flight_plan, fleet, folder, speed, console, yes=yes)


def parameter_table(rows: Iterable[Row]) -> Table:
    """Return what is, what should be and why; vehicles with the same value share a line."""
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for heading in ("systems", "parameter", "is", "should be", "why"):
        table.add_column(heading)
    for (name, value, words, why, severity), systems in _merged(rows).items():
        now = "not there" if value is None else f"{value:g}"
        style = STYLES[severity]
        table.add_row(numbers(systems), Text(name, style), now, words, why)
    return table


def _merged(rows: Iterable[Row]) -> dict[tuple[str, float | None, str, str, str], list[int]]:
    merged: dict[tuple[str, float | None, str, str, str], list[int]] = {}
    for row in rows:
        key = (row.name, row.value, row.words, row.why, row.severity)
        merged.setdefault(key, []).append(row.system)
    return merged


def _show(report: CheckReport, console: Console) -> None:
    changed: dict[str, list[int]] = {}
    for line in report.changed:
        system, words = line.removeprefix("system ").split(": ", 1)
        changed.setdefault(words, []).append(int(system))
    for words, systems in changed.items():
        console.print(f"set {of_systems(systems)}{words}", highlight=False)
    wrong = [row for vehicle in report.vehicles for row in vehicle.wrong]
    if wrong:
        console.print(parameter_table(wrong))
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for heading in ("", "check", "found"):
        table.add_column(heading)
    # parameters have a table of their own
    found = [finding for finding in report.findings if finding.check != "parameters"]
    for severity, check, words in in_common(found):
        table.add_row(Text(severity, STYLES[severity]), check, words)
    console.print(table)
    console.print()
    table = Table(box=None, padding=(0, 2, 0, 0), show_header=False)
    for item in report.items():
        mark = Text("GO", "bold green") if item.go else Text("NO-GO", "bold red")
        table.add_row(mark, item.subject, item.words)
    console.print(table)
    if report.passed:
        console.print(Text("GO for flight", "bold green"))
    else:
        console.print(Text("NO-GO: nothing may be armed like this", "bold red"))


def _object(report: CheckReport, folder: Path) -> dict[str, Any]:
    return {
        "go": report.passed,
        "list": [
            {"check": item.check, "subject": item.subject, "go": item.go, "words": item.words}
            for item in report.items()
        ],
        "vehicles": [
            {
                "system": vehicle.system,
                "firmware": vehicle.firmware,
                "health": dict(vehicle.health),
                "battery": vehicle.battery if vehicle.battery >= 0.0 else None,
                "problems": list(vehicle.problems),
                "parameters": [
                    {
                        "name": row.name,
                        "is": row.value,
                        "should_be": row.words,
                        "why": row.why,
                        "severity": row.severity,
                    }
                    for row in (*vehicle.wrong, *vehicle.good)
                ],
            }
            for vehicle in report.vehicles
        ],
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
        "changed": list(report.changed),
        "order": list(report.order),
        "findings": [finding_object(finding) for finding in report.findings],
        "record": str(folder),
    }
