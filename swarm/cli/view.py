"""``swarm view``: open a flight's record, a recording or a plan in the Rerun viewer."""

import tempfile
from pathlib import Path

import click
from rich.console import Console

from swarm import api
from swarm.cli.inputs import SET, load_mission, progress_bar
from swarm.cli.records import recorded_flight, recorded_plan
from swarm.errors import InputError, Interrupted, Problem, SwarmError
from swarm.view.replay import write_flight, write_plan
from swarm.view.screenshot import NoPicture, screenshot
from swarm.view.viewers import free_port, has_display, open_window, serve, web_url


@click.command()
@click.argument("source", metavar="RECORD|FILE.rrd|MISSION")
@SET
@click.option("--web", is_flag=True, help="Serve the viewer as a page on this machine only.")
@click.option(
    "--screenshot",
    "picture",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Render a PNG instead of opening a window; needs no screen.",
)
@click.option("--at", type=float, metavar="SECONDS", help="With --screenshot: the moment to show.")
@click.option(
    "--only", metavar="VIEW", help="With --screenshot: one of the views, for example Knot."
)
@click.option(
    "--compare", is_flag=True, help="With RECORD: planned and flown side by side, from its .tlog."
)
@click.option(
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    help="With MISSION: keep the plan's recording in this file (.rrd).",
)
def view(
    source: str,
    overrides: tuple[str, ...],
    web: bool,
    picture: Path | None,
    at: float | None,
    only: str | None,
    compare: bool,
    output: Path | None,
) -> None:
    """Open a flight's RECORD (its folder), a recording, or the plan of a MISSION in Rerun.

    A mission (a file or a knot's name) is planned first. The command ends when the window is
    closed; with --web, when it is interrupted.
    """
    with tempfile.TemporaryDirectory(prefix="swarm-") as folder:
        recording = find_recording(Path(source))
        if recording is None:
            recording = output or Path(folder) / "plan.rrd"
            with progress_bar(Console(stderr=True)) as progress:
                planned = api.plan(load_mission(source, overrides), progress)
            write_plan(planned.plan, recording)
        sources = [recording]
        if compare:
            sources = [_verification(Path(source), Path(folder) / "verification.rrd")]
        if picture is not None:
            _picture(sources, picture, at, only)
        elif web:
            _serve(sources)
        elif has_display():
            open_window(*map(str, sources)).wait()
        else:
            click.echo("no display here; see it with --web, or as a picture with --screenshot")


def _verification(record: Path, path: Path) -> Path:
    """Write what the record's .tlog says was flown beside its plan, arranged for verification."""
    plan = recorded_plan(record)
    write_flight(plan, recorded_flight(record, plan).trace, (), path)
    return path


def find_recording(source: Path) -> Path | None:
    """Return the recording of a record's folder or the file itself; None where it is neither.

    Raises :class:`InputError` for a folder without a recording.
    """
    if source.is_dir():
        found = sorted(source.glob("*.rrd"))
        if not found:
            raise InputError([Problem(str(source), "expected a record with an .rrd file in it")])
        return found[0]
    if source.suffix == ".rrd":
        if not source.is_file():
            raise InputError([Problem(str(source), "no such file")])
        return source
    return None


def _picture(sources: list[Path], picture: Path, at: float | None, only: str | None) -> None:
    try:
        screenshot(sources, picture, at=at, view=only)
    except NoPicture as error:
        raise SwarmError(str(error)) from None
    except OSError as error:
        raise InputError([Problem(str(picture), (error.strerror or "").lower())]) from None
    click.echo(f"{picture}")


def _serve(sources: list[Path]) -> None:
    port, web_port = free_port(), free_port()
    server = serve(port, web_port, *sources)
    click.echo(f"{web_url(web_port, port)} — ends with Ctrl-C")
    try:
        server.wait()
    except KeyboardInterrupt:
        raise Interrupted("no longer served") from None
    finally:
        server.terminate()
        server.wait()
