"""State of PX4's commander and navigator, and the values that derive from it alone."""

import math
from typing import Any

from sitl.autopilots.px4.tables import MODES
from sitl.protocol import wire
from sitl.protocol.mission_progress import MissionProgress
from sitl.protocol.vehicle import Vehicle

INFO, WARNING, CRITICAL, EMERGENCY = 6, 4, 2, 0
"""MAV_SEVERITY."""
_AUTO, _OFFBOARD = 4, 6


class Px4State:
    """Modes, failsafes and setpoints of one vehicle.

    ``mode`` is active, ``intended`` is the user's mode, ``after_disarm`` the one to return to;
    ``latched`` is the mode of a failsafe that lasts until the user changes the mode.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self.v = vehicle
        self.has_origin = True
        self.reset()

    def reset(self) -> None:
        """Set the state after a boot."""
        self.intended = "LOITER"
        self.after_disarm = "LOITER"
        self.mode = "LOITER"
        self.failsafe = False
        self.landing = False
        self.offboard_at = -math.inf
        self._offboard: wire.Setpoint | bytes | None = None
        self.armed_at = 0.0
        self.has_flown = False
        self.landed_at: float | None = None
        self.goal: Any = None
        self.stage = ""
        self.pilot = False
        self.latched: str | None = None
        self.delay_until: float | None = None
        self.delayed: str | None = None
        self.battery_level = 0
        self.battery_at_arming = 0
        self.gcs_connected = self.gcs_known = False
        self.radio_known = False
        self.radio_lost_at: float | None = None
        self.outside_fence = False
        self.v.mission_progress = MissionProgress(first=0)
        self.all_axes = False
        self.slow_at = -math.inf
        self.tumble_reported = False
        self.ready_at = -math.inf

    @property
    def offboard(self) -> wire.Setpoint | None:
        """The last accepted setpoint."""
        if isinstance(self._offboard, bytes):
            self._offboard = wire.setpoint_in(self._offboard)
        return self._offboard

    @offboard.setter
    def offboard(self, setpoint: wire.Setpoint) -> None:
        self._offboard = setpoint

    @property
    def follows_setpoints(self) -> bool:
        """Whether the vehicle follows setpoints of all axes: another one changes only the goal."""
        return self.mode == "OFFBOARD" and self.all_axes

    def note_setpoint(self, data: bytes, now: float) -> None:
        """Record a setpoint packet whose goal is already set, while `follows_setpoints`."""
        self.offboard_at, self._offboard = now, data

    @property
    def target_mask(self) -> int | None:
        """Type mask of POSITION_TARGET_LOCAL_NED; None without an active controller."""
        if not self.v.armed:
            return None
        return self.offboard.mask if self.mode == "OFFBOARD" and self.offboard else 0

    @property
    def logging(self) -> bool:
        """Whether the autopilot writes its log: SDLOG_MODE 0 logs while armed."""
        return self.v.armed

    @property
    def failsafe_active(self) -> bool:
        """Whether HEARTBEAT reports an active failsafe."""
        return self.failsafe and self.v.armed

    @property
    def taking_off(self) -> bool:
        """Whether the take-off mode is active."""
        return self.mode == "TAKEOFF"

    def custom_mode(self) -> int:
        """Return main and sub mode of the active mode, as PX4 packs them."""
        mode = MODES[self.mode]
        return mode.main << 16 | mode.sub << 24

    def base_mode(self) -> int:
        """Return the MAV_MODE_FLAG bits of the active mode."""
        mode = MODES[self.mode]
        flags = 1 | 16
        if mode.main == _AUTO:
            flags |= 4 | 8
        elif mode.main != _OFFBOARD:
            flags |= 64
        return flags | (128 if self.v.armed else 0)
