"""Compilation of loops for hot paths whose arrays are too small or too ragged for NumPy."""

import functools
import hashlib
import os
import platform
import re
import shutil
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar, cast

import llvmlite
import llvmlite.binding
import numba
import numpy as np
from numba import types
from numba.core.ccallback import CFunc
from numba.core.runtime import rtsys
from numba.experimental import function_type

from swarm.signatures import signature

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

KEPT: Final = 14.0
"""Days after its last use for which machine code is kept."""

_DAY: Final = 86400.0

_STARTED: Final = time.time()
"""Start of this process; files that were written later may differ from the imported ones."""

_SEALED: Final = threading.Event()

_ROOT: Final = str(Path(__file__).parents[1])
_PACKAGES: Final = ("swarm", "sitl")

_OPTIONS: Final = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
"""No compiled function is passed to C; its wrapper for that takes 5 % of the compilation."""

_IMPORTS: Final = re.compile(rb"\n[ \t]*(?:from|import) +([\w.]+)(?: +import +(\([^)]*\)|[^\n]*))?")
"""An import: the module, and the imported names."""


_TYPES: Final = CFunc, function_type.WrapperAddressProtocol
"""Types that Numba registers at the first compilation, otherwise while another thread, which only
calls machine code, goes through the registered ones."""


def compiled(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Return a function of numbers and arrays that is compiled before its first call, or at it.

    A function whose annotations determine the types of its arguments (:mod:`swarm.signatures`) has
    machine code for these types only; :mod:`swarm.precompile` compiles it beforehand. What only
    compiled functions call is an :func:`inner` one.

    The machine code is kept in the user's cache, so that it is compiled once per machine; where the
    cache is not writable, once per process. It is compiled again when the contents change of its
    file, or of a file of these packages or of its own package that this file imports directly or
    through others: constants and functions of other modules become part of the machine code.
    Division by 0 has the result of NumPy.
    """
    made = _made(function, "", **_OPTIONS)
    made._compile_for_args = functools.partial(_matching, made)
    return cast("Callable[Parameters, Result]", made)


def inner(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Return a function that only compiled functions call; it is compiled with them.

    It has no machine code for calls from Python, which would be a tenth of the compilation. Where
    Python calls it nevertheless, as tests do, a copy of it is compiled as :func:`compiled` does.
    """
    made = _made(function, "", no_cpython_wrapper=True, **_OPTIONS)
    # Numba's own method would let Python call what is missing, and the process would end there.
    made.add_overload = functools.partial(_kept_for_callers, made)
    made._compile_for_args = functools.partial(_copy_for_python, made)
    return cast("Callable[Parameters, Result]", made)


def allocates(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Let a compiled function make arrays, or use those that others return; as inner decorator.

    Its references to arrays are counted. That takes half of the time of functions that pass many
    arrays on to others, and more where several threads count references to the same arrays. Other
    functions do not count (``_nrt`` of Numba): they must not make or return arrays, nor call what
    returns them.
    """
    vars(function)["allocates"] = True
    return function


def _made(function: Callable[..., Any], folder: str, **options: Any) -> Any:
    """Return Numba's function with machine code kept in a folder of the cache, where that works."""
    before = numba.config.CACHE_DIR
    options["_nrt"] = vars(function).get("allocates", False)
    try:
        # Not beside the module: pip uninstall leaves files that it did not install, and Python
        # treats the remaining folders as a package.
        numba.config.CACHE_DIR = str(_folder(function.__code__.co_filename) / folder)
        made = numba.njit(function, cache=True, **options)
        made._cache.load_overload = functools.partial(_loaded, made._cache)
        return made
    except (RuntimeError, OSError):
        return numba.njit(function, **options)
    finally:
        numba.config.CACHE_DIR = before


def _loaded(kept: Any, types_: Any, context: Any) -> Any:
    """Return what Numba's cache has ``kept`` for argument types, None where it has nothing.

    Numba's own method first imports and registers all that can be compiled, which takes 0.2 s and
    is done again before each compilation. Machine code needs the runtime alone.
    """
    rtsys.initialize(context)
    return kept._load_overload(types_, context)


def _kept_for_callers(made: Any, compiled_as: Any) -> None:
    """Keep what was compiled for some types where compiled callers find it, but not Python."""
    made.overloads[tuple(compiled_as.signature.args)] = compiled_as


def _copy_for_python(made: Any, *_arguments: Any, **_named: Any) -> Callable[..., Any]:
    """Return the copy of an inner function that Python may call, for Numba's dispatcher."""
    return _interpreted(made) if _SEALED.is_set() else _copy(made.py_func)


@functools.cache
def _copy(function: Callable[..., Any]) -> Any:
    return _made(function, "python", **_OPTIONS)


def declared(made: Any) -> tuple[types.Type, ...] | None:
    """Return the argument types in the annotations of a compiled function, None without them.

    None for an inner function, too: its callers determine them.
    """
    return None if made.targetoptions.get("no_cpython_wrapper") else signature(made.py_func)


@contextmanager
def sealed() -> Iterator[None]:
    """Compile nothing in this context: a call that has no machine code is interpreted instead.

    For the time in the air. Compilation lasts seconds, and half a second without setpoints ends a
    flight. Interpreted, the same computation has the same result, a hundred times as slow, and
    gives a RuntimeWarning, which is an error in the tests.
    """
    _SEALED.set()
    try:
        yield
    finally:
        _SEALED.clear()


def _matching(made: Any, *arguments: Any, **named: Any) -> Callable[..., Any]:
    """Return what executes a call for which Numba finds no machine code of exactly its types.

    That of the declared types where the arguments fit them: an array without gaps is also one with
    gaps, and a row of one vehicle has none. Numba's dispatcher calls the result, and calls this
    function in place of its own method, which compiles the function for whatever types arrive.
    """
    expected = declared(made)
    if expected is not None and not named and _fit(made, arguments, expected):
        if expected not in made.overloads and not _SEALED.is_set():
            made.compile(expected)
        if expected in made.overloads:
            return cast("Callable[..., Any]", made.overloads[expected].entry_point)
    if not _SEALED.is_set():
        return cast("Callable[..., Any]", type(made)._compile_for_args(made, *arguments, **named))
    return _interpreted(made)


def _interpreted(made: Any) -> Callable[..., Any]:
    """Return a function as Python executes it, and say so."""
    name = f"{made.py_func.__module__}.{made.py_func.__name__}"
    warnings.warn(f"{name} is interpreted: no machine code", RuntimeWarning, stacklevel=3)
    return cast("Callable[..., Any]", made.py_func)


def _fit(made: Any, arguments: tuple[Any, ...], expected: tuple[types.Type, ...]) -> bool:
    """Return whether arguments are of the declared types, or convert to them exactly."""
    given = [made.typeof_pyval(argument) for argument in arguments]
    return len(given) == len(expected) and all(
        actual == wanted
        or (isinstance(actual, types.Array) and actual.can_convert_to(None, wanted) is not None)
        or (isinstance(actual, types.Integer) and isinstance(wanted, types.Integer | types.Float))
        for actual, wanted in zip(given, expected, strict=True)
    )


def cache() -> Path:
    """Return the folder in which machine code is kept between processes."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "swarm"


@functools.cache
def key(file: str) -> str:
    """Return a name for the sources of a file's machine code, its compiler and the processor.

    The sources are the contents of the file and of the files that it imports. Raises OSError where
    a file cannot be read, or has changed since this process started.
    """
    return _name_of_sources(file, compiler())


@functools.cache
def program(file: str) -> str:
    """Return a name for the sources of a file alone, the same on every machine.

    Raises OSError as :func:`key`.
    """
    return _name_of_sources(file, "")


def _name_of_sources(file: str, beginning: str) -> str:
    digest = hashlib.sha256(beginning.encode())
    for name, contents in sorted(_sources(file).items()):
        digest.update(f"{name}\n{contents}\n".encode())
    return digest.hexdigest()[:16]


@functools.cache
def _folder(file: str) -> Path:
    """Return the folder of the machine code of a file; its modification time is its last use."""
    folder = cache() / key(file)
    if not folder.exists():
        prune(cache())
    elif time.time() - folder.stat().st_mtime > _DAY:
        os.utime(folder)
    return folder


def prune(folder: Path) -> None:
    """Remove files and folders that were not used for ``KEPT`` days.

    Other processes may do the same at the same time, or use newer folders: each updates the time of
    the folders it uses once a day, and compiles again if a file is missing.
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
def compiler() -> str:
    """Return the versions of the compilers, and the processor."""
    versions = (numba.__version__, llvmlite.__version__, np.__version__, sys.version)
    processor = (
        platform.machine(),
        llvmlite.binding.get_host_cpu_name(),
        llvmlite.binding.get_host_cpu_features().flatten(),
    )
    return repr((*versions, *processor))


def _sources(file: str) -> dict[str, str]:
    """Return digests of a file and of its direct and indirect imports, by paths from the root."""
    digests: dict[str, str] = {}
    pending = [file]
    while pending:
        name = pending.pop()
        if name not in digests:
            digests[name], imported = _read(name)
            pending += imported
    return {name.removeprefix(_ROOT): digest for name, digest in digests.items()}


@functools.cache
def _read(file: str) -> tuple[str, tuple[str, ...]]:
    """Return the digest of a file's contents, and the files that it imports."""
    with open(file, "rb") as source:
        if _STARTED < os.fstat(source.fileno()).st_mtime <= time.time():
            raise OSError(f"{file} has changed since this process started")
        contents = source.read()
    folder = os.path.dirname(file)
    imported: set[str] = set()
    for module, names in _IMPORTS.findall(b"\n" + contents):
        imported.update(_files(folder, module.decode(), names.decode()))
    return hashlib.sha256(contents).hexdigest(), tuple(imported)


@functools.cache
def _package(folder: str) -> tuple[str, str]:
    """Return the folder that contains a package, and the package's name; "" for a script."""
    if not os.path.isfile(os.path.join(folder, "__init__.py")):
        return folder, ""
    above, package = _package(os.path.dirname(folder))
    return above, package or os.path.basename(folder)


def _files(folder: str, module: str, names: str) -> list[str]:
    """Return the files that an import in a folder's file may read, without installed packages."""
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
    """Return the file of a module; "" where there is no such module."""
    path = os.path.join(root, *module.split("."))
    candidates = (f"{path}.py", os.path.join(path, "__init__.py"))
    return next((file for file in candidates if os.path.isfile(file)), "")
