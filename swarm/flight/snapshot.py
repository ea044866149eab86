"""The flight at one moment, for displays and records."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from swarm.certification.monitor import Clearances

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Snapshot:
    """The team at one moment, by its reports.

    ``time`` is seconds since the flight's record began, ``mission_time`` and ``rate`` the mission
    clock. ``position``, ``velocity`` and ``setpoint`` (n, 3) are of grip points in mission ENU,
    NaN where unknown; ``battery`` (n,) is a share 0…1, ``link_age`` (n,) seconds since a vehicle
    was last received. ``modes`` and ``states`` are words per vehicle. ``clearances`` come from the
    live monitor (None while the cable is on the floor); ``available`` has, for each operator
    command, whether it is possible now, and its effect. ``round_trip`` (n,) is the latest in
    seconds, ``received`` and ``lost`` (n,) count packets since the record began; empty where they
    are not counted.

    ``waiting_for`` is what the clock waits for, ``held`` why the team holds, ``time_left`` the
    seconds until the gate's or the hold's timeout, ``remaining`` the seconds to the end of the plan
    without waiting; None where they do not apply. ``stray`` (n − 1,) is how far each strand is
    estimated from its catenary, in metres, and ``cable`` (n − 1, k, 3) are points of the strands;
    None while no cable is aloft.
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
    held: str | None = None
    time_left: float | None = None
    remaining: float | None = None
    stray: Floats | None = None
    cable: Floats | None = None


@dataclass(frozen=True)
class Event:
    """An event: seconds since the record began, kind, message, and the vehicle (from 1)."""

    time: float
    kind: str
    message: str
    vehicle: int | None = None
