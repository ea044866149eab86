"""The flight loop: the only place that joins sockets, the clock and the conductor.

Deadlines are absolute; a tick that was missed is not made up for, so nothing stale is sent. What is
sent at a deadline is worked out well before it, for that moment, so that nothing comes first then
but sending. Packets are taken as they come in between.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from swarm.flight.router import Address, Outgoing
from swarm.ground.record import Record
from swarm.ground.relay import Relay
from swarm.ground.sockets import Links
from swarm.mission.fleet import Fleet

_LEAD = 0.4
"""Share of a tick by which working it out begins before its deadline."""
_CATCH_UP = 0.2
"""Share of a tick for which packets that wait are taken although it is high time for the tick."""
_STILL = 0.0003
"""Seconds before a deadline in which nothing is begun any more: about what a packet takes."""


class Flown(Protocol):
    """What the loop runs: the conductor, or whoever only listens."""

    @property
    def fleet(self) -> Fleet:
        """The fleet whose links are served."""

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
        while not conductor.over:
            begin = deadline - _LEAD * interval
            self._receive(began, begin, max(begin, time.monotonic() + _CATCH_UP * interval))
            now = (max(time.monotonic(), deadline) - began) * self.speed
            outgoing = conductor.tick(now)
            if self.relay is not None:
                outgoing.extend(self.relay.to_vehicles())
            self._receive(began, deadline - _STILL, deadline - _STILL)
            if (left := deadline - time.monotonic()) > 0.0:
                time.sleep(left)
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

    def _receive(self, began: float, until: float, stop: float) -> None:
        """Take packets as they come, until a time; those that wait by then, up to ``stop``."""
        while (moment := time.monotonic()) < stop:
            for link, address, data in self.links.wait(until - moment):
                self._take(link, address, data, (time.monotonic() - began) * self.speed)
                if time.monotonic() >= stop:
                    return
            if time.monotonic() >= until:
                return

    def _take(self, link: str, address: Address | None, data: bytes, now: float) -> None:
        if not self.conductor.receive(link, address, data, now):
            return  # a flood does not go into the record
        if self.relay is not None:
            self.relay.from_vehicles(link, address, data)
        if self.record is not None:
            self.record.packet(data, now, "" if address is not None else link)

    def lateness_quantiles(self) -> tuple[float, float]:
        """Return median and 99 % of how late ticks were, in seconds."""
        late = np.array(self.lateness or [0.0])
        return float(np.quantile(late, 0.5)), float(np.quantile(late, 0.99))
