"""The team's response to every failure, printed by ``swarm failures`` without a mission."""

import click
from rich.console import Console
from rich.table import Table

from swarm.flight import policy
from swarm.flight.stages import Stage, mermaid


def print_responses(*, whole: bool, diagram: bool) -> None:
    """Print the table of responses, ``whole`` or on the plan only, or the diagram of stages."""
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
