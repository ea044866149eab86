"""The file of the MAVLink signing key, and the timestamp that is stored between flights."""

import os
import stat
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from swarm.errors import InputError, Problem, reason
from swarm.ground.priority import run_behind_main_thread
from swarm.mavlink.signing import KEY_LENGTH, TICKS_PER_SECOND, Signing, timestamp_at

SAVE_INTERVAL = 1.0
_CRASH_MARGIN = 10 * TICKS_PER_SECOND
_MAX_SIZE = 1024


def read_key(path: Path) -> bytes:
    """Return the key in a file: 64 hexadecimal digits, or 32 bytes.

    Raises :class:`InputError` if it is not a key, or if users other than its owner may read it.
    """
    try:
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            data = file.read(_MAX_SIZE)
    except OSError as error:
        raise _problem(path, reason(error)) from None
    if not stat.S_ISREG(status.st_mode):
        raise _problem(path, "expected a file")
    if status.st_mode & 0o077:
        mode = stat.S_IMODE(status.st_mode)
        text = f"other users may read this key (mode {mode:03o}); make it private: chmod 600 {path}"
        raise _problem(path, text)
    if status.st_uid != os.getuid():
        raise _problem(path, "expected a key file that this user owns")
    if len(data) == KEY_LENGTH:
        return data
    with suppress(ValueError):
        key = bytes.fromhex(data.decode("ascii", "strict"))
        if len(key) == KEY_LENGTH:
            return key
    raise _problem(path, f"expected {2 * KEY_LENGTH} hexadecimal digits or {KEY_LENGTH} bytes")


@contextmanager
def signing_with(file: str | None) -> Iterator[Signing | None]:
    """Yield the signing with a key file, None without one; the timestamp is saved beside the key.

    A thread saves the timestamp every second. A full disk has no effect in flight, but a timestamp
    that cannot be saved before the flight is an :class:`InputError`.
    """
    if file is None:
        yield None
        return
    path = Path(file)
    key = read_key(path)
    beside = path.with_name(path.name + ".timestamp")
    signing = Signing(key, max(timestamp_at(time.time()), _load(beside) + _CRASH_MARGIN))
    try:
        _save(beside, signing.timestamp)
    except OSError as error:
        raise _problem(beside, f"the timestamp cannot be saved: {reason(error)}") from None
    stopped = threading.Event()

    def work() -> None:
        run_behind_main_thread()
        while not stopped.wait(SAVE_INTERVAL):
            with suppress(OSError):
                _save(beside, signing.timestamp)

    saver = threading.Thread(target=work, name="signing", daemon=True)
    saver.start()
    try:
        yield signing
    finally:
        stopped.set()
        saver.join(5.0)
        with suppress(OSError):
            _save(beside, signing.timestamp)


def _load(path: Path) -> int:
    with suppress(OSError, ValueError):
        return max(0, min(int(path.read_text(encoding="ascii")[:20]), 1 << 47))
    return 0


def _save(path: Path, timestamp: int) -> None:
    """Replace the file atomically: after a crash it is the old one or the new one."""
    new = path.with_name(path.name + ".new")
    descriptor = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    with os.fdopen(descriptor, "w", encoding="ascii") as file:
        file.write(f"{timestamp}\n")
    new.replace(path)


def _problem(path: Path, message: str) -> InputError:
    return InputError([Problem(str(path), message)])
