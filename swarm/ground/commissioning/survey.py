"""A fleet on open links that is never armed, while blocking work runs in a thread.

The loop keeps the links; the thread reaches the vehicles through the relay. One such work is the
download of the autopilots' own logs through MAVSDK: the newest of every vehicle.
"""

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from swarm.errors import InputError, Problem, Refused, SwarmError, VehicleError
from swarm.flight.fleet_listener import FleetListener
from swarm.flight.parameters import Requirements, start_as_required
from swarm.flight.world import bare_world, emulated_world
from swarm.ground.commissioning.mavsdk_client import LogDownload, newest_logs
from swarm.ground.corrections import Corrections, open_corrections
from swarm.ground.emulator import EmulatorProcess
from swarm.ground.loop import Loop
from swarm.ground.mocap import MocapBridge
from swarm.ground.mocap_bridge import Borrowed, links_of, open_mocap
from swarm.ground.relay import Relay
from swarm.ground.signing_key import signing_with
from swarm.ground.sockets import Links
from swarm.mission.fleet import Fleet
from swarm.planning import Plan

__all__ = ["LogDownload", "LogProgress", "Survey", "download_logs", "open_survey"]

T = TypeVar("T")

_POLL = 0.1


@dataclass
class Survey:
    """A fleet on open links; ``relay`` has a loopback endpoint for each vehicle.

    ``corrections`` go to the vehicles' receivers meanwhile, and ``poses`` to the vehicles.
    """

    listener: FleetListener
    relay: Relay
    links: Links
    corrections: Corrections | None = None
    poses: Borrowed | MocapBridge | None = None
    _pause: threading.Event = field(default_factory=threading.Event)

    def run(self, work: Callable[[], T], each_tick: Callable[[float], None] = lambda _: None) -> T:
        """Keep the links while ``work`` runs in a thread; return its result.

        ``each_tick`` is called beside it, in this thread, and must be fast.

        Raises the errors of ``work`` that are meant for the user.
        """
        results: list[T] = []
        errors: list[Exception] = []

        def run_work() -> None:
            try:
                results.append(work())
            except (SwarmError, OSError) as error:
                errors.append(error)
            finally:
                self.listener.over = True

        thread = threading.Thread(target=run_work, name="survey", daemon=True)
        thread.start()
        feeds = [feed for feed in (self.poses, self.corrections) if feed is not None]
        copies = [self.poses] if isinstance(self.poses, Borrowed) else []
        Loop(self.listener, self.links, None, 1.0, each_tick, self.relay, copies, feeds=feeds).run()
        thread.join()
        if errors:
            raise errors[0]
        if not results:
            raise VehicleError("it ended without a result")
        return results[0]

    # For the work in the thread

    def wait(self, seconds: float) -> None:
        """Wait while the links continue."""
        self._pause.wait(seconds)

    def wait_until(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Wait until a condition holds; return whether it did within ``timeout`` seconds."""
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() >= deadline:
                return False
            self.wait(_POLL)
        return True

    def wait_for_vehicles(self, progress: Callable[[], None] = lambda: None) -> list[int]:
        """Wait until all vehicles are received; return those missing after ``limits.ready``.

        ``progress`` is called several times a second.
        """

        def complete() -> bool:
            progress()
            return not self.listener.missing

        self.wait_until(complete, self.listener.fleet.limits.ready)
        return self.listener.missing


@contextmanager
def open_survey(
    fleet: Fleet,
    folder: Path,
    plan: Plan | None = None,
    rtcm: str | None = None,
    mocap: str | None = None,
    required: Requirements | None = None,
) -> Iterator[Survey]:
    """Open the links of a fleet, and start the emulator for an emulated one.

    ``folder`` is for the files of the emulator, whose vehicles stand on the pads of ``plan``.
    ``rtcm`` is the address of a source of corrections, ``mocap`` of a motion capture system; the
    links are those of a bridge that runs (:mod:`swarm.ground.mocap_bridge`). Emulated vehicles
    start with the ``required`` parameters, if any.
    Raises :class:`InputError` if files cannot be written.
    """
    with ExitStack() as resources:
        links, borrowed = resources.enter_context(links_of(fleet, mocap))
        tracking = plan.mission.vehicles.tracking if plan is not None else math.inf
        listener = FleetListener(fleet, tracking if rtcm is not None else None)
        relay = Relay(listener.team)
        resources.callback(relay.close)
        try:
            listener.team.signing = resources.enter_context(signing_with(fleet.signing_key))
            folder.mkdir(parents=True, exist_ok=True)
            if fleet.emulated is not None:
                port = links.port(next(iter(fleet.links)))
                seed = fleet.emulated.seed
                world = (
                    emulated_world(plan, fleet, with_cable=False, seed=seed)
                    if plan is not None
                    else bare_world(fleet)
                )
                if required is not None:
                    start_as_required(world, required)
                emulator = EmulatorProcess(world, folder, port, 1.0, fleet.signing_key)
                resources.callback(emulator.stop)
            source = open_corrections(rtcm, fleet, listener.team)
            poses: Borrowed | MocapBridge | None = borrowed
            if borrowed is None and mocap is not None:
                poses = resources.enter_context(open_mocap(mocap, fleet, listener.team))
            yield Survey(listener, relay, links, resources.enter_context(source), poses)
        except OSError as error:
            raise InputError([Problem(str(folder), str(error.strerror or error))]) from None


TIMEOUT = 15.0
"""Seconds without new data after which the download of a log fails."""
_SUFFIX = {"px4": ".ulg", "ardupilot": ".bin"}

LogProgress = Callable[[int, float], None]
"""Called with a system id and the share of its log that has arrived."""


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
            downloads = newest_logs(
                ports, suffixes, self.folder, self.timeout, self.progress, self._any_armed
            )
            self._refuse_armed()
            logs += downloads.values()
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
