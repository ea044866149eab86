"""The ground station's clock, where it follows that of an emulated world."""

import struct
import time

import pytest

from swarm.flight.world import bare_world
from swarm.ground import world_clock
from swarm.ground.emulator import EmulatorProcess
from swarm.ground.world_clock import WorldClock, create_clock
from swarm.mission.fleet import emulated_fleet


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


@pytest.mark.slow
def test_a_world_waits_for_its_ground_station_but_not_for_a_dead_one(tmp_path):
    """It stands still at the time up to which it may go on, for two seconds of real time."""
    world = bare_world(emulated_fleet(1))
    emulator = EmulatorProcess(world, tmp_path, 14987, 4.0)
    try:
        clock, began = emulator.clock, time.monotonic()
        while clock.now() == 0.0:
            assert time.monotonic() < began + 10.0
        until = clock.now() + 0.5
        clock.allow(until)
        stands = 0.0
        while stands / 4.0 < until - 0.02:
            assert time.monotonic() < began + 20.0
            (stands,) = struct.unpack_from("<d", clock._map)
        time.sleep(0.3)
        (stands,) = struct.unpack_from("<d", clock._map)
        assert stands / 4.0 == pytest.approx(until, abs=0.02)
        time.sleep(3.0)
        (later,) = struct.unpack_from("<d", clock._map)
        assert later > stands + 1.0
    finally:
        emulator.stop()


def test_a_clock_of_another_program_is_read_alone(tmp_path):
    path = tmp_path / "clock"
    path.write_bytes(struct.pack("<d", 3.0))
    clock = WorldClock(path, 1.0)
    clock.allow(5.0)
    assert clock.now() == 3.0
    clock.close()
    assert path.read_bytes() == struct.pack("<d", 3.0)
