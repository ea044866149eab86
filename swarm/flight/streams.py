"""The streams of setpoints: to which vehicles they go, and the packets of this tick."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from swarm.flight.estimation import setpoints_ned
from swarm.flight.guidance import State
from swarm.flight.router import Outgoing
from swarm.flight.stages import Stage
from swarm.flight.state import FlightState

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


def start_stream(flight: FlightState, k: int) -> None:
    """Begin to send setpoints to a vehicle, from its position, blending into the plan."""
    if not flight.streams.active[k]:
        _set_active(flight, k, active=True)
        position = flight.observation.position[k]
        flight.guidance.join(k, position, flight.clock.time, flight.timing.moving)


def stop_stream(flight: FlightState, k: int) -> None:
    """End the setpoints to a vehicle."""
    if flight.streams.active[k]:
        _set_active(flight, k, active=False)


def stop_all_streams(flight: FlightState) -> None:
    """End all setpoints."""
    active = np.zeros_like(flight.streams.active)
    flight.streams = replace(flight.streams, active=active)


def stop_streams_of_landing(flight: FlightState) -> None:
    """End the setpoints to vehicles that have left offboard mode to land."""
    for k, vehicle in enumerate(flight.roster.vehicles):
        if flight.streams.active[k] and vehicle.in_mode("land"):
            stop_stream(flight, k)


def expect_armed(flight: FlightState, *, armed: bool = True) -> None:
    """From now on, a vehicle that is not armed has failed; or none has."""
    expected = np.full_like(flight.streams.expected_armed, armed)
    flight.streams = replace(flight.streams, expected_armed=expected)


def give_up(flight: FlightState, k: int) -> None:
    """Give up a vehicle that falls: no setpoints any more."""
    stop_stream(flight, k)
    flight.streams = replace(flight.streams, fallen=flight.streams.fallen | {k})


def begin_rejoining(flight: FlightState, k: int) -> None:
    """Begin to send setpoints to a vehicle that shall return to offboard mode."""
    rejoining = {**flight.streams.rejoining, k: flight.now}
    flight.streams = replace(flight.streams, rejoining=rejoining)
    start_stream(flight, k)


def end_rejoining(flight: FlightState, k: int) -> None:
    """Note that a vehicle has returned, or has not in time."""
    rejoining = {j: since for j, since in flight.streams.rejoining.items() if j != k}
    flight.streams = replace(flight.streams, rejoining=rejoining)


def setpoints(flight: FlightState) -> list[Outgoing]:
    """Return the setpoints of this moment, for every vehicle with a stream."""
    frames, setup = flight.placement.frames, flight.setup
    if frames is None or flight.stage not in {Stage.EXECUTE, Stage.CONTINGENCY}:
        return []
    state = flight.guidance.state(flight.clock, flight.timing.moving)
    active, roster = flight.streams.active, flight.roster
    packets: list[Outgoing] = []
    if np.count_nonzero(active):
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
            roster.systems, active, flight.now, states, flight.placement.yaw
        )
    flight.streams = replace(
        flight.streams,
        setpoint=state.position,
        velocity=state.velocity,
        sent=flight.streams.sent + len(packets),
    )
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


def _set_active(flight: FlightState, k: int, *, active: bool) -> None:
    changed = flight.streams.active.copy()
    changed[k] = active
    flight.streams = replace(flight.streams, active=changed)
