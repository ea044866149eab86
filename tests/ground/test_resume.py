"""A ground station is killed in the fold, and the next one resumes the flight, over UDP."""

import json
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest

from swarm.flight.world import emulated_world
from swarm.ground.record_reader import recorded_flight, recorded_plan
from swarm.mission.fleet import emulated_fleet
from swarm.verification import verify_trace
from tests.command import run
from tests.ground.station import FLIGHT_PLAN, fleet_on
from tests.ports import free_port

SPEED = "8"
pytestmark = pytest.mark.usefixtures("in_real_time")


@contextmanager
def process(*arguments):
    running = subprocess.Popen(
        [sys.executable, "-m", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield running
    finally:
        running.kill()
        running.wait()
        running.stdout.close()


@pytest.mark.slow
def test_after_sigkill_in_the_fold_the_team_is_found_and_the_flight_continues(tmp_path):
    port, record, clock = str(free_port()), tmp_path / "record", str(tmp_path / "clock.bin")
    world = emulated_world(
        FLIGHT_PLAN.plan, emulated_fleet(3, ("ardupilot",)), with_cable=True, seed=1
    )
    (tmp_path / "world.json").write_text(json.dumps(world))
    sitl = ("sitl", "--world", str(tmp_path / "world.json"), "--speed", SPEED, "--clock", clock)
    with process(*sitl, "--target", f"127.0.0.1:{port}") as world_process:
        assert "3 emulated vehicles" in world_process.stdout.readline()
        ground = (str(record), port, SPEED, clock)
        with process("tests.ground.station", "fly", *ground) as station:
            said = []
            for line in station.stdout:
                said.append(line)
                if line == "folding\n":
                    break
            else:
                raise AssertionError(said[-10:])
            station.send_signal(signal.SIGKILL)
            station.wait()
        with process("tests.ground.station", "resume", *ground, "continue") as on:
            said = on.communicate(timeout=60)[0]
    assert "resume: found the team at " in said
    assert "vehicle 3 follows again" in said, said[:3000]
    assert "outcome: done: all vehicles have landed and disarmed" in said, said[-2000:]
    resumed = record / "resumed"
    plan = recorded_plan(resumed)
    flown = verify_trace(plan, recorded_flight(resumed, plan).trace)
    assert flown.as_planned, "in the frames that its record keeps, for it begins in mid-air"
    # Setpoints of a busy machine come late now and then; a wrong frame is off all the time.
    assert all(error.rms < 0.1 for error in flown.tracking if error.phase == "fold")


def test_records_that_cannot_be_resumed_are_refused(tmp_path):
    def message(*arguments):
        done = run("fly", *arguments)
        return done.returncode, " ".join(done.stderr.split())

    code, words = message("--resume", str(tmp_path))
    assert code == 2
    assert "expected a flight record with plan.json and motion.npz in it" in words
    code, words = message("overhand", "--resume", str(tmp_path))
    assert code == 2
    assert "MISSION: comes from the record with --resume" in words


def test_the_fleet_of_the_test_is_a_real_one():
    assert fleet_on(14550).emulated is None
