"""On the ground: receive all vehicles, request their streams, wait until all are ready."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import common

from swarm.certification.findings import Finding
from swarm.errors import Refused
from swarm.flight.clearance import Audit
from swarm.flight.readiness import (
    assigned,
    decided_in_offboard,
    levelled,
    named,
    placement,
    readiness,
    rough_frames,
)
from swarm.flight.result import Outcome
from swarm.flight.router import Team
from swarm.mavlink.frames import Frames
from swarm.mavlink.vehicle import Vehicle
from swarm.mission.fleet import Fleet

Floats = npt.NDArray[np.float64]

_REQUEST_INTERVAL = 1.0
"""Seconds between requests for a vehicle's origin: it answers within a round trip of 0.7 s."""

SPARE_TIMEOUT = 5.0
"""Seconds to wait for vehicles beyond the number that the plan needs."""

GATHERING = 1.5
"""Seconds after the first duplicate system id in which others are collected."""
STANDING_TIME = 1.0
"""Seconds over which the positions of standing vehicles are averaged."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A team that is ready: vehicles in order along the cable, frames, yaw (n,), the audit."""

    flyers: list[Vehicle]
    frames: Frames
    yaw: Floats
    audit: Audit


@dataclass
class Preparation:
    """Prepares the fleet's vehicles and assigns them to pads.

    ``standing`` (n, 3) are the planned places of the centres before take-off, mission ENU.
    """

    team: Team
    fleet: Fleet
    standing: Floats
    _began: tuple[float, float] | None = None
    _enough_at: float | None = None
    _heard: list[Vehicle] = field(default_factory=list)
    _heard_at: float | None = None
    _conflict_at: float | None = None
    _samples: list[tuple[float, Floats]] = field(default_factory=list)

    def tick(self, now: float, real: float) -> Prepared | Outcome | None:
        """Continue; return None until the team is ready, or cannot be.

        ``real`` is real time in seconds. By it a person waits for vehicles that send nothing;
        vehicles of a simulated world that runs slower have that world's time to become ready.
        """
        if self._began is None:
            self._began = now, real
        waited = real - self._began[1]
        late = min(waited, now - self._began[0]) > self.fleet.limits.ready
        if conflicts := self.team.conflicts():
            self._conflict_at = now if self._conflict_at is None else self._conflict_at
            if now - self._conflict_at >= GATHERING:
                return Outcome("refused", "\n".join(finding.message for finding in conflicts))
            return None
        self._conflict_at = None
        if self._heard_at is None:
            return self._listen(now, real, waited)
        self._request(now)
        measured = np.array([vehicle.position for vehicle in self._heard])
        findings = readiness(self._heard, self.fleet, now) or self._moved(measured)
        if findings:
            self._samples.clear()
            return _not_ready(findings) if late else None
        self._samples.append((now, measured))
        if now - self._samples[0][0] < STANDING_TIME or self.team.undecided(now):
            return None
        for vehicle in self._heard:
            vehicle.stop_unused_streams(self._heard_at, now)
        return self._finish()

    @property
    def all_received(self) -> bool:
        """Whether every vehicle that will fly has been received."""
        return self._heard_at is not None

    def _listen(self, now: float, real: float, waited: float) -> Outcome | None:
        """Wait for all vehicles of the fleet; for spares only SPARE_TIMEOUT."""
        vehicles = list(self.team.vehicles.values())
        heard = [v for v in vehicles if v.autopilot is not None and v.heartbeat_at > -math.inf]
        if len(heard) >= len(self.standing) and self._enough_at is None:
            self._enough_at = real
        timed_out = self._enough_at is not None and real - self._enough_at > SPARE_TIMEOUT
        if len(heard) == len(vehicles) or timed_out:
            self._heard, self._heard_at = heard, now
            for vehicle in heard:
                request_streams(vehicle, self.fleet)
        elif waited > self.fleet.limits.ready:
            missing = [named(v, k) for k, v in enumerate(vehicles, 1) if v not in heard]
            words = f"not received in {self.fleet.limits.ready:g} s: {', '.join(missing)}"
            return Outcome("failed", words)
        return None

    def _request(self, now: float) -> None:
        """Request missing origins, and the mode in which readiness is decided."""
        for vehicle in self._heard:
            request_origin(vehicle, self.fleet, now)
            early = vehicle.autopilot is not None and vehicle.autopilot.ready_in_offboard_only
            if early and not vehicle.in_mode("offboard"):
                vehicle.set_mode("offboard")
            if not early:
                leave_offboard(vehicle)

    def _moved(self, measured: Floats) -> list[Finding]:
        """Return the vehicles that report another place than at first, though they stand.

        Their estimators have just found their places, as with the first poses of motion capture.
        """
        if not self._samples:
            return []
        away = np.linalg.norm(measured - self._samples[0][1], axis=1)
        return [
            Finding(
                "error",
                "position",
                f"system {vehicle.system} reports a motion of {distance:.2f} m on the ground",
            )
            for vehicle, distance in zip(self._heard, away.tolist(), strict=True)
            if distance > self.fleet.limits.placement
        ]

    def _finish(self) -> Prepared | Outcome:
        measured = np.mean([row for _, row in self._samples], axis=0)
        try:
            prepared = prepared_team(self._heard, self.fleet, self.standing, measured)
        except Refused as error:
            return Outcome("refused", str(error))
        audit = prepared.audit
        return replace(
            prepared, audit=replace(audit, findings=(*audit.findings, *self.team.findings()))
        )


def prepared_team(
    heard: Sequence[Vehicle], fleet: Fleet, standing: Floats, measured: Floats
) -> Prepared:
    """Return the vehicles on their pads, with their frames.

    ``measured`` (m, 3) are the reported positions of the received vehicles, NED metres in their own
    frames; ``standing`` (n, 3) the planned places of the centres, mission ENU; m ≥ n, the rest are
    spares. Raises :class:`Refused` where the mission cannot be placed on the earth.
    """
    number = {vehicle.system: k for k, vehicle in enumerate(heard)}
    given = {
        listed.pad - 1: number[listed.sysid]
        for listed in fleet.vehicles
        if listed.pad is not None and listed.pad <= len(standing) and listed.sysid in number
    }
    pads = np.full_like(measured, np.nan)
    for pad, k in given.items():
        pads[k] = standing[pad]
    frames = rough_frames(heard, fleet, pads)
    if fleet.frame == "pads":
        places = np.arange(len(measured))[:, None] * np.ones(3)
        order = assigned(places, np.arange(len(standing))[:, None] * np.ones(3), given)
    else:
        order = assigned(frames.points_to_mission(measured), standing, given)
    flyers = [heard[k] for k in order]
    frames = levelled(frames.select(order), fleet, standing, measured[order])
    findings = placement(flyers, fleet, frames, standing, measured[order])
    findings.extend(
        Finding("info", "spare", f"system {vehicle.system} stays on the ground")
        for vehicle in heard
        if vehicle not in flyers
    )
    findings.extend(
        Finding("info", "ready", f"{named(vehicle, number)}: it decides whether to arm in "
                "offboard mode only; on the ground it lacks a global position")
        for number, vehicle in enumerate(flyers, 1)
        if decided_in_offboard(vehicle, fleet)
    )  # fmt: skip
    return Prepared(
        flyers,
        frames,
        np.array([vehicle.attitude[2] for vehicle in flyers]),
        Audit(tuple(vehicle.system for vehicle in flyers), tuple(findings)),
    )


def request_origin(vehicle: Vehicle, fleet: Fleet, now: float) -> None:
    """Request, once a second, a vehicle's origin where it is required and not known.

    ArduPilot accepts the request and sends no origin until its estimator has one.
    """
    if vehicle.origin is None and fleet.frame == "gps" and now >= vehicle.next_origin_request:
        vehicle.next_origin_request = now + _REQUEST_INTERVAL
        vehicle.request_message(common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)


def leave_offboard(vehicle: Vehicle) -> None:
    """Command Hold to a vehicle on the ground that is not ready and in offboard mode.

    PX4 returns to offboard mode when it has landed and disarmed, and does not arm there without a
    stream.
    """
    if vehicle.ready is False and not vehicle.armed and vehicle.in_mode("offboard"):
        vehicle.set_mode("hold")


def request_streams(vehicle: Vehicle, fleet: Fleet) -> None:
    """Request the messages that a flight reads, at the fleet's rates."""
    rates = fleet.rates
    wanted = {
        common.MAVLINK_MSG_ID_LOCAL_POSITION_NED: rates.position,
        common.MAVLINK_MSG_ID_ATTITUDE: rates.position,
        common.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: rates.status,
        common.MAVLINK_MSG_ID_SYS_STATUS: rates.status,
        common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 1.0,
        common.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    }
    if vehicle.autopilot is not None:
        wanted[vehicle.autopilot.mode_message] = rates.heartbeat
    for message, rate in wanted.items():
        vehicle.request_interval(message, rate)


def _not_ready(findings: list[Finding]) -> Outcome:
    silent = any(finding.check == "heard" for finding in findings)
    words = "\n".join(finding.message for finding in findings)
    return Outcome("failed" if silent else "refused", words)
