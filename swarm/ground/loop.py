"""The flight loop: the only place that joins sockets, the clock and the conductor.

Deadlines are absolute; a tick that was missed is not made up for, so nothing stale is sent. What is
sent at a deadline is worked out just before it, for that moment. Packets are taken as they come in
between.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from swarm.fleet import Fleet
from swarm.flight.team import Address, Outgoing
from swarm.ground.record import Record
from swarm.ground.relay import Relay
from swarm.ground.sockets import Links

_FORGET = 0.98
_LONGEST_LEAD = 0.4
"""Share of a tick that working it out may begin before its deadline."""


class Flown(Protocol):
    """What the loop runs: the conductor, or whoever only listens."""

    fleet: Fleet

    def receive(self, link: str, address: Address | None, data: bytes, now: float) -> bool:
        """Take bytes that arrived; return whether they were read."""

    def tick(self, now: float) -> list[Outgoing]:
        """Let time pass; return what to send."""

    @property
    def over(self) -> bool:
        """Whether the loop may end."""


@dataclass
class Loop:
    """Runs a conductor on links in real time, ``speed`` times faster.

    ``each_tick`` is called after every tick with flight time; it must be quick. Through ``relay``
    others may speak to the vehicles too.
    """

    conductor: Flown
    links: Links
    record: Record | None
    speed: float
    each_tick: Callable[[float], None]
    relay: Relay | None = None
    lateness: list[float] = field(default_factory=list)
    cpu: float = 0.0
    began: float = 0.0

    def run(self) -> None:
        """Run until the conductor has finished."""
        conductor, links = self.conductor, self.links
        interval = 1.0 / (self.conductor.fleet.rates.setpoint * self.speed)
        began, cpu = time.monotonic(), time.process_time()
        self.began = began
        deadline = began
        lead = 0.0
        while not conductor.over:
            while (left := deadline - lead - time.monotonic()) > 0.0:
                self._receive(began, left)
            self._receive(began, 0.0)
            moment = time.monotonic()
            now = (max(moment, deadline) - began) * self.speed
            outgoing = conductor.tick(now)
            if self.relay is not None:
                outgoing.extend(self.relay.to_vehicles())
            ready = time.monotonic()
            lead = min(max(_FORGET * lead, ready - moment), _LONGEST_LEAD * interval)
            if ready < deadline:
                time.sleep(deadline - ready)
            self.lateness.append(time.monotonic() - deadline)
            links.send(outgoing)
            if self.record is not None:
                for one in outgoing:
                    self.record.packet(one.data, now)
            self.each_tick(now)
            missed = max(0.0, time.monotonic() - deadline) // interval
            deadline += (missed + 1.0) * interval
        elapsed = time.monotonic() - began
        self.cpu = (time.process_time() - cpu) / max(elapsed, 1e-9)

    def _receive(self, began: float, timeout: float) -> None:
        for link, address, data in self.links.wait(timeout):
            now = (time.monotonic() - began) * self.speed
            if not self.conductor.receive(link, address, data, now):
                continue  # a flood does not go into the record
            if self.relay is not None:
                self.relay.from_vehicles(link, address, data)
            if self.record is not None:
                self.record.packet(data, now, "" if address is not None else link)

    def lateness_quantiles(self) -> tuple[float, float]:
        """Return median and 99 % of how late ticks were, in seconds."""
        late = np.array(self.lateness or [0.0])
        return float(np.quantile(late, 0.5)), float(np.quantile(late, 0.99))
