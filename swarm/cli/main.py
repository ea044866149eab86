"""The ``swarm`` command: a shell around the library that turns errors into exit codes."""

import sys

import click

from swarm import __version__
from swarm.errors import SwarmError


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="swarm")
def cli() -> None:
    """Make a team of quadrotors tie a knot in a cable in mid-air."""


def main() -> None:
    """Run the command line; the exit code is 0, 1 (refused), 2 (usage), 3 (vehicle) or 130."""
    try:
        cli(standalone_mode=False)
    except click.exceptions.Abort:
        sys.exit(130)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except SwarmError as error:
        print(f"swarm: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        sys.exit(130)
