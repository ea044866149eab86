"""The streams of setpoints: the packets of this tick, and vehicles that return to the team.

A vehicle that left offboard mode returns when the operator agrees: setpoints to it begin at its
position, and the team holds meanwhile. Without the operator's consent, a team returns vehicles only
to move to where it can land.
"""

import numpy as np
import numpy.typing as npt

from swarm.flight.estimation import setpoints_ned
from swarm.flight.failures import OPERATOR
from swarm.flight.guidance import State
from swarm.flight.router import Outgoing
from swarm.flight.stages import Stage
from swarm.flight.state import FlightState

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


STREAM_BEFORE_OFFBOARD = 1.0
"""Seconds of setpoints before offboard mode is commanded (PX4 requires a stream first)."""
REJOIN_TIMEOUT = 6.0
"""Seconds after which a vehicle that does not return to offboard mode gets no more setpoints."""


def outside(flight: FlightState) -> list[int]:
    """Return the vehicles that fly without setpoints and could return to the team."""
    streams = flight.streams
    return [
        k
        for k, vehicle in enumerate(flight.roster.vehicles)
        if streams.expected_armed[k]
        and not streams.active[k]
        and vehicle.armed
        and flight.received(vehicle)
        and not vehicle.in_manual_mode
        and k not in streams.fallen
    ]


def rejoin(flight: FlightState) -> None:
    """Send setpoints to the vehicles outside again, from where each is; the team holds."""
    flight.hold(OPERATOR, "vehicles rejoin")
    for k in outside(flight):
        flight.begin_rejoining(k)


def continue_rejoining(flight: FlightState) -> None:
    """Command offboard mode once a stream has run long enough; report which have returned."""
    for k, since in flight.streams.rejoining.items():
        vehicle = flight.roster.vehicles[k]
        waited = flight.now - since
        if vehicle.in_mode("offboard"):
            flight.streams.end_rejoining(k)
            flight.report("rejoin", f"{flight.name(vehicle)} follows again", vehicle)
            flight.holds.end_vehicle(vehicle.system)
        elif waited > REJOIN_TIMEOUT:
            flight.streams.end_rejoining(k)
            flight.streams.switch(k, on=False)
            flight.report("rejoin", f"{flight.name(vehicle)} does not rejoin", vehicle)
        elif waited > STREAM_BEFORE_OFFBOARD:
            vehicle.set_mode("offboard")


def setpoints(flight: FlightState) -> list[Outgoing]:
    """Return the setpoints of this moment, for every vehicle with a stream."""
    frames, setup = flight.placement.frames, flight.setup
    if frames is None or flight.stage not in {Stage.EXECUTE, Stage.CONTINGENCY}:
        return []
    state = flight.guidance.state(flight.clock, flight.timing.moving)
    streams, roster = flight.streams, flight.roster
    packets: list[Outgoing] = []
    if np.count_nonzero(streams.active):
        # a setpoint stands until the next one comes: aim at the middle of its time
        lead = 0.5 / setup.fleet.rates.setpoint
        held = setup.carries_cable and all(vehicle.gripped for vehicle in roster.vehicles)
        pull = setup.pull.around(flight.clock.time) if held else setup.pull.none()
        states = np.empty((len(roster.systems), 3, 3))
        mobility = _mobility(flight)
        acceleration = against_drag(flight, state, mobility > 0.0)
        setpoints_ned(
            (state.position, state.velocity, acceleration), lead, mobility, pull,
            (frames.rotation, frames.translation, setup.lift), states,
        )  # fmt: skip
        packets = flight.team.setpoints(
            roster.systems, streams.active, flight.now, states, flight.placement.yaw
        )
    streams.setpoint, streams.velocity = state.position, state.velocity
    streams.sent += len(packets)
    return packets


def _mobility(flight: FlightState) -> Floats:
    """Return the acceleration per force (n,), 1/kg, with which the cable's pull is fed forward.

    It is 0 for autopilots that do not add accelerations: their integrators resist the pull.
    """
    per_mass = 1.0 / flight.setup.plan.mission.vehicles.mass
    kinds = [vehicle.autopilot for vehicle in flight.roster.vehicles]
    return np.array([per_mass if kind and kind.adds_acceleration else 0.0 for kind in kinds])


def against_drag(flight: FlightState, state: State, adds: Flags) -> Floats:
    """Return the accelerations (n, 3) of a state, with those against the drag of the vehicles.

    Integrators follow a change of the drag only slowly: with the fitted drag, the emulated overhand
    is 0.066 m off in the fold instead of 0.078 m. The drag is that of the fleet file, or else the
    one fitted in this flight. ``adds`` (n,) says whose autopilots add accelerations.
    """
    stated, fitted = flight.setup.drag, flight.detectors.grip_slip.drag
    drag = np.array([stated.get(system, fitted) for system in flight.roster.systems])
    against: Floats = state.acceleration.copy()
    against[adds, :2] += drag[adds, None] * state.velocity[adds, :2]
    return against
