"""``swarm knots`` and ``swarm identify``: the table of knots, listed or planned; curves."""

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.progress import track

from swarm.cli.inputs import FILE, JSON, OUTPUT, SET, print_json
from swarm.errors import InputError, Interrupted, Problem
from swarm.files import read_text
from swarm.knots.catalog import lookup_knot, table_names
from swarm.knots.curve import CurveDefect, parse_curve
from swarm.knots.gauss import KnotError
from swarm.knots.invariants import identify_curve
from swarm.mission.validation import LARGEST_FILE
from swarm.reports.knots import (
    identification_object,
    knot_object,
    print_identification,
    print_knot,
    print_knots,
    print_table_check,
)
from swarm.reports.studies import print_plan_rows
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
    completed = [rows[name] for name in names if name in rows]
    if as_json:
        print_json(completed)
    elif options.as_csv:
        click.echo(rows_csv(completed), nl=False)
    else:
        print_plan_rows(completed, Console())
    if interrupted:
        return Interrupted.exit_code
    return 0 if all(row["cleared"] for row in completed) else 1


@click.command()
@click.argument("name", required=False)
@JSON
@click.option(
    "--plot",
    type=OUTPUT,
    help="Plot the grid diagram of NAME (PNG).",
)
@click.option(
    "--table",
    "whole_table",
    is_flag=True,
    help="Check the table: search every grid diagram again, and identify it.",
)
@click.option("--plan", "planning", is_flag=True, help="Plan and certify every knot; see below.")
@click.option("--filter", metavar="REGEX", help="With --plan: only knots whose names match.")
@click.option(
    "--jobs", type=click.IntRange(1, 64), default=1, help="With --plan: parallel processes."
)
@click.option(
    "--scheduler",
    metavar="tcp://HOST:PORT",
    help="With --plan: plan on this Dask cluster instead.",
)
@click.option(
    "-o",
    "--output",
    "--to",
    "output",
    type=OUTPUT,
    help="With --plan: append rows to this file (JSON lines); its knots are not planned again.",
)
@click.option(
    "--vehicles",
    metavar="N|fewest|auto",
    help="With --plan: number of vehicles, as swarm plan --vehicles.",
)
@click.option("--csv", "as_csv", is_flag=True, help="With --plan: print the table as CSV.")
@click.option("--no-robustness", is_flag=True, help="With --plan: without e* and w*.")
@SET
@click.pass_context
def knots(
    context: click.Context,
    /,
    name: str | None,
    as_json: bool,
    plot: Path | None,
    whole_table: bool,
    planning: bool,
    **plan_options: Any,
) -> None:
    """List the knots, or show the knot NAME.

    NAME is a knot of the table (8_18), a common name (overhand, "carrick mat"), torus(p,q), a
    mirror image (m3_1) or a sum (3_1#m3_1).

    --plan plans and certifies every prime knot to ten crossings, and some sums and torus knots,
    with the default mission (and --set). It prints vehicles, cable, fold time, clearances, e*, w*,
    the budget (a negative one is refused only with --set limits.accept_negative_budget=false),
    processor time, and the attempts for knots that are not cleared. With --vehicles fewest it
    searches each knot's fewest vehicles; --to keeps a row per knot as it comes, and an interrupted
    run goes on from there. Exit code 1 if a knot is not cleared.

    Example: swarm knots 8_18 --plot 8_18.png
    """
    if planning:
        if name or plot or whole_table:
            raise click.UsageError("--plan is of many knots: use --filter instead of a NAME")
        context.exit(print_planned(PlanOptions(**plan_options), as_json=as_json))
    if PlanOptions(**plan_options) != PlanOptions():
        raise click.UsageError("these options belong to --plan")
    if name is None and plot is not None:
        raise click.UsageError("--plot needs the NAME of a knot")
    if whole_table:
        if name is not None:
            raise click.UsageError("--table is of all knots: leave NAME out")
        context.exit(_check_table(as_json))
    choices = [lookup_knot(knot) for knot in ([name] if name else table_names())]
    if plot is not None:
        from swarm.reports.plots import knot_figure, save  # noqa: PLC0415 - slow to import

        save(knot_figure(choices[0]), plot)
    if as_json:
        objects = [knot_object(choice) for choice in choices]
        print_json(objects[0] if name else objects)
    elif name:
        print_knot(choices[0], Console(highlight=False))
    else:
        print_knots(choices, Console())


def _check_table(as_json: bool) -> int:
    """Check the table with a progress bar, print the result, and return the exit code."""
    from swarm.knot_table import check_table  # noqa: PLC0415 - no other command needs it

    checks = list(
        track(
            check_table(),
            total=len(table_names()),
            description="searching grids",
            console=Console(stderr=True),
            transient=True,
        )
    )
    if as_json:
        print_json([vars(check) for check in checks])
    else:
        print_table_check(checks, Console())
    return 0 if all(check.right for check in checks) else 1


@click.command()
@click.argument("file", type=FILE)
@click.option("--closed", is_flag=True, help="Join the last point to the first.")
@JSON
def identify(file: Path, closed: bool, as_json: bool) -> None:
    """Identify the knot of the curve in FILE: rows of x, y, z, or columns with these names.

    An index that counts by one may come before x, y, z.

    The ends of an open curve are extended straight up and joined above it.

    Example: swarm identify curve.csv --closed
    """
    points, lines = parse_curve(read_text(file, LARGEST_FILE), str(file))
    try:
        identification = identify_curve(points, closed=closed)
    except CurveDefect as defect:
        numbers = " and ".join(str(lines[index]) for index in defect.points)
        where = f": line{'s' * (len(defect.points) > 1)} {numbers}" if numbers else ""
        raise InputError([Problem(f"{file}{where}", defect.message)]) from None
    except KnotError as error:
        raise InputError([Problem(str(file), str(error))]) from None
    if as_json:
        print_json(identification_object(identification))
    else:
        print_identification(identification, len(points), Console(highlight=False))
