"""How it is noticed that something is wrong: from what vehicles say, and from what they do not.

Looked at every tick. What follows is :data:`swarm.flight.failures.TABLE`.
"""

import math
from dataclasses import dataclass, field
from statistics import median
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from swarm.flight import estimation
from swarm.flight.failures import failure
from swarm.flight.measuring import follow_jump
from swarm.mavlink.vehicle import Vehicle
from swarm.mavlink.vehicle_state import VehicleEvent

if TYPE_CHECKING:
    from swarm.flight.conductor import Conductor

Floats = npt.NDArray[np.float64]

SINKING = 1.0
"""m/s by which a vehicle may go down faster than it was told to."""
FALLING = 5.0
"""m/s² downwards, between two reports, that no vehicle with thrust shows; SINKING_TOO with it."""
SINKING_TOO = 0.4
MODE_KNOWN = 1.5
"""Seconds after it was told for which a mode is taken to be the vehicle's."""
TURNED_OVER = math.radians(60.0)
"""Roll or pitch; PX4's own failure detector takes the same angle (FD_FAIL_R)."""
JUMP = 0.5
"""Metres by which a report may differ from where the last one and its velocity lead."""
LONGEST_STEP = 0.5
"""Seconds between reports up to which a jump can be told from flight."""
BATTERY_LOW, BATTERY_CRITICAL = 0.2, 0.1
"""Shares of charge; above what autopilots act on by themselves, so that the group decides."""
HEIGHTS_APART = (0.3, 1.0)
"""Metres by which one vehicle's height may drift against its GPS compared with the others': with
receivers that say that they are good while the cable is aloft, and otherwise; none tells less than
it claims."""
_ACCURACIES = 5.0
"""Times the stated upright accuracy of the receivers that a drift must exceed."""
FELL_AFTER = 0.5
"""Seconds of silence after which a vehicle whose neighbour is pulled down has fallen."""
PULLED = 0.3
"""Metres by which it is below its place then."""
NO_FIX = 3
_CALM = LONGEST_STEP, SINKING, SINKING_TOO, 0.5 * JUMP, TURNED_OVER
"""What `estimation.news` finds as it should is never noticed by `_watch_motion`, but not all that
is looked at more closely is noticed."""
_LANDS = frozenset({"land", "precision land"})
_HOME = frozenset({"return", "smart return", "auto return"})


@dataclass
class Reports:
    """What was last reported by each of n vehicles, to compare the next report with."""

    last: estimation.Measured
    step: Floats
    heights: Floats
    told: set[tuple[str, int]] = field(default_factory=set)
    next_heights: float = 0.0
    aloft: bool = False

    @classmethod
    def of(cls, n: int) -> "Reports":
        """Return the reports of n vehicles that have said nothing yet."""
        return cls(estimation.Measured.of(n), np.zeros(n), np.full(n, np.nan))

    def first(self, what: str, k: int) -> bool:
        """Whether this is said of a vehicle for the first time."""
        new = (what, k) not in self.told
        self.told.add((what, k))
        return new


def watch(flight: "Conductor") -> None:
    """Look at the links, and at how everybody moves."""
    reports, now, last = flight.reports, flight.measured, flight.reports.last
    told, calm, heard = estimation.news(
        flight.team.telemetry.values, flight.rows, now.places, now.at, last.places, last.at,
        flight.setpoint_velocity, flight.streaming, _CALM, reports.step,
    )  # fmt: skip
    _watch_links(flight, heard)
    if flight.frames is None or flight.over:
        return
    if (told and not calm) or not _healthy(flight):
        for k, vehicle in enumerate(flight.flyers):
            if flight.expected_armed[k] and not may_be_down(flight, vehicle):
                _watch_motion(flight, k, vehicle)
                _watch_health(flight, k, vehicle)
    if told:
        estimation.note(now.places, now.at, last.places, last.at, reports.step)
    if flight.now >= flight.reports.next_heights:
        flight.reports.next_heights = flight.now + 1.0
        _watch_heights(flight)


def _watch_links(flight: "Conductor", earliest: float) -> None:
    """Notice vehicles that fall silent, and that are heard again.

    ``earliest`` is when the one was heard who has been silent for longest.
    """
    limits = flight.fleet.limits
    longest = min(FELL_AFTER, limits.silence, limits.lost or limits.silence)
    if not flight.silent and flight.now - earliest <= longest:
        return
    lost = [vehicle for vehicle in flight.flyers if not flight.heard(vehicle, limits.lost)]
    for k, vehicle in enumerate(flight.flyers):
        silent, name = not flight.heard(vehicle), flight.name(vehicle)
        if silent and vehicle.system not in flight.silent:
            flight.silent.add(vehicle.system)
            words = f"{name} has been silent for {limits.silence:g} s"
            failure(flight, "silent", words, vehicle)
        elif vehicle.system in flight.silent and not silent and _mode_known(flight, vehicle):
            flight.silent.discard(vehicle.system)
            for cause in (f"silent {vehicle.system}", f"lost {vehicle.system}", "all lost"):
                flight.holds.pop(cause, None)
            flight.reports.told -= {("lost", k), ("all lost", 0)}
            flight.say("link", f"{name} is heard again", vehicle)
        if vehicle in lost and len(lost) < len(flight.flyers) and flight.reports.first("lost", k):
            failure(flight, "lost", f"not heard for {limits.lost:g} s: {name}", vehicle)
        if not flight.heard(vehicle, FELL_AFTER) and _pulled_down(flight, k):
            _tell_fallen(flight, k)
    if len(lost) == len(flight.flyers) and flight.reports.first("all lost", 0):
        failure(flight, "all lost", f"no vehicle has been heard for {limits.lost:g} s")


def _tell_fallen(flight: "Conductor", k: int) -> None:
    vehicle = flight.flyers[k]
    if flight.reports.first("fallen silent", k):
        words = f"{flight.name(vehicle)} is silent and a neighbour is pulled down: it has fallen"
        failure(flight, "fallen silent", words, vehicle)


def _beside(flight: "Conductor", k: int) -> list[int]:
    return [j for j in (k - 1, k + 1) if 0 <= j < len(flight.flyers)]


def _pulled_down(flight: "Conductor", k: int) -> bool:
    """Whether a neighbour along the cable says that it is well below where it should be."""
    if flight.phase.cable != "aloft" or not flight.expected_armed[k]:
        return False
    below = flight.setpoint[:, 2] - flight.position[:, 2]
    return any(
        below[j] > PULLED
        and flight.streaming[j]
        and flight.now - flight.flyers[j].position_at <= FELL_AFTER
        for j in _beside(flight, k)
    )


def _healthy(flight: "Conductor") -> bool:
    """Whether there is nothing in batteries and positions that :func:`_watch_health` notices."""
    for vehicle in flight.flyers:
        if (
            vehicle.battery <= BATTERY_LOW
            or not vehicle.position_healthy
            or 0 <= vehicle.fix_type < NO_FIX
        ):
            return False
    return True


def _mode_known(flight: "Conductor", vehicle: Vehicle) -> bool:
    """Whether it has said lately what it does: after a gap it may be landing by itself."""
    return flight.now - vehicle.mode_at <= MODE_KNOWN


def _watch_motion(flight: "Conductor", k: int, vehicle: Vehicle) -> None:
    """Notice who falls, and whose position jumps."""
    found, last = flight.measured, flight.reports.last
    if found.at[k] <= last.at[k]:
        return
    step = float(found.at[k] - last.at[k])
    before, up = last.velocity[k], float(flight.velocity[k, 2])
    told = min(0.0, float(flight.setpoint_velocity[k, 2])) if flight.streaming[k] else -SINKING
    if not _mode_known(flight, vehicle):
        told = -math.inf
    falls = step > 0.04 and (before[2] - up) / step > FALLING and told - up > SINKING_TOO
    tilt = max(abs(vehicle.attitude[0]), abs(vehicle.attitude[1]))
    if told - up > SINKING or falls or tilt > TURNED_OVER:
        fallen = [j for j in _beside(flight, k) if not flight.heard(flight.flyers[j], FELL_AFTER)]
        if fallen and tilt <= TURNED_OVER:
            _tell_fallen(flight, fallen[0])
        elif flight.reports.first("falling", k):
            how = "turned over" if tilt > TURNED_OVER else f"going down at {-up:.1f} m/s"
            failure(flight, "falling", f"{flight.name(vehicle)} falls: {how}", vehicle)
        return
    if step > LONGEST_STEP or k in flight.dead:
        return
    expected = last.reported[k] + 0.5 * step * (before + flight.velocity[k])
    jump = found.reported[k] - expected
    size = float(np.linalg.norm(jump))
    if size > JUMP:
        follow_jump(flight, k, jump)
        words = f"{flight.name(vehicle)}'s position jumped by {size:.1f} m: its frame moved"
        failure(flight, "position jumped", words, vehicle)


def _watch_health(flight: "Conductor", k: int, vehicle: Vehicle) -> None:
    """Notice batteries that run down and positions that get worse."""
    name, reports = flight.name(vehicle), flight.reports
    if vehicle.battery <= BATTERY_CRITICAL and reports.first("battery critical", k):
        words = f"{name} has {vehicle.battery:.0%} of its battery left"
        failure(flight, "battery critical", words, vehicle)
    elif vehicle.battery <= BATTERY_LOW and reports.first("battery low", k):
        words = f"{name} has {vehicle.battery:.0%} of its battery left"
        failure(flight, "battery low", words, vehicle)
    if not vehicle.position_healthy and reports.first("located", k):
        failure(flight, "position lost", f"{name} does not know where it is", vehicle)
    if 0 <= vehicle.fix_type < NO_FIX and flight.fleet.frame == "gps" and reports.first("fix", k):
        failure(flight, "position poor", f"{name} has lost its GPS fix", vehicle)


def _watch_heights(flight: "Conductor") -> None:
    """Compare each vehicle's height with its GPS, and that with the others': barometers drift."""
    apart = np.array([vehicle.height_difference for vehicle in flight.flyers])
    reports = flight.reports
    begun = flight.phase.cable == "aloft" and not flight.waiting and not flight.holds
    if begun and not reports.aloft:
        # what there was before the fold has been judged on the levelled line
        reports.heights[:], reports.aloft = np.nan, True
    fresh = np.isnan(reports.heights)
    reports.heights[fresh] = apart[fresh]
    moved = apart - reports.heights
    if np.count_nonzero(np.isnan(moved)) or len(moved) < 3:
        return
    middle = median(moved.tolist())
    stated = [vehicle.vertical_accuracy for vehicle in flight.flyers]
    known = [accuracy for accuracy in stated if not math.isnan(accuracy)]
    stated = [math.inf if math.isnan(accuracy) else accuracy for accuracy in stated]
    least, most = HEIGHTS_APART
    least = least if reports.aloft else most
    most, usual = max(most, *known) if known else most, median(stated)
    for k, (vehicle, by) in enumerate(zip(flight.flyers, moved.tolist(), strict=True)):
        off = by - middle
        allowed = min(max(_ACCURACIES * max(stated[k], usual), least), most)
        if abs(off) > allowed and flight.expected_armed[k] and reports.first("height", k):
            words = f"{flight.name(vehicle)}'s height has drifted by {off:+.1f} m"
            failure(flight, "heights disagree", words, vehicle)


def hear(flight: "Conductor") -> None:
    """Turn what vehicles reported into events, and failures of theirs into responses."""
    for vehicle in flight.team.vehicles.values():
        for event in vehicle.take_events():
            flies = vehicle.system in flight.number
            if not (event.kind == "done" and event.subject.startswith("interval")):
                spare = "" if flies else f"system {vehicle.system}: "
                flight.say(event.kind, spare + event.message, vehicle)
            if flies:
                _judge(flight, vehicle, event)


def _judge(flight: "Conductor", vehicle: Vehicle, event: VehicleEvent) -> None:
    if event.kind == "done" and event.subject in {"grab", "release"}:
        vehicle.gripped = event.subject == "grab"
    if flight.stage not in {"fly", "leave"}:
        return
    k, name = flight.number[vehicle.system] - 1, flight.name(vehicle)
    flying = bool(flight.expected_armed[k]) and not may_be_down(flight, vehicle)
    match event.kind:
        case "failed" if k not in flight.dead and not event.subject.startswith("interval"):
            failure(flight, "command failed", f"{name}: {event.message}", vehicle)
        case "disarmed" if flying and (flight.streaming[k] or _high(flight, k)):
            flight.streaming[k] = False
            failure(flight, "disarmed", f"{name} disarmed in flight", vehicle)
        case "landed" if flying and not flight.guidance.descending and _high(flight, k):
            words = f"{name} takes itself for landed, in the air"
            failure(flight, "believes it has landed", words, vehicle)
        case "mode" if flying and not vehicle.in_mode("offboard") and k not in flight.rejoining:
            _left(flight, k, vehicle, event)
        case "rebooted":
            flight.streaming[k] = False
            failure(flight, "rebooted", f"{name} {event.message}", vehicle)
        case "origin" if ("falling", k) not in flight.reports.told:
            failure(flight, "origin moved", f"{name}: {event.message}", vehicle)


def _high(flight: "Conductor", k: int) -> bool:
    return flight.height_above_start(k) > 1.0


def _left(flight: "Conductor", k: int, vehicle: Vehicle, event: VehicleEvent) -> None:
    """A vehicle is no longer in offboard mode: by its own decision, or a pilot's."""
    flight.streaming[k] = False
    said, name = vehicle.recent_warnings(flight.now), flight.name(vehicle)
    words = f"{name} left offboard mode by itself: {event.message}" + (f" ({said})" if said else "")
    if vehicle.in_manual_mode:
        failure(flight, "pilot", words, vehicle)
    elif vehicle.mode in _LANDS:
        failure(flight, "landing by itself", words, vehicle)
    elif vehicle.mode in _HOME:
        failure(flight, "flying home", words, vehicle)
    else:
        failure(flight, "left offboard", words, vehicle)


def may_be_down(flight: "Conductor", vehicle: Vehicle) -> bool:
    """Whether the vehicle was told to land: leaving offboard and disarming are then meant."""
    if flight.way_out is not None:
        return flight.way_out.told_to_land(vehicle)
    return flight.waiting and flight.gates[flight.gate].condition == "landed"
