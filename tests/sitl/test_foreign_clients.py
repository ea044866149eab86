"""Foreign clients: MAVSDK and MAVProxy find and fly the vehicles."""

import contextlib
import importlib.util
import json
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from mavsdk import ComponentType, Configuration, ConnectionResult, Mavsdk
from mavsdk.plugins.action import Action, ActionError
from mavsdk.plugins.failure import Failure
from mavsdk.plugins.failure.failure import FailureType, FailureUnit
from mavsdk.plugins.info import Info
from mavsdk.plugins.offboard import AccelerationNed, Offboard, PositionNedYaw, VelocityNedYaw
from mavsdk.plugins.param import Param, ParamError
from mavsdk.plugins.telemetry import Telemetry

from tests.ports import free_port

SPEED = 5.0
pytestmark = pytest.mark.usefixtures("in_real_time")
HOLD, RETURN, LAND, OFFBOARD = 3, 5, 6, 7
VERSIONS = {"px4": (1, 16), "ardupilot": (4, 6)}


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


def until(
    condition: Callable[[], Any], seconds: float = 30.0, what: Callable[[], str] = str
) -> None:
    """Wait for an effect of the other process; fail after ``seconds`` and say ``what`` is there."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"it did not happen in time: {what()}"
        select.select([], [], [], 0.02)


@contextlib.contextmanager
def nine_vehicles(autopilots: str) -> Iterator[list[Any]]:
    """Yield MAVSDK's systems of nine emulated vehicles.

    MAVSDK opens its port before the emulator sends to it.
    """
    port = free_port()
    with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
        opened = mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        assert opened is ConnectionResult.SUCCESS
        with emulator(port, "-n", "9", "--autopilot", autopilots):
            until(lambda: mavsdk.system_count() == 9, what=lambda: str(mavsdk.system_count()))
            yield mavsdk.get_systems()


class Pilot:
    """MAVSDK's plugins for one of several vehicles."""

    def __init__(self, system: Any) -> None:
        self.action, self.telemetry = Action(system), Telemetry(system)
        self.offboard, self.param, self.failure = Offboard(system), Param(system), Failure(system)

    def healthy(self) -> bool:
        health = self.telemetry.health()
        return bool(health.is_global_position_ok and health.is_home_position_ok)

    def mode(self) -> int:
        return int(self.telemetry.flight_mode())

    def height(self) -> float:
        return float(self.telemetry.position().relative_altitude_m)

    def north(self) -> float:
        return float(self.telemetry.position_velocity_ned().position.north_m)


@pytest.mark.slow
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_mavsdk_flies_nine_at_once(autopilot: str) -> None:
    """Discovery, health, setup, take-off, two moves, hold; landing, return, failure, kill."""
    with nine_vehicles(autopilot) as systems:
        pilots = [Pilot(system) for system in systems]
        telemetries = [pilot.telemetry for pilot in pilots]
        version = Info(systems[0]).get_version()
        assert (version.flight_sw_major, version.flight_sw_minor) == VERSIONS[autopilot]
        parameters = pilots[0].param.get_all_params()
        assert len(parameters.int_params) + len(parameters.float_params) > 80
        name = "COM_OBL_RC_ACT" if autopilot == "px4" else "FS_GCS_ENABLE"
        for pilot in pilots:
            pilot.telemetry.set_rate_position(10)
            pilot.telemetry.set_rate_position_velocity_ned(10)
            pilot.telemetry.set_rate_home(1)
            if autopilot == "ardupilot":
                pilot.telemetry.set_rate_health(2)
                pilot.telemetry.set_rate_gps_info(2)
            pilot.param.set_param_int(name, 5)
            assert pilot.param.get_param_int(name) == 5
        until(lambda: all(pilot.healthy() for pilot in pilots))
        for pilot in pilots:
            pilot.action.set_takeoff_altitude(4.0)
            pilot.action.arm()
            pilot.action.takeoff()
        until(lambda: all(abs(pilot.height() - 4.0) < 0.4 for pilot in pilots))
        assert all(telemetry.armed() and telemetry.in_air() for telemetry in telemetries)

        start = [pilot.north() for pilot in pilots]
        for pilot in pilots:
            here = pilot.telemetry.position()
            pilot.action.goto_location(
                here.latitude_deg + 3e-5, here.longitude_deg, here.absolute_altitude_m, 0.0
            )
        moved = 3e-5 * 111_195
        until(
            lambda: all(
                abs(pilot.north() - begin - moved) < 0.6
                for pilot, begin in zip(pilots, start, strict=True)
            )
        )
        still, places = VelocityNedYaw(0.0, 0.0, 0.0, 0.0), []
        for pilot in pilots:
            here = pilot.telemetry.position_velocity_ned().position
            places.append(PositionNedYaw(here.north_m + 2.0, here.east_m, here.down_m, 0.0))
            pilot.offboard.set_position_velocity_acceleration_ned(
                places[-1], still, AccelerationNed(0, 0, 0)
            )
            pilot.offboard.start()
        until(lambda: all(pilot.mode() == OFFBOARD for pilot in pilots))
        until(
            lambda: all(
                abs(pilot.north() - place.north_m) < 0.3
                for pilot, place in zip(pilots, places, strict=True)
            )
        )
        for pilot in pilots:
            pilot.action.hold()
        until(lambda: all(pilot.mode() == HOLD for pilot in pilots))

        broken, killed, returning, landing = pilots[3], pilots[4], pilots[5], pilots[6:]
        broken.failure.inject(FailureUnit.SYSTEM_MOTOR, FailureType.OFF, 0)
        killed.action.kill()
        returning.action.return_to_launch()
        for pilot in landing:
            pilot.action.land()
        until(lambda: returning.mode() == RETURN)
        until(lambda: not killed.telemetry.armed())
        until(lambda: broken.height() < 0.3)
        until(lambda: all(not pilot.telemetry.armed() for pilot in landing))
        assert all(pilot.telemetry.armed() and pilot.height() > 3.0 for pilot in pilots[:3])


def test_mavsdk_injects_failures_on_the_ground() -> None:
    with nine_vehicles("ardupilot,px4") as systems:
        pilots = [Pilot(system) for system in systems]
        victim = next(
            pilot for pilot in pilots if _is_px4(pilot) and pilot.telemetry.armed() is False
        )
        until(victim.telemetry.health_all_ok)
        victim.failure.inject(FailureUnit.SENSOR_GPS, FailureType.OFF, 0)
        until(lambda: not victim.telemetry.health().is_global_position_ok)
        with pytest.raises(ActionError):
            victim.action.arm()
        victim.failure.inject(FailureUnit.SENSOR_GPS, FailureType.OK, 0)
        until(victim.telemetry.health_all_ok)
        victim.action.arm()
        until(victim.telemetry.armed)
        victim.action.kill()
        until(lambda: not victim.telemetry.armed())
        assert not any(pilot.telemetry.armed() for pilot in pilots)


def _is_px4(pilot: Pilot) -> bool:
    """Return whether the vehicle has a parameter of PX4."""
    try:
        return pilot.param.get_param_int("COM_OBL_RC_ACT") == 0
    except ParamError:
        return False


@pytest.mark.slow
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
            # A busy machine takes longer than a tenth of a second to end a process.
            shell.ptyproc.delayafterterminate = 1.0
            shell.close(force=True)
    reader = mavutil.mavlink_connection(str(log))
    kinds = set()
    while (message := reader.recv_match()) is not None:
        kinds.add((message.get_srcSystem(), message.get_type()))
    reader.close()
    assert {(1, "HEARTBEAT"), (1, "PARAM_VALUE"), (255, "COMMAND_LONG")} <= kinds
