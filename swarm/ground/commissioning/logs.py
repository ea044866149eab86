"""The autopilots' own logs, fetched on request: the newest of every vehicle, through MAVSDK."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from swarm.errors import Refused
from swarm.ground.commissioning.mavsdk_client import fetch
from swarm.ground.commissioning.survey import Survey, attended
from swarm.mission.fleet import Fleet

PATIENCE = 15.0
"""Seconds without a piece of a log after which it is given up."""
_SUFFIX = {"px4": ".ulg", "ardupilot": ".bin"}

Tell = Callable[[int, float], None]
"""Is told of a vehicle and of the share of its log that has arrived."""


@dataclass(frozen=True)
class LogDownload:
    """What came of one vehicle's newest log.

    ``path`` is where it is, None where it could not be had, and then ``problem`` says why; ``size``
    in bytes; ``date`` as the vehicle gives it, empty where it does not know the time.
    """

    system: int
    path: Path | None
    size: int = 0
    date: str = ""
    problem: str = ""


def download_logs(
    fleet: Fleet, folder: Path, tell: Tell = lambda *_: None, *, patience: float = PATIENCE
) -> tuple[LogDownload, ...]:
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

    attendance: Survey
    folder: Path
    tell: Tell
    patience: float
    armed: set[int] = field(default_factory=set)
    """Systems that were armed at any time since it began."""

    def run(self) -> tuple[LogDownload, ...]:
        missing = self.attendance.hear()
        self._refuse_armed()
        heard = {vehicle.system: vehicle for vehicle in self.attendance.listening.heard}
        logs = [LogDownload(system, None, problem="not heard") for system in missing]
        relay = self.attendance.relay
        if heard:
            ports = {system: relay.ports[system] for system in heard}
            suffixes = {
                system: _SUFFIX.get(vehicle.autopilot.name if vehicle.autopilot else "", ".log")
                for system, vehicle in heard.items()
            }
            found = fetch(ports, suffixes, self.folder, self.patience, self.tell, self._any_armed)
            self._refuse_armed()
            logs += [
                LogDownload(system, log.path, log.size, log.date, log.problem)
                for system, log in found.items()
            ]
        relay.closed = True
        return tuple(sorted(logs, key=lambda log: log.system))

    def _any_armed(self) -> bool:
        self.armed |= {v.system for v in self.attendance.listening.heard if v.armed}
        return bool(self.armed)

    def _refuse_armed(self) -> None:
        if self._any_armed():
            self.attendance.relay.closed = True
            names = ", ".join(map(str, sorted(self.armed)))
            words = "logs are fetched from vehicles that stand on the ground, disarmed"
            raise Refused(f"system {names} is armed: {words}")
