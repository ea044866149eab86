"""The autopilots' own logs, fetched on request: the newest of every vehicle, through MAVSDK."""

import queue
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from mavsdk.plugins.log_files import Entry, LogFiles, LogFilesError, LogFilesResult

from swarm.errors import Refused
from swarm.fleet import Fleet
from swarm.ground.attendance import Attendance, attended
from swarm.ground.audit import discovered

PATIENCE = 15.0
"""Seconds without a piece of a log after which it is given up."""
_POLL = 0.2
_SUFFIX = {"px4": ".ulg", "ardupilot": ".bin"}
_UNKNOWN_DATE = "1970"

Tell = Callable[[int, float], None]
"""Is told of a vehicle and of the share of its log that has arrived."""


@dataclass(frozen=True)
class FetchedLog:
    """What came of one vehicle's newest log.

    ``path`` is where it is, None where it could not be had, and then ``problem`` says why; ``size``
    in bytes; ``date`` as the vehicle gives it, empty where it does not know the time.
    """

    system: int
    path: Path | None
    size: int = 0
    date: str = ""
    problem: str = ""


def fetch_logs(
    fleet: Fleet, folder: Path, tell: Tell = lambda *_: None, *, patience: float = PATIENCE
) -> tuple[FetchedLog, ...]:
    """Fetch every vehicle's newest log into ``folder``, one vehicle after the other.

    A log that is there already is not fetched again; nothing is overwritten. Who is not heard, has
    no log or does not send it is told in the result and does not keep others from sending theirs.

    Raises :class:`Refused` where anything is armed, or is armed meanwhile.
    """
    with attended(fleet, folder) as attendance:
        return attendance.run(_Fetching(attendance, folder, tell, patience).run)


@dataclass
class _Fetching:
    """The blocking part, in a thread of its own beside the loop."""

    attendance: Attendance
    folder: Path
    tell: Tell
    patience: float
    callbacks: list[object] = field(default_factory=list)
    """What the library may still call, until it is gone."""

    def run(self) -> tuple[FetchedLog, ...]:
        missing = self.attendance.hear()
        self._refuse_armed()
        heard = {vehicle.system: vehicle for vehicle in self.attendance.listening.heard}
        found = [FetchedLog(system, None, problem="not heard") for system in missing]
        relay = self.attendance.relay
        if heard:
            with discovered({system: relay.ports[system] for system in heard}) as handles:
                for system, vehicle in heard.items():
                    name = vehicle.autopilot.name if vehicle.autopilot else ""
                    logs, suffix = LogFiles(handles[system]), _SUFFIX.get(name, ".log")
                    found.append(self._newest(logs, system, suffix))
        relay.closed = True
        return tuple(sorted(found, key=lambda log: log.system))

    def _refuse_armed(self) -> None:
        armed = [str(v.system) for v in self.attendance.listening.heard if v.armed]
        if armed:
            self.attendance.relay.closed = True
            words = "logs are fetched from vehicles that stand on the ground, disarmed"
            raise Refused(f"system {', '.join(armed)} is armed: {words}")

    def _newest(self, logs: LogFiles, system: int, suffix: str) -> FetchedLog:
        """Fetch one vehicle's newest log, unless it is there already."""
        try:
            entries = logs.get_entries()
        except LogFilesError as error:
            return FetchedLog(system, None, problem=_words(error.result))
        entry = max(entries, key=lambda one: (one.date, one.id), default=None)
        if entry is None:
            return FetchedLog(system, None, problem=_words(LogFilesResult.NO_LOGFILES))
        date = "" if entry.date.startswith(_UNKNOWN_DATE) else entry.date
        found = FetchedLog(system, None, entry.size_bytes, date)
        when = date.replace(":", "-") or f"log{entry.id}"
        path = self.folder / f"{system}-{when}{suffix}"
        if path.exists():
            if path.stat().st_size == entry.size_bytes:
                return replace(found, path=path)
            return replace(found, problem=f"{path} is there already, and is another log")
        part = path.with_name(f"{path.name}.part")
        part.unlink(missing_ok=True)
        try:
            problem = self._download(logs, entry, part, system)
            arrived = part.stat().st_size if part.exists() else 0
            if not problem and arrived == entry.size_bytes:
                part.rename(path)
                return replace(found, path=path)
        finally:
            part.unlink(missing_ok=True)
        return replace(found, problem=problem or f"{arrived} of {entry.size_bytes} bytes arrived")

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
        while silent < self.patience:
            try:
                result, progress = said.get(timeout=_POLL)
            except queue.Empty:
                silent += _POLL
            else:
                if result is LogFilesResult.SUCCESS:
                    self.tell(system, 1.0)
                    return ""
                if result is not LogFilesResult.NEXT:
                    return _words(result)
                silent, share = 0.0, progress
                self.tell(system, share)
            if any(vehicle.armed for vehicle in self.attendance.listening.heard):
                logs.cancel_download_log_file()
                self._refuse_armed()
        logs.cancel_download_log_file()
        return f"nothing more came after {share:.0%} of it"


def _words(result: LogFilesResult) -> str:
    if result is LogFilesResult.NO_LOGFILES:
        return "has no logs"
    if result is LogFilesResult.TIMEOUT:
        return "does not answer when it is asked for its logs"
    return f"its log cannot be had: {result.name.replace('_', ' ').lower()}"
