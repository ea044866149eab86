"""The flight loop: the only place where sockets, the clock and the conductor meet.

Deadlines are absolute. A missed tick is not repeated, so no setpoint is stale. The packets of a
deadline are computed before it, for that moment, so that only sending remains at the deadline.
Packets are received in between.
"""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from swarm.flight.router import Address, Outgoing
from swarm.ground.record import Record
from swarm.ground.relay import Relay
from swarm.ground.sockets import Links
from swarm.ground.world_clock import SHORTEST_WAIT, WorldClock
from swarm.mission.fleet import Fleet

_LEAD = 0.4
"""Share of a tick by which its computation starts before the deadline."""
_CATCH_UP = 0.2
"""Share of a tick for which waiting packets are received although the tick is due."""
_GUARD = 0.0003
"""Seconds before a deadline in which no packet is received: about the time for one packet."""


class Runnable(Protocol):
    """The logic that the loop runs: the conductor, or a survey."""

    @property
    def fleet(self) -> Fleet:
        """The fleet whose links are served."""

    def receive(self, link: str, address: Address | None, data: bytes, now: float) -> bool:
        """Process received bytes; return whether they were read."""

    def tick(self, now: float, real: float, /) -> list[Outgoing]:
        """Advance to ``now``, at ``real`` seconds of real time; return the packets to send."""

    @property
    def over(self) -> bool:
        """Whether the loop may end."""


class Feed(Protocol):
    """What vehicles get from another system: poses of motion capture, corrections of positions."""

    def packets(self, now: float) -> Iterable[Outgoing]:
        """Return the packets that are due at ``now``."""

    def change(self, now: float) -> tuple[str, str] | None:
        """Return an event, kind and words, when the system falls silent or comes back."""


class Copy(Protocol):
    """Another program that gets what the vehicles send."""

    def from_vehicles(self, link: str, address: Address | None, data: bytes) -> None:
        """Pass on bytes that arrived on a link from an address."""


@dataclass
class Loop:
    """Runs a conductor on links in real time, ``speed`` times faster.

    ``each_tick`` is called with the flight time after every tick and must be fast. ``relay``
    forwards packets of other programs, ``copies`` get what the vehicles send, ``feeds`` send
    them what other systems measure. ``lateness`` are the seconds between deadline and sending of
    every tick, ``cpu`` the share of one core.
    ``world`` is the clock of a simulated world that is followed instead of real time, and that
    waits for this loop; flight time is zero at its ``start``, by default when `run` begins.
    """

    conductor: Runnable
    links: Links
    record: Record | None
    speed: float
    each_tick: Callable[[float], None]
    relay: Relay | None = None
    copies: Sequence[Copy] = ()
    lateness: list[float] = field(default_factory=list)
    cpu: float = 0.0
    feeds: Sequence[Feed] = ()
    world: WorldClock | None = None
    start: float | None = None
    start_time: float = 0.0

    def run(self) -> None:
        """Run until the conductor has finished."""
        conductor, links = self.conductor, self.links
        interval = 1.0 / (self.conductor.fleet.rates.setpoint * self.speed)
        began, cpu = time.monotonic(), time.process_time()
        deadline = self._now()
        start = deadline if self.start is None else self.start
        self.start_time = start
        while not conductor.over:
            earliest = deadline - _LEAD * interval
            self._receive(start, earliest, max(earliest, self._now() + _CATCH_UP * interval))
            now = (max(self._now(), deadline) - start) * self.speed
            outgoing = conductor.tick(now, time.monotonic())
            if self.relay is not None:
                outgoing.extend(self.relay.to_vehicles())
            for feed in self.feeds:
                outgoing.extend(feed.packets(now))
            self._receive(start, deadline - _GUARD, deadline - _GUARD)
            while (remaining := deadline - self._now()) > 0.0:
                time.sleep(max(remaining, self._shortest))
            self.lateness.append(self._now() - deadline)
            links.send(outgoing)
            if self.record is not None:
                for packet in outgoing:
                    self.record.packet(packet.data, now)
            self.each_tick(now)
            missed = max(0.0, self._now() - deadline) // interval
            deadline += (missed + 1.0) * interval
            if self.world is not None:
                self.world.allow(deadline + interval)
        elapsed = time.monotonic() - began
        self.cpu = (time.process_time() - cpu) / max(elapsed, 1e-9)

    def _receive(self, start: float, until: float, stop: float) -> None:
        """Receive packets until a time, then those that wait, at the latest until ``stop``."""
        while (moment := self._now()) < stop:
            wait = max(until - moment, self._shortest) if until > moment else 0.0
            for link, address, data in self.links.wait(wait):
                self._process(link, address, data, (self._now() - start) * self.speed)
                if self._now() >= stop:
                    return
            if self._now() >= until:
                return

    def _now(self) -> float:
        return time.monotonic() if self.world is None else self.world.now()

    @property
    def _shortest(self) -> float:
        """Seconds to wait at least: a clock that stands still must not keep the processor busy."""
        return 0.0 if self.world is None else SHORTEST_WAIT

    def _process(self, link: str, address: Address | None, data: bytes, now: float) -> None:
        if not self.conductor.receive(link, address, data, now):
            return  # a flood is not recorded
        if self.relay is not None:
            self.relay.from_vehicles(link, address, data)
        for copy in self.copies:
            copy.from_vehicles(link, address, data)
        if self.record is not None:
            self.record.packet(data, now, "" if address is not None else link)

    def lateness_quantiles(self) -> tuple[float, float]:
        """Return the median and the 99 % quantile of the lateness of ticks, in seconds."""
        late = np.array(self.lateness or [0.0])
        return float(np.quantile(late, 0.5)), float(np.quantile(late, 0.99))
