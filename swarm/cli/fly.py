"""``swarm fly``: plan, check and fly a mission; ``--resume RECORD`` takes over a team in flight."""

import re
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import click
from rich.console import Console

from swarm.certification.certificate import without_cable
from swarm.certification.findings import Finding, in_common
from swarm.cli.flight_session import (
    CONSOLE,
    CONSOLE_CERTIFICATE,
    MOCAP,
    RTCM,
    VIEW,
    Displays,
    displays,
    end_flight,
    opened_console,
    require_laboratory,
)
from swarm.cli.inputs import (
    FILE,
    FOLDER,
    JSON,
    REPLAN,
    SET,
    VERBOSE,
    YES,
    Address,
    confirmed,
    refuse_option_conflicts,
)
from swarm.cli.main import report_bug
from swarm.cli.planning import (
    load_source,
    load_training,
    prepare_flight,
    require_cleared,
    rest_of_fold,
)
from swarm.console.launch import parse_address, require_usable
from swarm.errors import InputError, Problem, Refused, SwarmError
from swarm.flight.bench_flight import RAISED, raised
from swarm.flight.execute import LARGEST
from swarm.flight.flight_plan import (
    Audit,
    Basis,
    ResumedFlight,
    basis_of,
    confirmed_basis,
    require_tracking,
)
from swarm.flight.responding import COUNTDOWN
from swarm.flight.result import FlightResult
from swarm.flight.setup import LOOSE_ERROR
from swarm.flight.state import Found
from swarm.flight.tlog import Then, left_off
from swarm.flight.training import require_emulated
from swarm.front.files import load_fleet
from swarm.ground.flight_process import FlightRequest, fly_in_process
from swarm.ground.fly import FlightCallbacks, FlyOptions, Unattended, with_found_team
from swarm.ground.ladder import require_steps
from swarm.ground.operator import parse_group
from swarm.ground.record import control_socket, new_record_folder
from swarm.ground.record_reader import (
    recorded_certificate,
    recorded_fleet,
    recorded_frames,
    recorded_log,
    recorded_plan,
)
from swarm.ground.relay import parse_forward
from swarm.ground.world_clock import require_clock
from swarm.mavlink.frames import AutopilotName
from swarm.mission import Mission
from swarm.mission.fleet import Fleet, emulated_fleet
from swarm.planner import certify_again
from swarm.planning.estimates import require_fleet
from swarm.reports.result import drawn, findings_table
from swarm.view import feeds

LARGEST_LOG = 1 << 30
"""Bytes of the packets of the interrupted flight."""


def resume_flight(
    context: click.Context,
    record: Path,
    folder: Path,
    options: FlyOptions,
    *,
    view: feeds.Live | None,
    as_json: bool,
    console_address: str | None,
    certificate: Path | None,
) -> None:
    """Resume the flight of a record with ``options``, and exit with its code."""
    console = Console(quiet=as_json)
    plan, fleet = recorded_plan(record), recorded_fleet(record)
    log = recorded_log(record, LARGEST_LOG)
    basis, assessment = recorded_certificate(record)
    flight_plan = ResumedFlight(plan, basis, assessment)
    if fleet.emulated is not None:
        raise Refused("the built-in emulator ended with its ground station: no vehicle is flying")
    moment = left_off(log, plan, fleet, recorded_frames(record, plan))
    attached = "carrying cable" if basis.cable else "without cable"
    console.print(
        f"Interrupted at {moment.mission_time:.1f} s of the plan, {attached}; searching for "
        f"{plan.vehicles} vehicles.",
        highlight=False,
    )
    options = replace(
        options, no_cable=not basis.cable, control=control_socket(folder), left=moment
    )
    prepare_flight()
    flight = _from_here(FlightRequest(flight_plan, fleet, folder, options), basis)
    plan = flight.flight_plan.plan
    with (
        displays(plan, folder, view, console, options.share) as shown,
        opened_console(folder, console_address, certificate, console),
        shown.screen,
    ):
        result = fly_in_process(
            flight,
            FlightCallbacks(on_snapshot=shown.on_snapshot, on_event=shown.on_event),
            read_keys=sys.stdin.isatty(),
            low_priority=True,
        )
    # What the report states as certified is shown again: now there is time for it.
    robustness = flight.flight_plan.assessment.robustness
    again = certify_again(plan if basis.cable else without_cable(plan), robustness)
    basis = confirmed_basis(plan, result.basis)
    kept = replace(result.adherence, certified=basis.max_tracking_error)
    result = replace(result, basis=basis, adherence=kept)
    end_flight(
        context,
        plan,
        again.assessment,
        result,
        folder,
        real=False,
        as_json=as_json,
        share=options.share,
    )


def _from_here(flight: FlightRequest, basis: Basis) -> FlightRequest:
    """Return a flight that is resumed; from where its vehicles are, if they are beside its fold.

    Where they are farther from their places than is certified, the rest of the fold is planned and
    certified from there. Where that is refused, the team only holds, at its places. Either is said
    on standard error.
    """
    plan, options = flight.flight_plan.plan, flight.options
    left = options.left
    if not basis.cable or left is None or options.then not in {"hold", "continue"}:
        return flight
    console = Console(stderr=True)

    def said(words: str) -> None:
        console.print(words, highlight=False, markup=False, soft_wrap=True)

    def rest(found: Found) -> FlightRequest:
        in_fold = left.gripped and plan.phase_at(found.time).name == "fold"
        if not in_fold or not (basis.max_tracking_error or 0.0) < found.off <= LARGEST:
            return flight
        said(
            f"The team is up to {found.off:.2f} m beside its places at {found.time:.1f} s of the "
            "plan: planning the rest of the fold from there."
        )
        certified = rest_of_fold(plan, found)
        require_tracking(basis_of(certified, cable=True), flight.fleet)
        seconds = certified.plan.phase("fold").duration
        said(f"It takes {seconds:.1f} s, and is certified. A rewind ends where it begins.")
        begins = replace(options, left=replace(left, mission_time=0.0, gate=0))
        return replace(flight, flight_plan=certified, options=begins)

    try:
        return with_found_team(flight.flight_plan, flight.fleet, options, rest) or flight
    except SwarmError as error:
        said(f"It is not planned anew:\n{error}")
    except Exception as error:
        report_bug(error)
    said("The team is led back to its places in the plan, and holds there.")
    return replace(flight, options=replace(options, then="hold"))


_FLIGHTS = Path("flights")
_NEEDS = {
    "positioning": ("firmware",),
    "mocap": ("fleet",),
    "rtcm": ("fleet",),
    "clock": ("fleet",),
    "console_certificate": ("console",),
    "skip_step": ("fleet",),
}
"""Options that go with others only."""
_RAISED_FLIGHT = (
    f"The fleet has no grippers (gripper: none): flown {RAISED:g} m higher, without contact with "
    f"the ground; tracking errors up to {LOOSE_ERROR:g} m do not stop the clock."
)


@dataclass(frozen=True)
class Options:
    """The argument and the options of the command."""

    mission: str | None
    overrides: tuple[str, ...]
    replan: bool
    as_json: bool
    verbose: bool
    fleet: Path | None
    speed: float
    no_cable: bool
    firmware: str | None
    positioning: str | None
    mocap: str | None
    rtcm: str | None
    clock: Path | None
    view: feeds.Live | None
    yes: bool
    record: Path | None
    forward: str | None
    resume: Path | None
    then: Then
    unattended: Unattended
    console: str | None
    console_certificate: Path | None
    share: str | None
    scenario: Path | None
    skip_step: bool

    def refuse_with_resume(self) -> None:
        """Raise :class:`InputError` for options whose values come from the resumed record."""
        given = {
            "MISSION": self.mission,
            "--set": self.overrides,
            "--replan": self.replan,
            "--fleet": self.fleet,
            "--no-cable": self.no_cable,
            "--firmware": self.firmware,
            "--positioning": self.positioning,
            "--speed": self.speed != 1.0,
        }
        message = "comes from the record with --resume"
        problems = [Problem(name, message) for name, value in given.items() if value]
        if problems:
            raise InputError(problems)


@click.command()
@click.argument("mission", metavar="[MISSION]", required=False)
@SET
@REPLAN
@JSON
@VERBOSE
@click.option(
    "--fleet",
    type=FILE,
    help="Fleet file: vehicles and their links. Default: the built-in emulator.",
)
@click.option(
    "--speed",
    type=click.FloatRange(0.1, 50.0),
    default=1.0,
    show_default=True,
    help="Multiple of real time; for emulated vehicles only.",
)
@click.option("--no-cable", is_flag=True, help="Fly without cable; simulate the grips.")
@click.option(
    "--firmware",
    metavar="KIND=PATH",
    help="Emulated vehicles of this kind fly with real firmware, as `swarm sitl --firmware`.",
)
@click.option(
    "--positioning",
    type=click.Choice(["gps", "rtk", "mocap"]),
    help="With --firmware: how these vehicles know their position, as `swarm sitl --positioning`.  "
    "[default: rtk]",
)
@MOCAP
@RTCM
@click.option(
    "--clock",
    type=FILE,
    help="With --fleet or --resume: follow the time in this file instead of the wall clock's. "
    "`swarm sitl --clock` writes it for vehicles that are simulated in another process.",
)
@VIEW
@YES
@click.option(
    "--record",
    type=FOLDER,
    help="Folder for the flight record. Default: a new folder in flights/.",
)
@click.option(
    "--forward",
    metavar="udp://HOST:PORT",
    type=Address(parse_forward),
    help="Send a copy of all packets of the vehicles there, for QGroundControl (port 14550); "
    "nothing that comes back is passed on.",
)
@click.option(
    "--resume",
    type=FOLDER,
    metavar="RECORD",
    help="Take over the team of this record after its ground station failed in flight.",
)
@click.option(
    "--then",
    type=click.Choice(get_args(Then)),
    default="hold",
    show_default=True,
    help="With --resume: action when all vehicles are found. For hold and continue, a team beside "
    "its places in the fold gets a new plan from there, certified.",
)
@click.option(
    "--unattended",
    type=click.Choice(get_args(Unattended)),
    default="hold",
    show_default=True,
    help="What the team does when the last screen of the flight is gone: the terminal is closed, "
    "and no other one is attached. hold: all land together after the hold timeout.",
)
@CONSOLE
@CONSOLE_CERTIFICATE
@click.option(
    "--share",
    metavar="GROUP",
    type=Address(parse_group),
    help="Members of this group of accounts of the machine may attach to the flight, and command "
    "the team. Default: only the account that began it.",
)
@click.option(
    "--scenario",
    type=FILE,
    help="Training: inject the faults of this scenario file (YAML) into emulated vehicles; the "
    "report has the times of detection and of the operator's reaction.",
)
@click.option(
    "--skip-step",
    is_flag=True,
    help="Fly cable with a fleet that has not passed the first tests before; the record says so.",
)
@click.pass_context
def fly(context: click.Context, /, **options: Any) -> None:
    """Plan MISSION (a mission or plan file, or the name of a knot), check the plan, and fly it.

    A plan file that `swarm plan --save` wrote is not planned again: the plan that was reviewed is
    certified again and flown.

    Without --fleet, the built-in emulator flies in a process of its own. Ctrl-C holds and then
    lands the team. The flight outlives this terminal: `swarm attach` shows it in another one. After
    a failure of the ground station in flight, --resume takes over the vehicles; plan and fleet come
    from the record.

    Example: swarm fly missions/overhand.yaml --fleet fleet.yaml --view
    """
    given = Options(**options)
    if given.console is not None:
        require_usable(parse_address(given.console), given.console_certificate)
    if given.resume is not None:
        refuse_option_conflicts(options, {}, [("resume", "scenario")])
        given.refuse_with_resume()
        require_clock(given.clock)
        folder = given.record or new_record_folder(_FLIGHTS, f"{given.resume.name}-resumed")
        resume_flight(
            context,
            given.resume,
            folder,
            FlyOptions(
                then=given.then,
                forward=given.forward,
                mocap=given.mocap,
                rtcm=given.rtcm,
                world_clock=given.clock,
                unattended=given.unattended,
                share=parse_group(given.share) if given.share is not None else None,
            ),
            view=given.view,
            as_json=given.as_json,
            console_address=given.console,
            certificate=given.console_certificate,
        )
        return
    if given.mission is None:
        raise click.UsageError("Missing argument 'MISSION'.")
    refuse_option_conflicts(options, _NEEDS, [])
    require_clock(given.clock)
    fleet = load_fleet(given.fleet) if given.fleet else None
    console = Console(quiet=given.as_json)
    scenario = None
    if given.scenario is not None:
        require_emulated(fleet)
        scenario = load_training(given.scenario, console)
    source = load_source(
        given.mission, given.overrides, replan=given.replan, flight=True, fleet=fleet
    )
    require_laboratory(given.mocap, fleet)
    if fleet is not None and isinstance(source.given, Mission):
        require_fleet(source.given, fleet)
    planned = source.planned()
    require_cleared(context, planned, verbose=given.verbose, as_json=given.as_json)
    team = fleet or _emulated_fleet(planned.plan.vehicles, given.firmware)
    if given.positioning == "mocap":
        team = team.model_copy(update={"frame": "shared"})
    flight_plan = raised(planned.certified(), team, no_cable=given.no_cable)
    if flight_plan.plan is not planned.plan:
        console.print(_RAISED_FLIGHT, style="dim", highlight=False, soft_wrap=True)
    real = team.emulated is None and given.clock is None
    skipped: tuple[str, ...] = ()
    if real:
        skipped = require_steps(flight_plan, team, no_cable=given.no_cable, skip=given.skip_step)
    systems = team.systems[: planned.plan.vehicles]
    training = scenario.training(systems) if scenario is not None else None
    folder = given.record or new_record_folder(_FLIGHTS, planned.plan.mission.name)
    control = control_socket(folder)
    flight = FlightRequest(
        flight_plan, team, folder,
        FlyOptions(
            speed=given.speed, no_cable=given.no_cable, control=control, forward=given.forward,
            firmware=given.firmware, positioning=given.positioning or "rtk", mocap=given.mocap,
            rtcm=given.rtcm, world_clock=given.clock, unattended=given.unattended,
            training=training, skipped=skipped,
            screens_answer=team.emulated is None and not given.yes,
            share=parse_group(given.share) if given.share is not None else None,
        ),
        confirm=True,
    )  # fmt: skip
    result = _fly(flight, given, console)
    end_flight(
        context, flight_plan.plan, planned.assessment, result, folder,
        real=real, as_json=given.as_json, share=flight.options.share,
    )  # fmt: skip


def _emulated_fleet(count: int, firmware: str | None) -> Fleet:
    """Return emulated vehicles; those of ``--firmware`` are of its kinds, in its order.

    Real autopilots carry the swinging cable: a cable without inertia answers each motion of a
    grip at once, which no control loop in steps stands.
    """
    if firmware is None:
        return emulated_fleet(count)
    matches = re.findall(r"(?:(\d+)\*)?(\w+)=", firmware)
    known = get_args(AutopilotName)
    kinds = [kind for number, kind in matches if kind in known for _ in range(int(number or 1))]
    return emulated_fleet(count, tuple(kinds) or ("px4",), cable="swinging")


def _fly(flight: FlightRequest, given: Options, console: Console) -> FlightResult:
    """Fly with terminal and viewer, after the operator's confirmation for real vehicles."""
    unasked = flight.fleet.emulated is not None or given.yes
    plan = flight.flight_plan.plan
    plan_findings = flight.flight_plan.assessment.findings
    prepare_flight()
    warnings = [finding for finding in plan_findings if finding.severity == "warning"]
    with (
        displays(plan, flight.folder, given.view, console, flight.options.share) as shown,
        opened_console(flight.folder, given.console, given.console_certificate, console),
        ExitStack() as screen,
    ):
        answered = threading.Event()
        confirm = _confirmation(
            shown, screen, console, unasked=unasked, warnings=warnings, answered=answered,
            read=given.console is None or sys.stdin.isatty(),
        )  # fmt: skip
        return fly_in_process(
            flight,
            FlightCallbacks(
                confirm=confirm,
                on_answered=answered.set,
                on_snapshot=shown.on_snapshot,
                on_event=shown.on_event,
            ),
            read_keys=sys.stdin.isatty(),
            low_priority=True,
        )


def _confirmation(
    shown: Displays,
    screen: ExitStack,
    console: Console,
    *,
    unasked: bool,
    warnings: Sequence[Finding],
    answered: threading.Event,
    read: bool,
) -> Callable[[Audit], bool | None]:
    """Return the confirmation before arming: a question unless ``unasked``, and a countdown.

    Before the question the ``warnings`` of the plan and the findings of the audit are printed. The
    screen starts after the question, or now. Without ``read`` only other screens answer. What is
    ``answered`` needs no answer, nor a countdown: None.
    """
    if unasked:
        screen.enter_context(shown.screen)

    def confirm(audit: Audit) -> bool | None:
        if not unasked:
            console.print(drawn(findings_table([*warnings, *in_common(audit.findings)])))
            answer = confirmed("Arm and fly?", answered.is_set, read=read)
            if answer is None:
                click.echo("\nanswered on another screen, or ended", err=True)
            elif not answer:
                return False
            screen.enter_context(shown.screen)
        for seconds in range(COUNTDOWN, 0, -1):
            if answered.is_set():
                return None
            shown.screen.countdown(seconds)
            answered.wait(1.0)
        return True

    return confirm
