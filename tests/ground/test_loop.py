"""The flight loop in virtual time: setpoints are sent at their deadlines whatever arrives."""

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
"""Seconds to read a packet; computing a tick takes five times as long."""


@dataclass
class Clock:
    """Virtual time, advanced by the steps that take time."""

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
    """Packets that arrive at given times, and the times of sent packets, in place of sockets."""

    clock: Clock
    incoming: deque = field(default_factory=deque)
    sent: list = field(default_factory=list)

    def wait(self, timeout):
        if timeout > 0.0 and (not self.incoming or self.incoming[0] > self.clock.now):
            next_one = self.incoming[0] if self.incoming else float("inf")
            self.clock.now = min(self.clock.now + timeout, max(next_one, self.clock.now))
        while self.incoming and self.incoming[0] <= self.clock.now:
            yield "a", 1, self.incoming.popleft()

    def send(self, outgoing):
        self.sent.append((self.clock.now, outgoing[0]))


@dataclass
class Conductor:
    """Receives packets and computes setpoints whose content is their deadline."""

    clock: Clock
    ticks: int
    start_time: float = 100.0
    received: int = 0
    fleet: object = FLEET
    times: list = field(default_factory=list)

    def receive(self, *_):
        self.clock.now += PACKET
        self.received += 1
        return True

    def tick(self, now, _real):
        self.clock.now += 5 * PACKET
        self.times.append(self.start_time + now)
        return [self.start_time + now]

    @property
    def over(self):
        return len(self.times) > self.ticks


@pytest.fixture
def run(monkeypatch):
    def running(incoming, ticks=50, pause=lambda _: 0.0):
        clock = Clock()
        names = {"monotonic": clock.monotonic, "process_time": clock.process_time}
        monkeypatch.setattr(loop, "time", SimpleNamespace(**names, sleep=clock.sleep))
        flown = Conductor(clock, ticks)
        traffic = Traffic(clock, deque(sorted(100.0 + time for time in incoming)))

        def each_tick(_):
            clock.now += pause(len(flown.times))

        Loop(flown, traffic, None, 1.0, each_tick).run()
        return flown, traffic

    return running


def test_setpoints_are_sent_at_their_deadline_under_any_load(run):
    # ten times the packets that fit a tick arrive in bursts right before each deadline
    burst = [tick * TICK - 1e-3 for tick in range(1, 50) for _ in range(int(10 * TICK / PACKET))]
    flown, traffic = run(burst)
    late = [sent - deadline for sent, deadline in traffic.sent[1:]]
    assert len(late) == 50
    assert max(late) <= PACKET
    assert min(late) >= -1e-9
    # and the rest of the time is used for reading
    assert flown.received > 0.9 * 50 * (TICK / PACKET - 5) - 100


def test_all_packets_are_read_before_the_next_tick_if_there_is_time(run):
    incoming = [0.37e-3 * k for k in range(2000)]
    flown, traffic = run(incoming)
    assert flown.received >= sum(one <= 50 * TICK - 1e-3 for one in incoming)
    assert all(sent == pytest.approx(deadline, abs=1e-9) for sent, deadline in traffic.sent[1:])


def test_a_missed_tick_is_not_repeated_and_waiting_packets_are_read_first(run):
    # the loop is blocked for five ticks and a half after its tenth
    incoming = [9 * TICK + 2e-3 + 1e-4 * k for k in range(20)]
    flown, _ = run(incoming, pause=lambda tick: 5.5 * TICK if tick == 10 else 0.0)
    steps = [after - before for before, after in zip(flown.times, flown.times[1:], strict=False)]
    assert max(steps) == pytest.approx(6 * TICK)
    assert sum(step > 1.5 * TICK for step in steps) == 1
    assert flown.received == 20
