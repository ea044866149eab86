"""``swarm failures``: print the policy of the flight."""

import click
from rich.console import Console
from rich.table import Table

from swarm.flight import policy
from swarm.flight.stages import Stage, mermaid


@click.command()
@click.option(
    "--table",
    "whole",
    is_flag=True,
    help="Print every cell: each failure, on the plan and outside it, under all open windows.",
)
@click.option("--diagram", is_flag=True, help="Print the stages of a flight in Mermaid instead.")
def failures(whole: bool, diagram: bool) -> None:
    """Print the team's response to every failure that is detected in flight."""
    if diagram:
        click.echo(mermaid())
        return
    heading, *rows = policy.rows()
    count = len(heading) if whole else 3
    table = Table(*heading[:count])
    for row in rows:
        if whole or row[1] == Stage.EXECUTE.name.lower():
            table.add_row(*row[:count])
    Console(width=None if whole else 100).print(table, highlight=False)
