"""``swarm fly``: plan, check, count down, fly, and tell what was flown."""

import os
import sys
import time
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from typing import Literal, get_args

import click
from rich.console import Console

from swarm import planner
from swarm.cli.flown import end_with
from swarm.cli.inputs import JSON, SET, progress_bar
from swarm.cli.resume import resume_flight
from swarm.errors import InputError, Problem
from swarm.flight.bench_flight import RAISED, raised
from swarm.flight.clearance import Audit
from swarm.flight.resuming import Then
from swarm.flight.setup import LOOSE_ERROR
from swarm.flight.snapshot import Event, Snapshot
from swarm.front.files import load_fleet, load_mission
from swarm.ground.flight_process import FlightRequest, fly_in_process
from swarm.mission.fleet import emulated_fleet
from swarm.reports.plan_summary import findings_table, plan_summary
from swarm.reports.terminal import FlightScreen
from swarm.view import rerun_log

COUNTDOWN = 3
LONGEST_SOCKET_PATH = 100
_BARE = (
    f"The fleet has no grippers (gripper: none): flown {RAISED:g} m higher, where nobody touches "
    f"the ground, and tracking errors up to {LOOSE_ERROR:g} m do not stop the clock."
)


@click.command()
@click.argument("mission", metavar="[MISSION]", required=False)
@SET
@JSON
@click.option(
    "--fleet",
    type=click.Path(dir_okay=False, path_type=Path),
    help="The vehicles and their links; without it, the built-in emulator.",
)
@click.option(
    "--speed",
    type=click.FloatRange(0.1, 50.0),
    default=1.0,
    show_default=True,
    help="Times real time; for emulated vehicles only.",
)
@click.option("--no-cable", is_flag=True, help="Fly with nothing attached, grips simulated.")
@click.option(
    "--view",
    is_flag=False,
    flag_value="native",
    type=click.Choice(["native", "web"]),
    help="Watch in Rerun while flying: its own viewer, or `web` on this machine's loopback.",
)
@click.option("--yes", is_flag=True, help="Do not ask; never passes an error.")
@click.option(
    "--record",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for the flight's record; the default is a new one below flights/.",
)
@click.option(
    "--resume",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="RECORD",
    help="Find the team of this record, whose ground station died in flight, and go on.",
)
@click.option(
    "--then",
    type=click.Choice(get_args(Then)),
    default="hold",
    show_default=True,
    help="With --resume: what follows once everybody is found.",
)
@click.pass_context
def fly(
    context: click.Context,
    mission: str | None,
    overrides: tuple[str, ...],
    as_json: bool,
    fleet: Path | None,
    speed: float,
    no_cable: bool,
    view: Literal["native", "web"] | None,
    yes: bool,
    record: Path | None,
    resume: Path | None,
    then: Then,
) -> None:
    """Plan MISSION (a file or a knot's name), check it, and fly it.

    Without --fleet the built-in emulator flies, in a process of its own. Ctrl-C stops the team and
    lands it together. Where the ground station itself died, --resume finds the vehicles before
    they land by themselves; plan and fleet are the record's then.
    """
    if resume is not None:
        _refuse_beside_resume(mission, overrides, fleet, speed, no_cable=no_cable)
        folder = record or _record_folder(f"{resume.name}-resumed")
        resume_flight(
            context, resume, folder, _control(folder), then=then, view=view, as_json=as_json
        )
        return
    if mission is None:
        raise click.UsageError("Missing argument 'MISSION'.")
    loaded = load_mission(mission, overrides)
    given = load_fleet(fleet) if fleet else None
    console = Console(quiet=as_json)
    with progress_bar(Console(stderr=True)) as progress:
        planned = planner.plan(loaded, progress)
    plan_summary(planned.plan, planned.assessment, console)
    team = given or emulated_fleet(planned.plan.vehicles)
    flight_plan = raised(planned.certified(), team, no_cable=no_cable)
    plan = flight_plan.plan
    if plan is not planned.plan:
        console.print(_BARE, style="dim", highlight=False, soft_wrap=True)
    folder = record or _record_folder(loaded.name)
    emulated = team.emulated is not None
    folder.mkdir(parents=True, exist_ok=True)
    viewer = rerun_log.start(plan, folder / "flight.rrd", view)
    screen = FlightScreen(plan, console)
    try:
        if viewer.message:
            console.print(viewer.message, soft_wrap=True, highlight=False)
        with ExitStack() as shown:

            def confirm(audit: Audit) -> bool:
                if not (emulated or yes):
                    console.print(findings_table(audit.findings))
                    if not click.confirm("Arm and fly?", err=True):
                        return False
                    shown.enter_context(screen)
                for left in range(COUNTDOWN, 0, -1):
                    screen.countdown(left)
                    time.sleep(1.0)
                return True

            def on_snapshot(snapshot: Snapshot) -> None:
                screen.show(snapshot)
                viewer.offer(snapshot)

            def on_event(event: Event) -> None:
                screen.event(event)
                viewer.offer(event)

            if emulated or yes:
                shown.enter_context(screen)
            result = fly_in_process(
                FlightRequest(
                    flight_plan,
                    team,
                    folder,
                    speed=speed,
                    no_cable=no_cable,
                    control=_control(folder),
                    asks=True,
                ),
                confirm=confirm,
                take_keys=(emulated or yes) and sys.stdin.isatty(),
                on_snapshot=on_snapshot,
                on_event=on_event,
                gives_way=True,
            )
    finally:
        viewer.close()
    end_with(context, plan, planned.assessment, result, folder, as_json=as_json)


def _refuse_beside_resume(
    mission: str | None,
    overrides: tuple[str, ...],
    fleet: Path | None,
    speed: float,
    *,
    no_cable: bool,
) -> None:
    given = {"MISSION": mission, "--set": overrides, "--fleet": fleet, "--no-cable": no_cable}
    stray = [name for name, value in given.items() if value] + ["--speed"] * (speed != 1.0)
    if stray:
        words = "the record says it when a flight is resumed"
        raise InputError([Problem(name, words) for name in stray])


def _control(folder: Path) -> Path | None:
    """Place of the control socket; None where its path is longer than sockets may have."""
    path = folder / "control"
    return path if len(os.fsencode(path)) < LONGEST_SOCKET_PATH else None


def _record_folder(name: str) -> Path:
    stem = f"{datetime.now().astimezone():%Y-%m-%dT%H-%M-%S}-{name}".replace("/", "-")
    for number in range(100):
        folder = Path("flights") / (f"{stem}-{number}" if number else stem)
        if not folder.exists():
            return folder
    raise InputError([Problem("flights", "expected a free name for the record")])
