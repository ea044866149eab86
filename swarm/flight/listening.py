"""Listening to a fleet without flying: who is there, where they stand, how good the links are."""

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from swarm.fleet import Fleet
from swarm.flight.preparation import request_streams
from swarm.flight.snapshot import Event
from swarm.flight.team import Address, Outgoing, Team
from swarm.preflight.findings import Finding

Floats = npt.NDArray[np.float64]

LOSS_TOLERATED = 0.05
SIGNING_ROOM = 13
SETPOINT_BYTES = 65


@dataclass(frozen=True)
class LinkQuality:
    """What a vehicle's link did while it was listened to.

    ``rate`` packets per second, ``longest_gap`` seconds without any, ``loss`` a share by sequence
    numbers, ``round_trip`` the shortest in seconds (NaN: never answered).
    """

    system: int
    rate: float
    longest_gap: float
    loss: float
    round_trip: float

    def findings(self, stream_loss: float) -> list[Finding]:
        """Return what is to be said of it, ``stream_loss`` being what ends a flight, in seconds."""
        name = f"system {self.system}"
        findings = [
            Finding(
                "info",
                "link",
                f"{name}: {self.rate:.0f} packets/s, longest gap {self.longest_gap:.2f} s, "
                f"{self.loss:.1%} lost, round trip {1000 * self.round_trip:.0f} ms",
            )
        ]
        if self.longest_gap > stream_loss:
            words = f"gaps of {self.longest_gap:.2f} s are longer than the {stream_loss:g} s "
            findings.append(
                Finding("error", "link", f"{name}: {words}after which its stream is lost")
            )
        if self.loss > LOSS_TOLERATED:
            findings.append(Finding("warning", "link", f"{name}: {self.loss:.1%} of packets lost"))
        return findings


@dataclass
class Listening:
    """A fleet that is heard and spoken to, and never armed. Sans-IO, like the conductor."""

    fleet: Fleet
    over: bool = False
    _events: list[Event] = field(default_factory=list)
    _asked: set[int] = field(default_factory=set)
    _last: dict[int, float] = field(default_factory=dict)
    _gap: dict[int, float] = field(default_factory=dict)
    _began: tuple[float, dict[int, tuple[int, int]]] | None = None
    now: float = 0.0

    def __post_init__(self) -> None:
        self.team = Team(self.fleet, self._report)

    def receive(self, link: str, address: Address | None, data: bytes, now: float) -> None:
        """Take bytes that arrived on a link from an address."""
        self.team.receive(link, address, data, now)

    def tick(self, now: float) -> list[Outgoing]:
        """Let time pass; return what to send."""
        self.now = now
        for system, vehicle in self.team.vehicles.items():
            vehicle.take_events()
            if vehicle.heard_at > -math.inf and system not in self._asked:
                self._asked.add(system)
                request_streams(vehicle, self.fleet)
            if self._began is not None:
                gap = now - max(vehicle.heard_at, self._began[0])
                self._gap[system] = max(self._gap.get(system, 0.0), gap)
        return self.team.tick(now)

    @property
    def missing(self) -> list[int]:
        """System ids that have not been heard."""
        return [s for s, v in self.team.vehicles.items() if v.heartbeat_at == -math.inf]

    def begin_soak(self) -> None:
        """Measure the links from now on."""
        counts = {s: (v.packets, v.lost_packets) for s, v in self.team.vehicles.items()}
        self._began = self.now, counts
        self._gap.clear()

    def soak(self) -> list[LinkQuality]:
        """Return what the links did since :meth:`begin_soak`."""
        if self._began is None:
            return []
        since, counts = self._began
        duration = max(self.now - since, 1e-3)
        found = []
        for system, vehicle in self.team.vehicles.items():
            packets, lost = (
                vehicle.packets - counts[system][0],
                vehicle.lost_packets - counts[system][1],
            )
            found.append(
                LinkQuality(
                    system,
                    packets / duration,
                    self._gap.get(system, 0.0),
                    lost / max(packets + lost, 1),
                    vehicle.round_trip,
                )
            )
        return found

    def events(self) -> list[Event]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    def _report(self, kind: str, words: str, system: int | None) -> None:
        self._events.append(Event(self.now, kind, words, system))


def radio_finding(vehicles: int, rate: float, bits_per_second: float, signed: bool) -> Finding:
    """Say whether setpoints for so many vehicles at a rate in Hz fit one radio.

    Half of the radio is left for what comes back.
    """
    size = SETPOINT_BYTES + (SIGNING_ROOM if signed else 0)
    needed = 8.0 * size * vehicles * rate
    share = needed / bits_per_second
    words = (
        f"setpoints for {vehicles} vehicles at {rate:g} Hz need {needed / 1000:.1f} kbit/s, "
        f"{share:.0%} of {bits_per_second / 1000:g} kbit/s"
    )
    fits = int(0.5 * bits_per_second / (8.0 * size * rate))
    if share <= 0.5:
        return Finding("info", "radio", words)
    return Finding("error", "radio", f"{words}; at this rate {fits} vehicles fit")
