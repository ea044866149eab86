"""Cut a .tlog down to some vehicles and a span of time, both directions, and compress it.

``python -m tests.recordings.trim FLIGHT.tlog[.gz] OUT.tlog.gz --systems 1 2 [--from S] [--to S]``

Seconds count from the first packet. From the ground station's packets those are kept that are
addressed to one of the vehicles, or to none; of what was sent to every vehicle at once (heartbeats,
time requests, the mission clock) one copy is kept. Packets are kept as they are, byte for byte.
"""

import argparse
import gzip
from collections.abc import Collection, Iterator
from pathlib import Path

from pymavlink.dialects.v20 import common as dialect

GROUND = 255
_STAMP, _HEADER, _CHECKSUM, _SIGNATURE = 8, 10, 2, 13
_SAME = 0.05
"""Seconds within which equal packets of the ground station are copies of one broadcast."""


def read(path: Path) -> bytes:
    """Return the bytes of a .tlog, compressed or not."""
    data = path.read_bytes()
    return gzip.decompress(data) if path.suffix == ".gz" else data


def entries(data: bytes) -> Iterator[tuple[float, bytes]]:
    """Yield seconds since 1970 and each MAVLink 2 packet of an undamaged .tlog."""
    start = 0
    while start + _STAMP + _HEADER <= len(data):
        at = start + _STAMP
        signed = data[at + 2] & 1
        end = at + _HEADER + data[at + 1] + _CHECKSUM + (_SIGNATURE if signed else 0)
        if data[at] != 0xFD or end > len(data):
            raise ValueError(f"byte {at}: expected a MAVLink 2 packet")
        yield int.from_bytes(data[start:at], "big") * 1e-6, data[at:end]
        start = end


def number(packet: bytes) -> int:
    """Return the message number of a packet."""
    return int.from_bytes(packet[7:10], "little")


def target(packet: bytes) -> int:
    """Return the system that a packet is addressed to; 0 is every system."""
    kind = dialect.mavlink_map.get(number(packet))
    if kind is None or "target_system" not in kind.fieldnames:
        return 0
    place = kind.ordered_fieldnames.index("target_system")
    offset = sum(
        _WIDTHS[kind.fieldtypes[kind.fieldnames.index(name)]]
        * max(1, kind.array_lengths[kind.ordered_fieldnames.index(name)])
        for name in kind.ordered_fieldnames[:place]
    )
    payload = packet[_HEADER : _HEADER + packet[1]]
    return payload[offset] if offset < len(payload) else 0


_WIDTHS = {
    "char": 1, "uint8_t": 1, "int8_t": 1, "uint16_t": 2, "int16_t": 2, "uint32_t": 4,
    "int32_t": 4, "float": 4, "uint64_t": 8, "int64_t": 8, "double": 8,
}  # fmt: skip


def trim(data: bytes, systems: Collection[int], begin: float, end: float) -> bytes:
    """Return the part of a .tlog that concerns ``systems`` in [begin, end) seconds."""
    out = bytearray()
    first: float | None = None
    latest: dict[bytes, float] = {}
    for stamp, packet in entries(data):
        first = stamp if first is None else first
        if not begin <= stamp - first < end:
            continue
        if packet[5] != GROUND:
            wanted = packet[5] in systems
        elif target(packet):
            wanted = target(packet) in systems
        else:
            body = packet[6:10] + packet[_HEADER : _HEADER + packet[1]]
            wanted = stamp - latest.get(body, -1.0) > _SAME
            latest[body] = stamp if wanted else latest.get(body, stamp)
        if wanted:
            out += round(stamp * 1e6).to_bytes(_STAMP, "big") + packet
    return bytes(out)


def main() -> None:
    """Read the arguments, trim, write."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0] if __doc__ else "")
    parser.add_argument("source", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--systems", type=int, nargs="+", required=True)
    parser.add_argument("--from", dest="begin", type=float, default=0.0)
    parser.add_argument("--to", dest="end", type=float, default=float("inf"))
    given = parser.parse_args()
    kept = trim(read(given.source), set(given.systems), given.begin, given.end)
    given.out.write_bytes(gzip.compress(kept, 9, mtime=0))


if __name__ == "__main__":
    main()
