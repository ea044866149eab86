"""A fleet received on the ground, without flying: vehicles, places, origins, clocks, links."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import common

from swarm.certification.findings import Finding, Severity
from swarm.errors import Refused
from swarm.flight.preparation import (
    FIXES,
    Prepared,
    Standstill,
    leave_offboard,
    prepared_team,
    problems_of,
    readiness,
    request_origin,
    request_streams,
)
from swarm.flight.router import Address, Outgoing, Team
from swarm.flight.snapshot import Event, Snapshot
from swarm.flight.stages import CheckStep
from swarm.mavlink.frames import to_mission
from swarm.mavlink.signing import SIGNATURE_LENGTH
from swarm.mavlink.vehicle import Vehicle, VehicleEvent
from swarm.mission.fleet import Fleet

Floats = npt.NDArray[np.float64]

LOSS_TOLERATED = 0.05
"""Share of lost packets without a warning: one setpoint in twenty; long gaps are a check of their
own."""
SETPOINT_BYTES, POSITION_BYTES = 65, 40
"""Bytes of unsigned packets: SET_POSITION_TARGET_LOCAL_NED has 53, LOCAL_POSITION_NED 28, and the
frame of MAVLink 2 adds 12."""
RADIO_SHARE = 0.5
"""Share of a slow link for setpoints; the rest is for positions, commands and repetitions."""
FEWEST_SATELLITES = 8
"""Satellites without a warning; the filters of PX4 and ArduPilot require 6."""
POOREST_ACCURACY = 1.5
"""Largest horizontal GPS accuracy in metres without a warning."""


@dataclass(frozen=True)
class LinkQuality:
    """The quality of a vehicle's link, with requests at the rate of setpoints.

    ``rate`` packets per second and ``longest_gap`` seconds without any, from the vehicle; ``loss``
    a share by sequence numbers; ``round_trip`` the shortest in seconds (NaN: no answer);
    ``unanswered`` the longest time in seconds without an answer to requests ten times a second: the
    gap in a stream of setpoints.
    """

    system: int
    rate: float
    longest_gap: float
    loss: float
    round_trip: float
    unanswered: float = 0.0

    def findings(self, stream_loss: float, position_rate: float = 0.0) -> list[Finding]:
        """Return the findings on the link.

        ``stream_loss`` is the gap in seconds that ends a stream, ``position_rate`` the required
        rate of positions in Hz.
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
            (self.unanswered, "requests stay unanswered for"),
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
class _Measurement:
    since: float
    counts: Mapping[int, tuple[int, int]]
    gap: dict[int, float] = field(default_factory=dict)
    unanswered: dict[int, float] = field(default_factory=dict)


@dataclass
class FleetListener:
    """Receives a fleet and sends requests, without arming. Sans-IO, like the conductor.

    ``tracking`` is that of :class:`.Standstill`: in metres where corrections are sent.
    """

    fleet: Fleet
    tracking: float | None = None
    over: bool = False
    now: float = 0.0
    _events: list[Event] = field(default_factory=list)
    _asked: set[int] = field(default_factory=set)
    _measurement: _Measurement | None = None
    _tried: dict[int, str | None] = field(default_factory=dict)
    _modes: dict[int, int] = field(default_factory=dict)
    _prepared: Prepared | None = None

    def __post_init__(self) -> None:
        self.team = Team(self.fleet, self._report)
        self._standstill = Standstill(self.fleet, self.tracking)

    def receive(self, link: str, address: Address | None, data: bytes, now: float) -> bool:
        """Take bytes that arrived on a link from an address; return whether they were read."""
        return self.team.receive(link, address, data, now)

    def tick(self, now: float, _real: float | None = None) -> list[Outgoing]:
        """Let time pass; return the packets to send."""
        self.now = now
        for system, vehicle in self.team.vehicles.items():
            for event in vehicle.take_events():
                self._judge(system, event)
            if vehicle.heartbeat_at > -math.inf and system not in self._asked:
                self._asked.add(system)
                request_streams(vehicle, self.fleet)
                vehicle.request_interval(common.MAVLINK_MSG_ID_GPS_RAW_INT, 1.0)
            request_origin(vehicle, self.fleet, now)
            if not self._tried:
                leave_offboard(vehicle)
            if self._measurement is not None:
                self._measure(self._measurement, system, vehicle)
        return self.team.tick(now)

    # Vehicles and their places

    @property
    def missing(self) -> list[int]:
        """System ids without a heartbeat."""
        return [s for s, v in self.team.vehicles.items() if v.heartbeat_at == -math.inf]

    @property
    def received(self) -> list[Vehicle]:
        """The vehicles with a heartbeat."""
        return [v for v in self.team.vehicles.values() if v.heartbeat_at > -math.inf]

    def not_ready(self) -> list[Finding]:
        """Return the errors that prevent arming; ArduPilot's mode does not count."""
        findings = readiness(self.received, self.fleet, self.now)
        return [f for f in findings if "not guided" not in f.message]

    def waits_for(self) -> list[Finding]:
        """Return what a flight would wait for before it takes off, as it is now.

        Call it several times a second: vehicles must stand for a while.
        """
        return self._standstill.problems(self.received, self.not_ready(), self.now)

    def at_rest(self) -> bool:
        """Whether :meth:`waits_for` has had nothing for long enough."""
        return not self.waits_for() and self._standstill.long_enough(self.now)

    def placement(self, standing: Floats) -> Prepared | Finding:
        """Return the vehicles on the pads (n, 3) of a plan, or why they cannot be assigned."""
        heard = self.received
        if len(heard) < len(standing):
            words = f"the plan needs {len(standing)} vehicles, {len(heard)} are received"
            return Finding("error", "fleet", words)
        lost = [v.system for v in heard if not math.isfinite(v.position[0])]
        if lost:
            words = f"no local position: system {', '.join(map(str, lost))}"
            return Finding("error", "position", words)
        try:
            rested = self._standstill.long_enough(self.now)
            latest = np.array([v.position for v in heard])
            measured = self._standstill.places if rested else latest
            self._prepared = prepared_team(heard, self.fleet, standing, measured)
            return self._prepared
        except Refused as error:
            return Finding("error", "placement", str(error))

    def snapshot(
        self,
        step: CheckStep,
        done: float,
        doing: str,
        states: Mapping[int, str],
        moving: int | None,
        wrong: Mapping[int, str],
        available: Mapping[str, tuple[bool, str]],
    ) -> Snapshot:
        """Return all vehicles of the fleet in its order, on the ground, in a step of a check.

        ``done`` are steps that are done, in words it is ``doing`` the present one. ``states`` and
        what is ``wrong`` are by system id; the one that is ``moving`` is to be moved by hand.
        """
        vehicles, now = list(self.team.vehicles.values()), self.now
        unknown = np.full((len(vehicles), 3), np.nan)
        problems = [
            [text for check, text in problems_of(v, self.fleet, now) if check != "mode"]
            + [wrong[system] for system in (v.system,) if system in wrong]
            for v in vehicles
        ]
        return Snapshot(
            time=now,
            mission_time=done,
            rate=0.0,
            phase=step,
            waiting_for=doing or None,
            position=self._places(vehicles, unknown),
            velocity=unknown,
            setpoint=unknown,
            modes=tuple(vehicle.mode for vehicle in vehicles),
            states=tuple(
                states.get(v.system, "not ready" if reasons else "ready")
                for v, reasons in zip(vehicles, problems, strict=True)
            ),
            armed=tuple(vehicle.armed for vehicle in vehicles),
            gripped=tuple(vehicle.gripped for vehicle in vehicles),
            battery=np.array([vehicle.battery for vehicle in vehicles]),
            link_age=np.array([max(now - vehicle.received_at, 0.0) for vehicle in vehicles]),
            available=available,
            round_trip=np.array([vehicle.latest_round_trip for vehicle in vehicles]),
            received=np.array([float(vehicle.packets) for vehicle in vehicles]),
            lost=np.array([float(vehicle.lost_packets) for vehicle in vehicles]),
            problems=tuple("; ".join(reasons) for reasons in problems),
            missing=(moving,) if moving is not None else (),
            voltage=np.array([vehicle.voltage for vehicle in vehicles]),
            fix=np.array([float(vehicle.fix_type) for vehicle in vehicles]),
            satellites=np.array([float(vehicle.satellites) for vehicle in vehicles]),
            position_age=np.array([max(now - v.position_at, 0.0) for v in vehicles]),
            numbers=tuple(vehicle.system for vehicle in vehicles),
        )

    def _places(self, vehicles: Sequence[Vehicle], unknown: Floats) -> Floats:
        """Return where vehicles stand (n, 3), mission ENU; NaN where that is not known yet."""
        prepared, places = self._prepared, unknown.copy()
        if prepared is not None:
            measured = np.array([vehicle.position for vehicle in prepared.flyers])
            rows = [vehicles.index(vehicle) for vehicle in prepared.flyers]
            places[rows] = prepared.frames.points_to_mission(measured)
        return places

    def frames_and_clocks(self, tracking: float = math.inf) -> list[Finding]:
        """Return findings on each vehicle's position, origin and clock.

        ``tracking`` is the largest tracking error in metres that the plan allows.
        """
        findings: list[Finding] = []
        first = next((v.origin for v in self.received if v.origin is not None), None)
        for vehicle in self.received:
            name = f"system {vehicle.system}"
            if self.fleet.frame != "shared":
                findings.append(position_quality(name, vehicle, self.fleet, tracking))
            if first is not None and vehicle.origin is not None:
                east, north, up = to_mission(first, 0.0, vehicle.origin).tolist()
                words = f"{name}: origin {east:+.2f} m east, {north:+.2f} m north, {up:+.2f} m up"
                findings.append(Finding("info", "origin", f"{words} of the first vehicle's"))
            elif self.fleet.frame == "gps":
                words = f"{name}: its estimator's origin is unknown"
                findings.append(Finding("error", "origin", words))
            if math.isfinite(vehicle.clock_offset):
                words = f"{name}: clock {vehicle.clock_offset:+.3f} s from the ground station, "
                words += f"{500.0 * vehicle.round_trip:.1f} ms away"
                findings.append(Finding("info", "clock", words))
            else:
                words = f"{name}: does not answer TIMESYNC, so its delay is unknown"
                findings.append(Finding("warning", "clock", words))
        return findings

    # Hold

    def try_hold(self) -> None:
        """Command Hold to all vehicles on the ground; :attr:`hold_results` has the results."""
        for vehicle in self.received:
            self._tried[vehicle.system] = None
            self._modes[vehicle.system] = vehicle.custom_mode
            if vehicle.armed:
                self._tried[vehicle.system] = "is armed, so Hold was not tried"
            elif vehicle.autopilot is None:
                self._tried[vehicle.system] = "its autopilot is not known"
            else:
                vehicle.set_mode("hold")

    @property
    def hold_results(self) -> Mapping[int, str] | None:
        """The error of Hold by system id, "" where it works; None before all have answered."""
        done = {system: words for system, words in self._tried.items() if words is not None}
        return done if len(done) == len(self._tried) else None

    def _judge(self, system: int, event: VehicleEvent) -> None:
        if event.subject == "mode hold" and self._tried.get(system, "") is None:
            self._tried[system] = "" if event.kind == "done" else event.message
            if event.kind == "done":
                self.team.vehicles[system].set_custom_mode(self._modes[system])

    # The links

    def begin_link_measurement(self) -> None:
        """Measure the links from now on, with requests at the rate of setpoints."""
        counts = {s: (v.packets, v.lost_packets) for s, v in self.team.vehicles.items()}
        self.team.set_timesync_interval(min(0.1, 1.0 / self.fleet.rates.setpoint))
        self._measurement = _Measurement(self.now, counts)

    def _measure(self, measurement: _Measurement, system: int, vehicle: Vehicle) -> None:
        for gaps, last in (
            (measurement.gap, vehicle.received_at),
            (measurement.unanswered, vehicle.timesync_at),
        ):
            gaps[system] = max(gaps.get(system, 0.0), self.now - max(last, measurement.since))

    def link_quality(self) -> list[LinkQuality]:
        """Return the quality of the links since :meth:`begin_link_measurement`."""
        measurement = self._measurement
        if measurement is None:
            return []
        duration = max(self.now - measurement.since, 1e-3)
        qualities = []
        for system, vehicle in self.team.vehicles.items():
            packets = vehicle.packets - measurement.counts[system][0]
            lost = max(vehicle.lost_packets - measurement.counts[system][1], 0)
            qualities.append(
                LinkQuality(
                    system,
                    packets / duration,
                    measurement.gap.get(system, 0.0),
                    lost / max(packets + lost, 1),
                    vehicle.round_trip,
                    measurement.unanswered.get(system, 0.0),
                )
            )
        return qualities

    def events(self) -> list[Event]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    def _report(self, kind: str, words: str, system: int | None) -> None:
        self._events.append(Event(self.now, kind, words, system))


def position_quality(name: str, vehicle: Vehicle, fleet: Fleet, tracking: float) -> Finding:
    """Return a finding on a vehicle's receiver, whose errors count as tracking errors.

    ``tracking`` is the largest tracking error in metres that the plan allows. Vehicles in frames of
    their own pads need no receiver.
    """
    if vehicle.fix_type < 0:
        return Finding("warning", "position", f"{name}: reports no satellites")
    accuracy = vehicle.horizontal_accuracy
    words = f"{name}: {vehicle.satellites} satellites"
    words += f", level to {accuracy:.2f} m" if math.isfinite(accuracy) else ""
    if vehicle.fix_type < common.GPS_FIX_TYPE_3D_FIX:
        return Finding("error", "position", f"{words}: no 3D fix")
    fix, error = FIXES.get(vehicle.fix_type, ("no solution of a rover", math.inf))
    if fleet.frame == "gps" and error > tracking:
        words += f": {fix}, with errors of {error:g} m; the plan allows tracking errors of "
        words += f"{tracking:g} m: RTK fixed is needed (--rtcm sends corrections)"
        return Finding("error", "position", words)
    poor = vehicle.satellites < FEWEST_SATELLITES or accuracy > POOREST_ACCURACY
    severity: Severity = "warning" if poor else "info"
    return Finding(severity, "position", words)


def radio_findings(fleet: Fleet, flyers: int) -> list[Finding]:
    """Return whether setpoints fit each link of known capacity: serial, or in the fleet file."""
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
    """Return whether setpoints for so many vehicles at a rate in Hz fit one radio.

    ``positions`` in Hz come back from each. Half of the radio is left for all other packets.
    """
    signature = SIGNATURE_LENGTH if signed else 0
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
