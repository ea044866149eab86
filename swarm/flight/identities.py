"""Two vehicles with one system id: detected by addresses, autopilots and clocks.

A vehicle may be received on several links, and one address (a router) may forward many vehicles.
Errors are:

- two autopilots, or two boot clocks, under one system id, on any links or addresses;
- one system id from two addresses of one link, even where autopilot and clock agree: packets
  go to the first address only, and two vehicles that were switched on together look the same. A
  redundant path to one vehicle needs a link of its own in the fleet file;
- an autopilot other than the fleet file lists;
- two components that are autopilots, or two answers with different times to one request: two
  vehicles behind one address.

Components that are not autopilots, such as cameras, may have addresses of their own. A heartbeat is
no second vehicle by itself: a network may send copies of packets late, and by other ways. It is one
where it comes again and again, as from the vehicle's own address.
"""

import math
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import common

from swarm.certification.findings import Finding
from swarm.mavlink.autopilots import Autopilot, flying_autopilot
from swarm.mavlink.packets import Packet
from swarm.mavlink.vehicle import Vehicle

Address = Hashable

CLOCKS_APART = 2.0
"""Seconds between two clocks that are different: more than packets are late."""
LASTING = 2.0
"""Seconds for which clocks must differ: after a restart one of two paths shows it first, and
packets that waited in a socket are old. Clocks of simulators drift by seconds, but alike on all
paths."""
BEATS, BEAT_GAP, BEAT_SHARE = 5, 2.5, 0.2
"""Heartbeats in a row that show a vehicle at an address, the most seconds between two of them, and
their share of those that come from the vehicle's own address meanwhile: they were requested four
times as often. Where 2 % of all packets come again, from one other address, copies of heartbeats do
so once in 30,000 heartbeats."""
_WORDS = {"px4": "PX4", "ardupilot": "ArduPilot"}
_HEARTBEAT = int(common.MAVLINK_MSG_ID_HEARTBEAT)
_TIMESYNC = int(common.MAVLINK_MSG_ID_TIMESYNC)
_POSITION = int(common.MAVLINK_MSG_ID_LOCAL_POSITION_NED)


@dataclass
class Place:
    """A link and an address from which a system id is received.

    ``trusted`` says whether packets from there count as the vehicle's. ``autopilots`` are the kinds
    in its heartbeats, ``components`` their senders; ``differs`` has since when its clock differs
    from the vehicle's, by message number, ``apart`` by how much, and when that was last received.
    ``beats`` counts the heartbeats in a row, the last one ``beat_at``; ``before`` those from the
    vehicle's own address before the row. ``speaks``: a vehicle is there, and not only copies.
    """

    link: str
    address: Address | None
    trusted: bool
    autopilots: set[str] = field(default_factory=set)
    components: set[int] = field(default_factory=set)
    differs: dict[int, float] = field(default_factory=dict)
    apart: dict[int, tuple[float, float]] = field(default_factory=dict)
    beats: int = 0
    beat_at: float = -math.inf
    before: int = 0
    speaks: bool = False

    def beat(self, kind: str, now: float, own: int) -> None:
        """Add the heartbeat of an autopilot; ``own`` have come from the vehicle's own address."""
        if not self.speaks and now - self.beat_at > BEAT_GAP:
            self.beats, self.before = 0, own
        self.beats, self.beat_at = self.beats + 1, now
        often = self.beats >= BEAT_SHARE * (own - self.before)
        self.speaks |= self.beats >= BEATS and often
        self.autopilots.add(kind)

    def compare(self, kind: int, ahead: float, now: float) -> None:
        """Add the seconds by which its clock is ahead of the vehicle's; NaN: not known."""
        if not abs(ahead) > CLOCKS_APART:
            self.differs.pop(kind, None)
            return
        self.differs.setdefault(kind, now)
        self.apart[kind] = abs(ahead), now

    @property
    def apart_by(self) -> float:
        """Seconds between its clock and the vehicle's; 0 where they may be the same."""
        lasting = [
            self.apart[kind][0]
            for kind, since in self.differs.items()
            if self.apart[kind][1] - since >= LASTING
        ]
        return max(lasting, default=0.0)

    def __str__(self) -> str:
        kinds = " and ".join(_WORDS[name] for name in sorted(self.autopilots)) or "unknown"
        if self.address is None:
            return f"{kinds} on link {self.link}"
        address = self.address
        where = f"{address[0]}:{address[1]}" if isinstance(address, tuple) else str(address)
        return f"{kinds} at {where} on link {self.link}"


@dataclass
class Identities:
    """The addresses of each system id of a fleet; ``listed``: autopilots in the fleet file."""

    listed: dict[int, Autopilot | None]
    _places: dict[int, dict[tuple[str, Address | None], Place]] = field(default_factory=dict)

    def heartbeat(
        self, way: tuple[str, Address | None], sender: tuple[int, int], autopilot: str, now: float
    ) -> None:
        """Add an autopilot (system, component) that sends a heartbeat from the vehicle's address.

        ``way`` are the link and the address.
        """
        system, component = sender
        place = self._place(system, *way, trusted=True)
        place.beat(autopilot, now, 0)
        place.components.add(component)

    def elsewhere(
        self, vehicle: Vehicle, packet: Packet, link: str, address: Address | None, now: float
    ) -> None:
        """Add a packet of an autopilot with a vehicle's system id from another address."""
        message = packet.message
        if message is None:
            return
        beat = packet.number == _HEARTBEAT
        if beat and (kind := flying_autopilot(packet.component, message)) is not None:
            other = self._place(packet.system, link, address, trusted=False)
            own = [place.beats for place in self._places[packet.system].values() if place.trusted]
            other.beat(kind.name, now, max(own, default=0))
        place = self._places.get(packet.system, {}).get((link, address))
        if place is None:
            return
        if packet.number == _POSITION and vehicle.boot_ms >= 0:
            known = vehicle.boot_ms * 1e-3 + now - vehicle.position_at
            place.compare(_POSITION, message.time_boot_ms * 1e-3 - known, now)
        elif packet.number == _TIMESYNC and message.tc1 == 0:
            known = now + vehicle.latest_clock_offset
            place.compare(_TIMESYNC, message.ts1 * 1e-9 - known, now)

    def moved(self, system: int, link: str, address: Address | None) -> bool:
        """Return whether the vehicle is at this other address of a link, and trust that one.

        From the first address came a single heartbeat, and from this one more since: it was a copy.
        """
        places = self._places.get(system, {})
        place = places.get((link, address))
        first = [one for one in places.values() if one.trusted and one.link == link]
        if place is None or place.beats < 2 or any(one.beats > 1 for one in first):
            return False
        for one in first:
            one.trusted = False
        place.trusted = True
        return True

    def undecided(self, now: float) -> bool:
        """Return whether it will be seen soon if there is a second vehicle."""
        return any(
            not place.trusted and not place.speaks and now - place.beat_at <= BEAT_GAP
            for places in self._places.values()
            for place in places.values()
        )

    def _place(self, system: int, link: str, address: Address | None, *, trusted: bool) -> Place:
        places = self._places.setdefault(system, {})
        if (link, address) not in places:
            places[link, address] = Place(link, address, trusted)
        return places[link, address]

    def findings(self, vehicles: Mapping[int, Vehicle]) -> Iterator[Finding]:
        """Yield an error for every system id that is not one vehicle, or not the listed one."""
        for system, places in sorted(self._places.items()):
            words = self._conflict(vehicles[system], list(places.values()))
            if words:
                yield Finding("error", "fleet", f"system {system} {words}")
        for system, vehicle in sorted(vehicles.items()):
            if vehicle.second_clock:
                words = f"system {system}: one request was answered with two times: two vehicles "
                words += "have this system id behind one address"
                yield Finding("error", "fleet", words)

    def _conflict(self, vehicle: Vehicle, places: list[Place]) -> str:
        """Return the error in the addresses of a system id; "" without one."""
        trusted = [place for place in places if place.trusted]
        kinds = set().union(*(place.autopilots for place in places))
        others = [place for place in places if not place.trusted]
        if len(kinds) == 1:
            others = [place for place in others if place.speaks]
        both = " and ".join(str(place) for place in [*trusted, *others])
        remedy = "give each vehicle a system id of its own"
        if len(kinds) > 1:
            return f"is two vehicles: {both}: {remedy}"
        apart = max((place.apart_by for place in others), default=0.0)
        if apart:
            return f"is two vehicles: {both}, started {apart:.0f} s apart: {remedy}"
        components = sorted(set().union(*(place.components for place in trusted)))
        if len(components) > 1:
            numbers = " and ".join(str(component) for component in components)
            return f"is two autopilots, components {numbers}: {both}: {remedy}"
        listed = self.listed[vehicle.system]
        if listed is not None and kinds - {listed.name}:
            return f"is {both}, and {_WORDS[listed.name]} in the fleet file"
        links = {place.link for place in trusted}
        if any(place.link in links for place in others):
            return (
                f"is received from two addresses: {both}: two vehicles have this system id, or one "
                "is connected twice: a second path to it needs a link of its own in the fleet file"
            )
        return ""
