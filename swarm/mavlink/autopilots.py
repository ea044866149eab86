"""What is different between autopilots, as a table: modes, take-off, frames.

Mode numbers: PX4 packs a main and a sub mode into HEARTBEAT.custom_mode (bits 16–23 and 24–31) and
takes them apart in MAV_CMD_DO_SET_MODE; ArduPilot Copter numbers its modes. PX4 sends HEARTBEAT
once a second and refuses any other rate, but says CURRENT_MODE whenever that changes (from 1.15).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from pymavlink.dialects.v20 import common

from swarm.mavlink.frames import Projection
from swarm.mavlink.packets import CURRENT_MODE

Mode = Literal["offboard", "hold", "land"]

_PX4_MAIN = {
    1: "manual", 2: "altitude", 3: "position", 4: "auto", 5: "acro", 6: "offboard",
    7: "stabilized", 8: "rattitude",
}  # fmt: skip
_PX4_AUTO = {
    1: "ready", 2: "takeoff", 3: "hold", 4: "mission", 5: "return", 6: "land", 8: "follow",
    9: "precision land",
}  # fmt: skip
_COPTER = {
    0: "stabilize", 1: "acro", 2: "altitude hold", 3: "auto", 4: "guided", 5: "loiter",
    6: "return", 7: "circle", 9: "land", 11: "drift", 13: "sport", 14: "flip", 15: "autotune",
    16: "position hold", 17: "brake", 18: "throw", 19: "avoid ADSB", 20: "guided without GPS",
    21: "smart return", 22: "flow hold", 23: "follow", 24: "zigzag", 27: "auto return",
}  # fmt: skip
BY_HAND = frozenset(
    {"manual", "altitude", "position", "acro", "stabilized", "rattitude", "stabilize",
     "altitude hold", "loiter", "drift", "sport", "position hold", "flow hold"}
)  # fmt: skip
"""Modes in which a pilot's sticks fly the vehicle."""


@dataclass(frozen=True)
class Autopilot:
    """One kind of autopilot.

    ``modes`` are parameters 2 and 3 of DO_SET_MODE. ``takes_off`` says that it must be told to
    take off and must not see setpoints until it flies; without it, it lifts with the setpoint.
    ``offboard_early`` says that it judges its readiness in offboard mode only. ``tells_mode`` is
    the message whose rate says how soon a change of mode is heard of. ``prearm_present`` says that
    SYS_STATUS lists the pre-arm check among the sensors present: ArduPilot does. PX4 (1.14 and
    later) sets its bit in the sensors' health alone, while the present mode can be armed in.
    ``bytewise`` says that whole numbers among its parameters travel as the bytes of an integer.
    """

    name: Projection
    identifier: int
    modes: Mapping[Mode, tuple[int, int]]
    takes_off: bool
    offboard_early: bool
    tells_mode: int
    prearm_present: bool
    bytewise: bool

    def custom_mode(self, mode: Mode) -> int:
        """Return what HEARTBEAT shows in this mode."""
        main, sub = self.modes[mode]
        return main << 16 | sub << 24 if self.name == "px4" else main

    def mode_name(self, custom_mode: int) -> str:
        """Return a word for what HEARTBEAT shows."""
        if self.name == "ardupilot":
            return _COPTER.get(custom_mode, f"mode {custom_mode}")
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
        name = _PX4_MAIN.get(main, f"mode {main}")
        return _PX4_AUTO.get(sub, f"auto {sub}") if name == "auto" else name


PX4 = Autopilot(
    name="px4",
    identifier=int(common.MAV_AUTOPILOT_PX4),
    modes={"offboard": (6, 0), "hold": (4, 3), "land": (4, 6)},
    takes_off=False,
    offboard_early=False,
    tells_mode=CURRENT_MODE,
    prearm_present=False,
    bytewise=True,
)

ARDUPILOT = Autopilot(
    name="ardupilot",
    identifier=int(common.MAV_AUTOPILOT_ARDUPILOTMEGA),
    modes={"offboard": (4, 0), "hold": (17, 0), "land": (9, 0)},
    takes_off=True,
    offboard_early=True,
    tells_mode=int(common.MAVLINK_MSG_ID_HEARTBEAT),
    prearm_present=True,
    bytewise=False,
)

AUTOPILOTS: Mapping[int, Autopilot] = {kind.identifier: kind for kind in (PX4, ARDUPILOT)}
