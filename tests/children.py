"""Processes that this process has started."""

import os
import subprocess


def children(module: str) -> list[int]:
    """Return the ids of the running child processes whose command names a module."""
    listed = subprocess.run(
        ["ps", "-ww", "-o", "pid=,stat=,args=", "--ppid", str(os.getpid())],
        capture_output=True, text=True, check=False,
    ).stdout  # fmt: skip
    rows = [row.split(maxsplit=2) for row in listed.splitlines()]
    return [int(pid) for pid, state, what in rows if module in what and not state.startswith("Z")]
