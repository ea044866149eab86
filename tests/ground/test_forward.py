"""The read-only copy for other ground stations: pymavlink listens to it, and commands in vain."""

import socket
import threading

import pytest
from pymavlink import mavutil

from swarm.errors import VehicleError
from swarm.ground.fly import FlyOptions, fly
from swarm.ground.forward import open_forward, parse_forward
from swarm.mission.fleet import emulated_fleet
from tests.command import run
from tests.network import small_plan

HOVER = "missions/first-steps/hover.yaml"


class ForeignStation(threading.Thread):
    """A client of pymavlink that hears vehicles, and orders each of them to disarm in the air."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.port = mavutil.mavlink_connection("udpin:127.0.0.1:0", source_system=254)
        self.url = f"udp://127.0.0.1:{self.port.port.getsockname()[1]}"
        self.heard: set[tuple[int, str]] = set()
        self.ordered = 0
        self.over = threading.Event()

    def run(self) -> None:
        force = 21196  # the value that disarms in the air
        while not self.over.is_set():
            message = self.port.recv_match(blocking=True, timeout=0.2)
            if message is None or message.get_type().startswith(("BAD_DATA", "UNKNOWN")):
                continue  # pymavlink does not read the header of a message that it does not know
            self.heard.add((message.get_srcSystem(), message.get_type()))
            if message.get_type() == "HEARTBEAT":
                self.port.mav.command_long_send(
                    message.get_srcSystem(), 1, mavutil.mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
                    0, 0, force, 0, 0, 0, 0, 0,
                )  # fmt: skip
                self.ordered += 1


@pytest.mark.usefixtures("in_real_time")
def test_a_foreign_station_sees_every_vehicle_and_commands_none(tmp_path):
    station = ForeignStation()
    station.start()
    options = FlyOptions(speed=4.0, forward=station.url)
    result = fly(small_plan(), emulated_fleet(3), tmp_path / "record", options)
    station.over.set()
    station.join(5)
    station.port.close()
    assert result.outcome.word == "done", result.outcome.explanation
    for system in (1, 2, 3):
        assert {(system, "HEARTBEAT"), (system, "LOCAL_POSITION_NED")} <= station.heard
    assert {system for system, _ in station.heard} == {1, 2, 3}
    assert station.ordered > 30
    # neither our log nor the emulated vehicles know of an order of system 254
    log = mavutil.mavlink_connection(str(tmp_path / "record" / "flight.tlog"))
    senders = set()
    while (message := log.recv_match()) is not None:
        if not message.get_type().startswith("UNKNOWN"):
            senders.add(message.get_srcSystem())
        assert message.get_type() != "COMMAND_LONG" or message.get_srcSystem() == 255
    assert 254 not in senders
    log.close()


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
