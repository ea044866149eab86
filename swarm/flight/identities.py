"""Two vehicles with one system id: told by where they speak from, what they are, and their clocks.

A vehicle may be heard on several links, and one address (a router) may forward many vehicles. What
is an error:

- two autopilots, or two boot clocks, under one system id, on whatever link or address;
- one system id from two addresses of one link, even where autopilot and clock agree: only the first
  address is spoken to, and two vehicles that were switched on together look the same. A redundant
  way to one vehicle needs a link of its own in the fleet file;
- an autopilot other than the fleet file lists;
- a boot clock that goes back again and again: two vehicles behind one address.
"""

import math
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import common

from swarm.mavlink.autopilots import AUTOPILOTS, Autopilot
from swarm.mavlink.packets import Packet
from swarm.mavlink.vehicle import Vehicle
from swarm.preflight.findings import Finding

Address = Hashable

CLOCKS_APART = 2.0
"""Seconds between the starts of two clocks that are not one: more than packets are ever late."""
SET_BACK = 3
"""How often a clock may not go back before take-off: a vehicle may be restarted once or twice."""
_WORDS = {"px4": "PX4", "ardupilot": "ArduPilot"}
_HEARTBEAT = int(common.MAVLINK_MSG_ID_HEARTBEAT)
_TIMESYNC = int(common.MAVLINK_MSG_ID_TIMESYNC)
_POSITION = int(common.MAVLINK_MSG_ID_LOCAL_POSITION_NED)


@dataclass
class Place:
    """A link and an address from which a system id is heard.

    ``spoken_to`` says whether it is taken for the vehicle. ``autopilots`` are the kinds that its
    heartbeats name; ``began`` is when its clock was zero, by the message that told:
    the earliest estimate, since delays only make it later; ``since`` when the first was made.
    """

    link: str
    address: Address | None
    spoken_to: bool
    autopilots: set[str] = field(default_factory=set)
    began: dict[int, float] = field(default_factory=dict)
    since: dict[int, float] = field(default_factory=dict)

    def tell_clock(self, kind: int, clock: float, now: float, restarted: float) -> None:
        """Take what a clock shows; what was told before the vehicle ``restarted`` is forgotten."""
        if self.since.get(kind, -math.inf) <= restarted:
            self.since[kind], self.began[kind] = now, math.inf
        self.began[kind] = min(self.began[kind], now - clock)

    def __str__(self) -> str:
        kinds = " and ".join(_WORDS[name] for name in sorted(self.autopilots)) or "unknown"
        if self.address is None:
            return f"{kinds} on link {self.link}"
        address = self.address
        where = f"{address[0]}:{address[1]}" if isinstance(address, tuple) else str(address)
        return f"{kinds} at {where} on link {self.link}"


@dataclass
class Identities:
    """Where each system id of a fleet is heard from; ``listed``: autopilots by the fleet file."""

    listed: dict[int, Autopilot | None]
    _places: dict[int, dict[tuple[str, Address | None], Place]] = field(default_factory=dict)

    def heartbeat(self, system: int, link: str, address: Address | None, autopilot: int) -> None:
        """Take the autopilot that a heartbeat names, from where the vehicle is spoken to."""
        known = AUTOPILOTS.get(autopilot)
        if known is not None:
            self._place(system, link, address, spoken_to=True).autopilots.add(known.name)

    def elsewhere(
        self, packet: Packet, place: tuple[str, Address | None], now: float, restarted: float
    ) -> None:
        """Take a packet that came from a link and address where its system is not spoken to.

        ``restarted`` is when the vehicle's clock last went back.
        """
        heard = self._place(packet.system, *place, spoken_to=False)
        message = packet.message
        if message is None:
            return
        if packet.number == _HEARTBEAT and message.autopilot in AUTOPILOTS:
            heard.autopilots.add(AUTOPILOTS[message.autopilot].name)
        elif packet.number == _POSITION:
            heard.tell_clock(_POSITION, message.time_boot_ms * 1e-3, now, restarted)
        elif packet.number == _TIMESYNC and message.tc1 == 0:
            heard.tell_clock(_TIMESYNC, message.ts1 * 1e-9, now, restarted)

    def _place(self, system: int, link: str, address: Address | None, *, spoken_to: bool) -> Place:
        places = self._places.setdefault(system, {})
        if (link, address) not in places:
            places[link, address] = Place(link, address, spoken_to)
        return places[link, address]

    def findings(self, vehicles: Mapping[int, Vehicle]) -> Iterator[Finding]:
        """Yield an error for every system id that is not one vehicle, or not the listed one."""
        for system, places in sorted(self._places.items()):
            words = self._conflict(vehicles[system], list(places.values()))
            if words:
                yield Finding("error", "fleet", f"system {system} {words}")
        for system, vehicle in sorted(vehicles.items()):
            if vehicle.set_back >= SET_BACK:
                words = f"system {system}: its clock went back {vehicle.set_back} times: two "
                words += "vehicles have this system id behind one address, or it starts anew again "
                yield Finding("error", "fleet", words + "and again")

    def _conflict(self, vehicle: Vehicle, places: list[Place]) -> str:
        """Return what is wrong with where a system id is heard from, or nothing."""
        spoken_to = [place for place in places if place.spoken_to]
        both = " and ".join(str(place) for place in [*spoken_to, *_others(places)])
        remedy = "give each vehicle a system id of its own"
        kinds = set().union(*(place.autopilots for place in places))
        if len(kinds) > 1:
            return f"is two vehicles: {both}: {remedy}"
        apart = max((_apart(vehicle, place) for place in _others(places)), default=0.0)
        if apart > CLOCKS_APART:
            return f"is two vehicles: {both}, started {apart:.0f} s apart: {remedy}"
        listed = self.listed[vehicle.system]
        if listed is not None and kinds - {listed.name}:
            return f"is {both}, and {_WORDS[listed.name]} in the fleet file"
        links = {place.link for place in spoken_to}
        if any(place.link in links for place in _others(places)):
            return (
                f"is heard from two places: {both}: two vehicles have this system id, or one is "
                "connected twice: a second way to it needs a link of its own in the fleet file"
            )
        return ""


def _others(places: list[Place]) -> list[Place]:
    return [place for place in places if not place.spoken_to]


def _apart(vehicle: Vehicle, place: Place) -> float:
    """Return seconds between the start of a vehicle's clock and of the one at another place.

    Only what the vehicle has said since counts, unless it was restarted meanwhile: after a restart
    one of two ways tells the new clock before the other does.
    """
    told = {_POSITION: (vehicle.position_at - vehicle.boot_ms * 1e-3, vehicle.position_at)}
    if not vehicle.set_back:
        told[_TIMESYNC] = (-vehicle.clock_offset, vehicle.answered_at)
    gaps = [0.0]
    for kind, began in place.began.items():
        known, at = told.get(kind, (math.nan, math.nan))
        if vehicle.set_back_at < place.since[kind] <= at and math.isfinite(known):
            gaps.append(abs(known - began))
    return max(gaps)
