"""Failures that vehicles report themselves: modes, arming, landing, commands, reboots, origins."""

from swarm.flight.failures import Failure, FailureKind, Finding
from swarm.flight.observation import Expected, Observation
from swarm.mavlink.vehicle import Vehicle
from swarm.mavlink.vehicle_state import VehicleEvent

HIGH = 1.0
"""Metres above its pad from which a vehicle is surely in the air."""
_LANDING_MODES = frozenset({"land", "precision land"})
_RETURN_MODES = frozenset({"return", "smart return", "auto return"})


class ReportDetector:
    """Judges the events that vehicles report; positions are those of the tick before."""

    def __init__(self) -> None:
        self._left: dict[int, FailureKind] = {}

    def detect(
        self,
        seen: Observation,
        expected: Expected,
        k: int,
        vehicle: Vehicle,
        event: VehicleEvent,
        now: float,
    ) -> list[Finding]:
        """Return the failure that an event of a vehicle reports, if it is one."""
        name = seen.names[k]
        flying = bool(expected.armed[k]) and not expected.may_land[k]
        high = float(seen.position[k, 2]) - float(expected.start_height[k]) > HIGH
        failure: Failure | None = None
        match event.kind:
            case "failed" if k not in expected.fallen and not event.subject.startswith("interval"):
                failure = Failure(FailureKind.COMMAND_FAILED, f"{name}: {event.message}", k)
            case "disarmed" if flying and (expected.streaming[k] or high):
                failure = Failure(FailureKind.DISARMED, f"{name} disarmed in flight", k)
            case "landed" if flying and not expected.descending and high:
                words = f"{name} reports that it has landed, in the air"
                failure = Failure(FailureKind.FALSE_LANDING, words, k)
            case "mode" if flying and k not in expected.rejoining | expected.fallen:
                if not vehicle.in_mode("offboard"):
                    failure = _left_offboard(name, k, vehicle, event, now)
                    # a PX4 that had lost its setpoints takes the last ones, and loses them again
                    known = not expected.streaming[k] and self._left.get(k) is failure.kind
                    self._left[k] = failure.kind
                    failure = None if known else failure
            case "rebooted":
                failure = Failure(FailureKind.REBOOTED, f"{name} {event.message}", k)
            case "origin" if k not in expected.fallen:
                failure = Failure(FailureKind.ORIGIN_MOVED, f"{name}: {event.message}", k)
        return [] if failure is None else [failure]


def _left_offboard(name: str, k: int, vehicle: Vehicle, event: VehicleEvent, now: float) -> Failure:
    """Return how a vehicle has left offboard mode: by its own decision, or a pilot's."""
    texts = vehicle.recent_warnings(now)
    words = f"{name} left offboard mode uncommanded: {event.message}"
    words += f" ({texts})" if texts else ""
    if vehicle.in_manual_mode:
        kind = FailureKind.PILOT
    elif vehicle.mode in _LANDING_MODES:
        kind = FailureKind.LANDING_ALONE
    elif vehicle.mode in _RETURN_MODES:
        kind = FailureKind.RETURNING
    else:
        kind = FailureKind.LEFT_OFFBOARD
    return Failure(kind, words, k)
