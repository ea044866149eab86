"""What the flight looks like at one moment: the only thing that views and records are shown."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from swarm.certification.monitor import Clearances

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Snapshot:
    """The team at one moment, as the ground station knows it.

    ``time`` is seconds since the flight's record began, ``mission_time`` and ``rate`` the mission
    clock. ``position``, ``velocity`` and ``setpoint`` (n, 3) are of grip points in mission ENU,
    NaN where unknown; ``battery`` (n,) is a share 0…1, ``link_age`` (n,) seconds since a vehicle
    was last heard. ``modes`` and ``states`` are words per vehicle. ``clearances`` are what the live
    monitor sees (None while the cable is on the floor); ``available`` says of each wish that the
    operator may have whether its window is open, and what it would do now. ``round_trip`` (n,) is
    the latest in seconds, ``received`` and ``lost`` (n,) count packets since the record began;
    empty where nobody counts.
    """

    time: float
    mission_time: float
    rate: float
    phase: str
    waiting_for: str | None
    position: Floats
    velocity: Floats
    setpoint: Floats
    modes: tuple[str, ...]
    states: tuple[str, ...]
    armed: tuple[bool, ...]
    gripped: tuple[bool, ...]
    battery: Floats
    link_age: Floats
    clearances: Clearances | None = None
    available: Mapping[str, tuple[bool, str]] = field(default_factory=dict)
    round_trip: Floats = field(default_factory=lambda: np.zeros(0))
    received: Floats = field(default_factory=lambda: np.zeros(0))
    lost: Floats = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class Event:
    """Something that happened: seconds since the record began, kind, words, and the vehicle."""

    time: float
    kind: str
    message: str
    vehicle: int | None = None
