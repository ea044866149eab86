"""Serial ports and connections: whole packets or none, never stale, never blocking."""

import os
import pty
import select
import socket
import termios
import tty

import pytest
from pymavlink.dialects.v20 import common

from swarm.errors import VehicleError
from swarm.flight.fleet_listener import FleetListener
from swarm.flight.router import Outgoing
from swarm.ground.relay import open_forward
from swarm.ground.sockets import open_links
from swarm.mavlink.packets import Decoder, Encoder
from swarm.mission.fleet import parse_fleet

HEARTBEAT = common.MAVLink_heartbeat_message(2, 12, 0, 6 << 16, 3, 3)


@pytest.fixture
def serial_pair():
    far, near = pty.openpty()
    tty.setraw(near)
    os.set_blocking(far, False)
    links = open_links({"usb": f"serial://{os.ttyname(near)}:57600"})
    yield far, near, links
    links.close()
    os.close(far)
    os.close(near)


def received_bytes(links):
    return b"".join(data for _, _, data in links.wait(0.5))


def test_a_serial_port_sends_and_receives(serial_pair):
    far, near, links = serial_pair
    assert termios.tcgetattr(near)[4] == termios.B57600
    packet = Encoder(4, 1).encode(HEARTBEAT)
    os.write(far, packet[:5])
    first = list(links.wait(0.5))
    assert first == [("usb", None, packet[:5])]
    os.write(far, packet[5:])
    assert received_bytes(links) == packet[5:]
    links.send([Outgoing("usb", None, b"hello")])
    assert select.select([far], [], [], 5.0)[0]
    assert os.read(far, 100) == b"hello"


def test_a_vehicle_is_discovered_on_a_serial_port(serial_pair):
    far, near, links = serial_pair
    text = f'schema: 1\nname: one\nlinks: {{usb: "serial://{os.ttyname(near)}:57600"}}\n'
    listener = FleetListener(parse_fleet(text + "vehicles: [{sysid: 4, links: [usb]}]\n", "one"))
    packet = Encoder(4, 1).encode(HEARTBEAT)
    for part in (packet[:7], packet[7:]):
        os.write(far, part)
        for link, address, data in links.wait(0.5):
            listener.receive(link, address, data, 1.0)
    assert listener.missing == []
    links.send(listener.tick(1.0))
    decoder, numbers = Decoder(stream=True), set()
    while not numbers >= {0, 76, 111}:
        assert select.select([far], [], [], 5.0)[0]
        numbers |= {packet.number for packet in decoder.feed(os.read(far, 4096))}


def test_a_full_port_drops_whole_packets_without_blocking(serial_pair):
    far, _, links = serial_pair
    packets = [Encoder(255, 190).encode(HEARTBEAT) for _ in range(4000)]
    links.send(Outgoing("usb", None, packet) for packet in packets)
    dropped = links.dropped()["usb"]
    assert 0 < dropped < 4000
    decoder, received = Decoder(stream=True), 0
    while received < 4000 - dropped:
        assert select.select([far], [], [], 5.0)[0]
        received += len(decoder.feed(os.read(far, 65536)))
        links.ports["usb"].flush()
    assert decoder.damaged == 0
    assert received == 4000 - dropped


def test_a_slow_connection_keeps_no_stale_packets():
    server = socket.create_server(("127.0.0.1", 0))
    server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    links = open_links({"net": f"tcp://127.0.0.1:{server.getsockname()[1]}"})
    peer, _ = server.accept()
    packet = Encoder(255, 190).encode(HEARTBEAT)
    links.send(Outgoing("net", None, packet) for _ in range(100_000))
    assert links.dropped()["net"] > 0
    peer.close()
    assert list(links.wait(0.5)) == []
    links.send([Outgoing("net", None, packet)])
    links.close()
    server.close()


@pytest.mark.parametrize("host", ["host.invalid", "a..b"])
def test_an_unknown_host_is_named_in_words(host):
    with pytest.raises(VehicleError, match=rf"link net \(udpout://{host}:14550\) cannot") as error:
        open_links({"net": f"udpout://{host}:14550"})
    assert "unknown error" not in str(error.value)
    with pytest.raises(VehicleError, match=rf"--forward udp://{host}:14550 cannot be opened: "):
        open_forward(f"udp://{host}:14550", None)


def test_a_missing_port_is_named():
    with pytest.raises(
        VehicleError,
        match=r"link usb \(serial:///dev/nowhere:57600\) cannot be opened: no such file",
    ):
        open_links({"usb": "serial:///dev/nowhere:57600"})
