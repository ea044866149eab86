"""The ``swarm`` command: a shell around the library that turns errors into exit codes."""

import os
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from types import FrameType

import click

from swarm.errors import InputError, Interrupted, SwarmError, reason
from swarm.version import __version__

# Vectors here are too short to be worth several threads, which spin while they wait for more and
# take the cores from the loop that flies. NumPy reads this when it is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

COMMANDS = {
    "fly": ("fly", "Plan a mission, check it, and fly it."),
    "dry-run": ("dry_run", "Fly a mission against the emulator in virtual time."),
    "check": ("check", "Check a fleet on the ground, before anything is armed."),
    "plan": ("plan", "Plan a mission, check it, and show or export the plan."),
    "certify": ("certify", "Check anybody's trajectories in the cable model."),
    "verify": ("verify", "Tell from a flight's record what was flown."),
    "view": ("view", "Open a record, a plan or a mission in the Rerun viewer."),
    "failures": ("responses", "Print the team's response to every failure."),
    "knots": ("knots", "List the knots, or show one."),
    "identify": ("knots", "Name the knot of a curve in space."),
    "init": ("files", "Write a commented mission file for a knot."),
    "schema": ("files", "Print the JSON schema of mission, fleet, world or scenario files."),
    "sitl": ("sitl", "Run emulated vehicles alone, for anybody's client."),
}
"""Command → module of swarm.cli that defines it, and what ``swarm --help`` says of it."""


class Commands(click.Group):
    """Loads a command's module when that command is asked for: help must not wait for SciPy."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Return the commands in the order in which they are shown."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Import and return a command, or None where there is none of that name."""
        if cmd_name not in COMMANDS:
            return None
        module = import_module(f"swarm.cli.{COMMANDS[cmd_name][0]}")
        command: click.Command = getattr(module, cmd_name.replace("-", "_"))
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Write the list of commands from the table above."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


@click.command(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="swarm")
def cli() -> None:
    """Make a team of quadrotors tie a knot in a cable in mid-air.

    Exit codes: 0 done, 1 refused, 2 usage or bad file, 3 link or vehicle failure, 130 interrupted.
    """


def main() -> None:
    """Run the command line and exit with its code."""
    try:
        with ends_as_interrupted():
            code = cli(standalone_mode=False)
    except click.ClickException as error:
        error.show()
        code = InputError.exit_code
    except (click.exceptions.Abort, KeyboardInterrupt):
        code = Interrupted.exit_code
    except SwarmError as error:
        click.echo(f"{error}", err=True)
        code = error.exit_code
    except BrokenPipeError:
        sys.stderr.close()  # whoever reads us has enough; nothing is left to say it to
        code = 0
    except Exception as error:
        code = _own_fault(error)
    sys.exit(code if isinstance(code, int) else 0)


@contextmanager
def ends_as_interrupted() -> Iterator[None]:
    """Have SIGTERM and SIGHUP end a command as Ctrl-C does.

    Otherwise they would end this process on the spot: its children would stay, and its temporary
    folders. A signal that is ignored (nohup) stays so, and a flight answers for itself.
    """

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        for each in before:
            signal.signal(each, signal.SIG_IGN)  # what cleans up is not interrupted once more
        raise KeyboardInterrupt

    names = ("SIGTERM", "SIGHUP")
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    before = {
        number: signal.getsignal(number)
        for number in numbers
        if signal.getsignal(number) == signal.SIG_DFL
        and threading.current_thread() is threading.main_thread()
    }
    for number in before:
        signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _own_fault(error: Exception) -> int:
    """Say that this is our bug, keep the traceback in a file for the report, return EX_SOFTWARE."""
    click.echo(f"swarm has a bug: {type(error).__name__}: {reason(error)}", err=True)
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="swarm-", suffix=".txt", delete=False, encoding="utf-8"
        ) as file:
            traceback.print_exception(error, file=file)
    except OSError as full:
        click.echo(f"What to report with it cannot be kept: {reason(full)}", err=True)
    else:
        click.echo(f"Please report it together with {file.name}", err=True)
    return 70
