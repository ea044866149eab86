"""The parameter protocol with one vehicle, compared with pymavlink's messages."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from swarm.mavlink.packets import Decoder, Encoder
from swarm.mavlink.parameters import (
    ATTEMPTS,
    FETCH_TIMEOUT,
    Parameters,
    decode_value,
    encode_value,
)

INT32, REAL32, INT8 = 6, 9, 2
STEP = 0.05


class Vehicle:
    """A vehicle with parameters as pymavlink packs them; it responds or loses the packet."""

    def __init__(self, table, *, bytewise, loses=lambda _: False):
        self.table, self.bytewise, self.loses = dict(table), bytewise, loses
        self.names = list(self.table)
        self.link = common.MAVLink(None, srcSystem=7, srcComponent=1)
        self.requests = []

    def value(self, name, index=None):
        value = self.table[name]
        whole = isinstance(value, int) and self.bytewise
        kind = INT32 if isinstance(value, int) else REAL32
        raw = struct.pack("<i", value) if whole else struct.pack("<f", value)
        body = raw + struct.pack(
            "<HH", len(self.names), self.names.index(name) if index is None else index
        )
        body += name.encode().ljust(16, b"\0") + bytes([kind])
        head = bytes([len(body), 0, 0, 0, 7, 1, 22, 0, 0])
        return (
            b"\xfd" + head + body + struct.pack("<H", common.x25crc(head + body + bytes([220])).crc)
        )

    def respond(self, packet):
        (message,) = common.MAVLink(None).parse_buffer(packet)
        self.requests.append(message.get_type())
        if message.get_type() == "PARAM_REQUEST_LIST":
            return [self.value(name) for name in self.names if not self.loses(name)]
        if message.get_type() == "PARAM_REQUEST_READ":
            name = self.names[message.param_index]
            return [] if self.loses(name) else [self.value(name)]
        name = message.param_id
        raw = bytes(message.get_msgbuf())[10:14]
        whole = isinstance(self.table[name], int)
        taken = struct.unpack("<i" if whole and self.bytewise else "<f", raw)[0]
        if not self.loses("set"):
            self.table[name] = round(taken) if whole else taken
        return [] if self.loses(name) else [self.value(name)]


def exchange(parameters, vehicle, begin=0.0, most=30.0):
    """Exchange packets until the parameters are not busy; return the duration."""
    encoder, decoder, now = Encoder(), Decoder(), begin
    while parameters.busy and now < begin + most:
        for message in parameters.tick(7, 1, bytewise=vehicle.bytewise, now=now):
            for reply in vehicle.respond(encoder.encode(message)):
                (packet,) = decoder.feed(reply)
                parameters.receive(packet.message, bytewise=vehicle.bytewise, now=now)
        now += STEP
    assert not parameters.busy
    return now - begin


def table(count):
    rng = np.random.default_rng(2)
    whole = {f"INT_{k:04d}": int(rng.integers(-(2**31), 2**31)) for k in range(count // 2)}
    return whole | {
        f"REAL_{k:04d}": float(np.float32(rng.normal(0.0, 100.0)))
        for k in range(count - count // 2)
    }


def test_as_many_as_a_real_autopilot_has_are_fetched_exactly():
    vehicle = Vehicle(table(1400), bytewise=True)
    parameters = Parameters()
    parameters.fetch()
    took = exchange(parameters, vehicle)
    assert parameters.values == vehicle.table
    assert vehicle.requests == ["PARAM_REQUEST_LIST"]
    assert took < 1.0


@pytest.mark.parametrize("share", [0.05, 0.4])
def test_only_lost_parameters_are_requested_again(share):
    rng = np.random.default_rng(5)
    vehicle = Vehicle(table(300), bytewise=True, loses=lambda _: rng.random() < share)
    parameters = Parameters()
    parameters.fetch()
    exchange(parameters, vehicle)
    assert parameters.values == vehicle.table
    assert vehicle.requests.count("PARAM_REQUEST_LIST") == 1
    assert vehicle.requests.count("PARAM_REQUEST_READ") < 300 * share * 3


def test_a_parameter_that_never_arrives_ends_in_time_with_a_reason():
    vehicle = Vehicle(table(300), bytewise=True, loses=lambda name: name == "INT_0007")
    parameters = Parameters()
    parameters.fetch()
    assert exchange(parameters, vehicle) < FETCH_TIMEOUT + 1.0
    assert parameters.problem == "299 of 300 of its parameters received, then none for 5 s"


def test_a_silent_vehicle_ends_in_time_with_a_reason():
    parameters = Parameters()
    parameters.fetch()
    assert (
        exchange(parameters, Vehicle({"A": 1}, bytewise=True, loses=lambda _: True))
        < FETCH_TIMEOUT + 1.0
    )
    assert parameters.problem == "none of its parameters received, then none for 5 s"


@pytest.mark.parametrize("bytewise", [True, False])
def test_set_parameters_are_read_back_although_responses_are_lost(bytewise):
    rng = np.random.default_rng(1)
    vehicle = Vehicle({"COUNT": 3, "SPEED": 2.5, "KEPT": 9}, bytewise=bytewise)
    parameters = Parameters()
    parameters.fetch()
    exchange(parameters, vehicle)
    vehicle.loses = lambda _: rng.random() < 0.3
    vehicle.requests.clear()
    parameters.set({"COUNT": 5.0, "SPEED": 0.3})
    exchange(parameters, vehicle, 10.0)
    assert parameters.failed == []
    assert vehicle.table == {"COUNT": 5, "SPEED": pytest.approx(0.3), "KEPT": 9}
    assert parameters.values["COUNT"] == 5.0
    assert set(vehicle.requests) == {"PARAM_SET"}


def test_a_rejected_value_is_reported_with_the_vehicles_value():
    vehicle = Vehicle({"COUNT": 3}, bytewise=True)
    parameters = Parameters()
    parameters.fetch()
    exchange(parameters, vehicle)
    vehicle.loses = lambda what: what == "set"
    parameters.set({"COUNT": 5.0})
    exchange(parameters, vehicle, 10.0)
    assert parameters.failed == [("COUNT", 5.0, 3.0)]
    assert vehicle.requests.count("PARAM_SET") == ATTEMPTS


def test_a_fraction_is_not_sent_to_an_integer():
    vehicle = Vehicle({"COUNT": 3}, bytewise=False)
    parameters = Parameters()
    parameters.fetch()
    exchange(parameters, vehicle)
    parameters.set({"COUNT": 5.5})
    exchange(parameters, vehicle, 10.0)
    assert parameters.failed == [("COUNT", 5.5, 3.0)]
    assert "PARAM_SET" not in vehicle.requests


def test_checksums_and_unrequested_values_are_not_part_of_the_list():
    vehicle = Vehicle({"A": 1, "B": 2}, bytewise=True)
    parameters = Parameters()
    parameters.fetch()
    parameters.tick(7, 1, bytewise=True, now=0.0)
    vehicle.table["_HASH_CHECK"] = 12345
    decoder = Decoder()
    for packet in (vehicle.value("_HASH_CHECK", 65535), vehicle.value("A", 65535)):
        parameters.receive(decoder.feed(packet)[0].message, bytewise=True, now=0.0)
    assert parameters.busy
    assert parameters.values == {"A": 1.0}


@settings(max_examples=200, deadline=None)
@given(value=st.integers(-(2**31), 2**31 - 1))
def test_every_integer_survives_as_bytes(value):
    """Including bytes of a signalling NaN, which a conversion to float changes."""
    assert decode_value(encode_value(value, INT32, bytewise=True), INT32, bytewise=True) == value
    assert (
        encode_value(value, INT32, bytewise=True)
        == struct.unpack("<I", struct.pack("<i", value))[0]
    )


@given(value=st.integers(-128, 127))
def test_small_integers_are_encoded_both_ways(value):
    for bytewise in (True, False):
        assert (
            decode_value(encode_value(value, INT8, bytewise=bytewise), INT8, bytewise=bytewise)
            == value
        )
    with pytest.raises(ValueError, match="does not fit its type"):
        encode_value(value + 256.0, INT8, bytewise=True)


def test_a_wrong_index_or_count_does_not_complete_the_list():
    """Only as many different parameters as the vehicle counts are all of them."""
    vehicle = Vehicle(table(12), bytewise=True)
    parameters, decoder = Parameters(), Decoder()
    parameters.fetch()
    parameters.tick(7, 1, bytewise=True, now=0.0)
    first, *others = vehicle.names

    def receive(name, index, count):
        vehicle.names = [*vehicle.table][:count]
        (packet,) = decoder.feed(vehicle.value(name, index))
        parameters.receive(packet.message, bytewise=True, now=0.0)

    receive(first, 0, 1)
    assert (parameters.busy, parameters.received) == (False, 1)
    parameters.fetch()
    for k, name in enumerate(others, 1):
        receive(name, k, 12)
    for name, index, count in ((first, 12, 12), (others[0], 0, 12), (first, 3, 12), (first, 0, 0)):
        receive(name, index, count)
        assert parameters.busy
    receive(first, 0, 5)
    assert (parameters.busy, parameters.total, parameters.received) == (False, 12, 12)
    assert parameters.values == vehicle.table


def test_names_have_no_control_characters():
    parameters = Parameters()
    kind = common.MAVLink_param_value_message(b"\x1b[2J_P\x07", 1.0, REAL32, 1, 0)
    (packet,) = Decoder().feed(kind.pack(common.MAVLink(None, 7, 1)))
    parameters.receive(packet.message, bytewise=False, now=0.0)
    assert list(parameters.values) == ["\ufffd[2J_P\ufffd"]
