"""Before anything is armed: is everybody there, healthy, and standing where the plan begins?

Where vehicles stand also ties their frames to the mission's: heights are levelled on the pads,
since barometers and satellites put the origins' heights metres apart.
"""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from swarm.fleet import Fleet
from swarm.mavlink.frames import Frames, Origin, gps_frames, shared_frames
from swarm.mavlink.vehicle import Vehicle
from swarm.preflight.findings import Finding, Severity

Floats = npt.NDArray[np.float64]

FRESH = 1.0
"""Seconds after which a position is too old to judge by."""
STEEPEST_LEVELLING = 30.0
"""Metres that a vehicle's height may be off before its height is not believed at all."""


def named(vehicle: Vehicle, number: int) -> str:
    """Return what a vehicle is called in messages: its place along the cable, and system id."""
    if number == vehicle.system:
        return f"vehicle {number}"
    return f"vehicle {number} (system {vehicle.system})"


def readiness(vehicles: Sequence[Vehicle], fleet: Fleet, now: float) -> list[Finding]:
    """Return what keeps the vehicles, in order along the cable, from being armed."""
    findings: list[Finding] = []
    for number, vehicle in enumerate(vehicles, 1):
        name = named(vehicle, number)
        problems = list(_problems(vehicle, fleet, now))
        findings.extend(Finding("error", check, f"{name}: {text}") for check, text in problems)
    return findings


def _problems(vehicle: Vehicle, fleet: Fleet, now: float) -> list[tuple[str, str]]:
    if vehicle.heartbeat_at == -math.inf:
        return [("heard", "no heartbeat")]
    if now - vehicle.heard_at > fleet.limits.silence + 1.0:
        return [("heard", f"silent for {now - vehicle.heard_at:.1f} s")]
    if vehicle.autopilot is None:
        return [("autopilot", "neither PX4 nor ArduPilot")]
    problems = []
    if vehicle.armed:
        problems.append(("disarmed", "is armed already"))
    if vehicle.landed_state and not vehicle.on_ground:
        problems.append(("on ground", "says that it is not on the ground"))
    if now - vehicle.position_at > FRESH:
        problems.append(("position", "no fresh local position"))
    if not math.isfinite(vehicle.attitude[2]):
        problems.append(("attitude", "no attitude"))
    if fleet.frame == "gps" and vehicle.origin is None:
        problems.append(("origin", "its estimator's origin is unknown"))
    if vehicle.autopilot.offboard_early and not vehicle.in_mode("offboard"):
        problems.append(("mode", f"is in {vehicle.mode}, not guided"))
    if vehicle.ready is False:
        said = vehicle.recent_words(now, within=30.0)
        problems.append(("ready", "not ready to arm" + (f" ({said})" if said else "")))
    elif vehicle.ready is None:
        problems.append(("ready", "has not said whether it is ready to arm"))
    return problems


def make_frames(
    vehicles: Sequence[Vehicle], fleet: Fleet, standing: Floats, measured: Floats
) -> Frames:
    """Return the frames of vehicles that stand on their pads.

    ``standing`` (n, 3) is where the plan has the vehicles' centres, mission ENU; ``measured``
    (n, 3) where each says that it is, in its own NED. Heights are levelled to ``standing``, except
    in a shared frame; in the frame ``pads`` the horizontal position is, too.
    """
    heading = -math.radians(fleet.origin.heading) if fleet.origin else 0.0
    if fleet.frame == "shared":
        return shared_frames(len(vehicles), heading)
    if fleet.frame == "pads":
        frames = shared_frames(len(vehicles), heading)
        return frames.shifted(standing - frames.points_to_mission(measured))
    place = fleet.origin
    origins = [vehicle.origin for vehicle in vehicles if vehicle.origin is not None]
    if place is None:
        raise ValueError("the mission's origin is not known")
    altitude = origins[0].altitude if place.altitude is None else place.altitude
    mission = Origin(place.latitude, place.longitude, altitude)
    projections = [v.autopilot.name if v.autopilot else "px4" for v in vehicles]
    frames = gps_frames(mission, heading, origins, projections)
    off = standing - frames.points_to_mission(measured)
    off[:, :2] = 0.0
    return frames.shifted(off)


def placement(
    vehicles: Sequence[Vehicle], fleet: Fleet, frames: Frames, standing: Floats, measured: Floats
) -> list[Finding]:
    """Return where vehicles stand against their pads; standing too far off is an error."""
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
