"""A flood of packets on the team's socket: setpoints stay correct and in time."""

import signal
import subprocess
import sys

import pytest

from swarm.ground.fly import FlightCallbacks, FlyOptions, fly
from swarm.mission.fleet import emulated_fleet
from tests.network import small_plan
from tests.ports import free_port

FLIGHT_PLAN = small_plan()
pytestmark = pytest.mark.usefixtures("in_real_time")
RATE = 100_000
LATEST = 0.1
"""Seconds, 99 % quantile of the lateness of setpoints: a fifth of the autopilots' timeout. Flood,
emulator and flight share the cores of this machine."""
FLOOD = """
import socket, sys, time
from pymavlink.dialects.v20 import common
port, rate = int(sys.argv[1]), float(sys.argv[2])
packets = [b"\\xfd" + bytes(range(60))]
for system in (1, 2, 3, 77):
    sender = common.MAVLink(None, srcSystem=system, srcComponent=1)
    packets.append(common.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3).pack(sender))
    packets.append(common.MAVLink_local_position_ned_message(9, 9e3, 9e3, -9e3, 5, 5, 5).pack(sender))
sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(40)]
print("flooding", flush=True)
began, sent = time.monotonic(), 0
while True:
    for k in range(200):
        sockets[(sent + k) % len(sockets)].sendto(packets[k % len(packets)], ("127.0.0.1", port))
    sent += 200
    ahead = began + sent / rate - time.monotonic()
    if ahead > 0.0:
        time.sleep(ahead)
    print(sent, time.monotonic() - began, flush=True)
"""


@pytest.mark.full
def test_setpoints_are_in_time_at_a_hundred_thousand_packets_a_second(tmp_path):
    port = free_port()
    fleet = emulated_fleet(3, ("px4", "ardupilot"))
    fleet = fleet.model_copy(update={"links": {"loopback": f"udpin://127.0.0.1:{port}"}})
    flooding = []
    counted = (tmp_path / "flood").open("w")

    def flood(event):
        if event.kind == "gate" and not flooding:  # the team has been discovered
            command = [sys.executable, "-c", FLOOD, str(port), str(RATE)]
            flooding.append(subprocess.Popen(command, stdout=counted))

    try:
        result = fly(
            FLIGHT_PLAN,
            fleet,
            tmp_path / "record",
            FlyOptions(speed=2.0),
            FlightCallbacks(on_event=flood),
        )
    finally:
        for one in flooding:
            one.send_signal(signal.SIGKILL)
            one.wait()
        counted.close()
    sent, seconds = map(float, (tmp_path / "flood").read_text().splitlines()[-2].split())
    print(f"{sent / seconds:.0f} packets/s for {seconds:.0f} s, late {result.statistics.lateness}")
    assert sent / seconds > 0.5 * RATE
    assert result.outcome.word == "done", [event.message for event in result.events[-12:]]
    assert result.statistics.lateness[1] < LATEST
    assert any(event.kind == "security" for event in result.events)
    assert (tmp_path / "record" / "flight.tlog").stat().st_size < 30_000_000
