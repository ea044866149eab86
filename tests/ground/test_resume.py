"""A ground station is killed in the fold, and the next one resumes the flight, over UDP."""

import json
import signal
import subprocess
import sys
from contextlib import contextmanager

import numpy as np
import pytest
from pymavlink import mavutil

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


@contextmanager
def killed_in_the_fold(folder):
    """A team whose ground station was killed: its record, the port, and the clock of its world."""
    port, record, clock = str(free_port()), folder / "record", str(folder / "clock.bin")
    world = emulated_world(
        FLIGHT_PLAN.plan, emulated_fleet(3, ("ardupilot",)), with_cable=True, seed=1
    )
    (folder / "world.json").write_text(json.dumps(world))
    sitl = ("sitl", "--world", str(folder / "world.json"), "--speed", SPEED, "--clock", clock)
    with process(*sitl, "--target", f"127.0.0.1:{port}") as world_process:
        assert "3 emulated vehicles" in world_process.stdout.readline()
        with process("tests.ground.station", "fly", str(record), port, SPEED, clock) as station:
            said = []
            for line in station.stdout:
                said.append(line)
                if line == "folding\n":
                    break
            else:
                raise AssertionError(said[-10:])
            station.send_signal(signal.SIGKILL)
            station.wait()
        yield record, port, clock


@pytest.mark.slow
def test_after_sigkill_in_the_fold_the_team_is_found_and_the_flight_continues(tmp_path):
    with killed_in_the_fold(tmp_path) as (record, port, clock):
        ground = (str(record), port, SPEED, clock)
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


def lead_aside(port, system, aside):
    """Lead a vehicle so many metres aside, NED, as another ground station."""
    link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=254)
    start = None
    for share in np.linspace(0.0, 1.0, 100):
        while True:
            place = link.recv_match(type="LOCAL_POSITION_NED", blocking=True, timeout=10.0)
            assert place is not None
            if place.get_srcSystem() == system:
                break
        start = start or place
        link.mav.set_position_target_local_ned_send(
            0, system, 1, mavutil.mavlink.MAV_FRAME_LOCAL_NED, 0b110111111000,
            *(np.array([start.x, start.y, start.z]) + share * np.array(aside)), *[0] * 8,
        )  # fmt: skip
    link.close()


@pytest.mark.slow
def test_a_team_that_was_moved_meanwhile_flies_the_rest_of_the_fold_from_there(tmp_path):
    with killed_in_the_fold(tmp_path) as (record, port, clock):
        lead_aside(port, 2, (0.0, 0.0, -0.7))
        folder = tmp_path / "resumed"
        options = ("--clock", clock, "--then", "continue", "--record", str(folder))
        done = run("fly", "--resume", str(record), *options)
    assert done.returncode == 0, done.stdout + done.stderr
    said = " ".join(done.stderr.split())
    assert "plan: planning the rest of the fold from there. It takes " in said
    assert "s, and is certified. A rewind ends where it begins." in said
    assert "all vehicles have landed and disarmed" in done.stdout
    plan = recorded_plan(folder)
    assert plan.phases[0].name == "fold"
    assert verify_trace(plan, recorded_flight(folder, plan).trace).as_planned


@pytest.mark.slow
def test_where_the_rest_is_refused_the_team_goes_back_to_its_places_and_holds(tmp_path):
    """Vehicle 2 is led so far aside that its segments are taut for the certificate."""
    with killed_in_the_fold(tmp_path) as (record, port, clock):
        lead_aside(port, 2, (0.0, 0.45, 0.0))
        folder = tmp_path / "resumed"
        options = ("--clock", clock, "--then", "continue", "--record", str(folder), "--json")
        done = run("fly", "--resume", str(record), *options)
    said = " ".join(done.stderr.split())
    assert "It is not planned anew: " in said
    assert "The team is led back to its places in the plan, and holds there." in said
    assert json.loads(done.stdout)["outcome"] == "interrupted", "it lands after the hold timeout"
    assert done.returncode == 130
    assert recorded_plan(folder).phases[0].name == "takeoff"


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
