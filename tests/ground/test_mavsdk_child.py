"""MAVSDK's process is killed and stopped by real signals: other attempts follow, then an error."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from swarm.errors import VehicleError
from swarm.ground.commissioning.check import check
from swarm.ground.commissioning.mavsdk_client import ATTEMPTS, vehicle_reports
from swarm.ground.commissioning.survey import download_logs
from swarm.ground.fly import FlyOptions, fly
from swarm.mission.fleet import emulated_fleet
from tests.children import children
from tests.command import run
from tests.ground.test_logs import NEW, PX4, content, team
from tests.network import small_plan


@contextmanager
def killing(number: int, most: int = 100) -> Iterator[set[int]]:
    """Send a signal to at most ``most`` of our MAVSDK processes, once each, as they appear."""
    killed: set[int] = set()
    over = threading.Event()

    def kill() -> None:
        while not over.wait(0.02):
            for pid in children("mavsdk_child"):
                if pid not in killed and len(killed) < most:
                    killed.add(pid)
                    os.kill(pid, number)

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        yield killed
    finally:
        over.set()
        killer.join()


@pytest.mark.slow
def test_a_crash_is_followed_by_another_attempt(tmp_path):
    with killing(signal.SIGSEGV, most=2) as killed:
        report = check(emulated_fleet(2, ("px4", "ardupilot")), tmp_path)
    assert len(killed) == 2
    assert [one.firmware for one in report.vehicles] == ["PX4 1.16.0", "ArduPilot 4.6.2"]


@pytest.mark.slow
def test_crashes_in_every_attempt_end_the_command_with_exit_code_3(tmp_path):
    with killing(signal.SIGSEGV) as killed:
        result = run("check", "--record", str(tmp_path), "--json")
    assert len(killed) == ATTEMPTS
    assert result.returncode == 3
    (only,) = result.stderr.strip().splitlines()
    assert only.endswith(
        "MAVSDK failed in 3 attempts of 3 for system 1, 2, 3, 4, 5, 6, 7, 8, 9: "
        "its process ended (signal 11)"
    )


@pytest.mark.slow
def test_crashes_refuse_a_flight_and_leave_its_record(tmp_path):
    with killing(signal.SIGABRT):
        result = fly(small_plan(), emulated_fleet(3), tmp_path / "record", FlyOptions(audit=True))
    assert result.outcome.word == "refused"
    assert result.outcome.explanation == (
        "MAVSDK failed in 3 attempts of 3 for system 1, 2, 3: its process ended (signal 6)"
    )
    assert (tmp_path / "record" / "flight.tlog").stat().st_size > 0


@pytest.mark.slow
def test_a_process_that_hangs_is_ended_in_time():
    with (
        killing(signal.SIGSTOP) as stopped,
        pytest.raises(VehicleError, match="its process was silent for 1 s") as error,
    ):
        vehicle_reports({4: 9}, timeout=1.0)
    assert str(error.value).startswith("MAVSDK failed in 3 attempts of 3 for system 4: ")
    assert len(stopped) == ATTEMPTS
    assert children("mavsdk_child") == []


@pytest.mark.slow
def test_a_crash_in_one_vehicles_log_does_not_affect_the_others(tmp_path):
    large = {"autopilot": PX4, "logs": {0: (NEW, content(1, 400_000))}}
    small = {"autopilot": PX4, "logs": {0: (NEW, content(2, 900))}}

    def crash(in_turns: list[int]) -> Callable[[int, float], None]:
        def on_share(system: int, share: float) -> None:
            if system == 1 and share > 0.1 and in_turns:
                in_turns.pop()
                for pid in children("mavsdk_child"):
                    os.kill(pid, signal.SIGSEGV)

        return on_share

    with team(large, small) as (fleet, _):
        never, other = download_logs(fleet, tmp_path / "never", crash([1] * 100))
        assert never.path is None
        assert never.problem == "MAVSDK failed in 3 attempts of 3: its process ended (signal 11)"
        assert other.path is not None
        assert [path.name for path in (tmp_path / "never").iterdir()] == [other.path.name]
        late, _ = download_logs(fleet, tmp_path / "late", crash([1, 1]))
        assert late.path is not None
        assert late.path.read_bytes() == content(1, 400_000)
