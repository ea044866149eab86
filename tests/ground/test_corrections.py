"""Corrections from a base station: the source's process, fragments, who gets them, what is said."""

import base64
import os
import signal
import socket
import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from swarm.flight.fleet_listener import position_quality
from swarm.flight.router import Team
from swarm.ground.corrections import (
    SILENCE,
    Corrections,
    CorrectionSource,
    correction_messages,
    open_corrections,
    parse_source,
    without_password,
)
from swarm.mavlink.vehicle import Vehicle
from swarm.mission.fleet import emulated_fleet
from tests.children import children
from tests.ports import free_port


def rtcm(kind, size, fill=0xD3):
    """Return an RTCM 3 message of ``size`` bytes in all; its checksum bit by bit (RTCM 10403)."""
    body = (kind << 4).to_bytes(2, "big") + bytes([fill]) * (size - 8)
    data = b"\xd3" + len(body).to_bytes(2, "big") + body
    crc = 0
    for byte in data:
        crc ^= byte << 16
        for _ in range(8):
            crc = crc << 1 ^ (0x1864CFB if crc & 0x800000 else 0)
    return data + crc.to_bytes(3, "big")


class Receiver:
    """Puts fragments together as common.xml says, sharing no code with the sender."""

    def __init__(self):
        self.whole, self.parts, self.sequence = [], {}, None

    def take(self, flags, data):
        if not flags & 1:
            self.whole.append(data)
            return
        if self.sequence != flags >> 3:
            self.parts, self.sequence = {}, flags >> 3
        self.parts[flags >> 1 & 3] = data
        for last in range(4):
            if last not in self.parts:
                return
            if len(self.parts[last]) < 180 or last == 3:
                self.whole.append(b"".join(self.parts[k] for k in range(last + 1)))
                self.parts = {}
                return


def sent(message):
    return message.flags, bytes(message.data[: message.len])


@pytest.mark.parametrize(
    ("size", "pieces"),
    [
        (8, [(0, 8)]), (180, [(0, 180)]), (181, [(1, 180), (3, 1)]),
        (360, [(1, 180), (3, 180), (5, 0)]), (540, [(1, 180), (3, 180), (5, 180), (7, 0)]),
        (720, [(1, 180), (3, 180), (5, 180), (7, 180)]), (721, []), (1029, []),
    ],
)  # fmt: skip
def test_a_message_ends_with_a_fragment_that_is_not_full(size, pieces):
    messages = correction_messages(rtcm(1077, size), 32)
    assert [(message.flags, message.len) for message in messages] == pieces


@given(st.lists(st.integers(8, 720), min_size=1, max_size=40), st.randoms(use_true_random=False))
def test_a_receiver_gets_whole_messages_whatever_the_order_of_fragments(sizes, rng):
    receiver, frames = Receiver(), [rtcm(1077, size, rng.randrange(256)) for size in sizes]
    sequence = 0
    for frame in frames:
        fragments = correction_messages(frame, sequence)
        sequence += len(fragments) > 1
        for message in rng.sample(fragments, len(fragments)):
            receiver.take(*sent(message))
    assert receiver.whole == frames


@given(st.randoms(use_true_random=False))
def test_a_lost_fragment_loses_its_message_and_no_other(rng):
    receiver = Receiver()
    frames = [rtcm(1077, rng.randrange(400, 721), k) for k in range(12)]
    lost = rng.randrange(11)
    for k, frame in enumerate(frames):
        fragments = correction_messages(frame, k)
        if k == lost:
            fragments.pop(rng.randrange(len(fragments)))
        for message in fragments:
            receiver.take(*sent(message))
    assert receiver.whole == frames[:lost] + frames[lost + 1 :]


GOOD = [rtcm(1005, 25), rtcm(1077, 360), rtcm(1087, 181)]


def next_frames(source, number):
    """Return the next messages of a source, or why there are none."""
    frames, deadline = [], time.monotonic() + 120.0
    while len(frames) < number and time.monotonic() < deadline and not source.problem:
        frames += source.frames()
    return frames, source.problem


class Caster(threading.Thread):
    """An NTRIP caster for one client; ``version`` 1 or 2. It needs a password and a mountpoint."""

    def __init__(self, version):
        super().__init__(daemon=True)
        self.version, self.asked = version, b""
        self.server = socket.create_server(("127.0.0.1", 0))
        self.port = self.server.getsockname()[1]
        self.start()

    def run(self):
        client, _ = self.server.accept()
        with self.server, client:
            self._serve(client)

    def _serve(self, client):
        while b"\r\n\r\n" not in self.asked:
            self.asked += client.recv(4096)
        if base64.b64encode(b"me:p@ss") not in self.asked:
            answer = b"HTTP/1.1 401 Unauthorized\r\n\r\n"
            client.sendall(answer if self.version == 2 else b"ERROR - Bad Password\r\n")
        elif not self.asked.startswith(b"GET /BASE "):
            head = b"HTTP/1.1 200 OK\r\nContent-Type: gnss/sourcetable\r\n\r\n"
            client.sendall(head if self.version == 2 else b"SOURCETABLE 200 OK\r\n\r\n")
        elif self.version == 1:
            client.sendall(b"ICY 200 OK\r\n\r\n" + b"noise" + b"".join(GOOD))
        else:
            client.sendall(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n")
            data = b"".join(GOOD)
            for at in range(0, len(data), 100):
                piece = data[at : at + 100]
                client.sendall(b"%x\r\n%b\r\n" % (len(piece), piece))
        client.settimeout(120.0)
        while rest := client.recv(4096):
            self.asked += rest


@pytest.mark.parametrize("version", [1, 2])
def test_corrections_come_from_a_caster(version):
    caster = Caster(version)
    url = f"ntrip://me:p%40ss@127.0.0.1:{caster.port}/BASE"
    source = CorrectionSource(parse_source(url), (-33.5, 151.25, 40.0))
    assert next_frames(source, 3) == (GOOD, "")
    source.close()
    caster.join(120.0)
    # its checksum is of NMEA 0183: the exclusive or of all characters between $ and *
    sentence = caster.asked.rpartition(b"\r\n\r\n")[2] or caster.asked
    sentence = sentence[sentence.rindex(b"$") :].strip()
    assert sentence.startswith(b"$GPGGA,")
    assert b",3330.00000,S,15115.00000,E,1,12," in sentence
    check = 0
    for character in sentence[1 : sentence.index(b"*")]:
        check ^= character
    assert int(sentence[-2:], 16) == check


@pytest.mark.slow
@pytest.mark.parametrize(
    ("version", "place", "problem"),
    [
        (1, "me:p%40ss@{}/OTHER", "the caster has no mountpoint OTHER"),
        (2, "me:p%40ss@{}/OTHER", "the caster has no mountpoint OTHER"),
        (1, "me:wrong@{}/BASE", "the caster answered: ERROR - Bad Password"),
        (2, "me:wrong@{}/BASE", "the caster answered: 401 Unauthorized"),
    ],
)
def test_a_caster_that_refuses_is_reported_without_the_password(version, place, problem):
    caster = Caster(version)
    host = f"127.0.0.1:{caster.port}"
    source = CorrectionSource("ntrip://" + place.format(host), None)
    mountpoint = place.rpartition("/")[2]
    assert next_frames(source, 1) == ([], f"ntrip://{host}/{mountpoint}: {problem}")
    source.close()
    caster.join(120.0)


def test_damaged_messages_are_left_out(tmp_path):
    damaged = bytearray(GOOD[1])
    damaged[40] ^= 1
    (tmp_path / "base.rtcm").write_bytes(GOOD[0] + damaged + b"$GPGGA,\r\n" + GOOD[2])
    source = CorrectionSource(parse_source(f"file:{tmp_path}/base.rtcm"), None)
    assert next_frames(source, 2)[0] == [GOOD[0], GOOD[2]]
    source.close()


def test_a_reader_that_ends_is_started_again_and_ends_with_us():
    port = free_port()
    source = CorrectionSource(parse_source(f"udp://127.0.0.1:{port}"), None)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def until_received():
        deadline, frames = time.monotonic() + 120.0, []
        while not frames and time.monotonic() < deadline:
            sender.sendto(GOOD[0], ("127.0.0.1", port))
            frames = list(source.frames())
        return frames[0]

    assert until_received() == GOOD[0]
    (first,) = children("corrections")
    os.kill(first, signal.SIGKILL)
    while children("corrections") in ([first], []):
        list(source.frames())
    assert until_received() == GOOD[0]
    source.close()
    sender.close()
    assert children("corrections") == []


def test_each_address_gets_each_message_once(tmp_path):
    fleet = emulated_fleet(3, ("px4",))
    team = Team(fleet, lambda *_: None)
    link = next(iter(fleet.links))
    for system, port in ((1, 5001), (2, 5001), (3, 5003)):
        beat = dialect.MAVLink(None, srcSystem=system, srcComponent=1)
        data = beat.heartbeat_encode(2, 12, 0, 0, 3).pack(beat)
        assert team.receive(link, ("127.0.0.1", port), data, 0.0)
    recording = tmp_path / "base.rtcm"
    recording.write_bytes(b"".join([*GOOD, rtcm(1230, 1000)]))
    with open_corrections(f"file:{recording}", fleet, team) as corrections:
        assert corrections.received(0.0).words() == "none received"
        assert corrections.change(0.0) is None
        outgoing, deadline = [], time.monotonic() + 120.0
        while corrections.received(1.0).too_long == 0 and time.monotonic() < deadline:
            outgoing += corrections.packets(1.0)
        for tick in range(20):
            outgoing += corrections.packets(1.0 + 0.02 * tick)
        for port in (5001, 5003):
            receiver, parser = Receiver(), dialect.MAVLink(None)
            for packet in outgoing:
                if packet.address[1] == port:
                    (message,) = parser.parse_buffer(packet.data)
                    assert message.get_type() == "GPS_RTCM_DATA"
                    receiver.take(*sent(message))
            assert receiver.whole == GOOD
        state = "RTCM 1005, 1077, 1087, 1230, 2.5 kbit/s, the newest {} s old"
        state += "; 1 longer than 720 bytes: not sent"
        ended = f"; file:{recording}: the source has ended"
        assert corrections.change(1.0)[1].removesuffix(ended) == state.format("0.0")
        assert corrections.finding(1.0 + SILENCE).severity == "info"
        assert corrections.change(1.1 + SILENCE) == (
            "corrections", "none for 5 s: receivers lose RTK fixed after a time of their own",
        )  # fmt: skip
        assert corrections.finding(1.1 + SILENCE).severity == "error"


class Epochs:
    """A source whose messages are there at once, as an epoch of a base is."""

    def __init__(self):
        self.ready, self.problem = [], ""

    def frames(self):
        ready, self.ready = self.ready, []
        yield from ready


def one_vehicle():
    """Return a team of one vehicle that has been received."""
    fleet = emulated_fleet(1, ("px4",))
    team = Team(fleet, lambda *_: None)
    beat = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    data = beat.heartbeat_encode(2, 12, 0, 0, 3).pack(beat)
    assert team.receive(next(iter(fleet.links)), ("127.0.0.1", 5001), data, 0.0)
    return team


@pytest.mark.parametrize("tick", [0.02, 0.05])
def test_an_epoch_never_overflows_the_eight_fragments_that_px4_keeps(tick):
    epoch = [rtcm(kind, 720, kind & 0xFF) for kind in (1077, 1087, 1097, 1127)]
    source, receiver, parser = Epochs(), Receiver(), dialect.MAVLink(None)
    corrections = Corrections(source, one_vehicle())
    at = []
    for k in range(round(3.0 / tick)):
        now = 10.0 + k * tick
        if k % round(1.0 / tick) == 0:
            source.ready = list(epoch)
        for packet in corrections.packets(now):
            (message,) = parser.parse_buffer(packet.data)
            receiver.take(*sent(message))
            at.append(now)
    assert receiver.whole == 3 * epoch
    for first, ninth in zip(at, at[8:], strict=False):
        assert ninth - first > 0.05
    assert max(now % 1.0 for now in at) < 0.4


def test_a_source_beyond_the_pace_is_late_by_a_second_at_most():
    source = Epochs()
    corrections = Corrections(source, one_vehicle())
    source.ready = 30 * [rtcm(1077, 720)]
    sent_at_once = len(list(corrections.packets(0.0)))
    assert 120 - 50 <= sent_at_once < 120
    assert sum(len(list(corrections.packets(0.02 * k))) for k in range(53)) == 120 - sent_at_once


def test_a_source_that_never_sends_is_reported(tmp_path):
    team = Team(emulated_fleet(1, ("px4",)), lambda *_: None)
    missing = tmp_path / "missing"
    corrections = Corrections(CorrectionSource(f"file:{missing}", None), team)
    while not corrections.source.problem:
        assert list(corrections.packets(0.0)) == []
    kind, words = corrections.change(SILENCE + 0.1)
    assert (kind, words) == (
        "corrections",
        f"none received: file:{missing}: no such file or directory: receivers lose RTK fixed after "
        "a time of their own",
    )
    assert corrections.finding(SILENCE).severity == "error"
    corrections.close()


@pytest.mark.parametrize(
    "url",
    [
        "caster", "ntrip://host", "ntrip:///BASE", "ntrip://host:x/BASE", "ntrip://host:99999/BASE",
        "udp://host", "udp://:3", "serial://", "file:", "http://host/BASE", "ntrip://me:word@/BASE",
    ],
)  # fmt: skip
def test_other_addresses_are_refused(url):
    with pytest.raises(ValueError, match=r"^expected ntrip://") as error:
        parse_source(url)
    assert "word" not in str(error.value)


@pytest.mark.parametrize(
    "url", ["ntrip://a:b@host:2101/BASE", "ntrips://host/BASE", "serial:///dev/ttyUSB0:57600",
            "udp://0.0.0.0:13320", "file:/tmp/base.rtcm"],
)  # fmt: skip
def test_addresses_of_sources(url):
    assert parse_source(url) == url
    assert without_password("ntrip://a:b@c@host/BASE") == "ntrip://host/BASE"


@pytest.mark.parametrize(
    ("fix", "tracking", "error"),
    [
        (6, 0.1, None), (8, 0.1, None), (5, 0.1, "RTK float, with errors of 0.4 m"),
        (5, 0.4, None), (3, 0.1, "a 3D fix without corrections, with errors of 1.5 m"),
        (4, 0.5, "a differential fix, with errors of 1 m"), (7, 0.1, "no solution of a rover"),
    ],
)  # fmt: skip
def test_a_fix_is_as_good_as_the_tracking_of_the_plan_requires(fix, tracking, error):
    fleet = emulated_fleet(1)
    vehicle = Vehicle(1)
    vehicle.fix_type, vehicle.satellites = fix, 14
    finding = position_quality("system 1", vehicle, fleet, tracking)
    assert finding.severity == ("error" if error else "info")
    if error:
        assert error in finding.message
        assert finding.message.endswith(
            f"the plan allows tracking errors of {tracking:g} m: RTK fixed is needed (--rtcm sends "
            "corrections)"
        )
    # in the frame of their pads, vehicles need no receiver
    other = fleet.model_copy(update={"frame": "pads"})
    assert position_quality("system 1", vehicle, other, tracking).severity == "info"
