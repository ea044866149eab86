"""``swarm knots --plan``: plan and certify every knot."""

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import click
from rich.console import Console
from rich.progress import track

from swarm.cli.inputs import print_json
from swarm.errors import Interrupted
from swarm.reports.studies_text import print_plan_rows
from swarm.studies import append_row, matching_knots, plan_rows, read_rows, rows_csv


@dataclass(frozen=True)
class PlanOptions:
    """The options of ``--plan``."""

    filter: str | None = None
    jobs: int = 1
    scheduler: str | None = None
    output: Path | None = None
    as_csv: bool = False
    no_robustness: bool = False
    vehicles: str | None = None
    overrides: tuple[str, ...] = ()


def print_planned(options: PlanOptions, *, as_json: bool) -> int:
    """Plan the knots that the output file does not have, print all rows, return the exit code.

    After an interrupt, the completed rows are in the file and are printed.
    """
    names = matching_knots(options.filter)
    count = (f"vehicles.count={options.vehicles}",) if options.vehicles else ()
    rows = read_rows(options.output) if options.output else {}
    remaining = [name for name in names if name not in rows]
    if rows:
        kept = f"{len(names) - len(remaining)} of {len(names)} knots"
        click.echo(f"{options.output}: {kept} as read, not planned or certified again", err=True)
    interrupted = False
    planned = plan_rows(
        remaining,
        (*options.overrides, *count),
        jobs=options.jobs,
        scheduler=options.scheduler,
        robustness=not options.no_robustness,
    )
    try:
        with closing(planned):
            for row in track(
                planned,
                total=len(remaining),
                description="planning",
                console=Console(stderr=True),
                transient=True,
            ):
                rows[row["knot"]] = row
                if options.output:
                    append_row(options.output, row)
    except KeyboardInterrupt:
        interrupted = True
    found = [rows[name] for name in names if name in rows]
    if as_json:
        print_json(found)
    elif options.as_csv:
        click.echo(rows_csv(found), nl=False)
    else:
        print_plan_rows(found, Console())
    if interrupted:
        return Interrupted.exit_code
    return 0 if all(row["cleared"] for row in found) else 1
