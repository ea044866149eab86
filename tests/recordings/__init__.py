"""Recordings of real autopilots, and reading them."""

from collections.abc import Iterator
from pathlib import Path

from tests.recordings.trim import entries, read

PX4 = "px4-1.16.0-takeoff-hold-land"
ARDUCOPTER = "arducopter-4.6.2-overhand"
ARDUCOPTER_CABLE = "arducopter-4.6.2-carries-cable"
ARDUCOPTER_ENDS = "arducopter-4.6.2-one-vehicle-ends"


def recorded(name: str) -> Iterator[tuple[float, bytes]]:
    """Yield seconds since the first packet, and each packet, of a recording."""
    first = None
    for stamp, packet in entries(read(Path(__file__).parent / f"{name}.tlog.gz")):
        first = stamp if first is None else first
        yield stamp - first, packet
