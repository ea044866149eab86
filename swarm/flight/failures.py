"""What follows from what when something goes wrong: one table.

The choices are the group's, never one vehicle's: vehicles that hold one cable must not part.
Returning to launch, alone or together, is not among them.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal

from swarm.mavlink.vehicle import Vehicle, VehicleEvent

if TYPE_CHECKING:
    from swarm.flight.conductor import Conductor

Response = Literal["note", "hold", "land"]
Failure = Literal[
    "silent",
    "lost",
    "all lost",
    "left offboard",
    "disarmed",
    "rebooted",
    "origin moved",
    "command failed",
    "gate timed out",
    "held too long",
]

RESPONSES: Mapping[Failure, Response] = {
    "silent": "hold",
    "lost": "land",
    "all lost": "note",
    "left offboard": "land",
    "disarmed": "land",
    "rebooted": "land",
    "origin moved": "land",
    "command failed": "land",
    "gate timed out": "land",
    "held too long": "land",
}
"""``hold`` ends by itself when its cause is over; ``land`` brings everybody down together."""

FATAL: frozenset[Failure] = frozenset(RESPONSES) - {"silent", "held too long"}
"""Failures after which a flight has failed, however well it lands."""

STANDING_STILL: frozenset[Failure] = FATAL - {"gate timed out"}
"""Failures after which the team does not move along the plan to a better place to land."""


def failure(flight: "Conductor", what: Failure, words: str, vehicle: Vehicle | None = None) -> None:
    """Answer a failure as the table says."""
    flight.say("failure", f"{what}: {words}", vehicle)
    if what in FATAL:
        flight.fail(words)
    if flight.stage != "fly":
        return
    match RESPONSES[what]:
        case "hold":
            flight.hold(f"{what} {vehicle.system}" if vehicle else what, words)
        case "land":
            flight.stopped_for_good = what in STANDING_STILL
            flight.leave("land", words, move=not flight.stopped_for_good)


def watch(flight: "Conductor") -> None:
    """Notice vehicles that fall silent, and that are heard again."""
    limits = flight.fleet.limits
    lost = [vehicle for vehicle in flight.flyers if not flight.heard(vehicle, limits.lost)]
    if len(lost) == len(flight.flyers):
        failure(flight, "all lost", f"no vehicle has been heard for {limits.lost:g} s")
        flight.conclude()
        return
    for vehicle in flight.flyers:
        silent, name = not flight.heard(vehicle), flight.name(vehicle)
        if silent and vehicle.system not in flight.silent:
            flight.silent.add(vehicle.system)
            words = f"{name} has been silent for {limits.silence:g} s"
            failure(flight, "silent", words, vehicle)
        elif not silent and vehicle.system in flight.silent:
            flight.silent.discard(vehicle.system)
            flight.holds.pop(f"silent {vehicle.system}", None)
            flight.say("link", f"{name} is heard again", vehicle)
    if lost and flight.stage == "fly":
        names = ", ".join(flight.name(vehicle) for vehicle in lost)
        failure(flight, "lost", f"not heard for {limits.lost:g} s: {names}")


def hear(flight: "Conductor") -> None:
    """Turn what vehicles reported into events, and failures of theirs into responses."""
    for vehicle in flight.team.vehicles.values():
        for event in vehicle.take_events():
            if not (event.kind == "done" and event.subject.startswith("interval")):
                flight.say(event.kind, event.message, vehicle)
            if vehicle.system in flight.number:
                _judge(flight, vehicle, event)


def _judge(flight: "Conductor", vehicle: Vehicle, event: VehicleEvent) -> None:
    if event.kind == "done" and event.subject in {"grab", "release"}:
        vehicle.gripped = event.subject == "grab"
    if flight.stage not in {"fly", "leave"}:
        return
    k, name = flight.number[vehicle.system] - 1, flight.name(vehicle)
    flying = bool(flight.expected_armed[k]) and not _may_be_down(flight, vehicle)
    match event.kind:
        case "failed":
            failure(flight, "command failed", f"{name}: {event.message}", vehicle)
        case "disarmed" if flying:
            flight.streaming[k] = False
            failure(flight, "disarmed", f"{name} disarmed in flight", vehicle)
        case "mode" if flying and flight.streaming[k] and not vehicle.in_mode("offboard"):
            flight.streaming[k] = False
            said = vehicle.recent_words(flight.now)
            words = f"{name} left offboard mode by itself: {event.message}"
            failure(flight, "left offboard", words + (f" ({said})" if said else ""), vehicle)
        case "rebooted":
            flight.streaming[k] = False
            failure(flight, "rebooted", f"{name} {event.message}", vehicle)
        case "origin":
            failure(flight, "origin moved", f"{name}: {event.message}", vehicle)


def _may_be_down(flight: "Conductor", vehicle: Vehicle) -> bool:
    """Whether the vehicle was told to land: leaving offboard and disarming are then meant."""
    if flight.way_out is not None:
        return flight.way_out.told_to_land(vehicle)
    return flight.waiting and flight.gates[flight.gate].condition == "landed"
