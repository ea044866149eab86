"""Whether a team outside the plan may land or release at a moment, or waits for a vehicle."""

from collections.abc import Collection

import numpy as np
import numpy.typing as npt

from swarm.certification.contingency_windows import above_rotors, rotors_clear
from swarm.flight.pace import rewind_end
from swarm.flight.policy import Response, Windows
from swarm.flight.router import answer_limit
from swarm.flight.state import FlightState
from swarm.mavlink.vehicle import Vehicle

LONGEST_HOVER, DESCENT_SPEED = 5.0, 0.2
"""Seconds for which the team waits until a vehicle that lands alone descends, and the speed in m/s
from which it does: ArduPilot hovers for 4 s before the landing of a failsafe (LAND_WITH_DELAY_MS in
its source). In a simulated flight, a team that descended at once pulled the cable taut there."""
TOUCHDOWN = 0.05
"""Height of a setpoint in metres at which a vehicle is commanded to land."""
LAG = 0.5
"""Metres by which a vehicle may stay off its place in a common descent: the largest tracking
error of a vehicle that follows is 0.2 m in winds that plans allow for."""


def windows(flight: FlightState) -> Windows:
    """Return what the plan and the vehicles' places allow at this moment."""
    landable = flight.setup.windows.can_land(flight.clock.time)
    return Windows.of(landable=landable, releasable=may_release(flight))


def may_release(flight: FlightState) -> bool:
    """Return whether no cable hangs above a rotor: as planned, and where vehicles do not follow.

    Such vehicles stopped by themselves, the others along the path: some decimetres apart.
    """
    if not flight.setup.windows.can_release(flight.clock.time):
        return False
    return not not_following(flight) or bool(rotors_clear(flight.setup.plan, _places(flight))[0])


def may_release_at(flight: FlightState, vehicles: Collection[int]) -> bool:
    """Return whether the strands beside some vehicles hang above no rotor: these would fall."""
    above = _above_rotors(flight)
    strands = {s for k in vehicles for s in (k - 1, k) if 0 <= s < above.shape[1]}
    return not above[:, sorted(strands)].any()


def turning_below_cable(flight: FlightState) -> list[Vehicle]:
    """Return the vehicles on the ground whose rotors still turn, with cable above them.

    None while a vehicle flies alone: the others keep their heights above it as they descend.
    """
    if _any_flies_alone(flight):
        return []
    gripped = flight.observation.gripped
    held = np.logical_and(gripped[:-1], gripped[1:])
    below: npt.NDArray[np.bool_] = np.any(_above_rotors(flight)[:, held], axis=1)
    return [
        vehicle
        for k, vehicle in enumerate(flight.roster.vehicles)
        if below[k] and (vehicle.on_ground or flight.streams.setpoint[k, 2] <= TOUCHDOWN)
    ]


def held_by_cable(flight: FlightState) -> list[int]:
    """Return the one or two vehicles that a caught strand holds back while the others descend.

    They are aside or above by more than LAG, and by twice as much as any other: cable that comes to
    lie on the floor pulls by 0.2 m. Those that land are held where they do not descend. Not while a
    vehicle flies alone: it pulls its neighbours. Positions in a frame that moved show nothing.
    """
    if _any_flies_alone(flight):
        return []
    seen, streams, vehicles = flight.observation, flight.streams, flight.roster.vehicles
    off = seen.position - streams.setpoint
    off[:, 2] = np.maximum(off[:, 2], 0.0)
    error = np.linalg.norm(off, axis=1)
    flies = seen.armed & ~np.array([vehicle.on_ground for vehicle in vehicles])
    flies &= streams.active | (seen.velocity[:, 2] > -DESCENT_SPEED)
    flies[list(flight.placement.moved)] = False
    error = np.where(flies & np.isfinite(error), error, 0.0)
    far = error > LAG
    held = 1 <= far.sum() <= 2 and error[~far].max(initial=0.0) < 0.5 * error[far].min()
    return np.flatnonzero(far).tolist() if held else []


def _any_flies_alone(flight: FlightState) -> bool:
    """Return whether a vehicle in the air follows no setpoints, or may not.

    Those whose setpoints ended as they came down, to let them land, do not count.
    """
    vehicles = flight.roster.vehicles
    alone = [vehicles[k] for k in (flight.contingency.alone if flight.contingency else ())]
    alone += [*unanswering(flight), *(one for one in vehicles if not flight.received(one))]
    return any(vehicle.armed and not vehicle.on_ground for vehicle in alone)


def _above_rotors(flight: FlightState) -> npt.NDArray[np.bool_]:
    """Return above which turning rotors which strands are (n, n - 1)."""
    above: npt.NDArray[np.bool_] = above_rotors(flight.setup.plan, _places(flight))[0]
    above[~flight.observation.armed] = False
    return above


def _places(flight: FlightState) -> npt.NDArray[np.float64]:
    """Return the grip points (1, n, 3): as planned, or where vehicles are that do not follow."""
    places, position = flight.streams.setpoint.copy(), flight.observation.position
    for k in not_following(flight):
        if np.isfinite(position[k]).all():
            places[k] = position[k]
    return places[None]


def not_following(flight: FlightState) -> list[int]:
    """Return the vehicles that fly without setpoints."""
    streams = flight.streams
    return [k for k in np.flatnonzero(~streams.active).tolist() if k not in streams.fallen]


def adrift(flight: FlightState) -> list[int]:
    """Return the vehicles that do not know where they are, so that they keep no place."""
    seen, lost = flight.observation, ~flight.observation.located
    if flight.setup.fleet.frame == "gps":
        lost = lost | seen.poor_fix
    return [k for k in np.flatnonzero(lost).tolist() if k not in flight.streams.fallen]


def waits_to_land(flight: FlightState, since: float) -> bool:
    """Return whether the team must not descend yet, because a vehicle would stay above it.

    A vehicle that flies alone, and does not descend as it is commanded to, is waited for during
    LONGEST_HOVER, and T longer where it is not in a landing mode: one that receives nothing lands
    by itself T after the loss. So is a silent vehicle, which may be one. A pilot's vehicle is not.
    ``since`` is when the last one began to fly without setpoints, or the team left the plan.
    """
    limits, vehicles = flight.setup.fleet.limits, flight.roster.vehicles
    flying = [k for k, one in enumerate(vehicles) if one.armed and k not in flight.streams.fallen]
    silent_for = [flight.now - vehicles[k].received_at for k in flying]
    if any(limits.silence < silence <= limits.hold for silence in silent_for):
        return True
    rising = flight.observation.velocity[:, 2]
    hovering = [
        vehicles[k]
        for k in set(not_following(flight)).intersection(flying)
        if not vehicles[k].in_manual_mode
        and flight.received(vehicles[k])
        and rising[k] > -DESCENT_SPEED
    ]
    landing = all(vehicle.in_mode("land") for vehicle in hovering)
    longest = LONGEST_HOVER + (0.0 if landing else limits.hold)
    return bool(hovering) and flight.now - since <= longest


def stays_above(flight: FlightState) -> Vehicle | None:
    """Return a vehicle on the cable that hovers LAG or more above its place in the team's descent.

    Of a silent one the last position counts, until it lands by itself T after it was received. One
    on the ground reports a height above it where its barometer drifts.
    """
    seen, longest = flight.observation, flight.setup.fleet.limits.hold
    above = seen.position[:, 2] - flight.streams.setpoint[:, 2]
    for k, vehicle in enumerate(flight.roster.vehicles):
        flies = vehicle.armed and not vehicle.on_ground and k not in flight.streams.fallen
        descends = flight.received(vehicle) and seen.velocity[k, 2] < -DESCENT_SPEED
        if flies and above[k] > LAG and flight.received(vehicle, longest) and not descends:
            return vehicle if flight.attached else None
    return None


def nearest_open(flight: FlightState, response: Response) -> float | None:
    """Return the mission time at which a response is open, nearest to where the clock can stop."""
    windows_, clock, gates = flight.setup.windows, flight.clock, flight.setup.gates
    flags = windows_.land if response is Response.LAND else windows_.release
    gate = flight.progress.gate
    gate_before = gates[gate - 1].time if gate else 0.0
    gate_after = gates[gate].time if gate < len(gates) else flight.setup.plan.duration
    stopping = 0.5 * clock.rate * abs(clock.rate) / clock.steepest
    moment = min(max(clock.time + stopping, gate_before), gate_after)
    return windows_.nearest(flags, moment, rewind_end(flight), gate_after)


def unanswering(flight: FlightState) -> list[Vehicle]:
    """Return the vehicles that may not receive: they have not answered lately."""
    seen, longest = flight.observation, answer_limit(flight.setup.fleet.limits)
    return [
        vehicle
        for k, vehicle in enumerate(flight.roster.vehicles)
        if seen.unanswered_for(k) > longest and k not in flight.streams.fallen
    ]
