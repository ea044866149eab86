"""Bodies of motion capture, and the vehicles that they should be. No sockets, no clock."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from swarm.certification.findings import Finding, Severity
from swarm.mavlink.vehicle import Vehicle

UNSEEN = 0.5
"""Seconds without a pose that are reported: ten ticks at the lowest rate, 20 Hz."""
SLOWEST = 10.0
"""Poses per second without a warning; PX4's documentation asks for 30 to 50."""
UNCHANGED = 2.0
"""Seconds without a change in any digit that are reported: systems that see a body have noise."""
OFF = 0.2
"""Metres between an estimate on the ground and the pose it should follow; both have errors of
centimetres there, PX4's height by a barometer among them."""
_OLD = 2.0
"""Seconds after which a reported position says nothing of the present: twenty at 10 Hz."""


class Pose(NamedTuple):
    """One body: seconds on the capture's clock, metres (ENU), quaternion w, x, y, z."""

    system: int
    time: float
    position: tuple[float, float, float]
    attitude: tuple[float, float, float, float]


class Body(NamedTuple):
    """What has come of one body: its newest pose, poses per second, seconds since the newest one,
    and seconds in which no digit of its poses has changed."""

    pose: Pose
    rate: float
    age: float
    unchanged: float


@dataclass(frozen=True)
class PoseRow:
    """The poses of one vehicle: per second, and the age of the newest in seconds, None without any.

    ``distance`` in metres is that of the vehicle's own estimate from its pose, None where it
    reports none; ``problem`` says in words what is wrong, "" if nothing is.
    """

    system: int
    rate: float
    age: float | None
    distance: float | None
    severity: Severity = "info"
    problem: str = ""

    def finding(self) -> Finding:
        """Return the row as a finding."""
        if self.age is None:
            return Finding("error", "poses", f"system {self.system}: {self.problem}")
        words = f"system {self.system}: {self.rate:.0f} poses/s, the newest {self.age:.2f} s old"
        if self.distance is not None:
            words += f", {self.distance:.2f} m from its estimate"
        return Finding(
            self.severity, "poses", words + (f"; {self.problem}" if self.problem else "")
        )


def pose_rows(
    vehicles: Iterable[Vehicle], bodies: Mapping[int, Body], now: float, *, positions: bool
) -> tuple[PoseRow, ...]:
    """Return a row for each vehicle, whose estimates are in the laboratory's frame.

    ``now`` is that of the vehicles' times. ``positions``: the vehicles were asked for positions,
    and stand on the ground.
    """
    return tuple(
        _row(vehicle, bodies.get(vehicle.system), now, positions=positions) for vehicle in vehicles
    )


def _row(vehicle: Vehicle, body: Body | None, now: float, *, positions: bool) -> PoseRow:
    system = vehicle.system
    if body is None:
        return PoseRow(system, 0.0, None, None, "error", "no pose")
    north, east, down = vehicle.position
    distance: float | None = math.dist((east, north, -down), body.pose.position)
    if not (math.isfinite(distance or 0.0) and now - vehicle.position_at <= _OLD):
        distance = None
    severity: Severity = "error"
    if body.age > UNSEEN:
        problem = f"no pose for {body.age:.1f} s"
    elif vehicle.heartbeat_at == -math.inf:
        problem = "the vehicle is not received: nothing is sent to it"
    elif positions and distance is None:
        problem = "its autopilot reports no position"
    elif positions and distance is not None and distance > OFF:
        problem = "its autopilot does not use them: its estimate and its pose must agree to "
        problem += f"{OFF:g} m on the ground"
    else:
        severity, problem = "warning", ""
        if body.unchanged > UNCHANGED:
            problem = f"no digit of its pose has changed for {body.unchanged:.0f} s: is it frozen?"
        elif body.rate < SLOWEST:
            problem = f"fewer than {SLOWEST:g} a second"
    return PoseRow(system, body.rate, body.age, distance, severity if problem else "info", problem)
