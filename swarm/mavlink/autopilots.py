"""The differences between autopilots, as a table: modes, take-off, readiness, parameters.

Mode numbers: PX4 packs a main and a sub mode into HEARTBEAT.custom_mode (bits 16–23 and 24–31),
and MAV_CMD_DO_SET_MODE has one parameter for each. ArduPilot Copter numbers its modes. PX4 sends
HEARTBEAT once a second and rejects any other rate, but sends CURRENT_MODE at every change of mode
(from 1.15).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from pymavlink.dialects.v20 import common

from swarm.mavlink.frames import AutopilotName
from swarm.mavlink.packets import CURRENT_MODE

_ROTORCRAFT = frozenset(
    int(getattr(common, f"MAV_TYPE_{name}"))
    for name in ("TRICOPTER", "QUADROTOR", "COAXIAL", "HELICOPTER", "HEXAROTOR", "OCTOROTOR",
                 "DECAROTOR", "DODECAROTOR")
)  # fmt: skip

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
MANUAL_MODES = frozenset(
    {"manual", "altitude", "position", "acro", "stabilized", "rattitude", "stabilize",
     "altitude hold", "loiter", "drift", "sport", "position hold", "flow hold"}
)  # fmt: skip
"""Modes in which a pilot's sticks fly the vehicle."""


@dataclass(frozen=True)
class Autopilot:
    """One kind of autopilot.

    - ``modes``: parameters 2 and 3 of DO_SET_MODE.
    - ``needs_takeoff_command``: it requires a take-off command and must not receive setpoints
      before it flies; otherwise it lifts with the setpoint.
    - ``ready_in_offboard_only``: it evaluates its readiness in offboard mode only.
    - ``mode_message``: the message whose rate limits how soon a change of mode is received.
    - ``lists_prearm_as_present``: SYS_STATUS lists the pre-arm check among the sensors present, as
      ArduPilot does. PX4 (1.14 and later) sets its bit only in the sensors' health, while the
      vehicle can be armed in its mode.
    - ``adds_acceleration``: the acceleration of a setpoint is added to the controller's output.
      ArduPilot takes it for the derivative of the setpoint's velocity (`AC_PosControl`,
      ``input_pos_vel_accel_xy``): its target leaves a position at rest with a steady acceleration,
      by the acceleration over 2 s⁻² with the default jerk and acceleration limits.
    - ``needs_origin``: it arms only with an origin on the earth, which is given to it where it has
      no receiver.
    - ``bytewise``: integer parameters are sent as the bytes of an integer
      (MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE).
    """

    name: AutopilotName
    identifier: int
    modes: Mapping[Mode, tuple[int, int]]
    needs_takeoff_command: bool
    ready_in_offboard_only: bool
    mode_message: int
    lists_prearm_as_present: bool
    adds_acceleration: bool
    needs_origin: bool
    bytewise: bool

    def custom_mode(self, mode: Mode) -> int:
        """Return HEARTBEAT.custom_mode of a mode."""
        main, sub = self.modes[mode]
        return main << 16 | sub << 24 if self.name == "px4" else main

    def mode_name(self, custom_mode: int) -> str:
        """Return the name of the mode of a HEARTBEAT.custom_mode."""
        if self.name == "ardupilot":
            return _COPTER.get(custom_mode, f"mode {custom_mode}")
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
        name = _PX4_MAIN.get(main, f"mode {main}")
        return _PX4_AUTO.get(sub, f"auto {sub}") if name == "auto" else name


PX4 = Autopilot(
    name="px4",
    identifier=int(common.MAV_AUTOPILOT_PX4),
    modes={"offboard": (6, 0), "hold": (4, 3), "land": (4, 6)},
    needs_takeoff_command=False,
    ready_in_offboard_only=False,
    mode_message=CURRENT_MODE,
    lists_prearm_as_present=False,
    adds_acceleration=True,
    needs_origin=False,
    bytewise=True,
)

ARDUPILOT = Autopilot(
    name="ardupilot",
    identifier=int(common.MAV_AUTOPILOT_ARDUPILOTMEGA),
    modes={"offboard": (4, 0), "hold": (17, 0), "land": (9, 0)},
    needs_takeoff_command=True,
    ready_in_offboard_only=True,
    mode_message=int(common.MAVLINK_MSG_ID_HEARTBEAT),
    lists_prearm_as_present=True,
    adds_acceleration=False,
    needs_origin=True,
    bytewise=False,
)

AUTOPILOTS: Mapping[int, Autopilot] = {kind.identifier: kind for kind in (PX4, ARDUPILOT)}


def flying_autopilot(component: int, heartbeat: Any) -> Autopilot | None:
    """Return the autopilot that sends a HEARTBEAT for its rotorcraft; None for anything else.

    Cameras, gimbals, companion computers and ADS-B receivers on board have the same system id, and
    some name an autopilot. Component 0 stands for all: no sender has it.
    """
    flies = component != 0 and heartbeat.type in _ROTORCRAFT
    return AUTOPILOTS.get(heartbeat.autopilot) if flies else None
