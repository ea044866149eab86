"""Clients that we did not write: MAVSDK and MAVProxy find, understand and fly the vehicles."""

import contextlib
import importlib.util
import json
import select
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action import Action, ActionError
from mavsdk.plugins.failure import Failure
from mavsdk.plugins.failure.failure import FailureType, FailureUnit
from mavsdk.plugins.info import Info
from mavsdk.plugins.offboard import AccelerationNed, Offboard, PositionNedYaw, VelocityNedYaw
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import Telemetry

SPEED = 5.0
HOLD, RETURN, LAND, OFFBOARD = 3, 5, 6, 7


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])


@contextlib.contextmanager
def emulator(port: int, *arguments: str) -> Iterator[None]:
    process = subprocess.Popen(
        [sys.executable, "-m", "sitl", "--json", "--target", f"127.0.0.1:{port}",
         "--speed", str(SPEED), *arguments],
        stdout=subprocess.PIPE,
    )  # fmt: skip
    try:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["ready"]
        yield
    finally:
        process.terminate()
        assert process.wait(5) == 0
        process.stdout.close()


def until(condition: Callable[[], Any], seconds: float = 15.0) -> None:
    """Wait for something that the other process does; fail if it does not."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        select.select([], [], [], 0.02)


@contextlib.contextmanager
def station(port: int, count: int) -> Iterator[list[Any]]:
    """MAVSDK as a ground station that sees ``count`` vehicles."""
    with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
        mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        until(lambda: mavsdk.system_count() == count)
        yield mavsdk.get_systems()


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_mavsdk_flies_everything(autopilot: str) -> None:
    port = free_port()
    with emulator(port, "--autopilot", autopilot), station(port, 1) as (system,):
        action, telemetry, offboard = Action(system), Telemetry(system), Offboard(system)
        version = Info(system).get_version()
        assert (version.flight_sw_major, version.flight_sw_minor) in {(1, 16), (4, 6)}
        if autopilot == "px4":
            until(telemetry.health_all_ok)
        telemetry.set_rate_position(20)
        telemetry.set_rate_position_velocity_ned(20)
        param = Param(system)
        name = "COM_OBL_RC_ACT" if autopilot == "px4" else "FS_GCS_ENABLE"
        assert param.get_param_int(name) == 0
        param.set_param_int(name, 5)
        assert param.get_param_int(name) == 5
        everything = param.get_all_params()
        assert len(everything.int_params) + len(everything.float_params) > 80

        action.arm()
        action.set_takeoff_altitude(4.0)
        action.takeoff()
        until(lambda: abs(telemetry.position().relative_altitude_m - 4.0) < 0.4)
        assert telemetry.armed()
        start = telemetry.position()
        action.goto_location(
            start.latitude_deg + 3e-5, start.longitude_deg, start.absolute_altitude_m, 0.0
        )
        until(lambda: telemetry.position().latitude_deg - start.latitude_deg > 2.7e-5)
        action.hold()
        here = telemetry.position_velocity_ned().position
        place = PositionNedYaw(here.north_m, here.east_m + 2.0, here.down_m, 0.0)
        still = VelocityNedYaw(0.0, 0.0, 0.0, 0.0)
        offboard.set_position_velocity_acceleration_ned(place, still, AccelerationNed(0, 0, 0))
        offboard.start()
        until(lambda: telemetry.flight_mode() == OFFBOARD)
        until(lambda: abs(telemetry.position_velocity_ned().position.east_m - place.east_m) < 0.3)
        action.hold()
        until(lambda: telemetry.flight_mode() == HOLD)
        action.return_to_launch()
        until(lambda: telemetry.flight_mode() == RETURN)
        action.land()
        until(lambda: not telemetry.armed(), 25.0)


def test_mavsdk_finds_nine_and_breaks_one() -> None:
    port = free_port()
    with emulator(port, "-n", "9"), station(port, 9) as systems:
        telemetries = [Telemetry(system) for system in systems]
        for telemetry in telemetries:
            until(telemetry.health_all_ok)
        action, failure = Action(systems[3]), Failure(systems[3])
        failure.inject(FailureUnit.SENSOR_GPS, FailureType.OFF, 0)
        until(lambda: not telemetries[3].health().is_global_position_ok)
        with pytest.raises(ActionError):
            action.arm()
        failure.inject(FailureUnit.SENSOR_GPS, FailureType.OK, 0)
        until(telemetries[3].health_all_ok)
        action.arm()
        until(telemetries[3].armed)
        action.kill()
        until(lambda: not telemetries[3].armed())
        assert not any(telemetry.armed() for telemetry in telemetries)


@pytest.mark.skipif(
    not importlib.util.find_spec("MAVProxy") or not importlib.util.find_spec("pexpect"),
    reason="MAVProxy and pexpect are not installed",
)
def test_mavproxy_flies_ardupilot_and_logs(tmp_path: Path) -> None:
    import pexpect
    from pymavlink import mavutil

    port = free_port()
    log = tmp_path / "flight.tlog"
    with emulator(port, "--autopilot", "ardupilot"):
        shell = pexpect.spawn(
            sys.executable,
            [str(Path(sys.executable).parent / "mavproxy.py"), f"--master=udpin:127.0.0.1:{port}",
             f"--logfile={log}", f"--state-basedir={tmp_path}", "--nowait",
             "--default-modules=link,param,mode,arm,cmdlong,wp,log"],
            encoding="utf8", timeout=20, cwd=tmp_path,
        )  # fmt: skip
        try:
            shell.expect("online system 1")
            began = time.monotonic()
            shell.expect(r"Received \d+ parameters")
            assert time.monotonic() - began < 10.0
            shell.sendline("mode GUIDED")
            shell.expect("Mode GUIDED")
            shell.sendline("arm throttle")
            shell.expect("Arming motors")
            shell.expect("ARMED")
            shell.sendline("takeoff 5")
            shell.expect("NAV_TAKEOFF: ACCEPTED")
            shell.sendline("mode LAND")
            shell.expect("Mode LAND")
            shell.expect("DISARMED")
        finally:
            shell.sendline("exit")
            shell.close(force=True)
    reader = mavutil.mavlink_connection(str(log))
    kinds = set()
    while (message := reader.recv_match()) is not None:
        kinds.add((message.get_srcSystem(), message.get_type()))
    reader.close()
    assert {(1, "HEARTBEAT"), (1, "PARAM_VALUE"), (255, "COMMAND_LONG")} <= kinds
