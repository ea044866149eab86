"""On the ground: receive all vehicles, request their streams, and wait until all are present,
healthy, and on their pads.

The vehicles' places on the pads also determine their frames: heights are levelled on the pads,
since barometers and GPS put the origins' heights metres apart.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
import scipy
from pymavlink.dialects.v20 import common

from swarm.certification.findings import Finding, Severity
from swarm.errors import Refused
from swarm.flight.flight_plan import Audit
from swarm.flight.result import Outcome
from swarm.flight.router import Team
from swarm.mavlink.fence import FenceItem, polygon
from swarm.mavlink.frames import (
    Frames,
    Origin,
    from_mission,
    gps_frames,
    shared_frames,
    to_mission,
)
from swarm.mavlink.vehicle import Vehicle
from swarm.mission.fleet import Fleet

Floats = npt.NDArray[np.float64]

FRESH = 1.0
"""Seconds after which a position is too old."""


FIXES = {
    int(common.GPS_FIX_TYPE_3D_FIX): ("a 3D fix without corrections", 1.5),
    int(common.GPS_FIX_TYPE_DGPS): ("a differential fix", 1.0),
    int(common.GPS_FIX_TYPE_RTK_FLOAT): ("RTK float", 0.4),
    int(common.GPS_FIX_TYPE_RTK_FIXED): ("RTK fixed", 0.02),
    int(common.GPS_FIX_TYPE_PPP): ("PPP", 0.1),
}
"""Kinds of solutions and their horizontal errors in metres: u-blox's ZED-F9P (data sheet: 1.5 m,
SBAS 1.0 m, RTK 0.01 m and 1 ppm); a float solution is good to a few decimetres."""


def named(vehicle: Vehicle, number: int) -> str:
    """Return the name of a vehicle in messages: its place along the cable, and system id."""
    if number == vehicle.system:
        return f"vehicle {number}"
    return f"vehicle {number} (system {vehicle.system})"


def readiness(vehicles: Sequence[Vehicle], fleet: Fleet, now: float) -> list[Finding]:
    """Return the errors that prevent arming, of vehicles in order along the cable."""
    findings: list[Finding] = []
    for number, vehicle in enumerate(vehicles, 1):
        name = named(vehicle, number)
        problems = problems_of(vehicle, fleet, now)
        findings.extend(Finding("error", check, f"{name}: {text}") for check, text in problems)
    return findings


def problems_of(vehicle: Vehicle, fleet: Fleet, now: float) -> list[tuple[str, str]]:
    """Return what prevents a vehicle from arming: checks, with the reasons in words."""
    if vehicle.heartbeat_at == -math.inf or vehicle.autopilot is None:
        return [("heard", "no heartbeat of a PX4 or ArduPilot")]
    if now - vehicle.received_at > fleet.limits.silence + 1.0:
        return [("heard", f"silent for {now - vehicle.received_at:.1f} s")]
    problems = []
    if vehicle.armed:
        problems.append(("disarmed", "is already armed"))
    if vehicle.landed_state and not vehicle.on_ground:
        problems.append(("on ground", "reports that it is not on the ground"))
    if now - vehicle.position_at > FRESH:
        problems.append(("position", "no fresh local position"))
    if not math.isfinite(vehicle.attitude[2]):
        problems.append(("attitude", "no attitude"))
    if fleet.frame == "gps" and vehicle.origin is None:
        problems.append(("origin", "its estimator's origin is unknown"))
    if vehicle.autopilot.ready_in_offboard_only and not vehicle.in_mode("offboard"):
        problems.append(("mode", f"is in {vehicle.mode}, not guided"))
    if fleet.frame != "shared" and not vehicle.compass_healthy:
        problems.append(("compass", "its compass is unhealthy"))
    if vehicle.ready is False and not decided_in_offboard(vehicle, fleet):
        said = vehicle.recent_warnings(now, within=30.0)
        problems.append(("ready", "not ready to arm" + (f" ({said})" if said else "")))
    elif vehicle.ready is None:
        problems.append(("ready", "has not reported whether it is ready to arm"))
    return problems


def decided_in_offboard(vehicle: Vehicle, fleet: Fleet) -> bool:
    """Return whether a vehicle's readiness is decided in offboard mode only.

    PX4 judges by its present mode (Commander: ``canArm(nav_state)``). On the ground that is Hold,
    which requires a global position; indoors there is none, and PX4 arms only in offboard mode with
    a stream of setpoints. The arm command before take-off shows the result.
    """
    early = vehicle.autopilot is not None and vehicle.autopilot.ready_in_offboard_only
    return fleet.frame == "shared" and vehicle.ready is False and not early


def rough_frames(vehicles: Sequence[Vehicle], fleet: Fleet, pads: Floats) -> Frames:
    """Return the vehicles' frames before heights are levelled.

    ``pads`` (n, 3) are the pads of vehicles that have theirs from the fleet file (NaN for the
    others); they place the mission on the earth where the fleet file does not. Raises
    :class:`Refused` where a required origin is not known.
    """
    if fleet.frame != "gps":
        turned = -math.radians(fleet.origin.heading) if fleet.origin else 0.0
        return shared_frames(len(vehicles), turned)
    mission, turned = _mission_place(vehicles, fleet, pads)
    projections = [v.autopilot.name if v.autopilot else "px4" for v in vehicles]
    origins = [vehicle.origin for vehicle in vehicles if vehicle.origin is not None]
    return gps_frames(mission, turned, origins, projections)


def _mission_place(vehicles: Sequence[Vehicle], fleet: Fleet, pads: Floats) -> tuple[Origin, float]:
    """Return the place of the mission's (0, 0, 0) on the earth, and how far it is turned."""
    origins = [vehicle.origin for vehicle in vehicles if vehicle.origin is not None]
    if len(origins) < len(vehicles):
        without = ", ".join(str(v.system) for v in vehicles if v.origin is None)
        raise Refused(f"the estimators' origins are not known of systems {without}")
    place = fleet.origin
    if place is None:
        return _fitted(vehicles, pads)
    altitude = origins[0].altitude if place.altitude is None else place.altitude
    return Origin(place.latitude, place.longitude, altitude), -math.radians(place.heading)


def mission_fence(
    flyers: Sequence[Vehicle], fleet: Fleet, standing: Floats, corners: Sequence[Sequence[float]]
) -> tuple[FenceItem, ...]:
    """Return a mission's fence for the vehicles' own fences.

    ``flyers`` are in order along the cable, ``standing`` (n, 3) their planned places, ``corners``
    x and y of the fence: all mission ENU, metres. Raises :class:`Refused` where the mission cannot
    be placed on the earth.
    """
    listed = {vehicle.sysid for vehicle in fleet.vehicles if vehicle.pad is not None}
    given = np.array([[vehicle.system in listed] for vehicle in flyers])
    place, turned = _mission_place(flyers, fleet, np.where(given, standing, np.nan))
    places = [from_mission(place, turned, np.array([x, y, 0.0])) for x, y in corners]
    return polygon([(place.latitude, place.longitude) for place in places])


def levelled(frames: Frames, fleet: Fleet, standing: Floats, measured: Floats) -> Frames:
    """Return the frames of vehicles that stand on their pads, corrected by their places there.

    ``standing`` (n, 3) are the planned places of the centres, mission ENU; ``measured`` (n, 3) the
    reported ones, each in its own NED. Heights are levelled to ``standing``, except
    in a shared frame; in the frame ``pads`` the horizontal position is, too.
    """
    if fleet.frame == "shared":
        return frames
    off = standing - frames.points_to_mission(measured)
    if fleet.frame == "gps":
        off[:, :2] = 0.0
    return frames.shifted(off)


def assigned(positions: Floats, pads: Floats, taken: Mapping[int, int]) -> list[int]:
    """Return the vehicle on each of the n pads: indices into ``positions`` (m, 3).

    ``taken`` are pads that the fleet file assigns; the others are assigned with the smallest sum of
    squared horizontal distances. The remaining vehicles are spares.
    """
    free_pads = [pad for pad in range(len(pads)) if pad not in taken]
    others = [k for k in range(len(positions)) if k not in taken.values()]
    apart = positions[others][None, :, :2] - pads[free_pads][:, None, :2]
    rows, columns = scipy.optimize.linear_sum_assignment((apart**2).sum(axis=2))
    chosen = dict(taken)
    chosen |= {free_pads[r]: others[c] for r, c in zip(rows, columns, strict=True)}
    return [chosen[pad] for pad in range(len(pads))]


def _fitted(vehicles: Sequence[Vehicle], pads: Floats) -> tuple[Origin, float]:
    """Place the mission so that pads fit their vehicles' places, by least squares.

    Rotation and translation in the plane from matched points: Umeyama 1991, without scale.
    """
    known = [k for k, v in enumerate(vehicles) if v.global_position and np.isfinite(pads[k]).all()]
    if len(known) < 2:
        raise Refused("the fleet file gives neither an origin nor two vehicles with their pads")
    places = [place for k in known if (place := vehicles[k].global_position) is not None]
    first = places[0]
    there = np.array([to_mission(first, 0.0, place)[:2] for place in places])
    here = pads[known][:, :2]
    spread_here, spread_there = here - here.mean(axis=0), there - there.mean(axis=0)
    sine = float(
        np.sum(spread_here[:, 0] * spread_there[:, 1] - spread_here[:, 1] * spread_there[:, 0])
    )
    cosine = float(np.sum(spread_here * spread_there))
    turned = math.atan2(sine, cosine)
    c, s = math.cos(turned), math.sin(turned)
    shift = there.mean(axis=0) - np.array([[c, -s], [s, c]]) @ here.mean(axis=0)
    return from_mission(first, 0.0, np.array([shift[0], shift[1], 0.0])), turned


def placement(
    vehicles: Sequence[Vehicle], fleet: Fleet, frames: Frames, standing: Floats, measured: Floats
) -> list[Finding]:
    """Return the distances of vehicles from their pads; too large ones are errors."""
    off = np.linalg.norm(frames.points_to_mission(measured) - standing, axis=1)
    findings = []
    limit = fleet.limits.placement
    for number, (vehicle, distance) in enumerate(zip(vehicles, off.tolist(), strict=True), 1):
        severity: Severity = "info" if distance <= limit else "error"
        text = f"{named(vehicle, number)} stands {distance:.2f} m from its pad"
        if severity == "error":
            text += f" (at most {limit:g} m)"
        findings.append(Finding(severity, "placement", text))
    return findings


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
class Standstill:
    """Waits until vehicles on the ground are ready, use corrections, and report places at rest.

    ``tracking``, metres: corrections are sent, and the errors of all receivers must be smaller;
    None: positions are taken as they are. Flights and checks wait alike.
    """

    fleet: Fleet
    tracking: float | None = None
    _samples: list[tuple[float, Floats]] = field(default_factory=list)

    def problems(
        self, vehicles: Sequence[Vehicle], unready: list[Finding], now: float
    ) -> list[Finding]:
        """Take the present places; return what must still be waited for.

        ``unready`` is what prevents the vehicles from arming. They are the same ones at each call.
        """
        measured = np.array([vehicle.position for vehicle in vehicles])
        findings = unready or self._uncorrected(vehicles) or self._moved(vehicles, measured)
        if findings:
            self._samples.clear()
        else:
            self._samples.append((now, measured))
        return findings

    def long_enough(self, now: float) -> bool:
        """Whether there was nothing to wait for over ``STANDING_TIME``."""
        return bool(self._samples) and now - self._samples[0][0] >= STANDING_TIME

    @property
    def places(self) -> Floats:
        """The mean places (m, 3) since then, each NED in the vehicle's own frame, metres."""
        return np.asarray(np.mean([row for _, row in self._samples], axis=0))

    def _uncorrected(self, vehicles: Sequence[Vehicle]) -> list[Finding]:
        """Return the vehicles whose receivers do not use the corrections yet."""
        if self.tracking is None or self.fleet.frame != "gps":
            return []
        findings = []
        for vehicle in vehicles:
            fix, error = FIXES.get(vehicle.fix_type, ("", 0.0))
            if error > self.tracking:
                words = f"system {vehicle.system}: {fix}, with errors of {error:g} m, though "
                words += "corrections are sent: RTK fixed is needed"
                findings.append(Finding("error", "position", words))
        return findings

    def _moved(self, vehicles: Sequence[Vehicle], measured: Floats) -> list[Finding]:
        """Return the vehicles that report another place than at first, though they stand.

        Their estimators have just found their places, as with the first poses of motion capture. An
        estimator follows the first corrections over seconds: they are waited for.
        """
        if not self._samples:
            return []
        most = self.fleet.limits.placement
        if self.tracking is not None and self.fleet.frame == "gps":
            most = min(most, 0.5 * self.tracking)
        away = np.linalg.norm(measured - self._samples[0][1], axis=1)
        return [
            Finding(
                "error",
                "position",
                f"system {vehicle.system} reports a motion of {distance:.2f} m on the ground",
            )
            for vehicle, distance in zip(vehicles, away.tolist(), strict=True)
            if distance > most
        ]


@dataclass
class Preparation:
    """Prepares the fleet's vehicles and assigns them to pads.

    ``standing`` (n, 3) are the planned places of the centres before take-off, mission ENU.
    ``tracking`` is that of :class:`Standstill`.
    """

    team: Team
    fleet: Fleet
    standing: Floats
    tracking: float | None = None
    _began: tuple[float, float] | None = None
    _enough_at: float | None = None
    _heard: list[Vehicle] = field(default_factory=list)
    _heard_at: float | None = None
    _conflict_at: float | None = None
    _standstill: Standstill = field(init=False)

    def __post_init__(self) -> None:
        self._standstill = Standstill(self.fleet, self.tracking)

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
        unready = readiness(self._heard, self.fleet, now)
        findings = self._standstill.problems(self._heard, unready, now)
        if findings:
            return _not_ready(findings) if late else None
        if not self._standstill.long_enough(now) or self.team.undecided(now):
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

    def _finish(self) -> Prepared | Outcome:
        measured = self._standstill.places
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
        Finding("info", "ready", f"system {vehicle.system}: it decides whether to arm in "
                "offboard mode only; on the ground it lacks a global position")
        for vehicle in flyers
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
