"""A fleet on open links that is never armed, while blocking work runs in a thread.

The loop keeps the links; the thread reaches the vehicles through the relay.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from swarm.errors import InputError, Problem, SwarmError, VehicleError
from swarm.flight.fleet_listener import FleetListener
from swarm.flight.world import bare_world, emulated_world
from swarm.ground.corrections import Corrections, open_corrections
from swarm.ground.emulator import EmulatorProcess
from swarm.ground.loop import Loop
from swarm.ground.relay import Relay
from swarm.ground.signing_key import signing_with
from swarm.ground.sockets import Links, open_links
from swarm.mission.fleet import Fleet
from swarm.planning import Plan

T = TypeVar("T")

_POLL = 0.1


@dataclass
class Survey:
    """A fleet on open links; ``relay`` has a loopback endpoint for each vehicle.

    ``corrections`` go to the vehicles' receivers meanwhile.
    """

    listener: FleetListener
    relay: Relay
    links: Links
    corrections: Corrections | None = None
    _pause: threading.Event = field(default_factory=threading.Event)

    def run(self, work: Callable[[], T]) -> T:
        """Keep the links while ``work`` runs in a thread; return its result.

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
        feeds = [self.corrections] if self.corrections is not None else []
        Loop(self.listener, self.links, None, 1.0, lambda _: None, self.relay, feeds=feeds).run()
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
    fleet: Fleet, folder: Path, plan: Plan | None = None, rtcm: str | None = None
) -> Iterator[Survey]:
    """Open the links of a fleet, and start the emulator for an emulated one.

    ``folder`` is for the files of the emulator, whose vehicles stand on the pads of ``plan``.
    ``rtcm`` is the address of a source of corrections.
    Raises :class:`InputError` if files cannot be written.
    """
    with ExitStack() as resources:
        links = open_links(fleet.links)
        resources.callback(links.close)
        listener = FleetListener(fleet)
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
                emulator = EmulatorProcess(world, folder, port, 1.0, fleet.signing_key)
                resources.callback(emulator.stop)
            source = open_corrections(rtcm, fleet, listener.team)
            yield Survey(listener, relay, links, resources.enter_context(source))
        except OSError as error:
            raise InputError([Problem(str(folder), str(error.strerror or error))]) from None
