"""Reading and writing of files; every failure is an :class:`InputError` that names the file."""

import codecs
import json
import math
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from swarm.errors import InputError, Problem, nearest, reason

DEEPEST_NESTING = 64
"""Largest depth of nesting: parsers recurse, and a hostile file must not crash them."""

_BRACKETS = re.compile(r'"(?:[^"\\]|\\.)*"?|[\[\]{}]', re.DOTALL)


def read_text(path: str | os.PathLike[str], largest: int) -> str:
    """Return UTF-8 text of at most ``largest`` bytes, without a byte-order mark.

    Raises :class:`InputError`.
    """
    return decoded(read_bytes(path, largest), os.fspath(path))


def decoded(data: bytes, source: str) -> str:
    """Return UTF-8 text without a byte-order mark; raises :class:`InputError` for other bytes."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        marked = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        got = ", got UTF-16: save the file as UTF-8" if marked else ""
        raise InputError([Problem(source, f"expected UTF-8 text{got}")]) from None


def parse_json(text: str | bytes, source: str) -> Any:
    """Return the data of JSON from an untrusted source, with every number finite.

    Raises :class:`InputError`, with line and column for a syntax error, and for a key twice in an
    object, for numbers that are not finite, and for nesting beyond DEEPEST_NESTING.
    """
    if isinstance(text, bytes):
        text = decoded(text, source)
    depth = 0
    for bracket in _BRACKETS.finditer(text):
        depth += (bracket[0] in "[{") - (bracket[0] in "]}")
        if depth > DEEPEST_NESTING:
            message = f"not valid JSON: nested more than {DEEPEST_NESTING} deep"
            raise InputError([Problem(source, message)])
    try:
        return json.loads(
            text, object_pairs_hook=_with_each_key_once, parse_constant=_finite, parse_float=_finite
        )
    except json.JSONDecodeError as error:
        place = f"{source}: line {error.lineno}, column {error.colno}"
        raise InputError([Problem(place, f"not valid JSON: {error.msg}")]) from None
    except ValueError as error:  # of the functions below, and for integers of thousands of digits
        raise InputError([Problem(source, f"not valid JSON: {error}")]) from None


def _with_each_key_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    document = dict(pairs)
    if len(document) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key {twice[:60]!r} twice in an object")
    return document


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"expected a finite number, got {text[:60]}")
    return value


def _missing(path: Path, error: FileNotFoundError) -> str:
    """Return why a file is not found, with the nearest name beside it, or beside its folder."""
    folder = next((each for each in reversed(path.parents) if not each.exists()), None)
    if folder is None:
        return reason(error) + nearest(path.name, _beside(path))
    return f"no such folder: {folder}{nearest(folder.name, _beside(folder, folders=True))}"


def _beside(path: Path, *, folders: bool = False) -> list[str]:
    """Return the names of the files of the same kind, or the folders, in the folder of a path."""
    try:
        return [
            each.name
            for each in path.parent.iterdir()
            if (each.is_dir() if folders else each.suffix == path.suffix)
        ]
    except OSError:
        return []


def read_bytes(path: str | os.PathLike[str], largest: int) -> bytes:
    """Return a file of at most ``largest`` bytes; raises :class:`InputError` otherwise."""
    try:
        with Path(path).open("rb") as file:
            data = file.read(largest + 1)
    except FileNotFoundError as error:
        raise InputError([Problem(os.fspath(path), _missing(Path(path), error))]) from None
    except OSError as error:
        raise InputError([Problem(os.fspath(path), reason(error))]) from None
    if len(data) > largest:
        raise InputError([Problem(os.fspath(path), f"expected at most {largest:,} bytes")])
    return data


def require_writable(path: str | os.PathLike[str]) -> None:
    """Raise :class:`InputError` where a file cannot be written; a new file is created, empty."""
    try:
        Path(path).open("ab").close()
    except OSError as error:
        raise InputError([Problem(os.fspath(path), reason(error))]) from None


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write UTF-8 text; raises :class:`InputError` where that fails."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file in one step; raises :class:`InputError` where that fails."""
    with replaced(path) as new:
        new.write_bytes(data)


@contextmanager
def replaced(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a new path beside ``path``, and put the file written there in its place at the end.

    Without an end, after any exception, nothing of the new file stays and ``path`` is as before.
    Links, devices and pipes are written themselves. Raises :class:`InputError` where that fails.
    """
    target = Path(path)
    try:
        if target.is_symlink() or (target.exists() and not target.is_file()):
            yield target
            return
        folder = Path(tempfile.mkdtemp(prefix=f".{target.name[:40]}-", dir=target.parent))
        try:
            new = folder / target.name
            yield new
            if target.exists():
                new.chmod(target.stat().st_mode & 0o777)
            new.replace(target)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    except OSError as error:
        raise InputError([Problem(os.fspath(path), reason(error))]) from None


def write_folder(path: str | os.PathLike[str], texts: Mapping[str, str]) -> None:
    """Write a new folder of UTF-8 files by their names; raises :class:`InputError` if it fails."""
    with replaced(path) as new:
        new.mkdir()
        for name, text in texts.items():
            (new / name).write_bytes(text.encode("utf-8"))
