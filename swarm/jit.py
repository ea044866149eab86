"""Compiled loops, for hot paths in which arrays are too small or too ragged for NumPy."""

import functools
import hashlib
import os
import platform
import re
import shutil
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final, ParamSpec, TypeVar, cast

import llvmlite
import llvmlite.binding
import numba
import numpy as np

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

KEPT: Final = 14.0
"""Days for which machine code is kept that no process has asked for."""

_DAY: Final = 86400.0

_BEGAN: Final = time.time()
"""Sources that were written later may differ from what this process has imported."""

_ROOT: Final = str(Path(__file__).parents[1])
_PACKAGES: Final = ("swarm", "sitl")

_IMPORTS: Final = re.compile(rb"\n[ \t]*(?:from|import) +([\w.]+)(?: +import +(\([^)]*\)|[^\n]*))?")
"""An import: the module, and the names that are taken from it."""


def compiled(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Compile a function of numbers and arrays when it is first called.

    The machine code is kept in the user's cache, so that it is compiled once per machine; where
    that cannot be written, once per process. It is compiled anew when the contents of its file
    have changed, or of any file of these packages, or of its own, which that file imports directly
    or through others: constants and functions of other modules become part of the machine code.
    Division by 0 gives what NumPy gives.
    """
    before = numba.config.CACHE_DIR
    try:
        # Not beside the module: what pip did not install stays behind when it uninstalls, and
        # Python takes the folders that are left for a package.
        numba.config.CACHE_DIR = str(_folder(function.__code__.co_filename))
        made = numba.njit(function, cache=True, error_model="numpy", nogil=True)
    except (RuntimeError, OSError):
        made = numba.njit(function, error_model="numpy", nogil=True)
    finally:
        numba.config.CACHE_DIR = before
    return cast("Callable[Parameters, Result]", made)


def cache() -> Path:
    """Return the folder in which machine code is kept between processes."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "swarm"


@functools.cache
def key(file: str) -> str:
    """Name what the machine code of a file's functions is made from, and what it is made for.

    That is the contents of the file and of those that it imports, the versions of what compiles
    them, and the processor. Raises OSError where one of them cannot be read, or has changed since
    this process began.
    """
    digest = hashlib.sha256(made_by().encode())
    for name, contents in sorted(_sources(file).items()):
        digest.update(f"{name}\n{contents}\n".encode())
    return digest.hexdigest()[:16]


@functools.cache
def _folder(file: str) -> Path:
    """Where machine code of a file's functions is kept; says by its time that it is in use."""
    folder = cache() / key(file)
    if not folder.exists():
        prune(cache())
    elif time.time() - folder.stat().st_mtime > _DAY:
        os.utime(folder)
    return folder


def prune(folder: Path) -> None:
    """Remove what no process has asked for in ``KEPT`` days.

    Other processes may do the same at the same time, or use what is newer: each touches what it
    uses once a day, and a file that is gone is compiled anew.
    """
    with suppress(OSError):
        for path in folder.iterdir():
            with suppress(OSError):
                if time.time() - path.stat().st_mtime < KEPT * _DAY:
                    continue
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink()


@functools.cache
def made_by() -> str:
    """Return the versions of what compiles, and the processor for which it does."""
    versions = (numba.__version__, llvmlite.__version__, np.__version__, sys.version)
    processor = (
        platform.machine(),
        llvmlite.binding.get_host_cpu_name(),
        llvmlite.binding.get_host_cpu_features().flatten(),
    )
    return repr((*versions, *processor))


def _sources(file: str) -> dict[str, str]:
    """Digests of a file and of all that it imports, directly or not; without where it all lies."""
    found: dict[str, str] = {}
    open_ends = [file]
    while open_ends:
        name = open_ends.pop()
        if name not in found:
            found[name], imported = _read(name)
            open_ends += imported
    return {name.removeprefix(_ROOT): digest for name, digest in found.items()}


@functools.cache
def _read(file: str) -> tuple[str, tuple[str, ...]]:
    """The digest of a file's contents, and the files from which it imports."""
    with open(file, "rb") as source:
        if _BEGAN < os.fstat(source.fileno()).st_mtime <= time.time():
            raise OSError(f"{file} has changed since this process began")
        contents = source.read()
    folder = os.path.dirname(file)
    imported: set[str] = set()
    for module, names in _IMPORTS.findall(b"\n" + contents):
        imported.update(_files(folder, module.decode(), names.decode()))
    return hashlib.sha256(contents).hexdigest(), tuple(imported)


@functools.cache
def _package(folder: str) -> tuple[str, str]:
    """The folder that a package lies in and the package's name, which is "" for a script's."""
    if not os.path.isfile(os.path.join(folder, "__init__.py")):
        return folder, ""
    above, package = _package(os.path.dirname(folder))
    return above, package or os.path.basename(folder)


def _files(folder: str, module: str, names: str) -> list[str]:
    """Files that an import in a folder's file may read, but for what is installed beside us."""
    root, package = _package(folder)
    first = module.partition(".")[0]
    if first in _PACKAGES:
        root = _ROOT
    elif package not in {"", first}:
        return []
    file = _file(root, module)
    if not file.endswith("__init__.py"):
        return [file] if file else []
    parts = (_file(root, f"{module}.{name}") for name in re.findall(r"\w+", names))
    return [file, *(part for part in parts if part)]


@functools.cache
def _file(root: str, module: str) -> str:
    """The file of a module of that name; "" where it is no module."""
    path = os.path.join(root, *module.split("."))
    candidates = (f"{path}.py", os.path.join(path, "__init__.py"))
    return next((file for file in candidates if os.path.isfile(file)), "")
