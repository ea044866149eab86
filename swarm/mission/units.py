"""Values that people give in a smaller unit than the key's."""

import math
from collections.abc import Mapping
from typing import Any

_SMALLER_UNITS: Mapping[str, tuple[float, ...]] = {
    "metres": (1e-3, 1e-2),  # millimetres, centimetres
    "kg": (1e-3,),  # grams
    "kg/m": (1e-3,),  # grams per metre
    "m/s": (1.0 / 3.6,),  # kilometres per hour
    "m/s²": (1e-3,),
    "newtons": (1e-3,),
    "s": (1e-3,),  # milliseconds
}
"""Unit of a key → the smaller units that people write, in this unit."""


_LARGER_UNITS: Mapping[str, float] = {"s": 60.0}
"""Unit of a key → the larger unit that people write, in this unit: minutes."""

_ALIKE = 4.0
"""Largest ratio of a value in minutes to the default: endurances are 5 to 40 minutes, by default
10."""


def other_unit(value: float, unit: str, bounds: tuple[float, float], typical: Any) -> str:
    """Return ``: did you mean …?`` for a value out of bounds that was given in another unit.

    Of several units the one is chosen whose value is nearest to the ``typical`` one. Empty for a
    value in its bounds, and where no unit fits.
    """
    least, most = bounds
    known = isinstance(typical, int | float) and typical > 0
    values = [share * value for share in _SMALLER_UNITS.get(unit, ()) if value > most]
    values = [one for one in values if least <= one <= most]
    if 0 < value < least and known and unit in _LARGER_UNITS:
        longer = _LARGER_UNITS[unit] * value
        values = [longer] if 1.0 / _ALIKE <= longer / typical <= _ALIKE else []
    if not values:
        return ""
    likely = min(values, key=lambda one: abs(math.log(one / typical))) if known else values[0]
    return f": did you mean {likely:.3g}?"
