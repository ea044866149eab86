"""What takes seconds to make and many tests read: made once for all processes of a run."""

import fcntl
import functools
import hashlib
import os
import pickle
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

FOLDER = "SWARM_TESTS_SHARED"
"""The variable that names the folder of this run; `tests/conftest.py` makes and removes it."""


@functools.cache
def drawn_by_program() -> int:
    """A seed for what is drawn by the program's text.

    The same program flies the same failures on every machine, and each change of it flies others.
    """
    root = Path(__file__).parents[1]
    sources = sorted(path for part in ("swarm", "sitl") for path in (root / part).rglob("*.py"))
    return zlib.crc32(b"".join(path.read_bytes() for path in sources))


def shared(make: Callable[P, T]) -> Callable[P, T]:
    """Call a function once in a run for the same arguments, in whichever process is first.

    The others wait, and read the value from a file. Whoever gets it must not change it.
    """

    @functools.cache
    def read(*arguments: P.args, **named: P.kwargs) -> T:
        folder = os.environ.get(FOLDER)
        if folder is None:
            return make(*arguments, **named)
        call = repr((make.__module__, make.__qualname__, arguments, sorted(named.items())))
        path = Path(folder, hashlib.sha256(call.encode()).hexdigest()[:16])
        with path.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
                value = make(*arguments, **named)
                new = path.with_suffix(".new")
                new.write_bytes(pickle.dumps(value))
                new.rename(path)
                return value
        return pickle.loads(path.read_bytes())  # type: ignore[no-any-return]  # noqa: S301

    return read  # type: ignore[return-value]
