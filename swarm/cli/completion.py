"""``swarm completion``: the script that completes commands, options and files in a shell."""

import click
from click.shell_completion import BashComplete, FishComplete, ZshComplete

VARIABLE = "_SWARM_COMPLETE"
"""Click reads it: the program then prints completions instead of running a command."""


_SHELLS = {"bash": BashComplete, "zsh": ZshComplete, "fish": FishComplete}


@click.command()
@click.argument("shell", type=click.Choice(list(_SHELLS)))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print the script that completes commands, options, knots and files in SHELL.

    Write it to the folder that your shell reads: for bash
    ~/.local/share/bash-completion/completions/swarm, for fish
    ~/.config/fish/completions/swarm.fish, for zsh a file _swarm in a folder of $fpath.

    Example: swarm completion bash > ~/.local/share/bash-completion/completions/swarm
    """
    command = context.find_root().command
    click.echo(_SHELLS[shell](command, {}, "swarm", VARIABLE).source())
