"""The emulator's world file for a plan and a fleet."""

from typing import Any

import numpy as np

from swarm.mission.fleet import Fleet, Place
from swarm.planning import Plan
from swarm.planning.cable_shape import laid_cable


def emulated_world(plan: Plan, fleet: Fleet, *, with_cable: bool, seed: int) -> dict[str, Any]:
    """Return the world for a plan: vehicles on their pads, the cable as the plan expects it.

    ENU metres and SI units, without knots or grids. Vehicles are in the fleet's order,
    the first n of them on the plan's pads.
    """
    mission, origin = plan.mission, fleet.origin
    pads = plan.motion.at(0.0)[0]
    world: dict[str, Any] = {
        "schema": 1,
        "seed": seed,
        "floor": 0.0,
        "projection": "autopilot",
        "indoor": fleet.frame == "shared",
        "wind": {"steady": [mission.wind.steady, 0.0, 0.0], "gust": mission.wind.gust},
        "biases": fleet.emulated.biases if fleet.emulated else "default",
        "vehicles": [
            {
                "id": listed.sysid,
                "autopilot": listed.autopilot,
                "pad": [float(x) for x in pads[(listed.pad or place) - 1]],
                "heading": _heading(listed.sysid, fleet, seed),
                "mass": mission.vehicles.mass,
                "payload": mission.vehicles.payload,
                "radius": mission.vehicles.radius,
                "grip_offset": mission.vehicles.grip_offset,
                "gripper": _gripper(plan, fleet, with_cable),
            }
            for place, listed in enumerate(fleet.vehicles[: plan.vehicles], 1)
        ],
    }
    if origin is not None:
        world["origin"] = _origin(origin)
    if fleet.emulated is not None:
        world["capture"] = fleet.emulated.capture.model_dump()
    gripped = next((gate.time for gate in plan.gates if gate.condition == "gripped"), None)
    if with_cable and gripped is not None:
        points = laid_cable(plan)
        points[:, 2] = 0.5 * mission.cable.diameter
        world["cable"] = {
            "mass_per_length": mission.cable.mass_per_length,
            "diameter": mission.cable.diameter,
            "breaking_load": mission.cable.breaking_load,
            "model": fleet.emulated.cable if fleet.emulated else "static",
            "points": points.tolist(),
        }
        if mission.grab == "attached":
            world["cable"]["attached"] = np.append(0.0, np.cumsum(plan.layout.lengths)).tolist()
    return world


def _gripper(plan: Plan, fleet: Fleet, with_cable: bool) -> str:
    if plan.mission.grab == "attached" and len(plan.layout.lengths) and with_cable:
        return "attached"
    return "mavlink" if fleet.gripper == "mavlink" else "none"


def _heading(system: int, fleet: Fleet, seed: int) -> float:
    """Return a vehicle's heading on its pad, radians from north: random, or 0 without biases."""
    if fleet.emulated is not None and fleet.emulated.biases == "none":
        return 0.0
    return float(np.random.default_rng([seed, system]).uniform(-np.pi, np.pi))


def bare_world(fleet: Fleet) -> dict[str, Any]:
    """Return a world with the fleet's vehicles only, three metres apart, for ground checks."""
    world: dict[str, Any] = {
        "schema": 1,
        "seed": fleet.emulated.seed if fleet.emulated else 1,
        "projection": "autopilot",
        "indoor": fleet.frame == "shared",
        "vehicles": [
            {"id": listed.sysid, "autopilot": listed.autopilot, "pad": [3.0 * place, 0.0, 0.0]}
            for place, listed in enumerate(fleet.vehicles)
        ],
    }
    if fleet.origin is not None:
        world["origin"] = _origin(fleet.origin)
    return world


def _origin(place: Place) -> dict[str, float]:
    return {
        "latitude": place.latitude,
        "longitude": place.longitude,
        "altitude": place.altitude if place.altitude is not None else 0.0,
    }
