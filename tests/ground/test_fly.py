"""Flights over real UDP, with the emulator in a process of its own."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from pymavlink import mavutil

from swarm.errors import InputError, VehicleError
from swarm.flight.swinging import largest_stray
from swarm.flight.world import emulated_world
from swarm.ground.emulator import EmulatorProcess, RealFirmware
from swarm.ground.fly import FlightCallbacks, FlyOptions, fly
from swarm.ground.record_reader import recorded_flight, recorded_plan
from swarm.ground.record_verification import verify_record
from swarm.ground.sockets import open_links
from swarm.mission.fleet import emulated_fleet
from swarm.verification import verify_trace
from tests.command import run
from tests.ground.foreign_station import ForeignStation
from tests.ground.station import fleet_on
from tests.network import small_plan

SPEED = 10.0
"""Times real time. The emulated world waits for its ground station, which does not wait for itself:
with 20, another thread that parses in its process held it up by 35 ms, 0.7 s of the flight, in
which no vehicle seems to answer."""
FLIGHT_PLAN = small_plan()
pytestmark = pytest.mark.usefixtures("in_real_time")


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flight") / "record"
    snapshots, events = [], []
    with ForeignStation() as station:
        result = fly(
            FLIGHT_PLAN,
            emulated_fleet(3, ("px4", "ardupilot")),
            folder,
            FlyOptions(speed=SPEED, forward=station.url),
            FlightCallbacks(on_snapshot=snapshots.append, on_event=events.append),
        )
    return result, snapshots, events, station


@pytest.mark.slow
def test_a_flight_over_udp_succeeds(flown):
    result, snapshots, events, _ = flown
    assert result.outcome.word == "done", [event.message for event in events[-10:]]
    assert result.statistics.setpoints > 500
    assert {event.kind for event in events} >= {"discovered", "gate", "armed", "landed", "outcome"}
    assert {snapshot.phase for snapshot in snapshots} >= {"takeoff", "fold", "land"}


@pytest.mark.slow
def test_the_figures_of_a_flight_are_those_that_its_verification_finds(flown):
    result = flown[0]
    verified = verify_record(result.record)
    assert verify_trace(FLIGHT_PLAN.plan, result.trace) == verified.verification
    assert result.adherence == verified.adherence
    assert largest_stray(result.trace).estimated > 0.0


@pytest.mark.slow
def test_its_record_is_complete(flown):
    result, _, events, _ = flown
    folder = result.record
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["outcome"] == "done"
    assert summary["record"] == {"dropped": 0, "problem": None}
    lines = (folder / "events.jsonl").read_text().splitlines()
    assert len(lines) == len(result.events) >= len(events)
    phases = [row["message"] for row in map(json.loads, lines) if row["kind"] == "phase"]
    planned = [phase.name for phase in FLIGHT_PLAN.plan.phases]
    assert (phases[0], [name for name in phases if name in planned]) == ("prepare", planned)
    log = mavutil.mavlink_connection(str(folder / "flight.tlog"))
    systems = set()
    while (message := log.recv_match()) is not None:
        # pymavlink does not read the header of a message that it does not know
        if not message.get_type().startswith("UNKNOWN"):
            systems.add((message.get_srcSystem(), message.get_type()))
    log.close()
    assert {system for system, _ in systems} == {1, 2, 3, 255}
    assert (255, "SET_POSITION_TARGET_LOCAL_NED") in systems
    with np.load(folder / "trace.npz") as trace:
        assert trace["position"].shape == result.trace.position.shape


@pytest.mark.slow
def test_a_foreign_station_sees_every_vehicle_and_commands_none(flown):
    result, _, _, station = flown
    for system in (1, 2, 3):
        assert {(system, "HEARTBEAT"), (system, "LOCAL_POSITION_NED")} <= station.heard
    assert {system for system, _ in station.heard} == {1, 2, 3}
    assert station.ordered > 30
    # neither our log nor the emulated vehicles know of an order of system 254
    log = mavutil.mavlink_connection(str(result.record / "flight.tlog"))
    senders = set()
    while (message := log.recv_match()) is not None:
        if not message.get_type().startswith("UNKNOWN"):
            senders.add(message.get_srcSystem())
        assert message.get_type() != "COMMAND_LONG" or message.get_srcSystem() == 255
    assert 254 not in senders
    log.close()


@pytest.mark.slow
def test_an_emulator_that_dies_is_a_vehicle_error(tmp_path):
    killers = []

    def kill_soon(pid):
        killers.append(threading.Timer(1.0, lambda: os.kill(pid, signal.SIGKILL)))
        killers[0].start()

    result = fly(
        FLIGHT_PLAN,
        emulated_fleet(3),
        tmp_path / "record",
        FlyOptions(speed=SPEED),
        FlightCallbacks(on_emulator=kill_soon),
    )
    killers[0].join()
    assert result.outcome.exit_code == 3
    assert "the emulator ended (signal 9)" in result.outcome.explanation
    assert isinstance(result.outcome.error(), VehicleError)


SCRIPT = """
import sys
from pathlib import Path
from swarm.mission.fleet import emulated_fleet
from swarm.ground.fly import FlyOptions, fly
from tests.network import small_plan
result = fly(small_plan(), emulated_fleet(3), Path(sys.argv[1]), FlyOptions(speed=float(sys.argv[2])))
sys.exit(result.outcome.exit_code)
"""


def started(folder: Path, speed: float = SPEED) -> subprocess.Popen:
    """Fly in another process; return it once the record shows the team airborne."""
    process = subprocess.Popen([sys.executable, "-c", SCRIPT, str(folder), str(speed)])
    events = folder / "events.jsonl"
    deadline = time.monotonic() + 60.0
    while not (events.exists() and "all are airborne" in events.read_text()):
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.05)
    return process


@pytest.mark.slow
def test_after_sigkill_only_the_last_second_of_the_record_is_missing(tmp_path):
    folder = tmp_path / "record"
    speed = 4.0  # real time is measured: no more than a busy machine keeps up with
    process = started(folder, speed)
    time.sleep(1.0)
    killed = time.time()
    process.kill()
    process.wait()
    log = mavutil.mavlink_connection(str(folder / "flight.tlog"))
    first = last = log.recv_match()
    while (message := log.recv_match()) is not None:
        last = message
    began = json.loads((folder / "versions.json").read_text())["start_time"]
    log.close()
    flown = (last._timestamp - began) / speed
    assert killed - began - flown < 1.0
    plan = recorded_plan(folder)
    again = recorded_flight(folder, plan)
    assert again.known.systems == (1, 2, 3)
    assert again.trace.time[-1] == pytest.approx(last._timestamp - first._timestamp, abs=0.2)
    assert verify_trace(plan, again.trace).knot in {"unknown", "0_1"}


@pytest.mark.slow
def test_a_disk_that_becomes_full_in_flight_damages_the_record_only(tmp_path):
    # the limit of file sizes simulates a full disk: writing fails beyond it
    limited = (
        f"import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))\n{SCRIPT}"
    )
    ended = subprocess.run(
        [sys.executable, "-c", limited, str(tmp_path / "record"), str(SPEED)],
        check=False,
    )
    folder = tmp_path / "record"
    summary = json.loads((folder / "summary.json").read_text())
    assert (summary["outcome"], ended.returncode) == ("done", 0), summary["explanation"]
    assert summary["record"]["problem"] == "file too large"
    assert summary["record"]["dropped"] > 100
    reports = [
        line for line in (folder / "events.jsonl").read_text().splitlines() if "record" in line
    ]
    assert len([line for line in reports if "cannot be written: file too large" in line]) == 1
    assert (folder / "flight.tlog").stat().st_size == 300_000
    plan = recorded_plan(folder)
    assert "takeoff" in recorded_flight(folder, plan).trace.phase


@pytest.mark.slow
def test_ctrl_c_lands_the_team_and_exits_with_130(tmp_path):
    process = started(tmp_path / "record")
    process.send_signal(signal.SIGINT)
    assert process.wait(60.0) == 130
    summary = json.loads((tmp_path / "record" / "summary.json").read_text())
    assert summary["explanation"] == "interrupted; all vehicles have landed"


def test_all_links_that_cannot_be_opened_are_named():
    with pytest.raises(VehicleError) as caught:
        open_links({"a": "udpin://192.0.2.1:14550", "b": "tcp://127.0.0.1:1"})
    assert "link a (udpin://192.0.2.1:14550) cannot be opened" in str(caught.value)
    assert "link b (tcp://127.0.0.1:1) cannot be opened: connection refused" in str(caught.value)


def test_the_clock_of_a_world_that_does_not_run_is_refused(tmp_path):
    missing = tmp_path / "clock.bin"
    with pytest.raises(InputError) as caught:
        fly(FLIGHT_PLAN, fleet_on(14991), tmp_path / "record", FlyOptions(world_clock=missing))
    assert str(caught.value) == (
        f"{missing}: expected the clock of a world that runs (swarm sitl --clock)"
    )


def test_a_flight_follows_a_worlds_clock_only_with_a_fleet():
    done = run("fly", "overhand", "--clock", "clock.bin")
    assert (done.returncode, done.stderr.strip()) == (2, "--clock needs --fleet")


def test_the_start_of_the_emulator_does_not_count_as_flight_time(tmp_path):
    """At 20 times real time, 3 s last 0.15 s: no program starts within that time."""
    fleet = emulated_fleet(3)
    limits = fleet.limits.model_copy(update={"ready": 3.0})
    fleet = fleet.model_copy(update={"limits": limits})
    audits = []
    result = fly(
        FLIGHT_PLAN,
        fleet,
        tmp_path,
        FlyOptions(speed=20.0),
        FlightCallbacks(confirm=lambda audit: bool(audits.append(audit))),
    )
    assert result.outcome.explanation == "not confirmed"
    assert len(audits) == 1


def test_an_emulator_that_does_not_start_in_time_is_ended(tmp_path):
    world = emulated_world(FLIGHT_PLAN.plan, emulated_fleet(3), with_cable=False, seed=1)
    with pytest.raises(VehicleError, match="the emulator has not started in 0 s"):
        EmulatorProcess(world, tmp_path, 14999, 1.0, timeout=0.0)


def test_an_emulator_that_ends_before_it_is_ready_says_why(tmp_path):
    program = tmp_path / "arducopter"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    # an instance whose ports no simulator uses: 9002 + 10 · 222
    vehicle = {"id": 223, "autopilot": "ardupilot", "pad": [0.0, 0.0, 0.0]}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 11222))
        with pytest.raises(VehicleError) as caught:
            EmulatorProcess(
                {"schema": 1, "vehicles": [vehicle]},
                tmp_path,
                14999,
                1.0,
                firmware=RealFirmware(f"ardupilot={program}"),
            )
    assert str(caught.value) == (
        "the emulator ended (exit code 3): --firmware: other programs have the ports "
        "UDP 11222 (vehicle 223)"
    )
