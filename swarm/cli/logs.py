"""What ``swarm check --logs`` does: fetch the autopilots' own logs."""

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table
from rich.text import Text

from swarm.cli.inputs import print_json
from swarm.errors import VehicleError
from swarm.front.files import load_fleet
from swarm.ground.commissioning.logs import LogDownload, download_logs
from swarm.mission.fleet import emulated_fleet

VEHICLES = 9
"""Vehicles of the built-in emulator that is asked where no fleet is given."""


def fetch(fleet_file: Path | None, folder: Path, *, as_json: bool) -> int:
    """Fetch every vehicle's newest log and say what came of it; return the exit code."""
    fleet = load_fleet(fleet_file) if fleet_file else emulated_fleet(VEHICLES)
    errors = Console(stderr=True)
    with Progress(
        TextColumn("{task.description}"), BarColumn(bar_width=30),
        TextColumn("{task.percentage:>3.0f} %"),
        console=errors, transient=True, disable=not errors.is_terminal,
    ) as bar:  # fmt: skip
        task = bar.add_task(f"listening to {fleet.name}", total=1.0)

        def tell(system: int, share: float) -> None:
            bar.update(task, description=f"log of system {system}", completed=share)

        fetched = download_logs(fleet, folder, tell)
    if as_json:
        print_json({"logs": [_object(log) for log in fetched]})
    else:
        Console().print(logs_table(fetched))
    return 0 if all(log.path for log in fetched) else VehicleError.exit_code


def logs_table(fetched: Sequence[LogDownload]) -> Table:
    """Return a line for every vehicle: where its log is, or why it could not be had."""
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for heading in ("system", "began", "size", "log"):
        table.add_column(heading, justify="right" if heading in {"system", "size"} else "left")
    for log in fetched:
        size = f"{log.size / 1e6:.2f} MB" if log.size else ""
        where = Text(str(log.path)) if log.path else Text(log.problem, "bold red")
        table.add_row(str(log.system), log.date, size, where)
    return table


def _object(log: LogDownload) -> dict[str, object]:
    return {
        "system": log.system,
        "path": str(log.path) if log.path else None,
        "size": log.size or None,
        "date": log.date or None,
        "problem": log.problem or None,
    }
