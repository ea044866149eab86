"""The displays of a flight and its end, shared by ``swarm fly`` and ``swarm fly --resume``."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import click
from rich.console import Console

from swarm.certification.assessment import Assessment
from swarm.cli.inputs import Address, print_json
from swarm.console.launch import DEFAULT, open_console, parse_address
from swarm.errors import InputError, Interrupted
from swarm.files import write_text
from swarm.flight.result import FlightResult
from swarm.flight.snapshot import Event, Snapshot
from swarm.ground.corrections import parse_source
from swarm.ground.ladder import STEPS, enter
from swarm.ground.mocap import parse_url
from swarm.ground.record import refuse_used, shared_folder
from swarm.ground.record_reader import recorded_certificate
from swarm.ground.record_verification import VerifiedRecord, recorded_result, verify_record
from swarm.mission.fleet import Fleet
from swarm.planning import Plan
from swarm.reports.flight import flight_report, outcome_object, print_outcome
from swarm.reports.terminal import FlightScreen
from swarm.verification import verify_trace
from swarm.view import feeds

RTCM = click.option(
    "--rtcm",
    metavar="KIND://SOURCE",
    type=Address(parse_source),
    help="Send corrections (RTCM 3) to the vehicles' receivers: ntrip://[USER:PASSWORD@]HOST[:PORT]"
    "/MOUNTPOINT (ntrips: with TLS), serial://DEVICE[:BAUD], udp://HOST:PORT, or file:PATH.",
)
MOCAP = click.option(
    "--mocap",
    metavar="KIND://HOST",
    type=Address(parse_url),
    help="Send the poses of a motion capture system to the vehicles (fleets with frame: shared), "
    "where no `swarm mocap` does: vicon, optitrack, qualisys, vrpn and others of libmotioncapture, "
    "or udp://HOST:PORT.",
)


def require_laboratory(mocap: str | None, fleet: Fleet | None, *, option: str = "--mocap") -> None:
    """Raise :class:`InputError` for poses for a fleet that has no place for them."""
    if mocap and fleet is not None and fleet.frame != "shared":
        raise InputError(f"{option}: expected a fleet with frame: shared, got {fleet.frame}")


VIEW = click.option(
    "--view",
    is_flag=False,
    flag_value="native",
    type=click.Choice(get_args(feeds.Live)),
    help="Show the flight in Rerun: its own window, or `web` for a page on this machine. "
    "`foxglove` serves Foxglove, on this machine; with fly, it keeps flight.mcap in the record.",
)
CONSOLE = click.option(
    "--console",
    is_flag=False,
    flag_value=DEFAULT,
    metavar="[ADDRESS:PORT]",
    type=Address(parse_address),
    help="Serve a page with the flight, live, and its buttons: on this machine alone "
    f"({DEFAULT}), or on another address, with TLS. The address that is printed has the token.",
)
CONSOLE_CERTIFICATE = click.option(
    "--console-certificate",
    type=click.Path(dir_okay=False, path_type=Path),
    help="With --console: PEM file with a certificate and its private key. Default: a self-signed "
    "certificate, on addresses that other machines reach.",
)


@contextmanager
def opened_console(
    folder: Path, address: str | None, certificate: Path | None, console: Console
) -> Iterator[None]:
    """Open the console of a flight, if it has an address, and print where it is."""
    if address is None:
        yield
        return
    with open_console(folder, parse_address(address), certificate) as opened:
        if console.quiet:
            click.echo(opened.message, err=True)  # standard output is JSON alone
        else:
            console.print(opened.message, soft_wrap=True, highlight=False, markup=False)
        yield


REPORT = "report.html"
"""The page of a flight in its record."""


def recorded_report(verified: VerifiedRecord) -> str:
    """Return the page of a flight from its record, as the flight's own terminal writes it.

    Raises :class:`InputError` for a record without a certificate, or that did not end.
    """
    plan, result = verified.plan, recorded_result(verified)
    _, recorded = recorded_certificate(verified.record)
    assessment = replace(verified.assessment, robustness=recorded.robustness)
    outcome = outcome_object(plan, result, verified.verification, assessment)
    return flight_report(plan, assessment, outcome, result.trace, result.events)


def note_first_test(folder: Path, *, real: bool) -> None:
    """Verify the record of a flight of real vehicles, and say which first test it passes."""
    if not real:
        return
    console = Console(stderr=True)
    try:
        entered = enter(verify_record(folder))
    except InputError as error:
        console.print(f"First tests: not noted: {error}", soft_wrap=True, markup=False)
        return
    if entered is not None:
        words = f"First test passed: {STEPS[entered.step][0]}"
        console.print(words, style="dim", highlight=False, soft_wrap=True)


@dataclass(frozen=True)
class Displays:
    """The displays of a flight: terminal and Rerun."""

    screen: FlightScreen
    viewer: feeds.Viewer

    def on_snapshot(self, snapshot: Snapshot) -> None:
        """Show the state of the team."""
        self.screen.show(snapshot)
        self.viewer.offer(snapshot)

    def on_event(self, event: Event) -> None:
        """Show an event."""
        self.screen.event(event)
        self.viewer.offer(event)


@contextmanager
def displays(
    plan: Plan, folder: Path, view: feeds.Live | None, console: Console, share: int | None
) -> Iterator[Displays]:
    """Create the folder of the record, start Rerun's log in it, and yield the displays.

    The members of the group ``share``, if any, may read them.

    Raises :class:`InputError` for a folder that cannot be created or holds a record, and
    :class:`Interrupted` where the output is closed: the flight goes on without this screen.
    """
    with shared_folder(folder, share):
        refuse_used(folder)
        viewer = feeds.start(plan, folder / "flight.rrd", view)
    try:
        if viewer.message:
            console.print(viewer.message, soft_wrap=True, highlight=False)
        yield Displays(FlightScreen(plan, console, keys=sys.stdin.isatty()), viewer)
    except (BrokenPipeError, SystemExit):  # Rich ends the program where its output is closed
        raise Interrupted(
            f"the output was closed, and the flight goes on: swarm attach {folder}"
        ) from None
    finally:
        viewer.close()


def end_flight(
    context: click.Context,
    plan: Plan,
    assessment: Assessment,
    result: FlightResult,
    folder: Path,
    *,
    real: bool,
    as_json: bool,
    share: int | None,
) -> None:
    """Write the report of a flight, print its outcome, and exit with its code.

    A whole flight of ``real`` vehicles is verified, and entered where it passes a first test.
    """
    verification = verify_trace(plan, result.trace)
    outcome = outcome_object(plan, result, verification, assessment)
    report = flight_report(plan, assessment, outcome, result.trace, result.events)
    unwritten = None
    try:
        with shared_folder(folder, share):
            write_text(folder / REPORT, report)
    except InputError as full:
        unwritten = full
    note_first_test(folder, real=real)
    if as_json:
        print_json(outcome)
    else:
        console = Console()
        print_outcome(plan, result, outcome, console)
        console.print(f"Record: {folder}", soft_wrap=True, highlight=False)
    if unwritten is not None:
        click.echo(f"The report was not written: {unwritten}", err=True)
    error = result.error()
    if error is not None:
        raise error
    context.exit(0 if verification.as_planned else 1)
