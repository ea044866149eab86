"""Assigns received packets to vehicles, and vehicles to links. Sans-IO.

Only vehicles of the fleet file count, each at the address from which its autopilot was first
received.

Two vehicles with one system id are detected by addresses, autopilots and clocks. A vehicle may be
received on several links, and one address (a router) may forward many vehicles. Errors are:

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
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import common

from swarm.certification.findings import Finding
from swarm.mavlink.autopilots import AUTOPILOTS, Autopilot, flying_autopilot
from swarm.mavlink.packets import (
    CRC_EXTRAS,
    GROUND_COMPONENT,
    GROUND_SYSTEM,
    Decoder,
    Encoder,
    Message,
    Packet,
    sender,
    unpack,
)
from swarm.mavlink.setpoints import SetpointPacker
from swarm.mavlink.signing import Signing
from swarm.mavlink.telemetry_table import ASKED_AT, TelemetryTable, packet_rows, read_datagrams
from swarm.mavlink.vehicle import HANDLED_MESSAGES, Vehicle
from swarm.mission.fleet import Fleet, Limits

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
        first = [other for other in places.values() if other.trusted and other.link == link]
        if place is None or place.beats < 2 or any(other.beats > 1 for other in first):
            return False
        for other in first:
            other.trusted = False
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


Floats = npt.NDArray[np.float64]

HEARTBEAT_INTERVAL = 0.2
"""Seconds. A link that loses 20 % must not pass for a dead ground station: ArduPilot counts
heartbeats only, for T less 4 s (4 s at least). At MAVLink's usual one a second, four in a row are
lost once in 600 times, at this rate twenty once in 10¹⁴."""
TIMESYNC_INTERVAL = 0.2
"""Seconds between requests for each clock, at most a third of the fleet's limits.silence: an answer
shows that setpoints reach the vehicle. One that has not answered by then is asked at every tick:
where a link loses 20 % each way, ten requests without an answer are one in 27,000."""
_CLOCKS_AT_ONCE = 10
"""Clock requests in one tick, if there is time for more: a hundred at once would delay setpoints
too much."""
_ROUNDING = 1e-6
"""Seconds: an interval of one tick must not become one of two now and then."""
_ROUTES_PER_VEHICLE = 4
"""Addresses that are remembered for each vehicle: two links, and both after a restart."""
_MOST_UNKNOWN = 60
"""Datagrams that are read between two heartbeats from an address without a vehicle."""
# A ground station, of no autopilot, active; MAVLink version 3 as in its definition.
_OWN_HEARTBEAT = common.MAVLink_heartbeat_message(
    common.MAV_TYPE_GCS, common.MAV_AUTOPILOT_INVALID, 0, 0, common.MAV_STATE_ACTIVE, 3
)


def timesync_interval(limits: Limits) -> float:
    """Return the seconds between requests for the clock of each vehicle in flight."""
    return min(TIMESYNC_INTERVAL, limits.silence / 3.0)


def answer_limit(limits: Limits) -> float:
    """Return the seconds after a request by which a vehicle that receives has answered.

    The last setpoint that it received may be older by the interval: ``limits.silence`` in all.
    """
    return limits.silence - timesync_interval(limits)


class Outgoing(NamedTuple):
    """Bytes to send: link, address (None: the link's only other end), data."""

    link: str
    address: Address | None
    data: bytes


_outgoing: Callable[[tuple[Any, ...]], Outgoing] = partial(tuple.__new__, Outgoing)


@dataclass
class Route:
    """One remote address on one link, with its own sequence numbers and its vehicles.

    ``alone`` is the only vehicle there, where datagrams hold whole packets.
    """

    link: str
    address: Address | None
    encoder: Encoder = field(default_factory=Encoder)
    decoder: Decoder = field(default_factory=Decoder)
    speakers: dict[int, Vehicle] = field(default_factory=dict)
    unknown: int = 0
    alone: Vehicle | None = None

    def note_alone(self) -> None:
        """Note whether one vehicle is there, after a change of ``speakers``."""
        only = list(self.speakers.values())
        self.alone = only[0] if len(only) == 1 and not self.decoder.stream else None


class Team:
    """Vehicles and the routes to them."""

    def __init__(self, fleet: Fleet, report: Callable[[str, str, int | None], None]) -> None:
        """``report`` is called with kind, message and system id of events on the links."""
        named: dict[str, Autopilot] = {kind.name: kind for kind in AUTOPILOTS.values()}
        self.telemetry = TelemetryTable(len(fleet.vehicles), len(fleet.links))
        self.vehicles: Mapping[int, Vehicle] = {
            listed.sysid: Vehicle(listed.sysid, named.get(listed.autopilot), self.telemetry, row)
            for row, listed in enumerate(fleet.vehicles)
        }
        self._identities = Identities(
            {listed.sysid: named.get(listed.autopilot) for listed in fleet.vehicles}
        )
        self._allowed = {listed.sysid: listed.links for listed in fleet.vehicles}
        self._streams = {
            name for name, url in fleet.links.items() if not url.startswith(("udpin", "udpout"))
        }
        self._routes: dict[tuple[str, Address | None], Route] = {}
        self._ways: dict[int, dict[str, Route]] = {sysid: {} for sysid in self.vehicles}
        self._best: dict[int, Route | None] = dict.fromkeys(self.vehicles)
        self._most_routes = _ROUTES_PER_VEHICLE * len(self.vehicles) + 16
        self._report = report
        self._noticed: set[tuple[Any, ...]] = set()
        self._strangers: set[int] = set()
        self._stations: set[int] = set()
        self._next_heartbeat = 0.0
        self._next_timesync = self._ticked = 0.0
        self._timesync_interval = timesync_interval(fleet.limits)
        self._clocks_to_ask: list[int] = []
        self._packer: SetpointPacker | None = None
        self._packed: tuple[int, ...] = ()
        self.rejected = 0
        self.signing: Signing | None = None
        self._link_number = {name: number for number, name in enumerate(fleet.links)}
        for name, url in fleet.links.items():
            if not url.startswith("udpin"):
                self._route(name, None)

    def report_to(self, report: Callable[[str, str, int | None], None]) -> None:
        """Call another function with the events on the links."""
        self._report = report

    def receive(self, link: str, address: Address | None, data: bytes, now: float) -> bool:
        """Take bytes that arrived on a link; return whether they were read.

        An address without a vehicle is read a bounded number of times a second.
        """
        route = self._routes.get((link, address)) or self._route(link, address)
        if route is None:
            self.rejected += 1
            return False
        if not route.speakers and route.address is not None:
            route.unknown += 1
            if route.unknown > _MOST_UNKNOWN:
                self.rejected += 1
                return False
        signing = self.signing
        before = signing.dropped.total() if signing else 0
        number = self._link_number[link]
        for packet in route.decoder.feed(data, signing):
            vehicle = route.speakers.get(packet[1]) or self._sender(route, packet, now)
            if vehicle is not None:
                vehicle.receive(packet, now, number)
                if packet[0] == _HEARTBEAT:
                    self._beat((link, address), packet, now)
        if signing is not None and signing.dropped.total() > before:
            self.rejected += signing.dropped.total() - before
            kinds = ", ".join(sorted(signing.dropped))
            words = f"packets on link {link} that are not signed as they must be ({kinds}): dropped"
            self._once(("signature", link, kinds), "security", words, None)
        return True

    def receive_all(
        self, link: str, arrived: Sequence[tuple[Address | None, bytes]], now: float
    ) -> None:
        """As :meth:`receive`, of bytes from any number of addresses at once, and quicker."""
        if not self._take(link, arrived, now):
            for address, data in arrived:
                self.receive(link, address, data, now)

    def _take(self, link: str, arrived: Sequence[tuple[Address | None, bytes]], now: float) -> bool:
        """Read the most frequent messages all at once, and then the other packets.

        False, and none is read, where there are other than plain packets from vehicles' own
        addresses.
        """
        speakers: list[Vehicle] = []
        origins: list[int] = []
        routes = self._routes
        for address, data in arrived:
            route = routes.get((link, address))
            if route is None or route.alone is None or self.signing is not None:
                return False
            vehicle = route.alone
            speakers.append(vehicle)
            origins += (len(data), vehicle.row, vehicle.system)
        if not arrived:
            return True
        together = b"".join([data for _, data in arrived])
        rows = packet_rows(together)
        count = read_datagrams(
            together, np.array(origins).reshape(-1, 3), CRC_EXTRAS, (self._link_number[link], now),
            self.telemetry.arrays, rows,
        )  # fmt: skip
        for which, number, component, start, end, order in rows[: max(count, 0)].tolist():
            message = unpack(number, together[start:end]) if number in HANDLED_MESSAGES else None
            speakers[which].read(number, component, message, now, order)
            if number == _HEARTBEAT:
                packet = Packet(number, speakers[which].system, component, 0, message)
                self._beat((link, arrived[which][0]), packet, now)
        return count >= 0

    def trusts(self, link: str, address: Address | None, packet: bytes) -> bool:
        """Return whether a packet is from its vehicle's address, and signed if it must be."""
        system = sender(packet)[0]
        way = self._ways.get(system, {}).get(link)
        from_vehicle = way is not None and way.address == address
        return from_vehicle and (self.signing is None or self.signing.is_genuine(packet))

    def sealed(self, link: str, packet: bytes) -> bytes:
        """Return a packet as it goes out on a link: signed where there is a key."""
        if self.signing is None:
            return packet
        return self.signing.sign(packet, self._link_number[link])

    def _route(self, link: str, address: Address | None) -> Route | None:
        key = (link, address)
        route = self._routes.get(key)
        if route is None and len(self._routes) < self._most_routes:
            route = Route(
                link,
                address,
                decoder=Decoder(link in self._streams, HANDLED_MESSAGES, include_unknown=True),
            )
            self._routes[key] = route
        return route

    def _beat(self, way: tuple[str, Address | None], packet: Packet, now: float) -> None:
        """Note the sender of a heartbeat from a vehicle's address."""
        system, component = packet.system, packet.component
        kind = flying_autopilot(component, packet.message)
        if kind is not None:
            self._identities.heartbeat(way, (system, component), kind.name, now)
        elif component != self.vehicles[system].component:
            self._aboard(system, way[0], component)

    def _sender(self, route: Route, packet: Packet, now: float) -> Vehicle | None:
        """Return the vehicle of a message, if this is its address.

        That is the address of its autopilot: a camera on board may have one of its own.
        """
        sysid = packet.system
        vehicle = self.vehicles.get(sysid)
        if vehicle is None:
            self._stranger(route, packet)
            return None
        ways = self._ways[sysid]
        known = ways.get(route.link)
        beat = packet.number == _HEARTBEAT and packet.message is not None
        kind = flying_autopilot(packet.component, packet.message) if beat else None
        if kind is None and packet.component != vehicle.component:
            if beat:
                self._aboard(sysid, route.link, packet.component)
            return None
        if known is not None or route.link not in self._allowed[sysid]:
            self.rejected += 1
            self._identities.elsewhere(vehicle, packet, route.link, route.address, now)
            self._once(
                ("address" if known else "link", sysid, route.link),
                "security",
                f"packets of system {sysid} on link {route.link} from another address: dropped",
                sysid,
            )
            if not known or not self._identities.moved(sysid, route.link, route.address):
                return None
            del known.speakers[sysid]
            known.note_alone()
        elif kind is None:
            return None
        ways[route.link] = route
        route.speakers[sysid] = vehicle
        route.note_alone()
        self._best[sysid] = next(ways[link] for link in self._allowed[sysid] if link in ways)
        return vehicle

    def _aboard(self, system: int, link: str, component: int) -> None:
        """Report a sender with a vehicle's system id that is not its autopilot."""
        words = f"component {component} on link {link} is neither a PX4 nor an ArduPilot of a "
        self._once(("aboard", system, component), "aboard", words + "rotorcraft: ignored", system)

    def _stranger(self, route: Route, packet: Packet) -> None:
        self.rejected += 1
        message, sysid = packet.message, packet.system
        if packet.number != _HEARTBEAT or message is None:
            return
        self._strangers.add(sysid)
        if message.type == common.MAV_TYPE_GCS:
            self._stations.add(sysid)
        if message.type == common.MAV_TYPE_GCS:
            words = f"another ground station (system {sysid}) on link {route.link}: its heartbeats "
            words += "defeat the vehicles' link-loss failsafe"
        else:
            words = f"system {sysid} on link {route.link} is not in the fleet file: ignored"
        self._once(("stranger", sysid, route.link), "security", words, None)

    def _once(self, key: tuple[Any, ...], kind: str, words: str, sysid: int | None) -> None:
        if key not in self._noticed and len(self._noticed) < 1000:
            self._noticed.add(key)
            self._report(kind, words, sysid)

    @property
    def strangers(self) -> list[int]:
        """System ids of vehicles that were received and are not in the fleet file."""
        return sorted(self._strangers - self._stations)

    @property
    def stations(self) -> list[int]:
        """System ids of other ground stations."""
        return sorted(self._stations)

    def conflicts(self) -> list[Finding]:
        """Return an error for each system id that is not one vehicle, or not the listed one."""
        return list(self._identities.findings(self.vehicles))

    def undecided(self, now: float) -> bool:
        """Return whether it will be seen soon if two vehicles have one system id."""
        return self._identities.undecided(now)

    def findings(self) -> list[Finding]:
        """Return the unexpected systems on the links, for the decision before a flight."""
        return [
            *(
                Finding("error", "fleet", f"system {s} is received and not in the fleet file")
                for s in self.strangers
            ),
            *self.conflicts(),
            *(
                Finding("warning", "fleet", f"another ground station (system {s}) is received: its "
                        "heartbeats defeat the vehicles' link-loss failsafe")
                for s in self.stations
            ),
        ]  # fmt: skip

    def set_timesync_interval(self, seconds: float) -> None:
        """Send clock requests at another interval, from the next tick on."""
        self._timesync_interval, self._next_timesync = seconds, 0.0

    def way_to(self, sysid: int) -> Route | None:
        """Return the route to a vehicle: its preferred link on which it was received."""
        return self._best[sysid]

    def tick(self, now: float) -> list[Outgoing]:
        """Return heartbeats, commands and clock requests that are due."""
        outgoing: list[Outgoing] = []
        passed, self._ticked = now - self._ticked, now
        if self.signing is not None:
            self.signing.advance(now)
        if now > self._next_heartbeat - _ROUNDING:
            self._next_heartbeat = now + HEARTBEAT_INTERVAL
            self.read_unknown_again()
            outgoing.extend(self._heartbeats())
        outgoing.extend(self._clock_requests(now, passed))
        for sysid, vehicle in self.vehicles.items():
            if vehicle.busy:
                self._send(outgoing, sysid, vehicle.tick(now))
        return outgoing

    def pause(self, since: float, seconds: float) -> None:
        """Count no silence of vehicles for seconds after ``since`` in which nothing was read."""
        for vehicle in self.vehicles.values():
            if vehicle.received_at <= since:
                vehicle.received_at += seconds
            if vehicle.asked_at <= since:
                vehicle.asked_at += seconds

    def read_unknown_again(self) -> None:
        """Read addresses without a vehicle again, as often as before."""
        for route in self._routes.values():
            route.unknown = 0

    def routes(self) -> list[Route]:
        """Return the routes to the vehicles, and those that have one other end only."""
        spoken_to = {id(route) for ways in self._ways.values() for route in ways.values()}
        return [r for r in self._routes.values() if r.address is None or id(r) in spoken_to]

    def _heartbeats(self) -> Iterable[Outgoing]:
        for route in self.routes():
            data = self.sealed(route.link, route.encoder.encode(_OWN_HEARTBEAT))
            yield Outgoing(route.link, route.address, data)

    def _clock_requests(self, now: float, passed: float) -> Iterable[Outgoing]:
        """Yield clock requests to a few vehicles; ``passed`` seconds since the last tick."""
        if now > self._next_timesync - _ROUNDING and not self._clocks_to_ask:
            self._next_timesync = now + self._timesync_interval
            self._clocks_to_ask = list(self.vehicles)
        late = now - self.telemetry.values[:, ASKED_AT] > self._timesync_interval - _ROUNDING
        if late.any():
            systems = list(self.vehicles)
            again = [systems[row] for row in np.flatnonzero(late).tolist()]
            self._clocks_to_ask = list(dict.fromkeys([*self._clocks_to_ask, *again]))
        share = math.ceil(len(self.vehicles) * passed / self._timesync_interval)
        if not self._clocks_to_ask:
            return []
        asked = self._clocks_to_ask[: max(_CLOCKS_AT_ONCE, share)]
        del self._clocks_to_ask[: len(asked)]
        # zero would read as "not a request of ours", so the clock starts at one
        request = common.MAVLink_timesync_message(0, int(now * 1e9) + 1)
        outgoing: list[Outgoing] = []
        for sysid in asked:
            self._send(outgoing, sysid, [request])
            self.vehicles[sysid].note_clock_request(now)
        return outgoing

    def _send(self, outgoing: list[Outgoing], sysid: int, messages: Iterable[Message]) -> None:
        route = self.way_to(sysid)
        if route is not None:
            for message in messages:
                data = self.sealed(route.link, route.encoder.encode(message))
                outgoing.append(Outgoing(route.link, route.address, data))

    def setpoints(
        self,
        systems: tuple[int, ...],
        streaming: npt.NDArray[np.bool_],
        now: float,
        states: Floats,
        yaw: Floats,
    ) -> list[Outgoing]:
        """Return setpoint packets for the vehicles that are streamed to.

        ``states`` (n, 3, 3) are position, velocity and acceleration of each of ``systems``, in the
        vehicle's own NED, SI units; ``yaw`` (n,) in radians.
        """
        best = self._best
        routes = [
            best[sysid] if wanted else None
            for sysid, wanted in zip(systems, streaming.tolist(), strict=True)
        ]
        if self._packer is None or self._packed != systems:
            components = [self.vehicles[sysid].component for sysid in systems]
            source = (GROUND_SYSTEM, GROUND_COMPONENT)
            signed = self.signing is not None
            self._packer = SetpointPacker(systems, components, source, signed=signed)
            self._packed = systems
        sequences = [route.encoder.next_sequence() if route else 0 for route in routes]
        packets = self._packer.pack(sequences, int(now * 1000), states, yaw)
        raw, length = packets.tobytes(), packets.shape[1]
        outgoing = [
            _outgoing((route.link, route.address, raw[k * length : (k + 1) * length]))
            for k, route in enumerate(routes)
            if route is not None
        ]
        signing, numbers = self.signing, self._link_number
        if signing is None:
            return outgoing
        return [
            Outgoing(
                packet.link,
                packet.address,
                signing.append_signature(packet.data, numbers[packet.link]),
            )
            for packet in outgoing
        ]
