"""Machine code before its first call: compiled on all cores, and loaded before a flight.

The compiled functions that Python calls declare the types of their arguments
(:mod:`swarm.signatures`). What is not in the user's cache is compiled in processes beside each
other; a process that flies then loads all of it, and compiles nothing more
(:func:`swarm.jit.sealed`).
"""

import gc
import hashlib
import importlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from numba.core.dispatcher import Dispatcher

from swarm.child_modules import module_command
from swarm.jit import cache, declared, key

Progress = Callable[[str, float], None]

PLANNING = ("swarm.geometry", "swarm.folding", "swarm.certification", "swarm.planning")
_MONITOR = "swarm.certification.monitor"
FLIGHT = ("swarm.flight", "swarm.mavlink", _MONITOR, "sitl")
"""Packages whose functions are compiled before the first plan and the first flight. What
only a flight calls of the certification is compiled with the flight (2.5 s of a processor)."""

SEARCH = ("swarm.untangling", "swarm.knots.sticks")
"""What only a search for a number of vehicles or for the motion of a given layout calls: compiled
before the first one, not before every first plan (20 s of a processor), and not loaded for a
flight."""

OPTIMISATION = ("swarm.planner.team_terms",)
"""What only an optimised fold calls, in the same way (5 s of a processor)."""

_RARE = (*SEARCH, *OPTIMISATION)

_PROCESSES = 4
"""Most processes that compile beside each other: the 33 s of a processor are then 9 s."""

_ENDS = ("first", "last")
"""Which modules a process takes first. Every other process begins with the last ones, because
neighbours call the same functions, and two processes would compile them at the same time."""

_STAGE = "compiling, once on this machine"


def functions(modules: Iterable[str]) -> Iterator[Any]:
    """Yield the compiled functions of imported modules."""
    for name in modules:
        for value in list(vars(sys.modules[name]).values()):
            if isinstance(value, Dispatcher) and value.py_func.__module__ == name:
                yield value


def imported() -> list[str]:
    """Return the names of this project's imported modules."""
    return [name for name in list(sys.modules) if name.partition(".")[0] in {"swarm", "sitl"}]


def load(modules: Iterable[str] | None = None) -> int:
    """Load or compile all declared functions of imported modules; return how many.

    The default is all modules but those of ``_RARE``, which no flight calls. After this and in
    :func:`swarm.jit.sealed` no call waits for a compiler.
    """
    count = 0
    if modules is None:
        modules = [name for name in imported() if not name.startswith(_RARE)]
    for function in functions(modules):
        types = declared(function)
        if types is not None:
            function.compile(types)
            count += 1
    return count


def prepare(packages: Sequence[str], progress: Progress | None = None) -> None:
    """Compile what the cache does not have of packages, in processes beside each other.

    ``progress`` is called with a stage and its completed share, 0…1. Nothing is done where it was
    done before for the same sources, or where there is no cache to share; whatever is not compiled
    here is compiled at its first call.
    """
    with compiling(packages) as finish:
        finish(progress)


@contextmanager
def compiling(packages: Sequence[str]) -> Iterator[Callable[[Progress | None], None]]:
    """Compile packages as :func:`prepare` while the body runs; yield what waits for the rest.

    What is not compiled at the end of the body is left.
    """
    marks = {package: mark for package in packages if (mark := _mark(package)) is not None}
    packages = [package for package, mark in marks.items() if not mark.exists()]
    if not packages:
        yield lambda _progress: None
        return
    with tempfile.TemporaryDirectory(prefix="swarm-") as taken:
        reading, writing = os.pipe()
        processes = [
            subprocess.Popen(  # noqa: S603
                module_command(__name__, taken, _ENDS[number % 2], *packages),
                stdin=subprocess.DEVNULL, stdout=writing, stderr=subprocess.DEVNULL,
            )
            for number in range(min(_PROCESSES, os.cpu_count() or 1))
        ]  # fmt: skip
        os.close(writing)

        def finish(progress: Progress | None) -> None:
            for share in _shares(lines):
                if progress is not None:
                    progress(_STAGE, share)
            if not any(process.wait() for process in processes):
                for package in packages:
                    with suppress(OSError):
                        marks[package].touch()

        try:
            with os.fdopen(reading) as lines:
                yield finish
        finally:
            for process in processes:
                process.kill()
                process.wait()


def _shares(lines: Iterable[str]) -> Iterator[float]:
    """Yield the completed share: a line is the number of all functions, or empty for one that is
    compiled."""
    total = done = 0
    for line in lines:
        if line.strip():
            total = int(line)
        else:
            done += 1
        yield done / max(total, 1)


def _mark(package: str) -> Path | None:
    """Return the file that says that these sources are compiled; None without a cache."""
    try:
        cache().mkdir(parents=True, exist_ok=True)
        # Numba finds machine code by the path and the time of its file
        files = sorted(_files([package]).values())
        keys = [(file, Path(file).stat().st_mtime_ns, key(file)) for file in files]
    except OSError:
        return None
    return cache() / f"compiled-{hashlib.sha256(repr(keys).encode()).hexdigest()[:16]}"


def _files(packages: Iterable[str]) -> dict[str, str]:
    """Return the files with compiled functions of packages, by the names of their modules.

    Those of ``_RARE`` and the monitor of a flight are found under their own names only.
    """
    files: dict[str, str] = {}
    for package in packages:
        spec = find_spec(package)
        if spec is None or spec.origin is None:
            raise ModuleNotFoundError(package)
        if not spec.submodule_search_locations:
            files[package] = spec.origin
            continue
        folder = Path(spec.origin).parent
        for path in sorted(folder.rglob("*.py")):
            if b"@compiled" in path.read_bytes():
                parts = path.relative_to(folder).with_suffix("").parts
                name = ".".join((package, *parts))
                if name not in {*_RARE, _MONITOR}:
                    files[name] = str(path)
    return files


def main(taken: str, end: str, packages: Sequence[str]) -> None:
    """Compile the declared functions of packages that no other process compiles.

    A process takes a module or a function by creating a file in the folder ``taken``. It takes
    whole modules while there are any, from the ``end`` that is first or last, because their
    functions call the same others, and then helps with what is left of those of other processes. In
    a module those that others call come last. Writes the number of all functions to standard
    output, and a line for each that is compiled here.
    """
    # Of what a compiler makes little becomes garbage; looking for it took an eighth of the time.
    gc.disable()
    modules = list(_files(packages))
    if end == "last":
        modules.reverse()
    for module in modules:
        importlib.import_module(module)
    pending = {
        module: [routine for routine in functions([module]) if declared(routine) is not None][::-1]
        for module in modules
    }
    sys.stdout.write(f"{sum(map(len, pending.values()))}\n")
    for module in modules:
        if _take(taken, module):
            _compile(taken, module, pending[module])
    for module in modules:
        _compile(taken, module, pending[module])


def _compile(taken: str, module: str, pending: Sequence[Any]) -> None:
    """Compile those functions of a module that no other process has taken."""
    for number, function in enumerate(pending):
        if _take(taken, f"{module}-{number}"):
            function.compile(declared(function))
            sys.stdout.write("\n")
            sys.stdout.flush()


def _take(taken: str, name: str) -> bool:
    """Return whether this process is the first to take a module or a function."""
    try:
        Path(taken, name).touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3:])
