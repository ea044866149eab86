"""Corrections of satellite positions (RTCM 3), from a base station to every vehicle's receiver.

A process of its own (:mod:`swarm.ground.corrections_child`) reads the source, so that a caster that
answers slowly delays no setpoint. It passes on whole messages whose checksum is right; the flight
sends each of them once to every remote address of the team's links, as GPS_RTCM_DATA, since the
message names no vehicle.
"""

import math
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

from pymavlink.dialects.v20 import common

from swarm.certification.findings import Finding
from swarm.flight.router import Outgoing, Route, Team
from swarm.ground.child_process import ChildError, RestartedProcess
from swarm.mission.fleet import Fleet

FRAGMENT = 180
"""Bytes of one GPS_RTCM_DATA (MAVLink, common.xml)."""
_MOST_FRAGMENTS = 4
"""The number of a fragment has two bits (MAVLink, common.xml)."""
SILENCE = 5.0
"""Seconds without corrections that are reported: five epochs of a base that sends every second."""
_PACE = 0.02
"""Seconds between two fragments. PX4 keeps eight, which its receiver's driver fetches every 0.05 s:
of epochs of ten fragments that were sent at once it passed on the last eight. An epoch of twenty,
those of all constellations, takes 0.4 s: receivers use corrections that are older by seconds."""
_CATCH_UP = 3
"""Fragments that follow at once where the last call was too long ago for the pace: fewer than half
of what PX4 keeps."""
_MOST_WAITING = round(1.0 / _PACE)
"""Fragments that wait at most, for a second, when a base sends the next ones: those beyond follow
at once."""
_EXPECTED = (
    "expected ntrip://[USER:PASSWORD@]HOST[:PORT]/MOUNTPOINT (ntrips: with TLS), "
    "serial://DEVICE[:BAUD], udp://HOST:PORT or file:PATH"
)


def parse_source(url: str) -> str:
    """Return the address of a source of corrections; raises `ValueError` for another text."""
    parts = urlsplit(url)
    try:
        port = parts.port if parts.scheme in ("udp", "ntrip", "ntrips") else None
    except ValueError:
        port = 0
    caster = bool(parts.hostname) and port != 0 and len(parts.path) > 1
    fits = {
        **dict.fromkeys(("ntrip", "ntrips"), caster),
        "udp": bool(parts.hostname) and bool(port),
        "serial": len(url) > len("serial://"),
        "file": bool(parts.path),
    }
    if not fits.get(parts.scheme, False):
        raise ValueError(f"{_EXPECTED}, got {without_password(url)}")
    return url


def without_password(url: str) -> str:
    """Return an address without the name and the password in it, for messages and records."""
    scheme, separator, rest = url.partition("://")
    return scheme + separator + rest.rpartition("@")[2] if separator else url


def correction_messages(frame: bytes, sequence: int) -> list[Any]:
    """Return an RTCM message as GPS_RTCM_DATA messages, none where it is longer than 720 bytes.

    A receiver knows the last of fewer than four fragments by its length below 180 bytes, so that a
    message of 360 or 540 bytes ends with an empty fragment. ``sequence`` counts the messages that
    are sent in fragments.
    """
    if len(frame) > _MOST_FRAGMENTS * FRAGMENT:
        return []
    pieces = [frame[at : at + FRAGMENT] for at in range(0, len(frame), FRAGMENT)]
    fragmented = len(pieces) > 1
    if fragmented and len(pieces[-1]) == FRAGMENT and len(pieces) < _MOST_FRAGMENTS:
        pieces.append(b"")
    return [
        common.MAVLink_gps_rtcm_data_message(
            1 | number << 1 | (sequence & 0x1F) << 3 if fragmented else 0,
            len(piece),
            piece.ljust(FRAGMENT, b"\0"),
        )
        for number, piece in enumerate(pieces)
    ]


@dataclass(frozen=True)
class Received:
    """What has come from the source: message types, bit/s over the last seconds, and its age.

    ``age`` seconds since the newest message, None before the first. ``problem``: why there is none.
    ``too_long`` counts messages that GPS_RTCM_DATA cannot carry.
    """

    types: tuple[int, ...]
    rate: float
    age: float | None
    too_long: int
    problem: str = ""

    def words(self) -> str:
        """Return the state in words."""
        if self.age is None:
            return f"none received{f': {self.problem}' if self.problem else ''}"
        kinds = ", ".join(map(str, self.types))
        text = f"RTCM {kinds}, {self.rate / 1000.0:.1f} kbit/s, the newest {self.age:.1f} s old"
        if self.too_long:
            text += f"; {self.too_long} longer than {_MOST_FRAGMENTS * FRAGMENT} bytes: not sent"
        return text + (f"; {self.problem}" if self.problem else "")


class CorrectionSource:
    """The process that reads a source; it is started again if it ends."""

    def __init__(self, url: str, position: tuple[float, float, float] | None) -> None:
        """Start; ``position`` (degrees, degrees, metres) is reported to a caster."""
        self._source, self.problem = without_password(url), ""
        self._child = RestartedProcess("swarm.ground.corrections_child", (url, position))

    def frames(self) -> Iterator[bytes]:
        """Yield the RTCM messages that have arrived."""
        try:
            for kind, content in self._child.arrived():
                self.problem = "" if kind == "frame" else f"{self._source}: {content}"
                if kind == "frame":
                    yield content
        except ChildError as error:
            self.problem = str(error)

    def close(self) -> None:
        """End the process."""
        self._child.close()


@dataclass
class Corrections:
    """Sends the messages of a source to the vehicles, and reports when there are none."""

    source: CorrectionSource
    team: Team
    _sequence: int = 0
    _too_long: int = 0
    _types: dict[int, float] = field(default_factory=dict)
    _sizes: "deque[tuple[float, int]]" = field(default_factory=deque)
    _newest: float | None = None
    _silent: bool | None = None
    _waiting: "deque[Any]" = field(default_factory=deque)
    _free_at: float = -math.inf

    def packets(self, now: float) -> Iterator[Outgoing]:
        """Yield the packets that are due at ``now``."""
        for frame in self.source.frames():
            self._newest = now
            self._types[frame[3] << 4 | frame[4] >> 4] = now
            self._sizes.append((now, 8 * len(frame)))
            messages = correction_messages(frame, self._sequence)
            self._too_long += not messages
            self._sequence += len(messages) > 1
            if not self._waiting:
                self._free_at = max(self._free_at, now)
            self._waiting += messages
        self._free_at = max(self._free_at, now - _CATCH_UP * _PACE)
        while self._waiting and (self._free_at <= now or len(self._waiting) > _MOST_WAITING):
            self._free_at = min(self._free_at, now) + _PACE
            yield from self._sent(self._waiting.popleft())
        while self._sizes and now - self._sizes[0][0] > SILENCE:
            self._sizes.popleft()

    def _sent(self, message: Any) -> Iterator[Outgoing]:
        """Yield a message's packets, one for each way to vehicles."""
        for route in self._routes():
            data = self.team.sealed(route.link, route.encoder.encode(message))
            yield Outgoing(route.link, route.address, data)

    def _routes(self) -> Iterable[Route]:
        """Return the routes to all vehicles, each address of a link once."""
        routes = (self.team.way_to(system) for system in self.team.vehicles)
        return {(r.link, r.address): r for r in routes if r is not None}.values()

    def received(self, now: float) -> Received:
        """Return what has come from the source."""
        newest = self._newest
        types = sorted(kind for kind, at in self._types.items() if now - at <= 6.0 * SILENCE)
        rate = sum(size for _, size in self._sizes) / SILENCE
        age = None if newest is None else now - newest
        return Received(tuple(types), rate, age, self._too_long, self.source.problem)

    def finding(self, now: float) -> Finding:
        """Return what has come from the source as a finding of the ground check."""
        state = self.received(now)
        silent = state.age is None or state.age > SILENCE
        return Finding("error" if silent else "info", "corrections", state.words())

    def change(self, now: float) -> tuple[str, str] | None:
        """Return an event, kind and words, when corrections begin, stay away or come again."""
        state = self.received(now)
        silent = now > SILENCE if state.age is None else state.age > SILENCE
        if silent == self._silent or (self._silent is None and state.age is None and not silent):
            return None
        first, self._silent = self._silent is None, silent
        if not silent:
            return "corrections", state.words() if first else "received again: " + state.words()
        away = f"none for {SILENCE:g} s" if state.age is not None else state.words()
        return "corrections", f"{away}: receivers lose RTK fixed after a time of their own"

    def close(self) -> None:
        """End the process of the source."""
        self.source.close()


@contextmanager
def open_corrections(url: str | None, fleet: Fleet, team: Team) -> Iterator[Corrections | None]:
    """Open a source of corrections for a team, if there is one; its process ends with the block.

    Casters that compute a base station near the caller get the origin of the fleet file.
    """
    if url is None:
        yield None
        return
    place = fleet.origin
    position = (place.latitude, place.longitude, place.altitude or 0.0) if place else None
    corrections = Corrections(CorrectionSource(url, position), team)
    try:
        yield corrections
    finally:
        corrections.close()
