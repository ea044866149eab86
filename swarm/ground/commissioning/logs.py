"""Download of the autopilots' own logs through MAVSDK: the newest of every vehicle."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from swarm.errors import Refused
from swarm.ground.commissioning.mavsdk_client import newest_logs
from swarm.ground.commissioning.survey import Survey, open_survey
from swarm.mission.fleet import Fleet

TIMEOUT = 15.0
"""Seconds without new data after which the download of a log fails."""
_SUFFIX = {"px4": ".ulg", "ardupilot": ".bin"}

LogProgress = Callable[[int, float], None]
"""Called with a system id and the share of its log that has arrived."""


@dataclass(frozen=True)
class LogDownload:
    """The result for the newest log of one vehicle.

    ``path`` is the file, None if it was not downloaded; ``problem`` is then the reason. ``size`` in
    bytes; ``date`` as the vehicle reports it, empty if the vehicle has no date.
    """

    system: int
    path: Path | None
    size: int = 0
    date: str = ""
    problem: str = ""


def download_logs(
    fleet: Fleet, folder: Path, progress: LogProgress = lambda *_: None, *, timeout: float = TIMEOUT
) -> tuple[LogDownload, ...]:
    """Download the newest log of every vehicle into ``folder``, one vehicle after the other.

    A log that exists already is not downloaded again, and no file is overwritten. A vehicle that is
    not received, has no log or does not send it does not affect the others.

    Raises :class:`Refused` if a vehicle is armed before or during the download.
    """
    with open_survey(fleet, folder) as survey:
        return survey.run(_Download(survey, folder, progress, timeout).run)


@dataclass
class _Download:
    """The blocking part, in a thread beside the loop; ``armed`` are systems that were armed."""

    survey: Survey
    folder: Path
    progress: LogProgress
    timeout: float
    armed: set[int] = field(default_factory=set)

    def run(self) -> tuple[LogDownload, ...]:
        missing = self.survey.wait_for_vehicles()
        self._refuse_armed()
        vehicles = {vehicle.system: vehicle for vehicle in self.survey.listener.received}
        logs = [LogDownload(system, None, problem="not received") for system in missing]
        relay = self.survey.relay
        if vehicles:
            ports = {system: relay.ports[system] for system in vehicles}
            suffixes = {
                system: _SUFFIX.get(vehicle.autopilot.name if vehicle.autopilot else "", ".log")
                for system, vehicle in vehicles.items()
            }
            found = newest_logs(
                ports, suffixes, self.folder, self.timeout, self.progress, self._any_armed
            )
            self._refuse_armed()
            logs += [
                LogDownload(system, log.path, log.size, log.date, log.problem)
                for system, log in found.items()
            ]
        relay.closed = True
        return tuple(sorted(logs, key=lambda log: log.system))

    def _any_armed(self) -> bool:
        self.armed |= {v.system for v in self.survey.listener.received if v.armed}
        return bool(self.armed)

    def _refuse_armed(self) -> None:
        if self._any_armed():
            self.survey.relay.closed = True
            names = ", ".join(map(str, sorted(self.armed)))
            text = "logs are downloaded from disarmed vehicles on the ground only"
            raise Refused(f"system {names} is armed: {text}")
