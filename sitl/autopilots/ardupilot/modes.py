"""ArduCopter's mode changes, arming and failsafe actions."""

from sitl.autopilots import controller_goals, mission_flight, streams
from sitl.autopilots.ardupilot import checks
from sitl.autopilots.ardupilot.state import CRITICAL, INFO, WARNING, ArduPilotState
from sitl.autopilots.ardupilot.tables import AUTO, LAND, MODES, RTL
from sitl.protocol.gripper import GripperRequest
from sitl.protocol.links import ACCEPTED, FAILED

_RELEASE_GRIPPER = 32
"""FS_OPTIONS."""
_LAND_PAUSE = 4.0
"""Seconds for which a failsafe's landing hovers first (LAND_WITH_DELAY_MS in its source)."""


def change(copter: ArduPilotState, number: int, *, failsafe: bool = False) -> int:
    """Change the mode, if it exists and can run; return the MAV_RESULT."""
    v = copter.v
    if number not in MODES:
        v.text(WARNING, f"No such mode {number}")
        return FAILED
    mode = MODES[number]
    if v.armed and mode.position and not copter.position_ok():
        v.text(WARNING, f"Mode change to {mode.name} failed: requires position")
        return FAILED
    if number == copter.mode and not failsafe:
        return ACCEPTED
    if number == AUTO and not _can_start_mission(copter):
        return FAILED
    copter.mode = number
    copter.failsafe = failsafe
    copter.descend_at = v.now + _LAND_PAUSE if failsafe and number == LAND else v.now
    v.environment.event("mode", v.system, mode=mode.name, failsafe=failsafe)
    _begin(copter)
    return ACCEPTED


def fail_to(copter: ArduPilotState, mode: int) -> None:
    """Change the mode for a failsafe; the gripper opens too where FS_OPTIONS requires it."""
    v = copter.v
    if v.parameters.integer("FS_OPTIONS") & _RELEASE_GRIPPER:
        v.gripper.start(GripperRequest(v.now, grab=False))
    if mode == RTL and (not copter.position_ok() or v.home is None):
        mode = LAND
    change(copter, mode, failsafe=True)


def _can_start_mission(copter: ArduPilotState) -> bool:
    """Return whether a mission exists that AUTO can start now."""
    v = copter.v
    if len(v.mission[0]) <= 1:
        v.text(WARNING, "Mode change to AUTO failed: init failed")
        return False
    if v.armed and v.landed and not mission_flight.starts_with_takeoff(v):
        v.text(CRITICAL, "Auto: Missing Takeoff Cmd")
        return False
    return True


def _begin(copter: ArduPilotState) -> None:
    v, p = copter.v, copter.v.parameters
    copter.landing = copter.mode == LAND
    copter.stage = ""
    copter.submode = ""
    v.bodies.goal_moves[v.index] = 0.0
    v.bodies.may_lift[v.index] = False
    cruise(copter)
    if not v.armed:
        return
    controller_goals.hold(v)
    if copter.mode == AUTO:
        copter.submode = "" if v.landed else "auto"
    elif copter.mode == LAND:
        rate = p["LAND_SPEED"] / 100.0 if v.now >= copter.descend_at else 0.0
        controller_goals.descend(v, rate, steer=v.local_valid)


def cruise(copter: ArduPilotState) -> None:
    """Set the speed limits of autonomous flight."""
    p = copter.v.parameters
    speeds = (p["WPNAV_SPEED"], p["WPNAV_SPEED_UP"], p["WPNAV_SPEED_DN"])
    controller_goals.limits(copter.v, *(max(0.1, speed / 100.0) for speed in speeds))


def arm(copter: ArduPilotState, force: bool) -> int:
    """Arm if the checks pass; return the MAV_RESULT."""
    v = copter.v
    if v.armed:
        return ACCEPTED
    reason = checks.refusal(copter)
    if not force:
        if reason:
            v.text(CRITICAL, reason)
            return FAILED
        if not MODES[copter.mode].armable:
            v.text(CRITICAL, f"Arm: {MODES[copter.mode].name} mode not armable")
            return FAILED
    v.bodies.armed[v.index] = True
    v.bodies.landed[v.index] = True
    v.bodies.may_lift[v.index] = False
    copter.idle_since = v.now
    copter.has_flown = False
    copter.submode = ""
    set_home(copter)
    v.text(INFO, "Arming motors")
    v.environment.event("armed", v.system)
    return ACCEPTED


def disarm(copter: ArduPilotState, reason: str) -> None:
    """Stop the motors, on the ground or in flight."""
    v = copter.v
    if not v.armed:
        return
    v.bodies.armed[v.index] = False
    v.bodies.landed[v.index] = True
    copter.disarmed_at = v.now
    v.bodies.goal_moves[v.index] = 0.0
    controller_goals.idle(v)
    copter.submode = ""
    copter.landing = False
    v.text(INFO, "Disarming motors")
    v.environment.event("disarmed", v.system, reason=reason)


def set_home(copter: ArduPilotState) -> None:
    """Set home where the vehicle arms; indoors too, once the estimator has an origin."""
    v = copter.v
    if v.global_valid or (v.environment.indoor and v.local_valid):
        v.set_home_here()
        streams.send_now(v, "GPS_GLOBAL_ORIGIN", "HOME_POSITION")
