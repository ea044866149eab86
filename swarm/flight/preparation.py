"""On the ground: hear everybody, ask for what the flight needs, wait until all are ready."""

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import common

from swarm.fleet import Fleet
from swarm.flight.clearance import Audit
from swarm.flight.readiness import make_frames, named, placement, readiness
from swarm.flight.result import Outcome
from swarm.flight.team import Team
from swarm.mavlink.frames import Frames
from swarm.mavlink.vehicle import Vehicle
from swarm.preflight.findings import Finding

Floats = npt.NDArray[np.float64]

STANDING_TIME = 1.0
"""Seconds over which the positions of standing vehicles are averaged."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A team that is ready: its frames, the yaw (n,) that each keeps, what the audit found."""

    frames: Frames
    yaw: Floats
    audit: Audit


@dataclass
class Preparation:
    """Prepares the vehicles that will fly, in order along the cable.

    ``standing`` (n, 3) is where the plan has their centres before take-off, mission ENU.
    """

    team: Team
    flyers: list[Vehicle]
    fleet: Fleet
    standing: Floats
    _began: float | None = None
    _all_heard_at: float | None = None
    _samples: list[tuple[float, Floats]] = field(default_factory=list)

    def tick(self, now: float) -> Prepared | Outcome | None:
        """Go on preparing: None until the team is ready, or cannot be."""
        if self._began is None:
            self._began = now
        late = now - self._began > self.fleet.limits.ready
        if self._all_heard_at is None:
            return self._listen(now, late=late)
        self._ask()
        findings = readiness(self.flyers, self.fleet, now)
        if findings:
            self._samples.clear()
            return _not_ready(findings) if late else None
        self._samples.append((now, np.array([vehicle.position for vehicle in self.flyers])))
        if now - self._samples[0][0] < STANDING_TIME:
            return None
        for vehicle in self.flyers:
            vehicle.quieten(self._all_heard_at, now)
        return self._finish()

    @property
    def everybody_heard(self) -> bool:
        """Whether every vehicle that will fly has been heard."""
        return self._all_heard_at is not None

    def _listen(self, now: float, *, late: bool) -> Outcome | None:
        missing = [v for v in self.flyers if v.autopilot is None or v.heartbeat_at == -math.inf]
        if not missing:
            self._all_heard_at = now
            self._request_streams()
        elif late:
            names = ", ".join(
                named(vehicle, number)
                for number, vehicle in enumerate(self.flyers, 1)
                if vehicle in missing
            )
            return Outcome("failed", f"not heard: {names}")
        return None

    def _request_streams(self) -> None:
        rates = self.fleet.rates
        wanted = {
            common.MAVLINK_MSG_ID_HEARTBEAT: rates.heartbeat,
            common.MAVLINK_MSG_ID_LOCAL_POSITION_NED: rates.position,
            common.MAVLINK_MSG_ID_ATTITUDE: rates.status,
            common.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: rates.status,
            common.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
            common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 1.0,
        }
        for vehicle in self.flyers:
            for message, rate in wanted.items():
                vehicle.request_interval(message, rate)

    def _ask(self) -> None:
        """Ask for what is still missing: origins, and the mode in which readiness is judged."""
        for vehicle in self.flyers:
            if vehicle.origin is None and self.fleet.frame == "gps" and vehicle.commands.idle:
                vehicle.request_message(common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
            early = vehicle.autopilot is not None and vehicle.autopilot.offboard_early
            if early and not vehicle.in_mode("offboard"):
                vehicle.set_mode("offboard")

    def _finish(self) -> Prepared:
        measured = np.mean([row for _, row in self._samples], axis=0)
        frames = make_frames(self.flyers, self.fleet, self.standing, measured)
        findings = placement(self.flyers, self.fleet, frames, self.standing, measured)
        findings.extend(
            Finding("warning", "fleet", f"system {system} is heard and not in the fleet file")
            for system in self.team.strangers
        )
        return Prepared(
            frames,
            np.array([vehicle.attitude[2] for vehicle in self.flyers]),
            Audit(tuple(vehicle.system for vehicle in self.flyers), tuple(findings)),
        )


def _not_ready(findings: list[Finding]) -> Outcome:
    silent = any(finding.check == "heard" for finding in findings)
    words = "\n".join(finding.message for finding in findings)
    return Outcome("failed" if silent else "refused", words)
