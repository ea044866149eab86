"""Compiled loops, for hot paths in which arrays are too small or too ragged for NumPy."""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar, cast

import numba

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

_SOURCES: dict[str, frozenset[str]] = {}
"""Files from which a file's compiled functions are made: itself, and those of what these call."""


def compiled(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Compile a function of numbers and arrays when it is first called.

    The machine code is kept in the user's cache, so that it is compiled once per machine; where
    that cannot be written, once per process. It is compiled anew when its file or that of any
    compiled function which it may call has changed. Division by 0 gives what NumPy gives.
    """
    before = numba.config.CACHE_DIR
    try:
        # Not beside the module: what pip did not install stays behind when it uninstalls, and
        # Python takes the folders that are left for a package.
        numba.config.CACHE_DIR = str(_folder(function))
        made = numba.njit(function, cache=True, error_model="numpy", nogil=True)
    except (RuntimeError, OSError):
        made = numba.njit(function, error_model="numpy", nogil=True)
    finally:
        numba.config.CACHE_DIR = before
    return cast("Callable[Parameters, Result]", made)


def _folder(function: Callable[..., object]) -> Path:
    """Where machine code that is made from these very sources may be kept."""
    own = function.__code__.co_filename
    callable_here = [
        value.py_func.__code__.co_filename
        for value in function.__globals__.values()
        if isinstance(value, numba.core.dispatcher.Dispatcher)
    ]
    sources = {own}.union(*(_SOURCES[name] for name in callable_here if name != own))
    _SOURCES[own] = _SOURCES.get(own, frozenset()) | sources
    stamps = [(name, os.stat(name).st_mtime_ns, os.stat(name).st_size) for name in sorted(sources)]
    stamp = hashlib.sha256(repr(stamps).encode()).hexdigest()[:16]
    caches = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(caches) / "swarm" / stamp
