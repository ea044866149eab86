"""``swarm sitl``: the emulator alone, for QGroundControl, MAVProxy or another client."""

import os
import sys

import click

from swarm.child_modules import module_command


@click.command(
    context_settings={"ignore_unknown_options": True, "help_option_names": []},
)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def sitl(arguments: tuple[str, ...]) -> None:
    """Run the emulator, a program of its own (`python -m sitl`), with ARGUMENTS."""
    os.execv(sys.executable, module_command("sitl", *arguments))  # noqa: S606
