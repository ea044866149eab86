"""Listening to a fleet without flying: who is there, where they stand, how good the links are."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import common

from swarm.certification.findings import Finding, Severity
from swarm.errors import Refused
from swarm.flight.preparation import (
    Prepared,
    ask_for_origin,
    out_of_offboard,
    prepared_team,
    request_streams,
)
from swarm.flight.readiness import readiness
from swarm.flight.router import Address, Outgoing, Team
from swarm.flight.snapshot import Event
from swarm.mavlink.frames import to_mission
from swarm.mavlink.vehicle import Vehicle
from swarm.mavlink.vehicle_state import VehicleEvent
from swarm.mission.fleet import Fleet

Floats = npt.NDArray[np.float64]

LOSS_TOLERATED = 0.05
SIGNATURE_BYTES = 13
SETPOINT_BYTES = 65
POSITION_BYTES = 40
RADIO_SHARE = 0.5
"""Share of a slow link that setpoints may take; the rest is for positions, commands and repeats."""
FEWEST_SATELLITES = 8
POOREST_ACCURACY = 1.5
"""Metres of level uncertainty that an estimator's satellites may leave."""


@dataclass(frozen=True)
class LinkQuality:
    """What a vehicle's link did while it was listened to and asked at the rate of setpoints.

    ``rate`` packets per second and ``longest_gap`` seconds without any, from the vehicle; ``loss``
    a share by sequence numbers; ``round_trip`` the shortest in seconds (NaN: never answered);
    ``unanswered`` the longest time in seconds without an answer to what was sent ten times a
    second: what a stream of setpoints would have gone through.
    """

    system: int
    rate: float
    longest_gap: float
    loss: float
    round_trip: float
    unanswered: float = 0.0

    def findings(self, stream_loss: float, position_rate: float = 0.0) -> list[Finding]:
        """Return what is to be said of it.

        ``stream_loss`` is what ends a flight, in seconds, ``position_rate`` in Hz what it needs.
        """
        name = f"system {self.system}"
        findings = [
            Finding(
                "info",
                "link",
                f"{name}: {self.rate:.0f} packets/s, longest gap {self.longest_gap:.2f} s, "
                f"longest without an answer {self.unanswered:.2f} s, {self.loss:.1%} lost, "
                f"round trip {1000 * self.round_trip:.0f} ms",
            )
        ]
        for gap, words in (
            (self.longest_gap, "gaps of"),
            (self.unanswered, "what is sent stays unanswered for"),
        ):
            if gap > stream_loss:
                text = f"{name}: {words} {gap:.2f} s, longer than the {stream_loss:g} s after "
                findings.append(Finding("error", "link", text + "which its stream is lost"))
        if self.rate < position_rate:
            text = f"{name}: {self.rate:.1f} packets/s; positions alone need {position_rate:g}"
            findings.append(Finding("error", "link", text))
        if self.loss > LOSS_TOLERATED:
            findings.append(Finding("warning", "link", f"{name}: {self.loss:.1%} of packets lost"))
        return findings


@dataclass
class _Soak:
    since: float
    counts: Mapping[int, tuple[int, int]]
    gap: dict[int, float] = field(default_factory=dict)
    unanswered: dict[int, float] = field(default_factory=dict)


@dataclass
class Listening:
    """A fleet that is heard and spoken to, and never armed. Sans-IO, like the conductor."""

    fleet: Fleet
    over: bool = False
    now: float = 0.0
    _events: list[Event] = field(default_factory=list)
    _asked: set[int] = field(default_factory=set)
    _soak: _Soak | None = None
    _tried: dict[int, str | None] = field(default_factory=dict)
    _modes: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.team = Team(self.fleet, self._report)

    def receive(self, link: str, address: Address | None, data: bytes, now: float) -> bool:
        """Take bytes that arrived on a link from an address; return whether they were read."""
        return self.team.receive(link, address, data, now)

    def tick(self, now: float) -> list[Outgoing]:
        """Let time pass; return what to send."""
        self.now = now
        for system, vehicle in self.team.vehicles.items():
            for event in vehicle.take_events():
                self._judge(system, event)
            if vehicle.heartbeat_at > -math.inf and system not in self._asked:
                self._asked.add(system)
                request_streams(vehicle, self.fleet)
                vehicle.request_interval(common.MAVLINK_MSG_ID_GPS_RAW_INT, 1.0)
            ask_for_origin(vehicle, self.fleet, now)
            if not self._tried:
                out_of_offboard(vehicle)
            if self._soak is not None:
                self._measure(self._soak, system, vehicle)
        return self.team.tick(now)

    # Who is there, and where

    @property
    def missing(self) -> list[int]:
        """System ids that have not been heard."""
        return [s for s, v in self.team.vehicles.items() if v.heartbeat_at == -math.inf]

    @property
    def heard(self) -> list[Vehicle]:
        """The vehicles that have been heard."""
        return [v for v in self.team.vehicles.values() if v.heartbeat_at > -math.inf]

    def not_ready(self) -> list[Finding]:
        """Return what keeps vehicles from being armed; ArduPilot is judged in its own mode."""
        found = readiness(self.heard, self.fleet, self.now)
        return [f for f in found if "not guided" not in f.message]

    def stand(self, standing: Floats) -> Prepared | Finding:
        """Return who stands on which pad (n, 3) of a plan, or why nobody can tell."""
        heard = self.heard
        if len(heard) < len(standing):
            words = f"the plan needs {len(standing)} vehicles, {len(heard)} are heard"
            return Finding("error", "fleet", words)
        lost = [v.system for v in heard if not math.isfinite(v.position[0])]
        if lost:
            words = f"no local position: system {', '.join(map(str, lost))}"
            return Finding("error", "position", words)
        try:
            measured = np.array([v.position for v in heard])
            return prepared_team(heard, self.fleet, standing, measured)
        except Refused as error:
            return Finding("error", "placement", str(error))

    def frames_and_clocks(self) -> list[Finding]:
        """Return each vehicle's position quality, origin and clock, in words."""
        findings: list[Finding] = []
        first = next((v.origin for v in self.heard if v.origin is not None), None)
        for vehicle in self.heard:
            name = f"system {vehicle.system}"
            if self.fleet.frame != "shared":
                findings.append(_position_quality(name, vehicle))
            if first is not None and vehicle.origin is not None:
                east, north, up = to_mission(first, 0.0, vehicle.origin).tolist()
                words = f"{name}: origin {east:+.2f} m east, {north:+.2f} m north, {up:+.2f} m up"
                findings.append(Finding("info", "origin", f"{words} of the first one's"))
            elif self.fleet.frame == "gps":
                words = f"{name}: its estimator's origin is unknown"
                findings.append(Finding("error", "origin", words))
            if math.isfinite(vehicle.clock_offset):
                words = f"{name}: clock {vehicle.clock_offset:+.3f} s from ours, "
                words += f"{500.0 * vehicle.round_trip:.1f} ms away"
                findings.append(Finding("info", "clock", words))
            else:
                words = f"{name}: does not answer TIMESYNC, so its delay is unknown"
                findings.append(Finding("warning", "clock", words))
        return findings

    # Is there a Hold?

    def try_hold(self) -> None:
        """Ask everybody into Hold on the ground; :attr:`holds` tells what came of it."""
        for vehicle in self.heard:
            self._tried[vehicle.system] = None
            self._modes[vehicle.system] = vehicle.custom_mode
            if vehicle.armed:
                self._tried[vehicle.system] = "is armed, so nothing was tried"
            elif vehicle.autopilot is None:
                self._tried[vehicle.system] = "its autopilot is not known"
            else:
                vehicle.set_mode("hold")

    @property
    def holds(self) -> Mapping[int, str] | None:
        """What came of trying Hold by system id, "" where it works; None while it is tried."""
        done = {system: words for system, words in self._tried.items() if words is not None}
        return done if len(done) == len(self._tried) else None

    def _judge(self, system: int, event: VehicleEvent) -> None:
        if event.subject == "mode hold" and self._tried.get(system, "") is None:
            self._tried[system] = "" if event.kind == "done" else event.message
            if event.kind == "done":
                self.team.vehicles[system].set_custom_mode(self._modes[system])

    # The links

    def begin_soak(self) -> None:
        """Measure the links from now on, asking at the rate at which setpoints would be sent."""
        counts = {s: (v.packets, v.lost_packets) for s, v in self.team.vehicles.items()}
        self.team.ask_clocks_every(min(0.1, 1.0 / self.fleet.rates.setpoint))
        self._soak = _Soak(self.now, counts)

    def _measure(self, soak: _Soak, system: int, vehicle: Vehicle) -> None:
        for gaps, last in ((soak.gap, vehicle.received_at), (soak.unanswered, vehicle.timesync_at)):
            gaps[system] = max(gaps.get(system, 0.0), self.now - max(last, soak.since))

    def soak(self) -> list[LinkQuality]:
        """Return what the links did since :meth:`begin_soak`."""
        soak = self._soak
        if soak is None:
            return []
        duration = max(self.now - soak.since, 1e-3)
        found = []
        for system, vehicle in self.team.vehicles.items():
            packets = vehicle.packets - soak.counts[system][0]
            lost = max(vehicle.lost_packets - soak.counts[system][1], 0)
            found.append(
                LinkQuality(
                    system,
                    packets / duration,
                    soak.gap.get(system, 0.0),
                    lost / max(packets + lost, 1),
                    vehicle.round_trip,
                    soak.unanswered.get(system, 0.0),
                )
            )
        return found

    def events(self) -> list[Event]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    def _report(self, kind: str, words: str, system: int | None) -> None:
        self._events.append(Event(self.now, kind, words, system))


def _position_quality(name: str, vehicle: Vehicle) -> Finding:
    if vehicle.fix_type < 0:
        return Finding("warning", "position", f"{name}: says nothing of its satellites")
    accuracy = vehicle.horizontal_accuracy
    words = f"{name}: {vehicle.satellites} satellites"
    words += f", level to {accuracy:.2f} m" if math.isfinite(accuracy) else ""
    if vehicle.fix_type < common.GPS_FIX_TYPE_3D_FIX:
        return Finding("error", "position", f"{words}: no 3D fix")
    poor = vehicle.satellites < FEWEST_SATELLITES or accuracy > POOREST_ACCURACY
    severity: Severity = "warning" if poor else "info"
    return Finding(severity, "position", words)


def radio_findings(fleet: Fleet, flyers: int) -> list[Finding]:
    """Say what fits each link whose capacity is known: serial ports, and what the file says."""
    findings = []
    for name, bits in fleet.capacities.items():
        on_link = sum(listed.links[0] == name for listed in fleet.vehicles)
        vehicles = min(on_link, flyers)
        if vehicles:
            signed = fleet.signing_key is not None
            rates = fleet.rates
            finding = radio_finding(vehicles, rates.setpoint, bits, signed, rates.position)
            findings.append(
                Finding(finding.severity, finding.check, f"link {name}: {finding.message}")
            )
    return findings


def radio_finding(
    vehicles: int, rate: float, bits_per_second: float, signed: bool, positions: float = 0.0
) -> Finding:
    """Say whether setpoints for so many vehicles at a rate in Hz fit one radio.

    ``positions`` in Hz come back from each. Half of the radio is left for everything else.
    """
    signature = SIGNATURE_BYTES if signed else 0
    setpoint, back = 8.0 * (SETPOINT_BYTES + signature), 8.0 * (POSITION_BYTES + signature)
    per_vehicle = setpoint * rate + back * positions
    needed = per_vehicle * vehicles
    share = needed / bits_per_second
    with_positions = f" and positions at {positions:g} Hz" if positions else ""
    many = "s" if vehicles > 1 else ""
    words = (
        f"setpoints for {vehicles} vehicle{many} at {rate:g} Hz{with_positions} need "
        f"{needed / 1000:.1f} kbit/s, {share:.0%} of {bits_per_second / 1000:g} kbit/s"
    )
    if share <= RADIO_SHARE:
        return Finding("info", "radio", words)
    fits = int(RADIO_SHARE * bits_per_second / per_vehicle)
    slower = (RADIO_SHARE * bits_per_second / vehicles - back * positions) / setpoint
    advice = f"at this rate {fits} vehicle{' fits' if fits == 1 else 's fit'}"
    if slower > 0.0:
        advice += f", and {vehicles} at {slower:.1f} Hz"
    return Finding("error", "radio", f"{words}; {advice}")
