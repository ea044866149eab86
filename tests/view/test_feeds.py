import os
import signal
import sys
import time
import urllib.request
from dataclasses import replace
from pathlib import Path

import pytest
import rerun as rr
from rerun.chunk import RrdReader

from swarm.errors import InputError
from swarm.flight.snapshot import Event
from swarm.ground.priority import helper_niceness
from swarm.planning import Plan
from swarm.view.feeds import NEWEST_SNAPSHOTS, Viewer, start
from swarm.view.rerun_scene import Recorder
from tests.reports.synthetic import events, fly, snapshot_at, trefoil_plan

posix = pytest.mark.skipif(sys.platform == "win32", reason="stops processes by signals")


@pytest.fixture(scope="module")
def plan() -> Plan:
    return trefoil_plan()


def rows(path: Path) -> dict[str, int]:
    """Count the rows of every entity in a recording, those of static chunks included."""
    found: dict[str, int] = {}
    for chunk in RrdReader(path).stream():
        found[chunk.entity_path] = found.get(chunk.entity_path, 0) + chunk.num_rows
    return found


def sink_pid(viewer: Viewer) -> int:
    return viewer._feeds[0]._process.pid


def test_records_a_flight(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "flight.rrd"
    viewer = start(plan, path, None)
    flown = fly(plan, duration=3.0)
    for snapshot in flown:
        viewer.offer(snapshot)
        time.sleep(0.001)
    for event in events(plan):
        viewer.offer(event)
    assert viewer.close(timeout=60.0)
    assert viewer.message is None
    assert viewer.dropped == 0
    found = rows(path)
    assert found["/log"] == len(events(plan))
    assert found["/plots/error"] == len(flown) + 1
    assert found["/flight/vehicles"] == len(flown) + 1
    assert found["/states/phase"] == 1
    assert found["/plots/battery"] == found["/plots/round_trip"] == found["/plots/loss"] == 4
    assert "/wind" not in found
    assert {"/pads", "/plan/knot", "/plan/path", "/plan/crossings"} <= set(found)


def test_the_wind_of_the_mission_is_drawn(plan: Plan, tmp_path: Path) -> None:
    wind = plan.mission.wind.model_copy(update={"steady": 1.0, "gust": 0.5})
    windy = replace(plan, mission=plan.mission.model_copy(update={"wind": wind}))
    stream = rr.RecordingStream("swarm")
    stream.save(tmp_path / "windy.rrd")
    Recorder(stream, windy).finish()
    stream.disconnect()
    assert rows(tmp_path / "windy.rrd")["/wind"] == 1


@posix
def test_a_stalled_sink_delays_neither_flight_nor_other_sinks(plan: Plan, tmp_path: Path) -> None:
    viewer = start(plan, tmp_path / "flight.rrd", None)
    os.kill(sink_pid(viewer), signal.SIGSTOP)
    moment = snapshot_at(plan, 40.0)
    for _ in range(3000):
        viewer.offer(moment)
        viewer.offer(Event(40.0, "phase", "still here"))
    assert viewer.dropped > 3000 - NEWEST_SNAPSHOTS - 300
    assert not viewer.close(timeout=0.5)


@posix
def test_a_killed_sink_delays_neither_flight_nor_other_sinks(plan: Plan, tmp_path: Path) -> None:
    viewer = start(plan, tmp_path / "flight.rrd", None)
    os.kill(sink_pid(viewer), signal.SIGKILL)
    moment = snapshot_at(plan, 40.0)
    for _ in range(1000):
        viewer.offer(moment)
    assert not viewer.close(timeout=5.0)


@posix
def test_sinks_have_a_low_priority_and_ignore_the_interrupt_of_the_flight(
    plan: Plan, tmp_path: Path
) -> None:
    """An interrupt of the keyboard goes to the flight's group of processes."""
    viewer = start(plan, tmp_path / "flight.rrd", None)
    try:
        nice = os.getpriority(os.PRIO_PROCESS, sink_pid(viewer))
        assert nice == helper_niceness() > os.getpriority(os.PRIO_PROCESS, 0)
        assert os.getpgid(sink_pid(viewer)) != os.getpgid(0)
    finally:
        os.kill(sink_pid(viewer), signal.SIGKILL)
        viewer.close(timeout=5.0)


@pytest.mark.slow
def test_without_a_display_the_recording_is_written_and_a_message_explains_it(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if sys.platform in {"darwin", "win32"}:
        pytest.skip("there is always a display")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    path = tmp_path / "flight.rrd"
    viewer = start(plan, path, "native")
    assert viewer.message == (
        f"no display, so no window; open {path} later with: swarm view {path}"
    )
    viewer.offer(snapshot_at(plan, 1.0))
    assert viewer.close(timeout=60.0)
    assert rows(path)["/plots/error"] == 2


def test_a_viewer_without_sinks(plan: Plan) -> None:
    viewer = start(plan, None, None)
    viewer.offer(snapshot_at(plan, 1.0))
    assert viewer.close()


def test_a_file_that_cannot_be_written_is_an_error_at_the_start(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "missing" / "flight.rrd"
    with pytest.raises(InputError, match="no such file or directory"):
        start(plan, path, None)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads Linux's table of sockets")
def test_the_page_is_served_on_loopback_only_and_ends_with_the_flight(
    plan: Plan, tmp_path: Path
) -> None:
    path = tmp_path / "flight.rrd"
    viewer = start(plan, path, "web")
    assert viewer.message is not None
    address = viewer.message.removeprefix("live view: ")
    page = _fetch(address)
    assert b"<html" in page[:500].lower()
    port = int(address.split(":")[2].split("/")[0])
    assert listening(port) == {"127.0.0.1"}
    # Nobody looks at it, and the file is complete nevertheless.
    for snapshot in fly(plan, duration=1.0):
        viewer.offer(snapshot)
    assert viewer.close(timeout=60.0)
    assert rows(path)["/plots/error"] == 21
    assert listening(port) == set()


def _fetch(address: str, patience: float = 30.0) -> bytes:
    until = time.monotonic() + patience
    while True:
        try:
            with urllib.request.urlopen(address) as answer:  # noqa: S310 - loopback
                page: bytes = answer.read()
                return page
        except OSError:
            if time.monotonic() > until:
                raise
            time.sleep(0.1)


def listening(port: int) -> set[str]:
    """Return the addresses on which anybody listens on a TCP port (from Linux's own table)."""
    found = set()
    for table, width in (("/proc/net/tcp", 8), ("/proc/net/tcp6", 32)):
        for line in Path(table).read_text().splitlines()[1:]:
            local, state = line.split()[1], line.split()[3]
            address, _, number = local.partition(":")
            if state == "0A" and int(number, 16) == port:
                found.add(
                    ".".join(str(int(address[i : i + 2], 16)) for i in (6, 4, 2, 0))
                    if width == 8
                    else address
                )
    return found
