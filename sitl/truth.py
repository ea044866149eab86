"""Ground truth, for tests and records only."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Truth:
    """The true state at ``time`` (world ENU, SI).

    ``position`` (n, 3) are grip points in the file's order of vehicles, ``velocity`` (n, 3),
    ``tilt`` (n,) radians from vertical, ``gripped`` (n,), ``grip_arc`` (n,) the arc length of each
    grip (NaN: none), ``cable`` (m, 3) samples along the cable (empty without one), ``tension``,
    ``chord`` and ``length`` of the spans between grips, ``contacts`` between vehicles or with the
    ground, ``strikes`` of rotors on cable and all ``events`` since the start.
    """

    time: float
    ids: tuple[int, ...]
    position: Array
    velocity: Array
    tilt: Array
    armed: NDArray[np.bool_]
    landed: NDArray[np.bool_]
    gripped: NDArray[np.bool_]
    grip_arc: Array
    cable: Array
    tension: Array
    chord: Array
    length: Array
    charge: Array
    contacts: tuple[dict[str, Any], ...]
    strikes: tuple[dict[str, Any], ...]
    events: tuple[dict[str, Any], ...]
