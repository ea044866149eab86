"""A flood on the socket that the team is flown over: no setpoint goes wrong or comes late for it."""

import signal
import socket
import subprocess
import sys

import pytest

from swarm.ground.callbacks import FlightCallbacks
from swarm.ground.fly import FlyOptions, fly
from swarm.mission.fleet import emulated_fleet
from tests.network import small_plan

FLIGHT_PLAN = small_plan()
pytestmark = pytest.mark.usefixtures("in_real_time")
RATE = 100_000
LATEST = 0.1
"""Seconds by which one of 100 setpoints may be late in the flood: a fifth of what autopilots wait
for the next, on a machine on which flood, emulator and flight share the cores."""
FLOOD = """
import socket, sys, time
from pymavlink.dialects.v20 import common
port, rate = int(sys.argv[1]), float(sys.argv[2])
lies = [b"\\xfd" + bytes(range(60))]
for system in (1, 2, 3, 77):
    liar = common.MAVLink(None, srcSystem=system, srcComponent=1)
    lies.append(common.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3).pack(liar))
    lies.append(common.MAVLink_local_position_ned_message(9, 9e3, 9e3, -9e3, 5, 5, 5).pack(liar))
ways = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(40)]
print("flooding", flush=True)
began, sent = time.monotonic(), 0
while True:
    for k in range(200):
        ways[(sent + k) % len(ways)].sendto(lies[k % len(lies)], ("127.0.0.1", port))
    sent += 200
    ahead = began + sent / rate - time.monotonic()
    if ahead > 0.0:
        time.sleep(ahead)
    print(sent, time.monotonic() - began, flush=True)
"""


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@pytest.mark.full
def test_a_hundred_thousand_packets_a_second_make_no_setpoint_late(tmp_path):
    port = free_port()
    fleet = emulated_fleet(3, ("px4", "ardupilot"))
    fleet = fleet.model_copy(update={"links": {"loopback": f"udpin://127.0.0.1:{port}"}})
    flooding = []
    counted = (tmp_path / "flood").open("w")

    def flood(event):
        if event.kind == "gate" and not flooding:  # the team is known and on its way
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
