"""A fleet that is listened to and never flown, while something slow and blocking asks it things.

The loop keeps the links; what asks runs in a thread of its own and speaks through the relay.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from swarm.errors import InputError, Problem, SwarmError, VehicleError
from swarm.flight.listening import Listening
from swarm.flight.world import bare_world, emulated_world
from swarm.ground.emulator import EmulatorProcess
from swarm.ground.loop import Loop
from swarm.ground.relay import Relay
from swarm.ground.signing_key import signing_with
from swarm.ground.sockets import Links, open_links
from swarm.mission.fleet import Fleet
from swarm.planning import Plan

T = TypeVar("T")

_LISTEN = 0.1


@dataclass
class Survey:
    """A fleet on open links; ``relay`` has a loopback endpoint for each vehicle."""

    listening: Listening
    relay: Relay
    links: Links
    _pause: threading.Event = field(default_factory=threading.Event)

    def run(self, work: Callable[[], T]) -> T:
        """Keep the links while ``work`` runs in a thread; return what it returns.

        Raises what it raises, where that is meant for the user.
        """
        results: list[T] = []
        errors: list[Exception] = []

        def work_beside() -> None:
            try:
                results.append(work())
            except (SwarmError, OSError) as error:
                errors.append(error)
            finally:
                self.listening.over = True

        thread = threading.Thread(target=work_beside, name="attendance", daemon=True)
        thread.start()
        Loop(self.listening, self.links, None, 1.0, lambda _: None, self.relay).run()
        thread.join()
        if errors:
            raise errors[0]
        if not results:
            raise VehicleError("it ended without a result")
        return results[0]

    # For what runs in the thread

    def wait(self, seconds: float) -> None:
        """Wait while the links go on."""
        self._pause.wait(seconds)

    def until(self, condition: Callable[[], bool], patience: float) -> bool:
        """Wait until a condition holds; return whether it did within so many seconds."""
        latest = time.monotonic() + patience
        while not condition():
            if time.monotonic() >= latest:
                return False
            self.wait(_LISTEN)
        return True

    def hear(self, tell: Callable[[], None] = lambda: None) -> list[int]:
        """Wait until all vehicles are heard; return those not heard within ``limits.ready``.

        ``tell`` is called now and then meanwhile.
        """

        def all_heard() -> bool:
            tell()
            return not self.listening.missing

        self.until(all_heard, self.listening.fleet.limits.ready)
        return self.listening.missing


@contextmanager
def attended(fleet: Fleet, folder: Path, plan: Plan | None = None) -> Iterator[Survey]:
    """Open a fleet's links, with the emulator behind them where the fleet is an emulated one.

    ``folder`` is for what the emulator reads and says; with a ``plan`` it stands on its pads.
    Raises :class:`InputError` where files cannot be written.
    """
    with ExitStack() as around:
        links = open_links(fleet.links)
        around.callback(links.close)
        listening = Listening(fleet)
        relay = Relay(listening.team)
        around.callback(relay.close)
        try:
            listening.team.signing = around.enter_context(signing_with(fleet.signing_key))
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
                around.callback(emulator.stop)
            yield Survey(listening, relay, links)
        except OSError as error:
            raise InputError([Problem(str(folder), str(error.strerror or error))]) from None
