"""One tick's telemetry of the team, as arrays over its n vehicles, and the setpoints to compare.

Positions are of grip points, mission ENU, SI.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from swarm.certification.monitor import Clearances, Monitor
from swarm.flight.estimation import Measured
from swarm.flight.failures import HoldCause
from swarm.mavlink.telemetry_table import Reports
from swarm.planning import CableState

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]

FIX_3D = 3
"""GPS_FIX_TYPE_3D_FIX."""


@dataclass(frozen=True, eq=False)
class Observation(Reports):
    """The latest reports of n vehicles at the time ``now``.

    ``table`` (m, WIDTH) is the team's telemetry table, ``rows`` (n,) the vehicles' rows in it, and
    ``values`` (n, WIDTH) what stood there: every number of :class:`Reports` is an attribute (n,).
    ``measured`` are their places. NaN: not known.
    """

    now: float
    names: Sequence[str]
    table: Floats
    rows: Indices
    measured: Measured
    values: Floats
    row: None = None

    @classmethod
    def of(
        cls, now: float, names: Sequence[str], table: Floats, rows: Indices, measured: Measured
    ) -> "Observation":
        """Return the observation of vehicles whose positions have been ``measured``."""
        return cls(now, names, table, rows, measured, table[rows])

    @property
    def position(self) -> Floats:
        """Grip points now (n, 3)."""
        return self.measured.position

    @property
    def velocity(self) -> Floats:
        """Velocities as reported (n, 3)."""
        return self.measured.velocity

    @property
    def error(self) -> Floats:
        """Tracking errors (n,) in metres; NaN: not known."""
        return self.measured.error

    @property
    def poor_fix(self) -> Flags:
        """Whether a vehicle (n,) has a GPS receiver without a position in space."""
        flags: Flags = (self.fix_type >= 0) & (self.fix_type < FIX_3D)
        return flags

    @cached_property
    def largest_error(self) -> float:
        """The largest known tracking error in metres; 0 where none is known."""
        known = [error for error in self.error.tolist() if not math.isnan(error)]
        return max(known, default=0.0)

    def silent_for(self, k: int) -> float:
        """Return the seconds since a packet of a vehicle was received."""
        return self.now - float(self.received_at[k])

    def unanswered_for(self, k: int) -> float:
        """Return the seconds for which a vehicle that is received has not answered; 0 where it has.

        Where nothing was received since the request, its silence tells as much.
        """
        asked = float(self.asked_at[k])
        return self.now - asked if asked < self.received_at[k] else 0.0

    def shifted(self, k: int, jump: Floats) -> "Observation":
        """Return the same with a vehicle's position moved back by (3,) metres."""
        places = self.measured.places.copy()
        measured = Measured(places, self.measured.numbers)
        measured.reported[k] -= jump
        measured.position[k] -= jump
        return replace(self, measured=measured)


@dataclass
class Sample:
    """Positions at one moment and a moment ahead.

    ``moments`` (2, n, 3) are grip points, mission ENU; ``strays`` (n − 1,) how far the strands
    swing from their catenaries, where that is estimated. Clearances are computed where they are
    read; the clock mostly needs a bound of the strands' distances alone.
    """

    monitor: Monitor
    moments: Floats
    cable: CableState
    strays: Floats | None = None

    @cached_property
    def clearances(self) -> Clearances:
        """Distances now; the margin is the smaller of now and ahead."""
        here, ahead = self.monitor.clearances(self.moments, self.cable)
        return min(
            here,
            replace(here, margin=ahead.margin, kind=ahead.kind),
            key=lambda distances: distances.margin,
        )

    @cached_property
    def pace(self) -> float:
        """The largest permitted rate of the clock, 0…1."""
        pace = self.monitor.clock_rate(self.moments, self.cable)
        if self.strays is None:
            return pace
        return min(pace, self.monitor.swinging_rate(self.moments, self.strays))


@dataclass(frozen=True, eq=False)
class Expected:
    """The commanded state of n vehicles, with which their observation is compared.

    ``setpoint`` and ``velocity`` (n, 3); ``streaming`` (n,) which vehicles get setpoints, ``armed``
    (n,) which must be armed, ``may_land`` (n,) which have been commanded to land. ``fallen`` are
    vehicles that have been given up, ``rejoining`` those that return to offboard mode, ``opening``
    those others that were to release outside the plan. ``start_height`` (n,) in metres is the
    height of the pads. ``cable`` is the state of the cable in the present phase. ``descending``
    says whether the team descends outside the plan, ``waiting`` whether the clock waits at a gate,
    ``holds`` why it is held. ``rate`` (−1…1) is the clock's; ``rewinding`` whether it runs
    backwards; ``allowed_error`` the tracking error in metres at which it stands still;
    ``monitored`` the live monitor's latest sample. ``blocked`` is for how many seconds a team that
    has left the plan could not move on to where it is to land.
    """

    setpoint: Floats
    velocity: Floats
    streaming: Flags
    armed: Flags
    may_land: Flags
    fallen: frozenset[int]
    rejoining: frozenset[int]
    opening: frozenset[int]
    start_height: Floats
    cable: CableState
    descending: bool
    waiting: bool
    holds: Mapping[HoldCause, str]
    rate: float
    rewinding: bool
    allowed_error: float
    monitored: Sample | None
    blocked: float
