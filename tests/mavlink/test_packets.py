"""Packets against pymavlink, byte by byte and field by field."""

import math
import struct
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from swarm.mavlink.packets import Decoder, Encoder
from swarm.mavlink.setpoints import SetpointPacker

NUMBERS = sorted(common.mavlink_map)


def random_message(number: int, payload: bytes):
    """Return pymavlink's message with these payload bytes, from its own decoder."""
    kind = common.mavlink_map[number]
    body = payload[: kind.unpacker.size].ljust(kind.unpacker.size, b"\0")
    header = struct.pack(
        "<BBBBBBBHB", 0xFD, len(body), 0, 0, 3, 7, 1, number & 0xFFFF, number >> 16
    )
    checksum = common.x25crc(header[1:] + body + bytes([kind.crc_extra])).crc
    return common.MAVLink(None).decode(bytearray(header + body + struct.pack("<H", checksum)))


def same(ours, theirs) -> bool:
    """Return whether two values are equal, NaN included; pymavlink truncates and decodes texts."""
    if isinstance(theirs, float):
        return ours == theirs or (math.isnan(ours) and math.isnan(theirs))
    if isinstance(theirs, list):
        return all(same(a, b) for a, b in zip(ours, theirs, strict=True))
    if isinstance(theirs, str):
        return ours.split(b"\0", 1)[0].decode("ascii", "replace") == theirs
    return ours == theirs


@given(number=st.sampled_from(NUMBERS), payload=st.binary(min_size=0, max_size=255))
@settings(max_examples=400, deadline=None)
def test_every_message_is_decoded_as_by_pymavlink(number, payload):
    theirs = random_message(number, payload)
    (packet,) = Decoder().feed(bytes(theirs.get_msgbuf()))
    assert (packet.number, packet.system, packet.component, packet.sequence) == (number, 7, 1, 3)
    for name in theirs.get_fieldnames():
        assert same(getattr(packet.message, name), getattr(theirs, name)), name


@given(number=st.sampled_from(NUMBERS), payload=st.binary(min_size=0, max_size=255))
@settings(max_examples=400, deadline=None)
def test_every_message_is_encoded_as_by_pymavlink(number, payload):
    message = random_message(number, payload)
    mav = common.MAVLink(None, srcSystem=9, srcComponent=4)
    encoder = Encoder(9, 4)
    for _ in range(2):
        assert encoder.encode(message) == bytes(message.pack(mav))
        mav.seq += 1


def test_truncated_payloads_and_version_1_packets_are_decoded():
    mav = common.MAVLink(None, srcSystem=5, srcComponent=1)
    message = common.MAVLink_heartbeat_message(2, 12, 0, 0, 0, 0)
    for data in (message.pack(mav), message.pack(mav, force_mavlink1=True)):
        (packet,) = Decoder().feed(data)
        assert packet.message.autopilot == 12
        assert packet.message.mavlink_version == 0
        assert packet.system == 5


@given(cuts=st.lists(st.integers(0, 400), max_size=8))
def test_a_stream_can_be_divided_anywhere(cuts):
    encoder = Encoder(3, 1)
    data = b"".join(
        encoder.encode(common.MAVLink_attitude_message(k, 0.1 * k, 0, 0, 0, 0, 0)) for k in range(8)
    )
    decoder = Decoder(stream=True)
    places = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    packets = [
        packet for start, stop in pairwise(places) for packet in decoder.feed(data[start:stop])
    ]
    assert [packet.message.time_boot_ms for packet in packets] == list(range(8))
    assert [packet.sequence for packet in packets] == list(range(8))


@given(garbage=st.binary(max_size=600), stream=st.booleans())
@settings(max_examples=300)
def test_arbitrary_bytes_raise_no_error(garbage, stream):
    decoder = Decoder(stream=stream)
    decoder.feed(garbage)
    good = Encoder(1, 1).encode(common.MAVLink_heartbeat_message(2, 3, 0, 0, 0, 3))
    decoder = Decoder()
    decoder.feed(garbage)
    assert decoder.feed(good)[0].system == 1


@given(place=st.integers(1, 20), bit=st.integers(0, 7))
def test_a_flipped_bit_is_detected(place, bit):
    data = bytearray(Encoder(1, 1).encode(common.MAVLink_heartbeat_message(2, 3, 9, 8, 7, 3)))
    data[place] ^= 1 << bit
    decoder = Decoder()
    assert all(packet.number != 0 for packet in decoder.feed(bytes(data)))
    assert decoder.damaged + decoder.unknown >= 1


def test_only_selected_messages_are_unpacked():
    encoder = Encoder(1, 1)
    data = encoder.encode(common.MAVLink_heartbeat_message(2, 3, 0, 0, 0, 3))
    data += encoder.encode(common.MAVLink_attitude_message(1, 0, 0, 0, 0, 0, 0))
    first, second = Decoder(unpacked={0}).feed(data)
    assert first.message is not None
    assert second.message is None


finite = st.floats(-1e4, 1e4, width=32)


@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_setpoints_are_encoded_as_by_pymavlink(data):
    n = data.draw(st.integers(1, 5))
    systems = data.draw(st.lists(st.integers(1, 250), min_size=n, max_size=n))
    components = data.draw(st.lists(st.integers(0, 255), min_size=n, max_size=n))
    sequences = data.draw(st.lists(st.integers(0, 255), min_size=n, max_size=n))
    boot = data.draw(st.integers(0, 2**32 - 1))
    numbers = data.draw(st.lists(finite, min_size=10 * n, max_size=10 * n))
    values = np.array(numbers).reshape(n, 10)
    packer = SetpointPacker(systems, components)
    packets = packer.pack(sequences, boot, values[:, :9].reshape(n, 3, 3), values[:, 9])
    for k in range(n):
        mav = common.MAVLink(None, srcSystem=255, srcComponent=190)
        mav.seq = sequences[k]
        single = common.MAVLink_set_position_target_local_ned_message(
            boot, systems[k], components[k], 1, 2048, *values[k, :9], values[k, 9], 0.0
        )
        assert packets[k].tobytes() == bytes(single.pack(mav))


def test_both_ways_of_packing_share_the_sequence_numbers():
    encoder = Encoder()
    heartbeat = common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    taken = []
    for _ in range(300):
        taken.append(encoder.encode(heartbeat)[4])
        taken.append(encoder.next_sequence())
    assert taken == [k % 256 for k in range(600)]


@pytest.mark.parametrize("number", [common.MAVLINK_MSG_ID_STATUSTEXT])
def test_texts_are_encoded_unchanged(number):
    encoder = Encoder(1, 1)
    text = b"Preflight Fail: ekf2 missing data\t"
    data = encoder.encode(common.MAVLink_statustext_message(3, text, 0, 0))
    (packet,) = Decoder().feed(data)
    assert packet.number == number
    assert packet.message.text.rstrip(b"\0") == text
