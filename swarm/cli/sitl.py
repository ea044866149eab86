"""``swarm sitl``: the emulated vehicles alone, for QGroundControl, MAVProxy or anybody's client."""

import os
import sys

import click


@click.command(
    context_settings={"ignore_unknown_options": True, "help_option_names": []},
)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def sitl(arguments: tuple[str, ...]) -> None:
    """Run the emulator with ARGUMENTS; it is a program of its own (`python -m sitl`)."""
    os.execv(sys.executable, [sys.executable, "-m", "sitl", *arguments])  # noqa: S606
