"""How far vehicles may be off their places in flights that measure errors, as a test hop does."""

from typing import TYPE_CHECKING

import numpy as np

from swarm.flight.failures import failure

if TYPE_CHECKING:
    from swarm.flight.conductor import Conductor


def watch_stray(flight: "Conductor") -> None:
    """Land all together where a vehicle is too far off its setpoint, or too near another one.

    Too far is the flight's ``stray_limit``, too near the mission's clearance between vehicles
    (level). Distances in the plan cannot tell, as errors here may be larger than it allows for.
    """
    landing = flight.waiting and flight.gates[flight.gate].condition == "landed"
    if flight.stray_limit is None or flight.stage != "fly" or landing:
        return
    _watch_errors(flight, flight.stray_limit)
    if flight.stage == "fly":
        _watch_distances(flight)


def _watch_errors(flight: "Conductor", limit: float) -> None:
    error = np.where(flight.streaming & np.isfinite(flight.error), flight.error, 0.0)
    worst = int(np.argmax(error))
    if error[worst] > limit:
        vehicle = flight.flyers[worst]
        words = f"{flight.name(vehicle)} is {error[worst]:.2f} m off its place, "
        failure(flight, "strayed", f"{words}more than the {limit:g} m allowed", vehicle)


def _watch_distances(flight: "Conductor") -> None:
    allowed = flight.plan.mission.clearance.vehicle
    first, second = np.triu_indices(len(flight.flyers), 1)
    level = flight.position[:, :2]
    apart = np.linalg.norm(level[first] - level[second], axis=1)
    near = np.flatnonzero(apart < allowed)
    if len(near):
        pair = near[np.argmin(apart[near])]
        one, other = (flight.flyers[k] for k in (first[pair], second[pair]))
        words = f"{flight.name(one)} and {flight.name(other)} are {apart[pair]:.2f} m apart, "
        failure(flight, "strayed", f"{words}nearer than the {allowed:g} m allowed", one)
