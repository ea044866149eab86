"""Random errors of a vehicle's links: loss, bursts, delay, duplicates, reordering, bandwidth."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Any

import numpy as np

from sitl.faults.scenario import Fault

_BLOCK = 256
_LONGEST_QUEUE = 2.0
"""Seconds of waiting beyond which a link of limited bandwidth drops packets."""


class UniformNumbers:
    """Uniform random numbers from 0 to 1, drawn in blocks: the same numbers as single draws."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._left: list[float] = []

    def draw(self) -> float:
        """Return the next number."""
        return self.at_least(1).pop()

    def at_least(self, count: int) -> list[float]:
        """Return the list of the next numbers, at least ``count``; callers pop from its end."""
        left = self._left
        while len(left) < count:
            left[:0] = self._rng.random(_BLOCK)[::-1].tolist()
        return left


@dataclass
class Channel:
    """One direction of a vehicle's link, with its errors; whole frames, in virtual time."""

    random: UniformNumbers
    fault: Fault | None = None
    queue: list[tuple[float, int, Any]] = field(default_factory=list)
    count: int = 0
    free_at: float = 0.0
    outage: bool = False
    checked_at: float = 0.0
    _plain: tuple[float, float, float] | None = field(init=False)
    """Loss, latency and jitter, if the fault has no other errors."""

    def __post_init__(self) -> None:
        self.set_fault(self.fault)

    def set_fault(self, fault: Fault | None) -> None:
        """Set the fault of this direction; None ends it."""
        self.fault, self._plain = fault, None
        if fault is not None and not (
            fault.burst or fault.reorder or fault.bandwidth or fault.duplicate
        ):
            self._plain = fault.loss, fault.latency, fault.jitter

    def push_all(self, items: Sequence[tuple[Any, ...]], now: float) -> None:
        """Send items into the channel, in the same way as `push`; each ends with its frame."""
        if self._plain is None:
            for item in items:
                self.push(item, len(item[-1]), now)
            return
        loss, latency, jitter = self._plain
        draw, queue = self.random.at_least(2 * len(items)).pop, self.queue
        count, soonest = self.count, now + latency
        for item in items:
            if loss > 0.0 and (loss >= 1.0 or draw() < loss):
                continue
            count += 1
            heappush(queue, (soonest + jitter * draw() if jitter else soonest, count, item))
        self.count = count

    def push(self, item: Any, size: int, now: float) -> None:
        """Send one frame into the channel."""
        fault, draw, at = self.fault, self.random.draw, now
        if fault is not None:
            if fault.burst > 0.0:
                if self._in_burst(fault, now):
                    return
            elif fault.loss > 0.0 and (fault.loss >= 1.0 or draw() < fault.loss):
                return
            at += fault.latency + (fault.jitter * draw() if fault.jitter else 0.0)
            if fault.reorder and draw() < fault.reorder:
                at += 0.02 + fault.jitter
            if fault.bandwidth:
                self.free_at = max(self.free_at, now) + size / fault.bandwidth
                if self.free_at - now > _LONGEST_QUEUE:
                    self.free_at -= size / fault.bandwidth
                    return
                at += self.free_at - now
        self.count += 1
        heappush(self.queue, (at, self.count, item))
        if fault is not None and fault.duplicate and draw() < fault.duplicate:
            self.count += 1
            heappush(self.queue, (at + 0.01 * draw(), self.count, item))

    def _in_burst(self, fault: Fault, now: float) -> bool:
        """Return whether a frame falls into a burst of losses (Gilbert's model).

        The mean length of a burst is ``burst`` seconds.
        """
        if fault.loss >= 1.0:
            return True
        elapsed, self.checked_at = now - self.checked_at, now
        mean = (
            fault.burst if self.outage else fault.burst * (1 - fault.loss) / max(fault.loss, 1e-9)
        )
        if self.random.draw() < 1 - math.exp(-elapsed / max(mean, 1e-6)):
            self.outage = not self.outage
        return self.outage

    def pop(self, now: float) -> list[Any]:
        """Return the items that have arrived by ``now``, and remove them."""
        arrived: list[Any] = []
        queue, limit = self.queue, now + 1e-9
        while queue and queue[0][0] <= limit:
            arrived.append(heappop(queue)[2])
        return arrived
