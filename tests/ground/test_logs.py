"""Autopilots' logs through MAVSDK, from minimal vehicles: pymavlink and a socket."""

import itertools
import json
import random
import socket
import threading
import time
import weakref
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager

import pytest
from click.testing import CliRunner
from mavsdk import Mavsdk
from mavsdk.plugins.log_files import LogFiles
from pymavlink.dialects.v20 import common

from swarm.cli.check import check
from swarm.errors import Refused
from swarm.ground.commissioning.mavsdk_child import LogDownloader
from swarm.ground.commissioning.survey import download_logs
from swarm.mission.fleet import Fleet, emulated_fleet
from tests.ports import free_port

OLD, NEW = 1_763_700_000, 1_763_730_000
PX4, ARDUPILOT = 12, 3


class Vehicle:
    """Sends heartbeats and serves its logs: times in s since 1970 and contents, by id.

    Every ``loses``-th packet of a log is lost, and none is sent after ``stops`` packets. The vehicle
    arms after ``arms`` packets. It sends no heartbeats between the two times ``silent``, in seconds
    after its beginning.
    """

    def __init__(
        self, system: int, port: int, autopilot: int, logs: Mapping[int, tuple[int, bytes]],
        *, loses: int = 0, stops: int | None = None, arms: int | None = None,
        silent: tuple[float, float] = (0.0, 0.0),
    ) -> None:  # fmt: skip
        self.logs, self.requests = logs, 0
        self._loses, self._stops, self._arms = loses, stops, arms
        self._autopilot, self._to = autopilot, ("127.0.0.1", port)
        self._packets = itertools.count(1)
        self._sent = 0
        self._silent = tuple(time.monotonic() + after for after in silent)
        self._link = common.MAVLink(None, srcSystem=system, srcComponent=1)
        self._link.robust_parsing = True
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(0.05)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self._socket.close()

    def _send(self, message: common.MAVLink_message) -> None:
        self._socket.sendto(message.pack(self._link), self._to)

    def _run(self) -> None:
        beat = 0.0
        while not self._over.is_set():
            first, last = self._silent
            if time.monotonic() > beat and not first < time.monotonic() < last:
                beat = time.monotonic() + 0.2
                armed = 128 if self._arms is not None and self._sent >= self._arms else 0
                self._send(common.MAVLink_heartbeat_message(2, self._autopilot, armed, 0, 3, 3))
            try:
                data, _ = self._socket.recvfrom(2048)
            except TimeoutError:
                continue
            for message in self._link.parse_buffer(data) or []:
                self._respond(message)

    def _respond(self, message: common.MAVLink_message) -> None:
        if message.get_type() == "LOG_REQUEST_LIST":
            last = max(self.logs, default=0)
            for number, (at, content) in self.logs.items():
                self._send(
                    common.MAVLink_log_entry_message(number, len(self.logs), last, at, len(content))
                )
        elif message.get_type() == "LOG_REQUEST_DATA":
            self.requests += 1
            content = self.logs[message.id][1]
            end = min(len(content), message.ofs + message.count)
            for start in range(message.ofs, end, 90):
                self._piece(message.id, start, content[start : min(start + 90, end)])

    def _piece(self, number: int, start: int, piece: bytes) -> None:
        if self._stops is not None and self._sent >= self._stops:
            return
        self._sent += 1
        if self._loses and next(self._packets) % self._loses == 0:
            return
        data = list(piece.ljust(90, b"\0"))
        self._send(common.MAVLink_log_data_message(number, start, len(piece), data))


@contextmanager
def team(*vehicles: dict) -> Iterator[tuple[Fleet, list[Vehicle]]]:
    port = free_port()
    fleet = emulated_fleet(len(vehicles), ("px4", "ardupilot"))
    limits = fleet.limits.model_copy(update={"ready": 1.5})
    links = {"loopback": f"udpin://127.0.0.1:{port}"}
    with ExitStack() as resources:
        flown = []
        for system, options in enumerate(vehicles, start=1):
            if options:
                flown.append(Vehicle(system, port, **options))
                resources.callback(flown[-1].close)
        changed = {"emulated": None, "links": links, "limits": limits}
        yield fleet.model_copy(update=changed), flown


def content(seed: int, size: int) -> bytes:
    return random.Random(seed).randbytes(size)


@pytest.mark.slow
def test_the_newest_log_arrives_whole_over_a_lossy_link(tmp_path):
    new, other = content(1, 20_011), content(2, 9_000)
    first = {"autopilot": PX4, "logs": {0: (NEW, new), 1: (OLD, content(3, 500))}, "loses": 100}
    # ArduPilot counts its logs from one, also if it does not know the time
    second = {"autopilot": ARDUPILOT, "logs": {1: (0, content(4, 200)), 2: (0, other)}}
    shares = []
    with team(first, second, {}) as (fleet, vehicles):
        logs = download_logs(fleet, tmp_path, lambda *arguments: shares.append(arguments))
        requests = [vehicle.requests for vehicle in vehicles]
        again = download_logs(fleet, tmp_path)
        assert [vehicle.requests for vehicle in vehicles] == requests, "the file exists"
    assert [log.system for log in logs] == [1, 2, 3]
    assert [log.problem for log in logs] == ["", "", "not received"]
    assert again == logs
    assert logs[0].path is not None
    assert logs[0].path.name == "1-2025-11-21T13-00-00Z.ulg"
    assert (logs[0].size, logs[0].date) == (len(new), "2025-11-21T13:00:00Z")
    assert logs[0].path.read_bytes() == new
    assert logs[1].path == tmp_path / "2-log2.bin"
    assert logs[1].path.read_bytes() == other
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "1-2025-11-21T13-00-00Z.ulg", "2-log2.bin",
    ]  # fmt: skip
    of_first = [share for system, share in shares if system == 1]
    assert of_first == sorted(of_first)
    assert of_first[-1] == pytest.approx(1.0)


@pytest.mark.slow
def test_a_download_that_stops_is_reported_with_its_progress(tmp_path):
    with team(
        {"autopilot": PX4, "logs": {0: (NEW, content(1, 300_000))}, "stops": 600},
        {"autopilot": PX4, "logs": {0: (NEW, content(2, 900))}},
    ) as (fleet, _):
        stuck, fine = download_logs(fleet, tmp_path, timeout=1.5)
    assert stuck.path is None
    assert stuck.problem == "no more data after 15% of it"
    assert fine.path is not None
    assert [path.name for path in tmp_path.iterdir()] == [fine.path.name]


def test_an_armed_team_is_refused(tmp_path):
    log = {"autopilot": PX4, "logs": {0: (NEW, content(1, 400_000))}}
    with (
        team({**log, "arms": 0}, log) as (fleet, vehicles),
        pytest.raises(Refused, match="system 1 is armed: logs are downloaded from disarmed"),
    ):
        download_logs(fleet, tmp_path)
    assert [vehicle.requests for vehicle in vehicles] == [0, 0]
    with (
        team({**log, "arms": 700}) as (fleet, _),
        pytest.raises(Refused, match="system 1 is armed"),
    ):
        download_logs(fleet, tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.full
def test_a_vehicle_that_mavsdk_does_not_find_at_first_is_searched_again(tmp_path):
    log = {"autopilot": PX4, "logs": {0: (NEW, content(1, 900))}}
    with team({**log, "silent": (0.5, 14.0)}) as (fleet, _):
        (found,) = download_logs(fleet, tmp_path)
    assert found.problem == ""
    assert found.path is not None


def test_callbacks_are_kept_until_mavsdk_is_destroyed(tmp_path, monkeypatch):
    callbacks, alive = [], []
    download, destroy = LogFiles.download_log_file_async, Mavsdk.destroy

    def watched_download(self, *arguments):
        download(self, *arguments)
        callbacks.append(weakref.ref(self._callbacks[-1]))

    def watched_destroy(self):
        destroy(self)
        alive.append([callback() is not None for callback in callbacks])

    monkeypatch.setattr(LogFiles, "download_log_file_async", watched_download)
    monkeypatch.setattr(Mavsdk, "destroy", watched_destroy)
    log = {"autopilot": PX4, "logs": {0: (NEW, content(1, 400_000))}}
    with team(log) as (fleet, vehicles):
        port = int(fleet.links["loopback"].rpartition(":")[2])
        downloader = LogDownloader(tmp_path, 5.0, lambda _: None, lambda: vehicles[0]._sent >= 700)
        downloader.run({1: port}, (255, 190), {1: ".ulg"})
    assert alive[0] == [True]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_command_reports_missing_logs_with_exit_code_3(tmp_path):
    result = CliRunner().invoke(check, ["--logs", str(tmp_path), "--json"], catch_exceptions=False)
    assert result.exit_code == 3
    found = json.loads(result.stdout)["logs"]
    assert [one["problem"] for one in found] == ["has no logs"] * 9
