"""MAVSDK in a process of its own: the only module that imports it, run as ``python -m``.

It is a library in C++ with threads of its own, which has crashed inside its caller. Here it is
asked by one thread, one vehicle after the other; what it says goes over the pipe whose descriptor
is the first argument. See :mod:`swarm.ground.commissioning.mavsdk_client` for the other side.
"""

import os
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache, partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from mavsdk import Configuration, Mavsdk, log_subscribe
from mavsdk.exceptions import MavsdkError
from mavsdk.plugins.events import Events
from mavsdk.plugins.info import Info
from mavsdk.plugins.log_files import Entry, LogFiles, LogFilesError, LogFilesResult
from mavsdk.plugins.telemetry import Telemetry

from swarm.ground.child_process import die_with_parent

DISCOVERY = 10.0
"""Seconds within which every vehicle must be discovered."""
HEALTH = 5.0
"""Seconds within which a vehicle that is healthy is expected to have said so."""
_POLL = 0.05
_UNKNOWN_DATE = "1970"

Tell = Callable[[tuple[Any, ...]], None]


class NotFoundError(Exception):
    """Vehicles that the library does not find; the text names them."""


@contextmanager
def discovered(ports: Mapping[int, int], source: tuple[int, int]) -> Iterator[dict[int, Any]]:
    """Give the library's handles of the vehicles behind loopback ports, by system id.

    ``source`` is the system and component that it speaks as. Raises :class:`NotFoundError`.
    """
    _quiet()
    with Mavsdk(Configuration.create_manual(*source, False)) as mavsdk:
        for port in ports.values():
            mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        found: dict[int, Any] = {}

        def all_found() -> bool:
            found.update({s.get_system_id(): s for s in mavsdk.get_systems()})
            return found.keys() >= ports.keys()

        if not _wait(all_found, DISCOVERY):
            missing = ", ".join(str(s) for s in sorted(ports.keys() - found.keys()))
            raise NotFoundError(f"not found by MAVSDK: system {missing}")
        yield {system: found[system] for system in ports}


@cache
def _quiet() -> None:
    """Keep the library's log off the terminal; once, since it frees what it was given before."""
    log_subscribe(lambda *_: True)


def report(ports: Mapping[int, int], source: tuple[int, int], tell: Tell) -> None:
    """Tell firmware, health, battery and arming problems: ``("vehicle", system, what)`` each."""
    with discovered(ports, source) as systems:
        telemetries = {system: Telemetry(handle) for system, handle in systems.items()}
        _wait(lambda: all(one.health_all_ok() for one in telemetries.values()), HEALTH)
        for system, handle in systems.items():
            telemetry = telemetries[system]
            health = telemetry.health()
            what = {
                "firmware": _firmware(handle),
                "health": {
                    "gyroscope": health.is_gyrometer_calibration_ok,
                    "accelerometer": health.is_accelerometer_calibration_ok,
                    "magnetometer": health.is_magnetometer_calibration_ok,
                    "local position": health.is_local_position_ok,
                    "global position": health.is_global_position_ok,
                    "home position": health.is_home_position_ok,
                    "armable": health.is_armable,
                },
                "battery": float(telemetry.battery().remaining_percent),
                "satellites": int(telemetry.gps_info().num_satellites),
                "problems": _arming_problems(handle),
            }
            tell(("vehicle", system, what))


def _firmware(handle: Any) -> str | None:
    with suppress(MavsdkError):
        version = Info(handle).get_version()
        return f"{version.flight_sw_major}.{version.flight_sw_minor}.{version.flight_sw_patch}"
    return None


def _arming_problems(handle: Any) -> tuple[str, ...]:
    """What PX4's health and arming checks complain of; other firmware has no such report."""
    with suppress(MavsdkError):
        found = Events(handle).get_health_and_arming_checks_report()
        return tuple(
            f"{problem.message}{': ' + problem.description if problem.description else ''}"
            for problem in found.all_problems
        )
    return ()


@dataclass
class Fetching:
    """Fetches the newest log of each vehicle into a folder, one vehicle after the other.

    Tells ``("share", system, share)`` while a log arrives and then ``("log", system, path, size,
    date, problem)``. A log that is there already is not fetched again; nothing is overwritten.
    ``patience`` in seconds without a piece ends one; ``cancelled`` ends everything.
    """

    folder: Path
    patience: float
    tell: Tell
    cancelled: Callable[[], bool] = lambda: False
    callbacks: list[object] = field(default_factory=list)
    """What the library may still call, until it is gone."""

    def run(
        self, ports: Mapping[int, int], source: tuple[int, int], suffixes: Mapping[int, str]
    ) -> None:
        """Fetch them all."""
        with discovered(ports, source) as systems:
            for system, handle in systems.items():
                if self.cancelled():
                    return
                self._newest(LogFiles(handle), system, suffixes[system])

    def _newest(self, logs: LogFiles, system: int, suffix: str) -> None:
        try:
            entries = logs.get_entries()
        except LogFilesError as error:
            self._done(system, problem=_words(error.result))
            return
        entry = max(entries, key=lambda one: (one.date, one.id), default=None)
        if entry is None:
            self._done(system, problem=_words(LogFilesResult.NO_LOGFILES))
            return
        date = "" if entry.date.startswith(_UNKNOWN_DATE) else entry.date
        when = date.replace(":", "-") or f"log{entry.id}"
        path = self.folder / f"{system}-{when}{suffix}"
        done = partial(self._done, system, size=int(entry.size_bytes), date=date)
        if path.exists():
            if path.stat().st_size == entry.size_bytes:
                done(path=path)
                return
            done(problem=f"{path} is there already, and is another log")
            return
        part = path.with_name(f"{path.name}.part")
        part.unlink(missing_ok=True)
        try:
            problem = self._download(logs, entry, part, system)
            arrived = part.stat().st_size if part.exists() else 0
            if not problem and arrived == entry.size_bytes:
                part.rename(path)
                done(path=path)
                return
        finally:
            part.unlink(missing_ok=True)
        problem = problem or f"{arrived} of {entry.size_bytes} bytes arrived"
        done(problem=problem)

    def _done(
        self,
        system: int,
        path: Path | None = None,
        size: int = 0,
        date: str = "",
        problem: str = "",
    ) -> None:
        self.tell(("log", system, path, size, date, problem))

    def _download(self, logs: LogFiles, entry: Entry, path: Path, system: int) -> str:
        """Download a log; return why it could not be had, or nothing."""
        said: queue.SimpleQueue[tuple[LogFilesResult, float]] = queue.SimpleQueue()
        logs.download_log_file_async(
            entry, str(path), lambda result, data, _: said.put((result, data.progress))
        )
        # The library frees these with `logs`, but what it has queued by then, after a download that
        # was given up, it still calls: it would jump into memory that is something else by now.
        self.callbacks += logs._callbacks
        silent, share = 0.0, 0.0
        while silent < self.patience and not self.cancelled():
            try:
                result, progress = said.get(timeout=_POLL)
            except queue.Empty:
                silent += _POLL
                continue
            if result is LogFilesResult.SUCCESS:
                self.tell(("share", system, 1.0))
                return ""
            if result is not LogFilesResult.NEXT:
                return _words(result)
            silent, share = 0.0, progress
            self.tell(("share", system, share))
        logs.cancel_download_log_file()
        return f"nothing more came after {share:.0%} of it"


def _words(result: LogFilesResult) -> str:
    if result is LogFilesResult.NO_LOGFILES:
        return "has no logs"
    if result is LogFilesResult.TIMEOUT:
        return "does not answer when it is asked for its logs"
    return f"its log cannot be had: {result.name.replace('_', ' ').lower()}"


def _wait(condition: Callable[[], bool], seconds: float) -> bool:
    deadline = time.monotonic() + seconds
    pause = threading.Event()
    while not condition():
        if time.monotonic() >= deadline:
            return False
        pause.wait(_POLL)
    return True


def main() -> None:
    """Do what the first message asks; a second one cancels it."""
    die_with_parent()
    with Connection(int(sys.argv[1])) as pipe:
        kind, arguments = pipe.recv()
        try:
            if kind == "report":
                report(tell=pipe.send, **arguments)
            else:
                ports, source, suffixes, folder, patience = arguments
                fetching = Fetching(folder, patience, pipe.send, pipe.poll)
                fetching.run(ports, source, suffixes)
        except NotFoundError as error:
            pipe.send(("missing", str(error)))
        except OSError as error:
            pipe.send(("failed", f"{error.filename}: {(error.strerror or str(error)).lower()}"))
        except Exception as error:
            pipe.send(("broken", f"{type(error).__name__}: {error}"))
        else:
            pipe.send(("done",))
    # nothing of the library's is waited for: its threads have hung and crashed at their end
    os._exit(0)


if __name__ == "__main__":
    main()
