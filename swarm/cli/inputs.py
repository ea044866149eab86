"""What commands are given: mission files, knot names, overrides; and progress while they work."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn

MISSION = click.argument("mission", metavar="MISSION")
SET = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY.PATH=VALUE",
    help="Override a key of the mission file; may be given many times.",
)
JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object for scripts.")


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


def print_json(value: Any) -> None:
    """Print one JSON object; numbers that are not finite never leave this program as JSON."""
    click.echo(json.dumps(value, indent=2, allow_nan=False))
