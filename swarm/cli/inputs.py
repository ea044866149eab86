"""Parts that all commands share: common options, the progress line, JSON output."""

import json
import os
import select
import sys
import termios
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)

from swarm.errors import InputError


def missions(
    _context: click.Context, _parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Return completions of a mission: files, and the names of knots."""
    from swarm.knots.catalog import table_names  # noqa: PLC0415 - slow to import

    names = [name for name in table_names() if name.startswith(incomplete)]
    return [CompletionItem(incomplete, type="file"), *map(CompletionItem, names)]


class Output(click.Path):
    """A file or folder to write, refused before the work where it cannot be written."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path; fails where its folder does not exist or is not writable."""
        super().convert(value, param, ctx)
        path = Path(value)
        if not path.parent.is_dir():
            self.fail(f"{value}: no such folder: {path.parent}", param, ctx)
        if not os.access(path if path.exists() else path.parent, os.W_OK):
            self.fail(f"{value}: permission denied", param, ctx)
        return path


class Address(click.ParamType[str]):
    """The address of another system; ``parse`` raises `ValueError` for another text."""

    name = "address"

    def __init__(self, parse: Callable[[str], object]) -> None:
        self._parse = parse

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the address; another text is a usage error."""
        try:
            self._parse(value)
        except ValueError as error:
            self.fail(str(error), param, ctx)
        return str(value)


FILE = click.Path(dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)
OUTPUT = Output(dir_okay=False, path_type=Path)
MISSION = click.argument("mission", metavar="MISSION", shell_complete=missions)
SET = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY.PATH=VALUE",
    help="Override a key of the mission file; can be repeated.",
)
REPLAN = click.option(
    "--replan", is_flag=True, help="Plan again, also where the mission was planned before."
)
JOBS = click.option(
    "--jobs", type=click.IntRange(1, 1024), help="Parallel processes [one per core]."
)
SEED = click.option("--seed", default=1, show_default=True, help="Seed of all random values.")
REPORT = click.option("--report", type=OUTPUT, help="Write a report (one HTML file).")
YES = click.option("--yes", is_flag=True, help="Do not ask for confirmation; errors still refuse.")
SCHEDULER = click.option(
    "--scheduler", metavar="tcp://HOST:PORT", help="Run on this Dask cluster instead."
)
JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object for scripts.")

VERBOSE = click.option(
    "--verbose", is_flag=True, help="Print all checks of the plan, tightest moments and budget too."
)


@dataclass(frozen=True)
class ProgressLine:
    """A progress line on the terminal; call it with the name of a stage and its completed share."""

    bar: Progress
    task: TaskID

    def __call__(self, stage: str, share: float) -> None:
        """Show a stage and its completed share, 0…1."""
        self.bar.update(self.task, description=stage, completed=share)

    @contextmanager
    def hidden(self) -> Iterator[None]:
        """Hide the line while other output or a question uses the terminal."""
        self.bar.stop()
        try:
            yield
        finally:
            self.bar.start()


@contextmanager
def progress_bar(console: Console, first: str = "planning") -> Iterator[ProgressLine]:
    """Yield a progress line that starts with ``first``; it is silent if there is no terminal."""
    with Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(bar_width=30),
        TextColumn("{task.percentage:>3.0f} %"),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    ) as bar:
        yield ProgressLine(bar, bar.add_task(first, total=1.0))


@contextmanager
def counting_bar(name: str, total: int | None = None) -> Iterator[Callable[..., None]]:
    """Yield a function that shows how many are done, and of how many; silent without a terminal."""
    console = Console(stderr=True)
    with Progress(
        TextColumn("{task.description}"), BarColumn(bar_width=30), MofNCompleteColumn(),
        TimeRemainingColumn(), console=console, transient=True, disable=not console.is_terminal,
    ) as bar:  # fmt: skip
        task = bar.add_task(name, total=total)
        yield lambda done, of=total: bar.update(task, completed=done, total=of)


_POLL = 0.1
"""Seconds between looks at whether a question is answered elsewhere: people see no delay."""

_LONGEST_LINE = 4096
"""Largest number of bytes in a line that a terminal hands over (N_TTY_BUF_SIZE in Linux)."""


def confirmed(
    question: str, elsewhere: Callable[[], bool] = lambda: False, *, read: bool = True
) -> bool | None:
    """Ask a question on the terminal; return the answer, None once it is answered ``elsewhere``.

    What was typed before is dropped: it answers nothing that was asked after it. Without ``read``
    only others can answer. Raises :class:`click.Abort` at the end of the input.
    """
    choice = "[y/N]:" if read else "The console is asked."
    click.echo(f"{question} {choice} ", err=True, nl=not read)
    if read and sys.stdin.isatty():
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
    while not elsewhere():
        if not read:
            time.sleep(_POLL)
        elif select.select([sys.stdin], [], [], _POLL)[0]:
            typed = os.read(sys.stdin.fileno(), _LONGEST_LINE)
            if not typed:
                raise click.Abort
            answer = typed.decode("utf-8", "replace").partition("\n")[0].strip().lower()
            if answer in {"y", "yes", "n", "no", ""}:
                return answer in {"y", "yes"}
            click.echo(f"Error: expected y or n\n{question} {choice} ", err=True, nl=False)
    return None


def print_json(value: Any) -> None:
    """Print one JSON object; raises ValueError for numbers that are not finite."""
    click.echo(json.dumps(value, indent=2, allow_nan=False))


def refuse_option_conflicts(
    options: Mapping[str, Any],
    requires: Mapping[str, Sequence[str]],
    excludes: Sequence[tuple[str, str]],
) -> None:
    """Raise :class:`InputError` for options without a required one, and for pairs that exclude."""
    given = {
        name
        for name, value in options.items()
        if value is not None and value is not False and value != ()  # a trial 0 equals False
    }
    problems = [
        f"{_option(name)} needs {' or '.join(map(_option, required))}"
        for name, required in requires.items()
        if name in given and not given & set(required)
    ]
    problems += [
        f"{_option(first)} and {_option(second)} do not go together"
        for first, second in excludes
        if {first, second} <= given
    ]
    if problems:
        raise InputError("\n".join(problems))


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")
