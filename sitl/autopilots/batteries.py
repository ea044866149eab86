"""Batteries of vehicles: discharge by momentum theory, and voltages under load."""

from collections.abc import Iterable

import numpy as np

from sitl.physics.dynamics import Bodies
from sitl.physics.geodesy import GRAVITY
from sitl.protocol.vehicle import Vehicle

_FULL_CELL, _EMPTY_CELL, _CELL_RESISTANCE = 4.2, 3.3, 0.004
_HOVER_CURRENT = 15.0


def discharge(vehicles: Iterable[Vehicle], bodies: Bodies, interval: float) -> None:
    """Discharge the batteries by seconds of the present thrust: power is as thrust^1.5."""
    load = (np.maximum(np.linalg.norm(bodies.thrust, axis=1), 0.0) / GRAVITY) ** 1.5 * bodies.armed
    for vehicle, share in zip(vehicles, load.tolist(), strict=True):
        if share > 0.0:
            vehicle.charge = max(0.0, vehicle.charge - interval * share / vehicle.spec.endurance)
        vehicle.current = _HOVER_CURRENT * share + 0.3
        sag = _CELL_RESISTANCE * vehicle.current
        cell = _EMPTY_CELL + (_FULL_CELL - _EMPTY_CELL) * vehicle.charge - sag
        vehicle.voltage = cell * vehicle.cells
