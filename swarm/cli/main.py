"""The ``swarm`` command.

The planner and its libraries take a second to import: mission and fleet files are validated before
the module of a command is imported. Old spellings of commands and options keep working, with a
note.
"""

import gc
import os
import shlex
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from itertools import zip_longest
from types import FrameType

import click
from click.shell_completion import BashComplete, CompletionItem, FishComplete, ZshComplete

from swarm.child_modules import module_command
from swarm.errors import InputError, Interrupted, SwarmError, nearest, reason
from swarm.version import __version__

_WITH_MISSION = frozenset({"plan", "dry-run", "trials", "failures", "rope", "check", "fly"})
"""Commands whose argument is a mission, a plan file or the name of a knot."""


def validate_files(arguments: Sequence[str]) -> None:
    """Raise :class:`swarm.errors.InputError` for a wrong mission or fleet file of a command.

    ``arguments`` begin with the command. A mission is found right after the command only; what is
    not found here is validated by the command itself.
    """
    command, *rest = arguments or ("",)
    if command not in _WITH_MISSION or {"-h", "--help"} & set(rest):
        return
    from swarm.front.files import is_plan_file, load_fleet, load_mission  # noqa: PLC0415 - slow

    if rest and not rest[0].startswith("-") and not is_plan_file(rest[0]):
        counts = [f"vehicles.count={count}" for count in _values("--vehicles", rest)]
        load_mission(rest[0], (*_values("--set", rest), *counts))
    for fleet in _values("--fleet", rest):
        load_fleet(fleet)


def _values(option: str, arguments: Sequence[str]) -> Iterator[str]:
    """Yield the values of an option that can be repeated."""
    for argument, following in zip_longest(arguments, arguments[1:]):
        name, equals, value = argument.partition("=")
        if name == option and equals:
            yield value
        elif name == option and following is not None:
            yield following


_OPTIONS: Mapping[str, Mapping[str, str]] = {
    "trials": {"--trials": "--count", "--results": "--output"},
    "failures": {"--times": "--repeat", "--row": "--filter", "--results": "--output"},
    "knots": {"--only": "--filter", "--to": "--output"},
}
"""Command → old name of an option → its name."""


def current_spelling(arguments: Sequence[str]) -> list[str]:
    """Return the arguments of ``swarm`` with every old spelling replaced.

    ``dry-run`` with ``--trials``, ``--failures`` or ``--rope`` was what ``trials``, ``failures``
    and ``rope`` are now.
    """
    if not arguments:
        return []
    command, *rest = arguments
    if command == "dry-run":
        names = [argument.partition("=")[0] for argument in rest]
        command = next(
            (word for word in ("trials", "failures", "rope") if f"--{word}" in names), command
        )
        if command in ("failures", "rope"):
            rest.remove(f"--{command}")
    renamed = _OPTIONS.get(command, {})
    return [command, *(_renamed(argument, renamed) for argument in rest)]


def _renamed(argument: str, names: Mapping[str, str]) -> str:
    name, equals, value = argument.partition("=")
    return names.get(name, name) + equals + value


# The vectors are too short for several threads, which spin while they wait and take the cores from
# the flight loop. NumPy reads this when it is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

SECTIONS = {
    "Plan and simulate": {
        "plan": ("plan", "Plan a mission, check the plan, and show or export it."),
        "dry-run": ("dry_run", "Simulate one flight of a mission in virtual time."),
        "trials": ("trials", "Simulate many flights, each under other conditions."),
        "failures": ("failures", "Run failure tests, or print the response to every failure."),
        "rope": ("rope", "Simulate a rope with contact, and identify its knot."),
    },
    "Fly": {
        "check": ("check", "Check a fleet on the ground, before arming."),
        "fly": ("fly", "Plan, check and fly a mission."),
        "attach": ("attach", "Show a flight that another terminal began, with its keys."),
        "mocap": ("mocap", "Send the poses of motion capture to the vehicles, beside flights."),
        "flights": ("attach", "List the flights that run on this machine."),
        "verify": ("verify", "Verify a flight record."),
        "view": ("view", "Open a flight record, a plan or a recording in the Rerun viewer."),
        "export": ("export", "Write a flight or a plan for Foxglove, PlotJuggler and others."),
        "sitl": ("main", "Run the emulator of vehicles, for any MAVLink client."),
    },
    "Knots and files": {
        "init": ("files", "Write a commented mission file for a knot."),
        "schema": ("files", "Print the JSON schema of mission, fleet, world or scenario files."),
        "knots": ("knots", "List the knots, or show one."),
        "identify": ("knots", "Identify the knot of a curve in space."),
        "certify": ("certify", "Certify an external trajectory."),
        "completion": ("main", "Print the script that completes commands in a shell."),
    },
}
"""Section of ``swarm --help`` → command → module of swarm.cli that defines it, and its line."""

COMMANDS = {name: entry for section in SECTIONS.values() for name, entry in section.items()}
"""Command → module of swarm.cli that defines it, and its line in ``swarm --help``."""

_EXAMPLES = {
    "Plan and simulate": "swarm plan missions/overhand.yaml --report plan.html",
    "Fly": "swarm fly missions/overhand.yaml --fleet fleet.yaml",
    "Knots and files": "swarm init figure-eight --output mission.yaml",
}


class Commands(click.Group):
    """Imports the module of a command when it is needed: help must not wait for SciPy."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Return the commands in the order of the help."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Import and return a command; None for an unknown name."""
        if cmd_name not in COMMANDS:
            return None
        module = import_module(f"swarm.cli.{COMMANDS[cmd_name][0]}")
        command: click.Command = getattr(module, cmd_name.replace("-", "_"))
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Write the list of commands."""
        widest = max(map(len, COMMANDS))
        for title, commands in SECTIONS.items():
            with formatter.section(title):
                rows = [(name.ljust(widest), text) for name, (_, text) in commands.items()]
                formatter.write_dl(rows)
                formatter.write_paragraph()
                formatter.write_text(f"Example: {_EXAMPLES[title]}")

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command of the arguments; an unknown one is refused with the nearest."""
        if args and args[0] not in COMMANDS and not args[0].startswith("-"):
            ctx.fail(f"No such command {args[0]!r}{nearest(args[0], COMMANDS) or '.'}")
        with _without_garbage_collection():
            validate_files(args)
            return super().resolve_command(ctx, args)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse arguments; old spellings work, with a note on stderr."""
        current = current_spelling(args)
        if current != args:
            click.echo(f"note: the new spelling is: swarm {shlex.join(current)}", err=True)
        return super().parse_args(ctx, current)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Return the commands that begin so; no module of a command is imported for it."""
        matches = [
            CompletionItem(name, help=text)
            for name, (_, text) in COMMANDS.items()
            if name.startswith(incomplete)
        ]
        return matches or click.Command.shell_complete(self, ctx, incomplete)


@click.command(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="swarm")
def cli() -> None:
    """Make a team of quadrotors tie a knot in a cable in mid-air.

    Exit codes: 0 success, 1 refused, 2 wrong usage or file, 3 link or vehicle failure, 130
    interrupted.

    Example: swarm dry-run missions/overhand.yaml
    """


VARIABLE = "_SWARM_COMPLETE"
"""Click reads it: the program then prints completions instead of running a command."""

_SHELLS = {"bash": BashComplete, "zsh": ZshComplete, "fish": FishComplete}


@click.command()
@click.argument("shell", type=click.Choice(list(_SHELLS)))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print the script that completes commands, options, knots and files in SHELL.

    Write it to the folder that your shell reads: for bash
    ~/.local/share/bash-completion/completions/swarm, for fish
    ~/.config/fish/completions/swarm.fish, for zsh a file _swarm in a folder of $fpath.

    Example: swarm completion bash > ~/.local/share/bash-completion/completions/swarm
    """
    command = context.find_root().command
    click.echo(_SHELLS[shell](command, {}, "swarm", VARIABLE).source())


@click.command(
    context_settings={"ignore_unknown_options": True, "help_option_names": []},
)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def sitl(arguments: tuple[str, ...]) -> None:
    """Run the emulator, a program of its own (`python -m sitl`), with ARGUMENTS."""
    os.execv(sys.executable, module_command("sitl", *arguments))  # noqa: S606


def main() -> None:
    """Run the command line and exit with its code."""
    try:
        with termination_as_interrupt():
            code = cli(prog_name="swarm", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        code = InputError.exit_code
    except (click.exceptions.Abort, KeyboardInterrupt):
        code = Interrupted.exit_code
    except SwarmError as error:
        click.echo(f"{error}", err=True)
        code = error.exit_code
    except (BrokenPipeError, SystemExit):
        sys.stderr.close()  # the reader of the output has closed it; Rich then ends the program
        code = 0
    except Exception as error:
        code = report_bug(error)
    sys.exit(code if isinstance(code, int) else 0)


@contextmanager
def _without_garbage_collection() -> Iterator[None]:
    """Let no garbage be looked for during imports, nor in what they made, after them.

    Modules stay until the end. To look through them again and again took a sixth of the imports'
    time, and more later.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


@contextmanager
def termination_as_interrupt() -> Iterator[None]:
    """Raise KeyboardInterrupt on SIGTERM and SIGHUP, as on Ctrl-C.

    Otherwise they would end this process at once and leave its children and temporary folders. An
    ignored signal (nohup) stays ignored; a flight has handlers of its own.
    """

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        for each in before:
            signal.signal(each, signal.SIG_IGN)  # the cleanup must not be interrupted
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


def report_bug(error: Exception) -> int:
    """Print that this is a bug, write the traceback to a file, and return EX_SOFTWARE."""
    click.echo(f"swarm has a bug: {type(error).__name__}: {reason(error)}", err=True)
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="swarm-", suffix=".txt", delete=False, encoding="utf-8"
        ) as file:
            traceback.print_exception(error, file=file)
    except OSError as full:
        click.echo(f"The traceback cannot be written: {reason(full)}", err=True)
    else:
        click.echo(f"Please report it together with {file.name}", err=True)
    return 70
