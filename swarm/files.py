"""Reading and writing of files; every failure is an :class:`InputError` that names the file."""

import os
from collections.abc import Mapping
from pathlib import Path

from swarm.errors import InputError, Problem, reason


def read_text(path: str | os.PathLike[str], largest: int) -> str:
    """Return UTF-8 text of at most ``largest`` bytes; raises :class:`InputError` otherwise."""
    data = read_bytes(path, largest)
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        raise InputError([Problem(os.fspath(path), "expected UTF-8 text")]) from None


def read_bytes(path: str | os.PathLike[str], largest: int) -> bytes:
    """Return a file of at most ``largest`` bytes; raises :class:`InputError` otherwise."""
    try:
        with Path(path).open("rb") as file:
            data = file.read(largest + 1)
    except OSError as error:
        raise InputError([Problem(os.fspath(path), reason(error))]) from None
    if len(data) > largest:
        raise InputError([Problem(os.fspath(path), f"expected at most {largest:,} bytes")])
    return data


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write UTF-8 text; raises :class:`InputError` where that fails."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file; raises :class:`InputError` where that fails."""
    try:
        Path(path).write_bytes(data)
    except OSError as error:
        raise InputError([Problem(os.fspath(path), reason(error))]) from None


def write_folder(path: str | os.PathLike[str], texts: Mapping[str, str]) -> None:
    """Write a new folder of UTF-8 files by their names; raises :class:`InputError` if it fails."""
    try:
        Path(path).mkdir()
    except OSError as error:
        raise InputError([Problem(os.fspath(path), reason(error))]) from None
    for name, text in texts.items():
        write_text(Path(path) / name, text)
