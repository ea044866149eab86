"""MAVLink 2 signing, compared with pymavlink's; and a whole signed flight."""

import hashlib

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from swarm.mavlink.packets import Decoder, Encoder
from swarm.mavlink.setpoints import SetpointPacker
from swarm.mavlink.signing import TICKS_PER_SECOND, Signing, timestamp_at
from swarm.mission.fleet import emulated_fleet
from tests.network import Network, small_plan

KEY = hashlib.sha256(b"for tests only").digest()
NOW = timestamp_at(1_800_000_000.0)
HEARTBEAT = common.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3)


def theirs(timestamp: int = NOW, key: bytes = KEY, link: int = 3) -> common.MAVLink:
    mav = common.MAVLink(None, srcSystem=7, srcComponent=1)
    mav.robust_parsing = True
    mav.signing.secret_key, mav.signing.link_id = key, link
    mav.signing.timestamp, mav.signing.sign_outgoing = timestamp, True
    return mav


def test_pymavlink_accepts_our_signatures():
    signing = Signing(KEY, NOW)
    encoder = Encoder()
    reader = theirs()
    packer = SetpointPacker([1, 2], [1, 1], signed=True)
    setpoints = packer.pack([0, 1], 17, np.full((2, 3, 3), 1.5), np.zeros(2))
    sent = signing.sign(encoder.encode(HEARTBEAT), link=5)
    sent += b"".join(signing.append_signature(row.tobytes(), 5) for row in setpoints)
    messages = reader.parse_buffer(sent)
    assert [m.get_type() for m in messages] == [
        "HEARTBEAT", "SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_LOCAL_NED",
    ]  # fmt: skip
    assert messages[2].target_system == 2


def test_only_packets_signed_with_the_key_are_accepted():
    signing, decoder = Signing(KEY, NOW), Decoder()
    mav = theirs()
    genuine = bytes(HEARTBEAT.pack(mav))
    forged = bytes(HEARTBEAT.pack(theirs(key=bytes(32))))
    unsigned = Encoder(7, 1).encode(HEARTBEAT)
    assert len(decoder.feed(genuine, signing)) == 1
    assert decoder.feed(forged + unsigned + genuine, signing) == []
    assert dict(signing.dropped) == {"forged": 1, "unsigned": 1, "replayed": 1}
    assert len(decoder.feed(bytes(HEARTBEAT.pack(mav)), signing)) == 1


def test_a_stream_with_an_old_first_timestamp_is_a_replay():
    signing, decoder = Signing(KEY, NOW), Decoder()
    minute = 60 * TICKS_PER_SECOND
    assert decoder.feed(bytes(HEARTBEAT.pack(theirs(NOW - minute - 10))), signing) == []
    assert len(decoder.feed(bytes(HEARTBEAT.pack(theirs(NOW - minute + 10))), signing)) == 1
    assert signing.dropped["replayed"] == 1


def test_our_timestamp_follows_the_clock_and_later_timestamps():
    signing = Signing(KEY, NOW)
    signing.advance(2.0)
    assert signing.timestamp == NOW + 2 * TICKS_PER_SECOND
    Decoder().feed(bytes(HEARTBEAT.pack(theirs(NOW + 10**9))), signing)
    assert signing.timestamp == NOW + 10**9
    signing.advance(3.0)
    stamps = [int.from_bytes(signing.sign(Encoder().encode(HEARTBEAT))[-12:-6], "little")]
    assert stamps[0] == NOW + 10**9 + 1


def test_a_key_of_another_length_is_refused():
    with pytest.raises(ValueError, match="expected a key of 32 bytes, got 5"):
        Signing(b"short", 0)


def test_a_signed_team_flies_and_ignores_unsigned_packets():
    flight = Network(small_plan(), emulated_fleet(3, ("px4", "ardupilot")), no_cable=True)
    signing = flight.conductor.team.signing = Signing(KEY, NOW)
    flight.emulator.sign_with(KEY, 1_800_000_000.0)
    flight.until_phase("takeoff", 2.0)
    spoof = Encoder(2, 1).encode(common.MAVLink_heartbeat_message(2, 3, 0, 6, 3, 3))
    before = flight.conductor.flyers[1].custom_mode
    for _ in range(5):
        flight.conductor.receive("loopback", 2, spoof, flight.now)
    assert flight.conductor.flyers[1].custom_mode == before
    assert signing.dropped == {"unsigned": 5}
    assert flight.conductor.statistics().rejected["unsigned"] == 5
    flight.once()
    sent = [data for _, system, data in flight.sent if system == 1]
    assert all(data[2] & 1 for data in sent)
    assert any("not signed as they must be" in words for words in flight.words("security"))


def test_vehicles_with_a_key_ignore_a_ground_station_without_one():
    flight = Network(small_plan(), emulated_fleet(3), no_cable=True)
    flight.emulator.sign_with(KEY, 1_800_000_000.0)
    flight.run(most=200.0)
    assert flight.conductor.finished.word in {"failed", "refused"}
    assert not flight.emulator.truth().armed.any()


def test_a_clock_at_the_end_of_all_timestamps_is_not_followed():
    signing = Signing(KEY, NOW)
    for stamp in (2**48 - 1, 2**48 - 10**12):
        assert not Decoder().feed(bytes(HEARTBEAT.pack(theirs(stamp))), signing)
    assert signing.timestamp == NOW
    assert signing.dropped["replayed"] == 2
