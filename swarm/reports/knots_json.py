"""Knots and identified curves as JSON-ready objects."""

from typing import Any

from swarm.knots.catalog import KnotChoice
from swarm.knots.invariants import Identification


def knot_object(choice: KnotChoice) -> dict[str, Any]:
    """Return a knot with its codes, grid diagram and number of vehicles."""
    return {
        "name": choice.title or choice.name,
        "crossings": choice.crossings,
        "arc_index": choice.grid.size,
        "vehicles": choice.vehicles,
        "gauss": choice.gauss,
        "dt": list(choice.diagram.dt()),
        "chirality": choice.chirality,
        "grid": {"size": choice.grid.size, "columns": [list(pair) for pair in choice.grid.columns]},
    }


def identification_object(identification: Identification) -> dict[str, Any]:
    """Return the name of an identified curve and its invariants."""
    return {
        "name": identification.name,
        "chirality": identification.chirality,
        "crossings": identification.crossings,
        "candidates": list(identification.candidates),
        "invariants": identification.invariants,
    }
