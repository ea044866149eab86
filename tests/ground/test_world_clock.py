"""The ground station's clock, where it follows that of an emulated world."""

import struct

import pytest

from swarm.ground import world_clock
from swarm.ground.world_clock import WorldClock, create_clock


class Wall:
    """A wall clock that is set by hand."""

    now = 500.0

    def monotonic(self):
        return self.now


@pytest.fixture
def wall(monkeypatch):
    clock = Wall()
    monkeypatch.setattr(world_clock, "time", clock)
    return clock


def set_world(path, time):
    with path.open("r+b") as file:
        file.write(struct.pack("<d", time))


def test_it_stops_with_the_world_at_most_one_step_ahead(tmp_path, wall):
    path = tmp_path / "clock"
    create_clock(path)
    clock = WorldClock(path, 1.0)
    set_world(path, 10.0)
    assert clock.now() == 10.0
    wall.now += 0.015
    assert clock.now() == pytest.approx(10.015)
    wall.now += 1.5
    assert clock.now() == pytest.approx(10.02)
    set_world(path, 10.01)
    assert clock.now() == pytest.approx(10.02)  # never back
    set_world(path, 10.04)
    assert clock.now() == pytest.approx(10.04)
    clock.close()


def test_a_world_that_has_ended_does_not_stop_the_flight(tmp_path, wall):
    path = tmp_path / "clock"
    create_clock(path)
    clock = WorldClock(path, 2.0)
    set_world(path, 10.0)
    assert clock.now() == 5.0
    wall.now += 2.0
    assert clock.now() == pytest.approx(5.01)
    wall.now += 30.0
    assert clock.now() == pytest.approx(35.01)
    clock.close()
