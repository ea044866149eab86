"""State of ArduCopter's modes, and the values that derive from it alone."""

import math
from typing import Any

from sitl.autopilots.ardupilot.tables import GUIDED, LOITER, MODES, STABILIZE
from sitl.protocol.mission_progress import MissionProgress
from sitl.protocol.vehicle import Vehicle

INFO, WARNING, CRITICAL = 6, 4, 2
"""MAV_SEVERITY."""
POSITION_READY = 42.0
"""Seconds after boot until the estimator has an absolute position."""
_TAKEN_OFF = 0.9
"""Share of the height at which a take-off ends."""
_LOGS_ON = 15.0
"""Seconds for which the log continues after disarming."""


class ArduPilotState:
    """Mode, failsafes and setpoints of one vehicle.

    ``submode`` is the kind of GUIDED ("takeoff", "posvel", …) or AUTO, ``stage`` the part of RTL
    or of a mission's landing.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self.v = vehicle
        self.booted = -math.inf
        self.has_origin = True
        self.reset()

    def reset(self) -> None:
        """Set the state after a boot."""
        self.mode = STABILIZE
        self.failsafe = False
        self.landing = False
        self.submode = ""
        self.setpoint_at = self.descend_at = -math.inf
        self.takeoff_at = -math.inf
        self.takeoff_height = self.takeoff_from = 0.0
        self.idle_since = 0.0
        self.has_flown = False
        self.goal: Any = None
        self.stage = ""
        self.stage_at = 0.0
        self.accepted_mask: int | None = None
        self.gcs_connected = self.gcs_lost = False
        self.checked = (-math.inf, False)
        self.radio_known = self.radio_failed = False
        self.radio_lost_at: float | None = None
        self.outside_fences = 0
        self.v.mission_progress = MissionProgress(first=1)
        self.battery_level = 0
        self.battery_low_at = {1: math.inf, 2: math.inf}
        self.position_lost_at: float | None = None
        self.prearm_at = 0.0
        self.tumbled_at: float | None = None
        self.landed_at = math.inf
        self.disarmed_at = -math.inf
        self.slow_at = -math.inf
        self.pilot = False

    @property
    def logging(self) -> bool:
        """Whether the autopilot writes its log: while armed, and for a while afterwards."""
        return self.v.armed or self.v.now - self.disarmed_at < _LOGS_ON

    @property
    def failsafe_active(self) -> bool:
        """Whether HEARTBEAT reports an active failsafe, in flight or not."""
        reported = self.gcs_lost or self.radio_failed or self.battery_level > 0
        return self.failsafe or reported

    @property
    def taking_off(self) -> bool:
        """Whether NAV_TAKEOFF is active: until its height, or a setpoint."""
        if self.submode != "takeoff":
            return False
        height = float(self.v.estimated()[2]) - self.takeoff_from
        return height < _TAKEN_OFF * (self.takeoff_height - self.takeoff_from)

    @property
    def target_mask(self) -> int | None:
        """Type mask of POSITION_TARGET_LOCAL_NED: the values that GUIDED accepted."""
        return self.accepted_mask if self.mode == GUIDED else None

    def custom_mode(self) -> int:
        """Return the mode's number."""
        return self.mode

    def base_mode(self) -> int:
        """Return the MAV_MODE_FLAG bits."""
        guided = 8 if MODES[self.mode].autonomous or self.mode == LOITER else 0
        return 1 | 16 | 64 | guided | (128 if self.v.armed else 0)

    def position_ok(self) -> bool:
        """Return whether the estimator has an absolute position."""
        return self.v.local_valid and self.v.now - self.booted >= POSITION_READY
