"""MAVLink 2 message signing: what we send is signed, what is not signed is not heard.

A signature is a link number, a timestamp that only goes up (48 bits, 10 µs since 2015-01-01) and
the first six bytes of SHA-256 over key, packet and these. https://mavlink.io/en/guide/message_signing.html
"""

import hashlib
from collections import Counter
from typing import Literal

from pymavlink.dialects.v20 import common

KEY_LENGTH = 32
SIGNATURE_LENGTH = 13
TICKS_PER_SECOND = 100_000
_EPOCH = 1_420_070_400
_OLDEST = 60 * TICKS_PER_SECOND
_MOST_STREAMS = 4096
_FLAG = 1
_HEADER = 10

Verdict = Literal["genuine", "unsigned", "forged", "replayed"]


def ticks_at(unix_seconds: float) -> int:
    """Return the signing timestamp of a moment, given in seconds since 1970."""
    return int((unix_seconds - _EPOCH) * TICKS_PER_SECOND)


class Signing:
    """The ground station's key, its timestamp, and the timestamps of those who speak to it.

    ``timestamp`` is the last one used; it must be kept from one run to the next.
    """

    def __init__(self, key: bytes, timestamp: int) -> None:
        """``key`` has 32 bytes; ``timestamp`` is newer than any that was used before."""
        if len(key) != KEY_LENGTH:
            raise ValueError(f"expected a key of {KEY_LENGTH} bytes, got {len(key)}")
        self._key = key
        self._began = timestamp
        self.timestamp = timestamp
        self.dropped: Counter[Verdict] = Counter()
        self._streams: dict[tuple[int, int, int], int] = {}

    def follow(self, elapsed: float) -> None:
        """Let the timestamp follow the clock: seconds since this began."""
        self.timestamp = max(self.timestamp, self._began + int(elapsed * TICKS_PER_SECOND))

    def seal(self, packet: bytes, link: int = 0) -> bytes:
        """Return an unsigned MAVLink 2 packet of a known message as a signed one."""
        flagged = bytearray(packet)
        flagged[2] |= _FLAG
        number = packet[7] | packet[8] << 8 | packet[9] << 16
        extra = common.mavlink_map[number].crc_extra
        close = _HEADER + packet[1]
        checksum = common.x25crc(bytes(flagged[1:close]) + bytes([extra])).crc
        flagged[close : close + 2] = int(checksum).to_bytes(2, "little")
        return self.sign(bytes(flagged), link)

    def sign(self, packet: bytes, link: int = 0) -> bytes:
        """Return a packet that is flagged as signed, with its signature."""
        self.timestamp += 1
        tail = bytes([link]) + self.timestamp.to_bytes(6, "little")
        return packet + tail + self._digest(packet + tail)

    def genuine(self, packet: bytes) -> bool:
        """Whether a packet was signed with this key, at any time."""
        return self._signature(packet) == "genuine"

    def judge(self, packet: bytes) -> Verdict:
        """Judge a packet that arrived, and count it if it must be dropped."""
        verdict = self._signature(packet)
        if verdict == "genuine" and not self._newer(packet):
            verdict = "replayed"
        if verdict != "genuine":
            self.dropped[verdict] += 1
        return verdict

    def _signature(self, packet: bytes) -> Verdict:
        if packet[0] != 0xFD or not packet[2] & _FLAG:
            return "unsigned"
        return "genuine" if self._digest(packet[:-6]) == packet[-6:] else "forged"

    def _newer(self, packet: bytes) -> bool:
        """Whether the timestamp is newer than the stream's last one; streams begin near ours."""
        stream = packet[5], packet[6], packet[-13]
        stamp = int.from_bytes(packet[-12:-6], "little")
        last = self._streams.get(stream)
        if last is None:
            if stamp + _OLDEST < self.timestamp or len(self._streams) >= _MOST_STREAMS:
                return False
        elif stamp <= last:
            return False
        self._streams[stream] = stamp
        self.timestamp = max(self.timestamp, stamp)
        return True

    def _digest(self, data: bytes) -> bytes:
        return hashlib.sha256(self._key + data).digest()[:6]
