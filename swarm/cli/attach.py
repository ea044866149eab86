"""``swarm attach`` and ``swarm flights``: screens of flights that another terminal began."""

import getpass
import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path

import click
from rich.console import Console

from swarm.cli.flight_session import (
    CONSOLE,
    CONSOLE_CERTIFICATE,
    REPORT,
    VIEW,
    Displays,
    opened_console,
    recorded_report,
)
from swarm.cli.inputs import FOLDER, JSON, print_json, refuse_option_conflicts
from swarm.errors import InputError, Problem, Refused, VehicleError, reason
from swarm.files import write_text
from swarm.flight.snapshot import Checked, Event, Snapshot
from swarm.ground.flight_process import MODULE
from swarm.ground.ladder import enter
from swarm.ground.operator import read_screen_line, terminal_keys
from swarm.ground.record import control_socket
from swarm.ground.record_reader import recorded_plan
from swarm.ground.record_verification import verify_record
from swarm.reports.formatting import clock
from swarm.reports.terminal import FlightScreen
from swarm.view import feeds

_POLL = 0.05
_ANSWERS = 2.0
"""Seconds within which a flight answers: two hundred times its tick."""
_ENDS = 10.0
"""Seconds within which a flight that has ended writes its summary."""
_DETACH = "d"


@click.command()
@click.argument("record", type=FOLDER, metavar="[RECORD]", required=False)
@VIEW
@CONSOLE
@CONSOLE_CERTIFICATE
@click.pass_context
def attach(
    context: click.Context,
    record: Path | None,
    view: feeds.Live | None,
    console: str | None,
    console_certificate: Path | None,
) -> None:
    """Show a flight that another terminal began, with its keys; the key d detaches.

    RECORD is the folder of its record; without it, the only flight that runs. Ctrl-C holds and
    lands the team, as in the terminal that began the flight. A console that was opened with
    --console goes on until the flight ends.

    Example: swarm attach flights/2025-06-01T10-00-00-overhand
    """
    certificate = console_certificate
    given = {"console": console, "console_certificate": certificate}
    refuse_option_conflicts(given, {"console_certificate": ("console",)}, [])
    folder = record if record is not None else _only_flight()
    connection = _connect(folder)
    plan, terminal = recorded_plan(folder), Console()
    sender = _Sender(connection)
    signal.signal(signal.SIGINT, lambda *_: sender.line("interrupt"))
    viewer = feeds.start(plan, None, view)
    if viewer.message:
        terminal.print(viewer.message, soft_wrap=True, highlight=False)
    shown = Displays(FlightScreen(plan, terminal, keys=sys.stdin.isatty()), viewer)
    sender.line(f"name {getpass.getuser()} at an attached terminal")
    sender.line("watch")
    with (
        connection,
        closing(viewer),
        opened_console(folder, console, certificate, terminal),
        shown.screen,
        terminal_keys(sender.key) as poll_keys,
    ):
        for item in _watched(connection):
            if isinstance(item, Snapshot):
                shown.on_snapshot(item)
            elif isinstance(item, Event):
                shown.on_event(item)
            poll_keys()
            if sender.detached:
                terminal.print("Detached: the flight goes on.", highlight=False)
                return
    code = _print_outcome(folder, terminal)
    context.exit(code)


@click.command()
@JSON
def flights(as_json: bool) -> None:
    """List the flights that run on this machine, with their records.

    Example: swarm flights
    """
    rows = [(folder, _state(folder)) for folder in running_flights()]
    if as_json:
        print_json(
            [
                {
                    "record": str(folder),
                    "phase": state.phase if state else None,
                    "mission_time": state.mission_time if state else None,
                    "held": state.held if state else None,
                }
                for folder, state in rows
            ]
        )
        return
    console = Console()
    if not rows:
        console.print("No flight runs on this machine.", highlight=False)
        return
    for folder, state in rows:
        words = "does not answer"
        if state is not None:
            words = f"{state.phase or 'on the ground'}, {clock(state.mission_time)} of the plan"
            words += f", held: {state.held}" if state.held else ""
        console.print(f"{folder}: {words}", soft_wrap=True, highlight=False, markup=False)


def running_flights() -> list[Path]:
    """Return the folders of the records of the flights that run on this machine."""
    listed = subprocess.run(
        ["ps", "-ww", "-e", "-o", "args="],  # noqa: S607 - the system's ps
        capture_output=True, text=True, check=False,
    ).stdout  # fmt: skip
    rows = (row for row in listed.splitlines() if f"'{MODULE}'" in row)
    folders = [Path(folder) for row in rows for folder in re.findall(r" \d+ (/.*)$", row)]
    return sorted(folders)


@dataclass
class _Sender:
    """Sends the keys of this terminal to the flight."""

    connection: socket.socket
    detached: bool = False

    def key(self, key: str) -> None:
        """Send a key; the one that detaches stays here."""
        if key == _DETACH:
            self.detached = True
        else:
            self.line(f"key {key}")

    def line(self, text: str) -> None:
        """Send a line; that the flight has ended is what reading reports."""
        with suppress(OSError):
            self.connection.sendall(text.encode() + b"\n")


def _only_flight() -> Path:
    """Return the record of the only flight that runs; raises :class:`Refused` without it."""
    folders = running_flights()
    if len(folders) == 1:
        return folders[0]
    if not folders:
        raise Refused("no flight runs on this machine")
    listed = "".join(f"\n  {folder}" for folder in folders)
    raise InputError(f"RECORD: expected one of the flights that run:{listed}")


def _connect(folder: Path) -> socket.socket:
    """Return a connection to the control socket of a flight."""
    path = control_socket(Path(os.path.relpath(folder)))
    if path is None:
        raise InputError([Problem(str(folder), "too long a path for a control socket")])
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        connection.connect(str(path))
    except PermissionError:
        words = "only the account that began this flight may attach, and the group of --share"
        raise Refused(f"{folder}: {words}") from None
    except OSError as error:
        connection.close()
        why = "it has ended" if (folder / "summary.json").exists() else reason(error)
        words = f"expected the record of a flight that runs: {why}"
        raise InputError([Problem(str(folder), words)]) from None
    return connection


def _watched(connection: socket.socket) -> Iterator[Snapshot | Event | Checked | str | None]:
    """Yield what the flight shows until it ends; None whenever nothing arrives for a moment."""
    received = b""
    while True:
        if not select.select([connection], [], [], _POLL)[0]:
            yield None
            continue
        try:
            data = connection.recv(1 << 16)
        except OSError:
            return
        if not data:
            return
        *lines, received = (received + data).split(b"\n")
        for line in lines:
            try:
                yield read_screen_line(line)
            except ValueError as error:
                raise VehicleError(
                    f"the flight sent what this version cannot read: {error}"
                ) from None


def _state(folder: Path) -> Snapshot | None:
    """Return the newest snapshot of a flight; None where it does not answer."""
    try:
        with _connect(folder) as connection:
            connection.sendall(b"snapshot\n")
            latest = time.monotonic() + _ANSWERS
            for item in _watched(connection):
                if isinstance(item, Snapshot):
                    return item
                if time.monotonic() > latest:
                    return None
    except (InputError, Refused, VehicleError, OSError):
        return None
    return None


def _complete(folder: Path, console: Console) -> None:
    """Write the page of a flight whose own terminal is gone, and enter the first test it passes.

    Another account, with which the flight is shared, only reads its record.
    """
    if (folder / REPORT).exists() or not os.access(folder, os.W_OK):
        return
    try:
        verified = verify_record(folder)
        enter(verified)
        write_text(folder / REPORT, recorded_report(verified))
    except InputError as error:
        console.print(f"Report: not written: {error}", soft_wrap=True, markup=False)


def _print_outcome(folder: Path, console: Console) -> int:
    """Print how a flight ended, once its record is complete; return its exit code."""
    latest = time.monotonic() + _ENDS
    while True:
        try:
            ended = json.loads((folder / "summary.json").read_text())
            word, explanation, code = ended["outcome"], ended["explanation"], ended["exit_code"]
            break
        except (OSError, ValueError, KeyError):
            if time.monotonic() > latest:
                message = f"{folder}: the flight ended without a summary"
                raise VehicleError(message) from None
            time.sleep(_POLL)
    _complete(folder, console)
    words = f"{word}: {explanation}" if explanation else word
    console.print(words, soft_wrap=True, highlight=False, markup=False)
    console.print(f"Record: {folder}", soft_wrap=True, highlight=False)
    return int(code)
