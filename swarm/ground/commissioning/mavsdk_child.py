"""MAVSDK in a process of its own: the only module that imports it, run as ``python -m``.

MAVSDK is a C++ library with threads of its own, which has crashed inside its caller. Here one
thread uses it, one vehicle after the other, and sends the results over the pipe whose descriptor is
the first argument. :mod:`swarm.ground.commissioning.mavsdk_client` is the other side.
"""

import math
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

from swarm.errors import printable
from swarm.ground.child_process import die_with_parent

DISCOVERY_TIMEOUT = 10.0
"""Seconds within which every vehicle must be discovered."""
HEALTH_TIMEOUT = 5.0
"""Seconds within which a healthy vehicle is expected to report that it is healthy."""
_HEALTH_PERIOD = 1.0
"""Seconds within which a subsystem was healthy at least once: without GPS, each SYS_STATUS of an
ArduPilot makes MAVSDK's local position unhealthy until the next LOCAL_POSITION_NED, measured every
0.5 s for 0.05 to 0.2 s: two such periods, where one may be missed."""
_HEALTH = {
    "gyroscope": "is_gyrometer_calibration_ok",
    "accelerometer": "is_accelerometer_calibration_ok",
    "magnetometer": "is_magnetometer_calibration_ok",
    "local position": "is_local_position_ok",
    "global position": "is_global_position_ok",
    "home position": "is_home_position_ok",
    "armable": "is_armable",
}
"""The subsystems, with their names in MAVSDK's health."""
_POLL = 0.05
_UNKNOWN_DATE = "1970"

Send = Callable[[tuple[Any, ...]], None]


class NotFoundError(Exception):
    """MAVSDK has not found vehicles; the text names them."""


@contextmanager
def discovered(ports: Mapping[int, int], source: tuple[int, int]) -> Iterator[dict[int, Any]]:
    """Yield MAVSDK's handles of the vehicles behind loopback ports, by system id.

    ``source`` are the system and component ids of its packets. Raises :class:`NotFoundError`.
    """
    _silence_log()
    with Mavsdk(Configuration.create_manual(*source, False)) as mavsdk:
        for port in ports.values():
            mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        handles: dict[int, Any] = {}

        def all_found() -> bool:
            handles.update({s.get_system_id(): s for s in mavsdk.get_systems()})
            return handles.keys() >= ports.keys()

        if not _wait(all_found, DISCOVERY_TIMEOUT):
            missing = ", ".join(str(s) for s in sorted(ports.keys() - handles.keys()))
            raise NotFoundError(f"not found by MAVSDK: system {missing}")
        yield {system: handles[system] for system in ports}


@cache
def _silence_log() -> None:
    """Keep MAVSDK's log off the terminal; only once, since it frees the previous callback."""
    log_subscribe(lambda *_: True)


def report(ports: Mapping[int, int], source: tuple[int, int], send: Send) -> None:
    """Send ``("vehicle", system, fields)`` with firmware, health, battery, arming problems."""
    with discovered(ports, source) as systems:
        telemetries = {system: Telemetry(handle) for system, handle in systems.items()}
        healthy_at: dict[tuple[int, str], float] = {}

        def all_healthy() -> bool:
            now = time.monotonic()
            for system, telemetry in telemetries.items():
                health = telemetry.health()
                for subsystem, name in _HEALTH.items():
                    if getattr(health, name):
                        healthy_at[system, subsystem] = now
            return all(telemetry.health_all_ok() for telemetry in telemetries.values())

        _wait(all_healthy, HEALTH_TIMEOUT)
        recent = time.monotonic() - _HEALTH_PERIOD
        for system, handle in systems.items():
            telemetry = telemetries[system]
            fields = {
                "firmware": _firmware(handle),
                "health": {
                    subsystem: healthy_at.get((system, subsystem), -math.inf) >= recent
                    for subsystem in _HEALTH
                },
                "battery": float(telemetry.battery().remaining_percent),
                "satellites": int(telemetry.gps_info().num_satellites),
                "problems": _arming_problems(handle),
            }
            send(("vehicle", system, fields))


def _firmware(handle: Any) -> str | None:
    with suppress(MavsdkError):
        version = Info(handle).get_version()
        return f"{version.flight_sw_major}.{version.flight_sw_minor}.{version.flight_sw_patch}"
    return None


def _arming_problems(handle: Any) -> tuple[str, ...]:
    """Return the problems of PX4's health and arming checks; other firmware has no such report."""
    with suppress(MavsdkError):
        checks = Events(handle).get_health_and_arming_checks_report()
        return tuple(
            printable(
                f"{problem.message}{': ' + problem.description if problem.description else ''}"
            )
            for problem in checks.all_problems
        )
    return ()


@dataclass
class LogDownloader:
    """Downloads the newest log of each vehicle into a folder, one vehicle after the other.

    Sends ``("share", system, share)`` while a log arrives, and then ``("log", system, path, size,
    date, problem)``. A log that exists already is not downloaded again; no file is overwritten.
    The download of a log fails after ``timeout`` seconds without data; ``cancelled`` ends all
    downloads. ``callbacks`` are kept because MAVSDK may call them until it is destroyed.
    """

    folder: Path
    timeout: float
    send: Send
    cancelled: Callable[[], bool] = lambda: False
    callbacks: list[object] = field(default_factory=list)

    def run(
        self, ports: Mapping[int, int], source: tuple[int, int], suffixes: Mapping[int, str]
    ) -> None:
        """Download all logs."""
        with discovered(ports, source) as systems:
            for system, handle in systems.items():
                if self.cancelled():
                    return
                self._newest(LogFiles(handle), system, suffixes[system])

    def _newest(self, logs: LogFiles, system: int, suffix: str) -> None:
        try:
            entries = logs.get_entries()
        except LogFilesError as error:
            self._done(system, problem=_problem(error.result))
            return
        entry = max(entries, key=lambda log: (log.date, log.id), default=None)
        if entry is None:
            self._done(system, problem=_problem(LogFilesResult.NO_LOGFILES))
            return
        date = "" if entry.date.startswith(_UNKNOWN_DATE) else entry.date
        when = date.replace(":", "-") or f"log{entry.id}"
        path = self.folder / f"{system}-{when}{suffix}"
        done = partial(self._done, system, size=int(entry.size_bytes), date=date)
        if path.exists():
            if path.stat().st_size == entry.size_bytes:
                done(path=path)
                return
            done(problem=f"{path} exists, and is another log")
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
        self.send(("log", system, path, size, date, problem))

    def _download(self, logs: LogFiles, entry: Entry, path: Path, system: int) -> str:
        """Download a log; return the reason if it fails, otherwise an empty text."""
        results: queue.SimpleQueue[tuple[LogFilesResult, float]] = queue.SimpleQueue()
        logs.download_log_file_async(
            entry, str(path), lambda result, data, _: results.put((result, data.progress))
        )
        # MAVSDK frees these with `logs`, but after a cancelled download it still makes the calls
        # that are queued by then: it would jump into memory that has been reused
        self.callbacks += logs._callbacks
        silent, share = 0.0, 0.0
        while silent < self.timeout and not self.cancelled():
            try:
                result, progress = results.get(timeout=_POLL)
            except queue.Empty:
                silent += _POLL
                continue
            if result is LogFilesResult.SUCCESS:
                self.send(("share", system, 1.0))
                return ""
            if result is not LogFilesResult.NEXT:
                return _problem(result)
            silent, share = 0.0, progress
            self.send(("share", system, share))
        logs.cancel_download_log_file()
        return f"no more data after {share:.0%} of it"


def _problem(result: LogFilesResult) -> str:
    if result is LogFilesResult.NO_LOGFILES:
        return "has no logs"
    if result is LogFilesResult.TIMEOUT:
        return "does not respond to the request for its logs"
    return f"its log cannot be downloaded: {result.name.replace('_', ' ').lower()}"


def _wait(condition: Callable[[], bool], seconds: float) -> bool:
    deadline = time.monotonic() + seconds
    pause = threading.Event()
    while not condition():
        if time.monotonic() >= deadline:
            return False
        pause.wait(_POLL)
    return True


def main() -> None:
    """Serve the request in the first message; a second message cancels it."""
    die_with_parent()
    with Connection(int(sys.argv[1])) as pipe:
        kind, arguments = pipe.recv()
        try:
            if kind == "report":
                report(send=pipe.send, **arguments)
            else:
                ports, source, suffixes, folder, timeout = arguments
                downloader = LogDownloader(folder, timeout, pipe.send, pipe.poll)
                downloader.run(ports, source, suffixes)
        except NotFoundError as error:
            pipe.send(("missing", str(error)))
        except OSError as error:
            pipe.send(("failed", f"{error.filename}: {(error.strerror or str(error)).lower()}"))
        except Exception as error:
            pipe.send(("broken", f"{type(error).__name__}: {error}"))
        else:
            pipe.send(("done",))
    # do not wait for MAVSDK: its threads have hung and crashed at their end
    os._exit(0)


if __name__ == "__main__":
    main()
