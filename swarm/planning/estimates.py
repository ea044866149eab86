"""What can be said of a mission before it is folded: its vehicles, and the weight of its cable."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from swarm.errors import Refused
from swarm.knots.catalog import choose_knot
from swarm.mission import Mission
from swarm.mission.fleet import Fleet
from swarm.planning.few_vehicles import least_vehicles

Floats = npt.NDArray[np.float64]


_RESERVE = 3.0
"""Proposed payload over the least one: sag and sideways pull took 2.0 times it in the figure-eight,
and the cable swings."""


def vehicles_needed(mission: Mission) -> int:
    """Return the number of vehicles that is known before planning.

    It is the number of places of a formation, of given corners, or 2N − 1 of the grid; or
    ``vehicles.count`` where that is a number, and its lower bound where that is ``fewest``.

    Raises :class:`swarm.errors.InputError` for a knot that does not exist.
    """
    if mission.formation is not None:
        return len(mission.formation.places[0])
    if mission.layout.corners is not None:
        return len(mission.layout.corners)
    assert mission.knot is not None  # noqa: S101 - a mission has a knot or a formation
    choice = choose_knot(**mission.knot.model_dump())
    match mission.vehicles.count:
        case "auto":
            return choice.vehicles
        case "fewest":
            return least_vehicles(choice.crossings)
        case count:
            return count


def require_fleet(mission: Mission, fleet: Fleet) -> None:
    """Raise :class:`swarm.errors.Refused` where the fleet has fewer vehicles than are needed."""
    needed = vehicles_needed(mission)
    if len(fleet.vehicles) < needed:
        raise Refused(
            f"the plan needs {needed} vehicles, the fleet {fleet.name} has {len(fleet.vehicles)}"
        )


def refuse_overload(mission: Mission, layouts: Sequence[Floats]) -> None:
    """Refuse a cable that is too heavy for the vehicles in every layout.

    ``layouts`` are corners (n, 2) in metres, in the smallest cells. In the hold all corners are at
    one height, so that each vehicle carries half of its segments' weight, and a segment is longer
    than the distance of its corners: the real force is larger, since strands sag and pull sideways.

    Raises :class:`swarm.errors.Refused` with the heaviest cable that these vehicles could carry.
    """
    carried = [_largest_share(corners) for corners in layouts]
    least = min(carried)
    vehicles, cable = mission.vehicles, mission.cable
    if cable.mass_per_length * least <= vehicles.payload:
        return
    heaviest = vehicles.payload / least
    required = cable.mass_per_length * least
    raise Refused(
        f"payload: {len(layouts[0])} vehicles of {_grams(vehicles.payload)} payload carry at most "
        f"{_grams(heaviest)}/m in this layout, where one vehicle holds at least "
        f"{least:.1f} m of cable; "
        f"cable.mass_per_length is {_grams(cable.mass_per_length)}/m. For example: "
        f"--set cable.mass_per_length={heaviest / _RESERVE:.2g}, or vehicles that carry more: "
        f"--set vehicles.payload={_RESERVE * required:.2g}"
    )


def _largest_share(corners: Floats) -> float:
    """Return the largest length of cable, in metres, that hangs on one vehicle at least."""
    halves = 0.5 * np.linalg.norm(np.diff(corners, axis=0), axis=1)
    shares = np.concatenate([halves, [0.0]]) + np.concatenate([[0.0], halves])
    return float(shares.max())


def _grams(kilograms: float) -> str:
    return f"{1e3 * kilograms:.2g} g" if kilograms < 0.1 else f"{kilograms:.2g} kg"
