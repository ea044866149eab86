"""The read-only copy for other ground stations: pymavlink listens to it, and commands in vain."""

import socket

import pytest
from pymavlink import mavutil

from swarm.errors import VehicleError
from swarm.flight.router import Team
from swarm.ground.relay import Relay, open_forward, parse_forward
from swarm.mission.fleet import emulated_fleet
from tests.command import run

HOVER = "missions/first-steps/hover.yaml"


class Trusting:
    """A team that trusts what comes from one address."""

    def trusts(self, _link, address, _packet):
        return address == "vehicle"


def test_only_whole_packets_of_the_teams_vehicles_are_sent_on():
    heartbeat = mavutil.mavlink.MAVLink(None, srcSystem=7)
    packet = heartbeat.heartbeat_encode(2, 3, 0, 0, 4).pack(heartbeat)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(5)
        url = f"udp://127.0.0.1:{listener.getsockname()[1]}"
        forward = open_forward(url, Trusting())
        forward.from_vehicles("a", "stranger", packet)
        forward.from_vehicles("a", "vehicle", packet + b"rest" + packet)
        assert [listener.recv(1000), listener.recv(1000)] == [packet, packet]
        listener.setblocking(False)
        with pytest.raises(BlockingIOError):
            listener.recv(1000)
        forward.close()


def test_mavsdk_gets_the_autopilots_packets_only():
    """It would take a camera's battery for the vehicle's."""
    fleet = emulated_fleet(1)
    team = Team(fleet, lambda *_: None)
    pilot, camera = (mavutil.mavlink.MAVLink(None, 1, component) for component in (1, 100))
    beat = pilot.heartbeat_encode(2, 12, 0, 0, 4).pack(pilot)
    status = [
        one.sys_status_encode(0, 0, 0, 0, 16000, 0, 50, 0, 0, 0, 0, 0, 0).pack(one)
        for one in (camera, pilot)
    ]
    team.receive("loopback", 1, beat, 0.0)
    relay = Relay(team)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as mavsdk:
        mavsdk.bind(("127.0.0.1", relay.ports[1]))
        mavsdk.settimeout(5)
        relay.from_vehicles("loopback", 1, status[0] + beat + status[1])
        assert [mavsdk.recv(1000), mavsdk.recv(1000)] == [beat, status[1]]
    relay.close()


def test_a_program_that_does_not_listen_costs_nothing():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
    forward = open_forward(f"udp://127.0.0.1:{port}", Trusting())
    heartbeat = mavutil.mavlink.MAVLink(None, srcSystem=7)
    packet = heartbeat.heartbeat_encode(2, 3, 0, 0, 4).pack(heartbeat)
    for _ in range(10):
        forward.from_vehicles("a", "vehicle", packet)
    forward.close()


@pytest.mark.parametrize(
    "url", ["127.0.0.1:14550", "udp://127.0.0.1", "udp://h:0", "udp://h:70000", "tcp://h:1", ""]
)
def test_other_addresses_are_refused(url):
    with pytest.raises(ValueError, match=r"expected udp://HOST:PORT, got"):
        parse_forward(url)


def test_the_command_refuses_another_address_before_it_plans():
    said = run("fly", HOVER, "--forward", "14550")
    assert (said.returncode, said.stdout) == (2, "")
    assert "'--forward': expected udp://HOST:PORT, got '14550'" in said.stderr


def test_a_host_that_does_not_exist_is_a_link_that_cannot_be_opened():
    with pytest.raises(
        VehicleError, match=r"^--forward udp://nohost\.invalid:1 cannot be opened: "
    ):
        open_forward("udp://nohost.invalid:1", Trusting())
