"""One tick's telemetry of the team, as arrays over its n vehicles, and the setpoints to compare.

Positions are of grip points, mission ENU, SI.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from swarm.flight.estimation import Measured
from swarm.flight.failures import HoldCause
from swarm.flight.monitoring import Sample
from swarm.mavlink.telemetry_table import (
    ARMED,
    ASKED_AT,
    ATTITUDE,
    BATTERY,
    FIX_TYPE,
    GRIPPED,
    HEIGHT_DIFFERENCE,
    MODE_AT,
    POSITION_AT,
    POSITION_HEALTHY,
    RECEIVED_AT,
    VERTICAL_ACCURACY,
)
from swarm.planning import CableState

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]

FIX_3D = 3
"""GPS_FIX_TYPE_3D_FIX."""


@dataclass(frozen=True, eq=False)
class Observation:
    """The latest reports of n vehicles at the time ``now``.

    ``table`` (m, WIDTH) is the team's telemetry table, ``rows`` (n,) the vehicles' rows in it.
    ``heard_at``, ``asked_at`` (`VehicleState`), ``position_at`` and ``mode_at`` (n,) are times in
    seconds; ``attitude`` (n, 3) roll, pitch and yaw in radians. ``battery`` (n,) is a share 0…1,
    ``located`` (n,) whether the vehicle has a position estimate, ``fix`` (n,) GPS_FIX_TYPE (-1: not
    reported). ``height_gap`` (n,) in metres is the local height against the GPS,
    ``height_accuracy`` (n,) the receiver's own statement; ``gripped`` (n,) whether the vehicle
    holds the cable, ``armed`` (n,) whether its motors run. NaN: not known.
    """

    now: float
    names: Sequence[str]
    table: Floats
    rows: Indices
    measured: Measured
    heard_at: Floats
    asked_at: Floats
    position_at: Floats
    attitude: Floats
    mode_at: Floats
    battery: Floats
    located: Flags
    fix: Floats
    height_gap: Floats
    height_accuracy: Floats
    gripped: Flags
    armed: Flags

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
        flags: Flags = (self.fix >= 0) & (self.fix < FIX_3D)
        return flags

    @cached_property
    def largest_error(self) -> float:
        """The largest known tracking error in metres; 0 where none is known."""
        known = [error for error in self.error.tolist() if not math.isnan(error)]
        return max(known, default=0.0)

    def silent_for(self, k: int) -> float:
        """Return the seconds since a packet of a vehicle was received."""
        return self.now - float(self.heard_at[k])

    def unanswered_for(self, k: int) -> float:
        """Return the seconds for which a vehicle that is received has not answered; 0 where it has.

        Where nothing was received since the request, its silence tells as much.
        """
        asked = float(self.asked_at[k])
        return self.now - asked if asked < self.heard_at[k] else 0.0

    def shifted(self, k: int, jump: Floats) -> "Observation":
        """Return the same with a vehicle's position moved back by (3,) metres."""
        places = self.measured.places.copy()
        measured = Measured(places, self.measured.numbers)
        measured.reported[k] -= jump
        measured.position[k] -= jump
        return replace(self, measured=measured)


def observation_of(
    now: float, names: Sequence[str], table: Floats, rows: Indices, measured: Measured
) -> Observation:
    """Return the observation of vehicles whose positions have been ``measured``."""
    reported = table[rows]
    return Observation(
        now=now,
        names=names,
        table=table,
        rows=rows,
        measured=measured,
        heard_at=reported[:, RECEIVED_AT],
        asked_at=reported[:, ASKED_AT],
        position_at=reported[:, POSITION_AT],
        attitude=reported[:, ATTITUDE : ATTITUDE + 3],
        mode_at=reported[:, MODE_AT],
        battery=reported[:, BATTERY],
        located=reported[:, POSITION_HEALTHY] > 0.0,
        fix=reported[:, FIX_TYPE],
        height_gap=reported[:, HEIGHT_DIFFERENCE],
        height_accuracy=reported[:, VERTICAL_ACCURACY],
        gripped=reported[:, GRIPPED] > 0.0,
        armed=reported[:, ARMED] > 0.0,
    )


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
