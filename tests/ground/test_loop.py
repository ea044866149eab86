"""The flight loop in virtual time: what may come before setpoints at their deadline, and what not."""

from collections import deque
from dataclasses import dataclass, field
from types import SimpleNamespace

import pytest

from swarm.ground import loop
from swarm.ground.loop import Loop
from swarm.mission.fleet import emulated_fleet

FLEET = emulated_fleet(1)
TICK = 1.0 / FLEET.rates.setpoint
PACKET = 1e-4
"""Seconds that reading a packet takes here, and five times that for working out a tick."""


@dataclass
class Clock:
    """Time that passes only where something takes time."""

    now: float = 100.0

    def monotonic(self):
        return self.now

    def process_time(self):
        return self.now

    def sleep(self, seconds):
        assert seconds > 0.0
        self.now += seconds


@dataclass
class Traffic:
    """Packets that come at given times, and when something was sent; stands for sockets."""

    clock: Clock
    coming: deque = field(default_factory=deque)
    sent: list = field(default_factory=list)

    def wait(self, timeout):
        if timeout > 0.0 and (not self.coming or self.coming[0] > self.clock.now):
            next_one = self.coming[0] if self.coming else float("inf")
            self.clock.now = min(self.clock.now + timeout, max(next_one, self.clock.now))
        while self.coming and self.coming[0] <= self.clock.now:
            yield "a", 1, self.coming.popleft()

    def send(self, outgoing):
        self.sent.append((self.clock.now, outgoing[0]))


@dataclass
class Flown:
    """Takes packets and works out setpoints, which say for when they are."""

    clock: Clock
    ticks: int
    began: float = 100.0
    heard: int = 0
    fleet: object = FLEET
    times: list = field(default_factory=list)

    def receive(self, *_):
        self.clock.now += PACKET
        self.heard += 1
        return True

    def tick(self, now):
        self.clock.now += 5 * PACKET
        self.times.append(self.began + now)
        return [self.began + now]

    @property
    def over(self):
        return len(self.times) > self.ticks


@pytest.fixture
def run(monkeypatch):
    def running(coming, ticks=50, pause=lambda _: 0.0):
        clock = Clock()
        names = {"monotonic": clock.monotonic, "process_time": clock.process_time}
        monkeypatch.setattr(loop, "time", SimpleNamespace(**names, sleep=clock.sleep))
        flown = Flown(clock, ticks)
        traffic = Traffic(clock, deque(sorted(100.0 + time for time in coming)))

        def each_tick(_):
            clock.now += pause(len(flown.times))

        Loop(flown, traffic, None, 1.0, each_tick).run()
        return flown, traffic

    return running


def test_setpoints_for_a_deadline_go_out_at_that_deadline_however_much_comes_in(run):
    # ten times as much as can be read in a tick comes in bursts right before each deadline
    burst = [tick * TICK - 1e-3 for tick in range(1, 50) for _ in range(int(10 * TICK / PACKET))]
    flown, traffic = run(burst)
    late = [sent - deadline for sent, deadline in traffic.sent[1:]]
    assert len(late) == 50
    assert max(late) <= PACKET
    assert min(late) >= -1e-9
    # and as much as there is time for is read
    assert flown.heard > 0.9 * 50 * (TICK / PACKET - 5) - 100


def test_everything_is_read_before_the_next_tick_where_there_is_time(run):
    coming = [0.37e-3 * k for k in range(2000)]
    flown, traffic = run(coming)
    assert flown.heard >= sum(one <= 50 * TICK - 1e-3 for one in coming)
    assert all(sent == pytest.approx(deadline, abs=1e-9) for sent, deadline in traffic.sent[1:])


def test_a_tick_that_was_missed_is_not_made_up_for_and_what_waits_is_read_first(run):
    # the loop gets no time for five ticks and a half after its tenth
    coming = [9 * TICK + 2e-3 + 1e-4 * k for k in range(20)]
    flown, _ = run(coming, pause=lambda tick: 5.5 * TICK if tick == 10 else 0.0)
    steps = [after - before for before, after in zip(flown.times, flown.times[1:], strict=False)]
    assert max(steps) == pytest.approx(6 * TICK)
    assert sum(step > 1.5 * TICK for step in steps) == 1
    assert flown.heard == 20
