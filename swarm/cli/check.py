"""``swarm check``: check a fleet on the ground."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from swarm.certification.certificate import CertifiedPlan
from swarm.certification.findings import Finding
from swarm.cli.flight_session import (
    CONSOLE,
    CONSOLE_CERTIFICATE,
    MOCAP,
    RTCM,
    note_first_test,
    opened_console,
    require_laboratory,
)
from swarm.cli.inputs import (
    FILE,
    FOLDER,
    JSON,
    OUTPUT,
    REPLAN,
    SET,
    YES,
    ProgressLine,
    confirmed,
    print_json,
    progress_bar,
)
from swarm.cli.planning import load_source
from swarm.console.launch import parse_address, require_usable
from swarm.errors import InputError, Problem, Refused, VehicleError
from swarm.files import read_text, write_text
from swarm.flight.bench_flight import hop
from swarm.flight.flight_plan import basis_of, require_tracking
from swarm.flight.parameters import ParameterResult
from swarm.front.files import load_fleet
from swarm.ground.commissioning.check import CheckOptions, CheckReport
from swarm.ground.commissioning.check import check as check_fleet
from swarm.ground.commissioning.screens import CheckScreens
from swarm.ground.commissioning.survey import download_logs
from swarm.ground.fly import FlightCallbacks
from swarm.ground.hop import HopResult, fly_hop, hop_question
from swarm.ground.ladder import carries_cable, missing_steps, passed_steps, words_of
from swarm.ground.record import control_socket, new_check_folder
from swarm.ground.world_clock import require_clock
from swarm.mission.fleet import Fleet, emulated_fleet, with_tracking
from swarm.mission.mission import LARGEST_TRACKING
from swarm.mission.validation import LARGEST_FILE
from swarm.reports.check import (
    check_object,
    logs_object,
    logs_table,
    parameter_table,
    print_check,
    steps_table,
)
from swarm.reports.formatting import certified
from swarm.reports.layout_sheet import layout_sheet
from swarm.reports.result import drawn
from swarm.reports.terminal import FlightScreen

EMULATED_VEHICLES = 9
"""Vehicles of the built-in emulator without a fleet file and without a mission."""


@dataclass(frozen=True)
class Options:
    """The argument and the options of the command."""

    mission: str | None
    overrides: tuple[str, ...]
    replan: bool
    as_json: bool
    fleet_file: Path | None
    fix: bool
    restore: Path | None
    soak: float
    with_hop: bool
    sheet: Path | None
    logs: Path | None
    record: Path | None
    speed: float
    clock: Path | None
    rtcm: str | None
    mocap: str | None
    fence: bool
    identify: bool
    console: str | None
    console_certificate: Path | None
    yes: bool

    def require_others(self) -> None:
        """Raise :class:`InputError` for options that need a mission or others, without them."""
        given = {
            "--hop": self.with_hop,
            "--fence": self.fence,
            "--sheet": self.sheet,
            "--set": self.overrides,
            "--replan": self.replan,
        }
        missing = [name for name, value in given.items() if value and self.mission is None]
        problems = [Problem(name, "expected a MISSION") for name in missing]
        if self.clock is not None and not (self.fleet_file and self.with_hop):
            problems.append(Problem("--clock", "expected --fleet and --hop"))
        if self.rtcm is not None and self.fleet_file is None:
            problems.append(Problem("--rtcm", "expected --fleet: emulated receivers have RTK"))
        if self.mocap is not None and self.fleet_file is None:
            problems.append(Problem("--mocap", "expected --fleet"))
        if self.identify and self.fleet_file is None:
            problems.append(Problem("--identify", "expected --fleet"))
        if self.console_certificate is not None and self.console is None:
            problems.append(Problem("--console-certificate", "expected --console"))
        if self.console is not None and self.with_hop:
            words = "its page ends before a hop: check first, then fly the hop without it"
            problems.append(Problem("--console", words))
        if problems:
            raise InputError(problems)
        require_clock(self.clock)
        if self.console is not None:
            require_usable(parse_address(self.console), self.console_certificate)


@click.command()
@click.argument("mission", required=False)
@SET
@REPLAN
@JSON
@click.option(
    "--fleet",
    "fleet_file",
    type=OUTPUT,
    help="Fleet file: vehicles and their links. Default: the built-in emulator.",
)
@click.option("--fix", is_flag=True, help="Set wrong parameters, after a question.")
@click.option(
    "--fence",
    is_flag=True,
    help="Upload the mission's fence (workspace.fence) to every vehicle, read it back, and enable "
    "it. --restore restores the fence that the vehicle had.",
)
@click.option(
    "--restore",
    type=FOLDER,
    metavar="FOLDER",
    help="Restore the parameters and fences that an earlier check or flight saved in FOLDER.",
)
@click.option(
    "--soak",
    type=click.FloatRange(0.0, 3600.0),
    default=0.0,
    metavar="SECONDS",
    help="Measure rate, gaps and packet loss of every link for this time.",
)
@click.option(
    "--hop",
    "with_hop",
    is_flag=True,
    help="Fly a test hop, measure hover errors, and write the tracking error to plan with into a "
    "copy of the fleet file, for swarm plan --fleet.",
)
@click.option(
    "--sheet",
    type=FILE,
    help="Write a layout sheet to print (HTML): cable, marks, pads, labels, parameters.",
)
@click.option(
    "--logs",
    type=FOLDER,
    metavar="FOLDER",
    help="Instead of a check, fetch the newest log of every autopilot into FOLDER.",
)
@click.option(
    "--record",
    type=FOLDER,
    help="Folder for saved parameters and the hop. Default: a new folder in checks/.",
)
@click.option(
    "--speed",
    type=click.FloatRange(0.1, 50.0),
    default=1.0,
    show_default=True,
    help="Multiple of real time of the hop; for emulated vehicles only.",
)
@click.option(
    "--clock",
    type=FILE,
    help="The hop follows the time in this file, as `swarm fly --clock`.",
)
@MOCAP
@click.option(
    "--identify",
    is_flag=True,
    help="With motion capture: ask to lift, lean and turn one vehicle after the other, and find "
    "bodies that are swapped, mirrored, turned, frozen, lost or flipping, as `swarm mocap`.",
)
@RTCM
@CONSOLE
@CONSOLE_CERTIFICATE
@YES
@click.pass_context
def check(context: click.Context, /, **options: Any) -> None:
    """Check a fleet on the ground, and against MISSION if given.

    MISSION is a mission or plan file, or the name of a knot.

    Checks links, firmware, health, batteries, positions, parameters, origins, clocks and the Hold
    mode, and the poses of motion capture, where `swarm mocap` or --mocap sends them. Parameters are
    saved first. Only --hop arms vehicles. Of vehicles that are not emulated it lists the first
    tests that they have passed. Exit code 0 for go, 1 for no-go, 3
    if vehicles, links or logs are missing.

    Example: swarm check missions/overhand.yaml --fleet fleet.yaml --soak 60
    """
    given = Options(**options)
    if given.logs is not None:
        context.exit(_fetch_logs(given, given.logs))
    given.require_others()
    fleet = load_fleet(given.fleet_file) if given.fleet_file else None
    require_laboratory(given.mocap, fleet)
    require_laboratory("poses" if given.identify else None, fleet, option="--identify")
    before = read_text(given.fleet_file, LARGEST_FILE) if given.fleet_file else None
    # a hop measures anew: an earlier measurement must not prevent it
    known = None if given.with_hop else fleet
    flight_plan = None
    if given.mission is not None:
        source = load_source(given.mission, given.overrides, replan=given.replan, fleet=known)
        flight_plan = source.planned().certified()
    if fleet is None:
        fleet = emulated_fleet(flight_plan.plan.vehicles if flight_plan else EMULATED_VEHICLES)
    console = Console(quiet=given.as_json)
    folder = given.record or new_check_folder(Path("checks"))
    console.print(f"{fleet.name}: {len(fleet.vehicles)} vehicles listed", highlight=False)
    report = _checked(given, fleet, folder, flight_plan, known, console)
    hop_result, measured = None, None
    real = fleet.emulated is None and given.clock is None
    if flight_plan is not None:
        if given.with_hop:
            ready = report.passed or fleet.emulated is not None
            hop_result = _fly_hop(flight_plan, fleet, folder / "hop", given, ready=ready)
            report = report.with_findings(*hop_result.findings)
            if hop_result.hovers:
                note_first_test(folder / "hop", real=real)
            measured = _write_measured(before, fleet, folder, hop_result)
        if given.sheet:
            sheet = layout_sheet(flight_plan.plan, fleet, report.order, flight_plan.assessment)
            write_text(given.sheet, sheet)
    passed = passed_steps(fleet) if real else None
    if real and flight_plan is not None:
        report = report.with_findings(*_step_findings(flight_plan, fleet))
    if given.as_json:
        print_json(check_object(report, hop_result, folder, measured, passed))
    else:
        if passed is not None:
            console.print(drawn(steps_table(passed)))
        print_check(report, console)
        console.print(f"Parameters saved in {folder}", soft_wrap=True, highlight=False)
        if measured is not None:
            words = f"Fleet with its measured tracking error, for swarm plan --fleet: {measured}"
            console.print(words, soft_wrap=True, highlight=False)
    context.exit(0 if report.passed else 1)


def _checked(
    given: Options,
    fleet: Fleet,
    folder: Path,
    flight_plan: CertifiedPlan | None,
    known: Fleet | None,
    console: Console,
) -> CheckReport:
    """Check the fleet with terminal and console; the plan's figures are for the fleet ``known``."""
    screens = CheckScreens(control_socket(folder) if given.console is not None else None)
    with (
        opened_console(folder, given.console, given.console_certificate, console),
        progress_bar(Console(stderr=True), f"listening to {fleet.name}") as progress,
    ):
        fix = _fix_question(console, progress, screens, yes=given.yes) if given.fix else None
        beforehand = () if flight_plan is None else (_plan_finding(flight_plan, known),)
        options = CheckOptions(
            given.soak, fix, given.restore, progress, given.rtcm, given.fence, given.mocap,
            prepared=given.fleet_file is None, identify=given.identify,
            say=partial(_say, progress), beforehand=beforehand, screens=screens,
        )  # fmt: skip
        return check_fleet(fleet, folder, flight_plan, options)


def _plan_finding(flight_plan: CertifiedPlan, fleet: Fleet | None) -> Finding:
    """Return what the plan is certified for; an error where ``fleet`` was measured with more."""
    if fleet is not None:
        held = fleet.gripper != "none" and len(flight_plan.plan.layout.lengths) > 0
        try:
            require_tracking(basis_of(flight_plan, cable=held), fleet)
        except Refused as refusal:
            return Finding("error", "plan", str(refusal))
    plan, limit = flight_plan.plan, flight_plan.assessment.robustness.tracking
    words = f"{plan.mission.name}, {plan.vehicles} vehicles, certified for tracking errors of "
    words += f"{plan.mission.vehicles.tracking:g} m"
    return Finding(
        "info", "plan", words + (f", e* {certified(limit)}" if limit is not None else "")
    )


def _step_findings(flight_plan: CertifiedPlan, fleet: Fleet) -> list[Finding]:
    """Return a warning where a flight of the plan with cable would be refused."""
    if not carries_cable(flight_plan, no_cable=False):
        return []
    missing = missing_steps(fleet, flight_plan.plan)
    if not missing:
        return [Finding("info", "first tests", "all before this flight have been passed")]
    words = "; ".join(words_of(step, flight_plan.plan) for step in missing)
    message = f"swarm fly refuses this flight with cable; not passed before: {words}"
    return [Finding("warning", "first tests", message)]


def _say(progress: ProgressLine, words: str) -> None:
    """Print a line beside the progress."""
    with progress.hidden():
        click.echo(words, err=True)


def _fix_question(
    console: Console, progress: ProgressLine, screens: CheckScreens, *, yes: bool
) -> Callable[[Sequence[ParameterResult]], bool]:
    def confirm(rows: Sequence[ParameterResult]) -> bool:
        with progress.hidden():
            console.print(drawn(parameter_table(rows)))
            if yes:
                return True
            question = f"Set these {len(rows)} parameters?"
            if screens.control is not None:
                return _answered(question, f"sets these {len(rows)} parameters", screens)
            return sys.stdin.isatty() and bool(confirmed(question))

    return confirm


def _answered(question: str, effect: str, screens: CheckScreens) -> bool:
    """Ask on the terminal and on the console; return the first answer."""
    with screens.asking(effect) as asked:
        typed = confirmed(question, lambda: asked.answer is not None, read=sys.stdin.isatty())
        if typed is not None:
            asked.settle(typed)
    if asked.answer is not typed:
        click.echo(f"{'yes' if asked.answer else 'no'}: answered by the console", err=True)
    return bool(asked.answer)


def _fly_hop(
    flight_plan: CertifiedPlan, fleet: Fleet, folder: Path, given: Options, *, ready: bool
) -> HopResult:
    """Fly the hop if the vehicles are ready and the operator confirms it; emulated ones always."""
    if not ready:
        return HopResult((Finding("warning", "hop", "not flown: the check is a no-go"),))
    ask = fleet.emulated is None and not given.yes
    if ask and not (sys.stdin.isatty() and confirmed(hop_question(flight_plan))):
        return HopResult((Finding("warning", "hop", "not flown: not confirmed"),))
    flight = hop(flight_plan)
    with FlightScreen(flight.plan, Console(quiet=given.as_json)) as screen:
        return fly_hop(
            flight,
            flight_plan,
            fleet,
            folder,
            speed=given.speed,
            world_clock=given.clock,
            rtcm=given.rtcm,
            mocap=given.mocap,
            callbacks=FlightCallbacks(on_snapshot=screen.show, on_event=screen.event),
        )


def _write_measured(
    before: str | None, fleet: Fleet, folder: Path, hop_result: HopResult
) -> Path | None:
    """Write the text of a fleet file with the tracking error of a hop, and return its path.

    None without a fleet file, and where not all vehicles were measured or one was too far off.
    """
    tracking = hop_result.tracking
    if before is None or tracking is None or tracking > LARGEST_TRACKING:
        return None
    key = str(Path(fleet.signing_key).resolve()) if fleet.signing_key else None
    path = folder / "measured-fleet.yaml"
    write_text(path, with_tracking(before, tracking, key))
    return path


def _fetch_logs(given: Options, folder: Path) -> int:
    """Fetch every vehicle's newest log, print the paths, and return the exit code."""
    checks = (
        given.mission, given.fix, given.restore, given.soak, given.with_hop, given.sheet,
        given.clock, given.rtcm, given.mocap, given.fence, given.identify, given.console,
    )  # fmt: skip
    if any(checks) or given.record:
        raise click.UsageError("--logs can be combined with --fleet and --json only")
    fleet = load_fleet(given.fleet_file) if given.fleet_file else emulated_fleet(EMULATED_VEHICLES)
    with progress_bar(Console(stderr=True), f"listening to {fleet.name}") as progress:
        logs = download_logs(
            fleet, folder, lambda system, share: progress(f"log of system {system}", share)
        )
    if given.as_json:
        print_json(logs_object(logs))
    else:
        Console().print(drawn(logs_table(logs)))
    return 0 if all(log.path for log in logs) else VehicleError.exit_code
