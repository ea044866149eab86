"""What commands are given: mission files, knot names, overrides; and progress while they work."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn

from swarm.errors import InputError, Problem, reason
from swarm.front.files import load, refuse_unknown_knot
from swarm.mission import Mission, mission_for_knot
from swarm.mission.validation import LARGEST_FILE

MISSION = click.argument("mission", metavar="MISSION")
SET = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY.PATH=VALUE",
    help="Override a key of the mission file; may be given many times.",
)
JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object for scripts.")


def read_text(path: Path) -> str:
    """Read a text file of bounded size; raises :class:`InputError` when it cannot be read."""
    try:
        with path.open(encoding="utf-8") as file:
            return file.read(LARGEST_FILE + 1)
    except UnicodeDecodeError:
        raise InputError([Problem(str(path), "expected UTF-8 text")]) from None
    except OSError as error:
        raise InputError([Problem(str(path), reason(error))]) from None


def read_record(path: Path, largest: int) -> bytes:
    """Read a file of a record; raises :class:`InputError` where it is too large for one.

    Raises OSError where it cannot be read.
    """
    with path.open("rb") as file:
        data = file.read(largest + 1)
    if len(data) > largest:
        raise InputError([Problem(str(path), "too large for a flight's record")])
    return data


def load_mission(mission: str, overrides: tuple[str, ...]) -> Mission:
    """Return the mission of a file, or the default mission of a knot's name.

    A file is what exists as one, or is written like one (ends in .yaml or .yml, or has a slash).
    """
    path = Path(mission)
    if path.is_file() or path.suffix in {".yaml", ".yml"} or "/" in mission:
        return load(mission, *overrides)
    loaded = mission_for_knot(mission, overrides)
    refuse_unknown_knot(loaded, mission)
    return loaded


@dataclass(frozen=True)
class Shown:
    """A line on the terminal that says what is being done; called with stage and share done."""

    bar: Progress
    task: TaskID

    def __call__(self, stage: str, share: float) -> None:
        """Show a stage and how much of it is done."""
        self.bar.update(self.task, description=stage, completed=share)

    @contextmanager
    def away(self) -> Iterator[None]:
        """Take the line off the terminal while something else is asked or printed there."""
        self.bar.stop()
        try:
            yield
        finally:
            self.bar.start()


@contextmanager
def progress_bar(console: Console, first: str = "planning") -> Iterator[Shown]:
    """Show long work as ``progress(stage, share done)``; silent where it is not a terminal."""
    with Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(bar_width=30),
        TextColumn("{task.percentage:>3.0f} %"),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    ) as bar:
        yield Shown(bar, bar.add_task(first, total=1.0))


def write_text(path: Path, text: str) -> None:
    """Write a file that the user asked for; raises :class:`InputError` when that fails."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError([Problem(str(path), reason(error))]) from None


def print_json(value: Any) -> None:
    """Print one JSON object; numbers that are not finite never leave this program as JSON."""
    click.echo(json.dumps(value, indent=2, allow_nan=False))
