"""The time of the emulator's world, for flights that follow it instead of the wall clock.

On a busy machine the world, and the autopilots in it, fall behind real time; a ground station that
does not would see all vehicles lag, by the speed times the delay.
"""

import mmap
import struct
import time
from pathlib import Path

from swarm.errors import InputError, Problem

_TIME = struct.Struct("<d")
_ALLOWED_AT = _TIME.size
"""Where the file has the time up to which the world may go on; other programs' clocks end here."""
_STEP = 0.02
"""Seconds of the world between two values in the file."""
_PATIENCE = 2.0
"""Seconds of real time without a new value after which the world counts as ended."""
SHORTEST_WAIT = 0.001
"""Seconds of real time to wait at least while the world has not advanced."""


def create_clock(path: Path) -> None:
    """Create the file in which the emulator puts its time; raises `OSError`."""
    path.write_bytes(2 * _TIME.pack(0.0))


def open_clock(path: Path) -> "WorldClock":
    """Open the clock of a world in real time that another process simulates; close it after use.

    Raises :class:`InputError` where the file is not such a clock.
    """
    try:
        return WorldClock(path, 1.0)
    except (OSError, ValueError):
        message = "expected the clock of a world that runs (swarm sitl --clock)"
        raise InputError([Problem(str(path), message)]) from None


def require_clock(path: Path | None) -> None:
    """Raise :class:`InputError` where a given file is not a world's clock."""
    if path is not None:
        open_clock(path).close()


class WorldClock:
    """Seconds of a world that runs at ``speed`` times real time, divided by ``speed``.

    Between values it goes on with the wall clock, by one step at most. It never goes back; without
    an emulator it continues after a while, so that a flight notices the silence.
    """

    def __init__(self, path: Path, speed: float) -> None:
        """Raise `OSError` if the file cannot be read."""
        with path.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), 0)
        self._speed = speed
        self._world, self._changed, self._last = -1.0, 0.0, 0.0

    def now(self) -> float:
        """Return the time, seconds."""
        world, moment = _TIME.unpack_from(self._map)[0], time.monotonic()
        if world != self._world:
            self._world, self._changed = world, moment
        since = moment - self._changed
        ahead = min(since, _STEP / self._speed) + max(since - _PATIENCE, 0.0)
        self._last = max(self._last, world / self._speed + ahead)
        return self._last

    def allow(self, until: float) -> None:
        """Let the world go on until a time of this clock; it waits there for the next call.

        It does so for two seconds of real time at most, and not before the first call.
        """
        if len(self._map) > _ALLOWED_AT:
            _TIME.pack_into(self._map, _ALLOWED_AT, until * self._speed)

    def close(self) -> None:
        """Let the world go on, and close the file."""
        self.allow(0.0)
        self._map.close()
