"""Folders of flight records, and the control socket in them."""

import os
from datetime import datetime
from pathlib import Path

from swarm.errors import InputError, Problem

LONGEST_SOCKET_PATH = 100
"""Bytes; longer paths of sockets are refused by the operating system."""


def new_record_folder(parent: Path, name: str) -> Path:
    """Return an unused folder in ``parent``, named by the local time and ``name``."""
    stem = f"{_timestamp()}-{name}".replace("/", "-")
    for number in range(100):
        folder = parent / (f"{stem}-{number}" if number else stem)
        if not folder.exists():
            return folder
    raise InputError([Problem(str(parent), "expected a free name for the record")])


def new_check_folder(parent: Path) -> Path:
    """Return the folder of a check that starts now, named by the local time."""
    return parent / _timestamp()


def control_socket(folder: Path) -> Path | None:
    """Return the path of the control socket; None if it is longer than a socket's path may be."""
    path = folder / "control"
    return path if len(os.fsencode(path)) < LONGEST_SOCKET_PATH else None


def _timestamp() -> str:
    return f"{datetime.now().astimezone():%Y-%m-%dT%H-%M-%S}"
