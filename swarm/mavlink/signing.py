"""MAVLink 2 message signing: signing of sent packets, verification of received ones.

A signature is a link number, a timestamp that only increases (48 bits, units of 10 µs since
2015-01-01), and the first six bytes of SHA-256 over key, packet and these.
https://mavlink.io/en/guide/message_signing.html
"""

import hashlib
from collections import Counter
from typing import Literal

from pymavlink.dialects.v20 import common

KEY_LENGTH = 32
SIGNATURE_LENGTH = 13
TICKS_PER_SECOND = 100_000
_EPOCH = 1_420_070_400
_MAX_AGE = 60 * TICKS_PER_SECOND
_MAX_STREAMS = 4096
_LATEST = 2**48 - 365 * 86_400 * TICKS_PER_SECOND
"""A year before timestamps end, in 2104: a sender with that clock would leave the others none."""
_FLAG = 1
_HEADER = 10

Verdict = Literal["genuine", "unsigned", "forged", "replayed"]


def timestamp_at(unix_seconds: float) -> int:
    """Return the signing timestamp of a moment, given in seconds since 1970."""
    return int((unix_seconds - _EPOCH) * TICKS_PER_SECOND)


class Signing:
    """The key and timestamp of the ground station, and the latest timestamp of every stream.

    ``timestamp`` is the last one used; it must be stored from one run to the next. ``dropped``
    counts rejected packets by verdict.
    """

    def __init__(self, key: bytes, timestamp: int) -> None:
        """``key`` has 32 bytes; ``timestamp`` must be newer than all that were used before."""
        if len(key) != KEY_LENGTH:
            raise ValueError(f"expected a key of {KEY_LENGTH} bytes, got {len(key)}")
        self._key = key
        self._start = timestamp
        self.timestamp = timestamp
        self.dropped: Counter[Verdict] = Counter()
        self._streams: dict[tuple[int, int, int], int] = {}

    def advance(self, elapsed: float) -> None:
        """Advance the timestamp to at least its start value plus ``elapsed`` seconds."""
        self.timestamp = max(self.timestamp, self._start + int(elapsed * TICKS_PER_SECOND))

    def sign(self, packet: bytes, link: int = 0) -> bytes:
        """Return the signed form of an unsigned MAVLink 2 packet of a known message."""
        flagged = bytearray(packet)
        flagged[2] |= _FLAG
        number = packet[7] | packet[8] << 8 | packet[9] << 16
        extra = common.mavlink_map[number].crc_extra
        close = _HEADER + packet[1]
        checksum = common.x25crc(bytes(flagged[1:close]) + bytes([extra])).crc
        flagged[close : close + 2] = int(checksum).to_bytes(2, "little")
        return self.append_signature(bytes(flagged), link)

    def append_signature(self, packet: bytes, link: int = 0) -> bytes:
        """Return a packet, which has the flag for signing, with its signature appended."""
        self.timestamp += 1
        tail = bytes([link]) + self.timestamp.to_bytes(6, "little")
        return packet + tail + self._digest(packet + tail)

    def is_genuine(self, packet: bytes) -> bool:
        """Return whether a packet was signed with this key, at any time."""
        return self._signature(packet) == "genuine"

    def verify(self, packet: bytes) -> Verdict:
        """Return the verdict on a received packet, and count it if it must be dropped."""
        verdict = self._signature(packet)
        if verdict == "genuine" and not self._is_newer(packet):
            verdict = "replayed"
        if verdict != "genuine":
            self.dropped[verdict] += 1
        return verdict

    def _signature(self, packet: bytes) -> Verdict:
        if packet[0] != 0xFD or not packet[2] & _FLAG:
            return "unsigned"
        return "genuine" if self._digest(packet[:-6]) == packet[-6:] else "forged"

    def _is_newer(self, packet: bytes) -> bool:
        """Return whether the timestamp is newer than the stream's last; a first must be recent."""
        stream = packet[5], packet[6], packet[-13]
        stamp = int.from_bytes(packet[-12:-6], "little")
        last = self._streams.get(stream)
        if stamp > _LATEST:
            return False
        if last is None:
            if stamp + _MAX_AGE < self.timestamp or len(self._streams) >= _MAX_STREAMS:
                return False
        elif stamp <= last:
            return False
        self._streams[stream] = stamp
        self.timestamp = max(self.timestamp, stamp)
        return True

    def _digest(self, data: bytes) -> bytes:
        return hashlib.sha256(self._key + data).digest()[:6]
