"""Requests to MAVSDK: firmware, health and arming problems of vehicles, and log download.

MAVSDK runs in a child process (:mod:`swarm.ground.commissioning.mavsdk_child`) behind the relay's
loopback endpoints. If the process ends early or is silent for too long, it is started again a few
times for the vehicles that are still missing. Then an error reports how it ended.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from swarm.errors import VehicleError
from swarm.ground.child_process import ChildError, ChildProcess
from swarm.mavlink.packets import GROUND_COMPONENT, GROUND_SYSTEM

ATTEMPTS = 3
TIMEOUT = 15.0
"""Seconds without a message after which the process has failed: longer than discovery takes."""
_MODULE = "swarm.ground.commissioning.mavsdk_child"
_SOURCE = (GROUND_SYSTEM, GROUND_COMPONENT)
_POLL = 0.1


@dataclass(frozen=True)
class VehicleReport:
    """The state of a vehicle as MAVSDK reports it.

    ``firmware`` is the version number, None if unknown; ``battery`` in percent, negative or NaN if
    unknown; ``problems`` the vehicle's own reasons why it cannot be armed.
    """

    firmware: str | None
    health: Mapping[str, bool]
    battery: float
    satellites: int
    problems: tuple[str, ...]


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


def vehicle_reports(
    ports: Mapping[int, int],
    on_report: Callable[[int], None] = lambda _: None,
    *,
    timeout: float = TIMEOUT,
) -> dict[int, VehicleReport]:
    """Return the reports of the vehicles behind loopback ports, by system id.

    Blocks; ``on_report`` is called for each vehicle. Raises :class:`VehicleError` if vehicles are
    not found, or if in every attempt the process ends or sends nothing for ``timeout`` seconds.
    """
    reports: dict[int, VehicleReport] = {}

    def handle(message: tuple[Any, ...]) -> None:
        _, system, fields = message
        reports[system] = VehicleReport(**fields)
        on_report(system)

    for remaining in range(ATTEMPTS - 1, -1, -1):
        missing = {system: port for system, port in ports.items() if system not in reports}
        try:
            request = ("report", {"ports": missing, "source": _SOURCE})
            _request(request, handle, timeout, partial(_complete, reports, ports))
            return reports
        except MissingError:
            if not remaining:
                raise
        except ChildError as error:
            if not remaining:
                names = ", ".join(str(s) for s in sorted(ports.keys() - reports.keys()))
                text = f"MAVSDK failed in {ATTEMPTS} attempts of {ATTEMPTS} for system {names}"
                raise VehicleError(f"{text}: {error}") from None
    return reports


def newest_logs(
    ports: Mapping[int, int],
    suffixes: Mapping[int, str],
    folder: Path,
    timeout: float,
    on_share: Callable[[int, float], None],
    cancelled: Callable[[], bool],
) -> dict[int, LogDownload]:
    """Download the newest log of each vehicle behind loopback ports into ``folder``.

    If the process fails for a vehicle in every attempt, this is the problem of its log, and the
    next vehicle follows. Ends early once ``cancelled`` returns True. Raises :class:`VehicleError`
    if vehicles are not found in three searches or ``folder`` cannot be written.
    """
    logs: dict[int, LogDownload] = {}
    failures, searches = dict.fromkeys(ports, 0), 0

    def handle(message: tuple[Any, ...]) -> None:
        kind, system, *fields = message
        if kind == "share":
            on_share(system, *fields)
        else:
            logs[system] = LogDownload(system, *fields)

    while not cancelled() and (missing := [s for s in ports if s not in logs]):
        remaining = {system: ports[system] for system in missing}
        request = ("logs", (remaining, _SOURCE, suffixes, folder, timeout))
        try:
            complete = partial(_complete, logs, ports)
            _request(request, handle, TIMEOUT + timeout, complete, cancelled)
        except MissingError:
            searches += 1
            if searches == ATTEMPTS and not cancelled():
                raise
        except ChildError as error:
            current = next(system for system in missing if system not in logs)
            failures[current] += 1
            if failures[current] == ATTEMPTS:
                text = f"MAVSDK failed in {ATTEMPTS} attempts of {ATTEMPTS}: {error}"
                logs[current] = LogDownload(current, None, problem=text)
        finally:
            for system in missing:
                for part in folder.glob(f"{system}-*{suffixes[system]}.part"):
                    part.unlink(missing_ok=True)
    return logs


class MissingError(VehicleError):
    """MAVSDK did not find vehicles that send on the links; another attempt may find them."""


def _complete(received: Mapping[int, object], required: Mapping[int, object]) -> bool:
    return received.keys() >= required.keys()


def _request(
    request: Any,
    handle: Callable[[tuple[Any, ...]], None],
    timeout: float,
    complete: Callable[[], bool],
    cancelled: Callable[[], bool] = lambda: False,
) -> None:
    """Send a request to a new child process, and handle its messages until it is complete.

    The end of the process is not waited for. Raises :class:`ChildError` if the process ends or is
    silent before, and :class:`VehicleError` with its message if it cannot serve the request.
    """
    child = ChildProcess(_MODULE)
    try:
        child.send(request)
        latest = time.monotonic()
        cancel_sent = False
        while not complete():
            if cancelled() and not cancel_sent:
                child.send("cancel")
                cancel_sent = True
            for message in child.receive(_POLL):
                latest = time.monotonic()
                if message[0] == "done":
                    return
                if message[0] == "missing":
                    raise MissingError(message[1])
                if message[0] == "failed":
                    raise VehicleError(message[1])
                if message[0] == "broken":
                    raise ChildError(f"its process failed: {message[1]}")
                handle(message)
            if time.monotonic() - latest > timeout:
                raise ChildError(f"its process was silent for {timeout:g} s")
    finally:
        child.close()
