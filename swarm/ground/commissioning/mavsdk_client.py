"""What MAVSDK is asked for: firmware, health and arming problems in words, and log download.

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

TRIES = 3
SILENCE = 15.0
"""Seconds without a word after which the process is given up: longer than discovery takes."""
_MODULE = "swarm.ground.commissioning.mavsdk_child"
_SOURCE = (GROUND_SYSTEM, GROUND_COMPONENT)
_POLL = 0.1


@dataclass(frozen=True)
class Report:
    """What a vehicle said of itself through MAVSDK.

    ``firmware`` is the version's number, None where it did not say; ``battery`` in percent,
    negative or NaN where it is not known; ``problems`` what keeps it from arming, in its own words.
    """

    firmware: str | None
    health: Mapping[str, bool]
    battery: float
    satellites: int
    problems: tuple[str, ...]


@dataclass(frozen=True)
class Log:
    """What came of one vehicle's newest log; ``path`` None where ``problem`` says why."""

    path: Path | None
    size: int
    date: str
    problem: str


def reports(
    ports: Mapping[int, int],
    on_report: Callable[[int], None] = lambda _: None,
    *,
    silence: float = SILENCE,
) -> dict[int, Report]:
    """Ask the vehicles behind loopback ports, by system id; ``on_report`` is called for each.

    Blocks. Raises :class:`VehicleError` where vehicles are not found, or the process ends or is
    silent for so many seconds in every try.
    """
    found: dict[int, Report] = {}

    def take(message: tuple[Any, ...]) -> None:
        _, system, what = message
        found[system] = Report(**what)
        on_report(system)

    for left in range(TRIES - 1, -1, -1):
        missing = {system: port for system, port in ports.items() if system not in found}
        try:
            request = ("report", {"ports": missing, "source": _SOURCE})
            _converse(request, take, silence, partial(_all_in, found, ports))
            return found
        except MissingError:
            if not left:
                raise
        except ChildError as error:
            if not left:
                names = ", ".join(str(s) for s in sorted(ports.keys() - found.keys()))
                words = f"MAVSDK failed in {TRIES} tries of {TRIES} when asked about system {names}"
                raise VehicleError(f"{words}: {error}") from None
    return found


def fetch(
    ports: Mapping[int, int],
    suffixes: Mapping[int, str],
    folder: Path,
    patience: float,
    on_share: Callable[[int, float], None],
    cancelled: Callable[[], bool],
) -> dict[int, Log]:
    """Fetch the newest log of each vehicle behind loopback ports into ``folder``.

    A vehicle in whose turn the process ends or hangs is asked again a few times; then that is its
    log's problem, and the next vehicle is asked. Ends early where ``cancelled`` says so. Raises
    :class:`VehicleError` where vehicles are not found or ``folder`` cannot be written.
    """
    found: dict[int, Log] = {}
    failures = dict.fromkeys(ports, 0)

    def take(message: tuple[Any, ...]) -> None:
        kind, system, *what = message
        if kind == "share":
            on_share(system, *what)
        else:
            found[system] = Log(*what)

    while not cancelled() and (missing := [s for s in ports if s not in found]):
        asked = {system: ports[system] for system in missing}
        request = ("logs", (asked, _SOURCE, suffixes, folder, patience))
        try:
            enough = partial(_all_in, found, ports)
            _converse(request, take, SILENCE + patience, enough, cancelled)
        except ChildError as error:
            turn = next(system for system in missing if system not in found)
            failures[turn] += 1
            if failures[turn] == TRIES:
                words = f"MAVSDK failed in {TRIES} tries of {TRIES}: {error}"
                found[turn] = Log(None, 0, "", words)
        finally:
            for system in missing:
                for part in folder.glob(f"{system}-*{suffixes[system]}.part"):
                    part.unlink(missing_ok=True)
    return found


class MissingError(VehicleError):
    """The library did not find vehicles that are heard on the links: worth another try."""


def _all_in(found: Mapping[int, object], wanted: Mapping[int, object]) -> bool:
    return found.keys() >= wanted.keys()


def _converse(
    request: Any,
    take: Callable[[tuple[Any, ...]], None],
    silence: float,
    enough: Callable[[], bool],
    cancelled: Callable[[], bool] = lambda: False,
) -> None:
    """Ask a child process, and take its messages until it is done or they are ``enough``.

    What the library does at its end is not waited for. Raises :class:`ChildError` where it ends or
    is silent before that, and :class:`VehicleError` with its words where it cannot do what it is
    asked.
    """
    child = ChildProcess(_MODULE)
    try:
        child.send(request)
        heard = time.monotonic()
        told = False
        while not enough():
            if cancelled() and not told:
                child.send("cancel")
                told = True
            for message in child.receive(_POLL):
                heard = time.monotonic()
                if message[0] == "done":
                    return
                if message[0] == "missing":
                    raise MissingError(message[1])
                if message[0] == "failed":
                    raise VehicleError(message[1])
                if message[0] == "broken":
                    raise ChildError(f"its process failed: {message[1]}")
                take(message)
            if time.monotonic() - heard > silence:
                raise ChildError(f"its process said nothing for {silence:g} s")
    finally:
        child.close()
