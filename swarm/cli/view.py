"""``swarm view``: open a flight record, a recording or a plan in the Rerun viewer."""

import math
import tempfile
from pathlib import Path
from typing import Any

import click

from swarm.cli.inputs import OUTPUT, REPLAN, SET
from swarm.cli.planning import load_source
from swarm.errors import InputError, Interrupted, Problem, reason
from swarm.ground.record_reader import recorded_flight, recorded_plan
from swarm.view.replay import write_flight, write_plan
from swarm.view.screenshot import screenshot
from swarm.view.viewers import (
    Process,
    ViewerFailed,
    ending,
    exit_description,
    free_port,
    has_display,
    serve,
    web_url,
    window,
)

_RECORDING = b"RRF"
"""The first bytes of a Rerun recording; the version follows."""


@click.command()
@click.argument("source", metavar="RECORD|FILE.rrd|FILE.plan|MISSION")
@SET
@REPLAN
@click.option("--web", is_flag=True, help="Serve the viewer as a web page, on this machine only.")
@click.option(
    "--screenshot",
    "picture",
    type=OUTPUT,
    help="Render a PNG without a window; needs no display.",
)
@click.option("--at", type=float, metavar="SECONDS", help="With --screenshot: the time to show.")
@click.option(
    "--only",
    metavar="VIEW",
    help="With --screenshot: the view to show: Knot or Field (of a flight or a plan), Planned or "
    "Flown (with --compare), or another view by its name.",
)
@click.option(
    "--compare",
    is_flag=True,
    help="With RECORD: planned and flown motion side by side, from its .tlog.",
)
@click.option(
    "--output",
    type=OUTPUT,
    help="With MISSION: write the recording of the plan to this file (.rrd).",
)
def view(
    source: str,
    overrides: tuple[str, ...],
    replan: bool,
    web: bool,
    compare: bool,
    output: Path | None,
    **picture_options: Any,
) -> None:
    """Open a flight RECORD (a folder), a recording, or the plan of a MISSION in Rerun.

    A mission (a file or the name of a knot) is planned first; a plan file is certified again. The
    command ends when the window is closed; with --web, at an interrupt.

    Example: swarm view flights/2025-06-01T10-00-00-overhand --compare
    """
    picture = _picture_options(**picture_options)
    with tempfile.TemporaryDirectory(prefix="swarm-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        recording = find_recording(Path(source))
        if recording is None:
            recording = output or folder / "plan.rrd"
            write_plan(load_source(source, overrides, replan=replan).planned().plan, recording)
        else:
            _require_recording(recording)
        sources = [recording]
        if compare:
            sources = [_verification(Path(source), folder / "verification.rrd")]
        if picture is not None:
            _picture(sources, *picture)
        elif web:
            _serve(sources, folder)
        elif has_display():
            with ending(window(*map(str, sources), folder=folder)) as shown:
                _wait(shown, folder)
        else:
            click.echo("no display: use --web, or --screenshot for a picture")


def _picture_options(
    picture: Path | None, at: float | None, only: str | None
) -> tuple[Path, float | None, str | None] | None:
    """Return the file, the time and the view of a screenshot; None without one.

    Raises :class:`click.UsageError` for options without their file, and for times before 0.
    """
    if picture is None and (at is not None or only is not None):
        raise click.UsageError("--at and --only belong to --screenshot")
    if at is not None and not 0.0 <= at < math.inf:
        raise click.UsageError(f"--at: expected seconds from 0 on, got {at:g}")
    return None if picture is None else (picture, at, only)


def _verification(record: Path, path: Path) -> Path:
    """Write a recording of the flown motion, from the .tlog, beside the planned motion."""
    plan = recorded_plan(record)
    write_flight(plan, recorded_flight(record, plan).trace, (), path)
    return path


def find_recording(source: Path) -> Path | None:
    """Return the recording in a record, or the recording itself; None for another source.

    Raises :class:`InputError` for a folder without a recording.
    """
    if source.is_dir():
        recordings = sorted(source.glob("*.rrd"))
        if not recordings:
            raise InputError(
                [Problem(str(source), "expected a flight record with an .rrd file in it")]
            )
        return recordings[0]
    if source.suffix == ".rrd":
        if not source.is_file():
            raise InputError([Problem(str(source), "no such file")])
        return source
    return None


def _require_recording(path: Path) -> None:
    """Raise :class:`InputError` for a file that is no recording: the viewer would stay empty."""
    try:
        with path.open("rb") as file:
            begins = file.read(len(_RECORDING))
    except OSError as error:
        raise InputError([Problem(str(path), reason(error))]) from None
    if begins != _RECORDING:
        got = "another kind of file" if begins else "an empty file"
        raise InputError([Problem(str(path), f"expected a Rerun recording, got {got}")])


def _picture(sources: list[Path], picture: Path, at: float | None, only: str | None) -> None:
    try:
        screenshot(sources, picture, at=at, view=only)
    except OSError as error:
        raise InputError([Problem(str(picture), reason(error))]) from None
    click.echo(f"{picture}")


def _serve(sources: list[Path], folder: Path) -> None:
    port, web_port = free_port(), free_port()
    try:
        with ending(serve(port, web_port, *sources, folder=folder)) as server:
            click.echo(f"{web_url(web_port, port)} — ends with Ctrl-C")
            _wait(server, folder)
    except KeyboardInterrupt:
        raise Interrupted("the viewer has stopped") from None


def _wait(process: Process, folder: Path) -> None:
    """Wait until the viewer ends; raises :class:`ViewerFailed` if it failed."""
    if process.wait():
        raise ViewerFailed(exit_description(process, folder))
