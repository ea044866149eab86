"""PX4's commander: mode changes, arming, the failsafe framework, flight termination.

``UserModeIntention`` and ``failsafe.cpp``: a failsafe holds for COM_FAIL_ACT_T while a pilot could
take over, then acts; a mode whose requirements fail falls back to the next one of `FALLBACK`.
"""

from sitl.autopilots import controller_goals
from sitl.autopilots.px4 import checks, flight
from sitl.autopilots.px4.state import CRITICAL, EMERGENCY, INFO, Px4State
from sitl.autopilots.px4.tables import FALLBACK, MODES, OFFBOARD_LOSS
from sitl.protocol.links import ACCEPTED, DENIED, TEMPORARILY_REJECTED


def change(px4: Px4State, name: str | None) -> int:
    """Change the user's mode if the new one can run; return the MAV_RESULT."""
    if name is None:
        return DENIED
    if px4.mode == "TERMINATION":
        return TEMPORARILY_REJECTED
    if px4.v.armed and not checks.can_run(px4, name):
        label = MODES[name].label
        px4.v.text(CRITICAL, f"Switching to mode '{label}' is currently not possible\t")
        return TEMPORARILY_REJECTED
    intend(px4, name)
    return ACCEPTED


def intend(px4: Px4State, name: str) -> None:
    """Set the user's mode; this clears failsafes that last until a mode change."""
    px4.intended = name
    px4.latched = None
    px4.delay_until = None
    px4.goal = None
    px4.stage = ""
    if not MODES[name].prevents_arming:
        px4.after_disarm = name
    evaluate(px4)


def restart_mode(px4: Px4State) -> None:
    """Enter the mode once more, with its new goal."""
    px4.mode = ""
    evaluate(px4)


def arm(px4: Px4State, force: bool) -> int:
    """Arm if the checks pass; return the MAV_RESULT."""
    v = px4.v
    if v.armed:
        return ACCEPTED
    reason = checks.refusal(px4)
    if reason and not force:
        v.text(CRITICAL, f"Arming denied: {reason}\t")
        return TEMPORARILY_REJECTED
    v.bodies.armed[v.index] = True
    v.bodies.landed[v.index] = True
    px4.armed_at = v.now
    px4.has_flown = False
    px4.landed_at = None
    px4.battery_at_arming = px4.battery_level
    px4.radio_known, px4.radio_lost_at = v.radio_connected, None
    px4.outside_fence = False
    if v.global_valid:
        v.set_home_here()
    v.text(INFO, "Armed by external command\t")
    v.environment.event("armed", v.system)
    restart_mode(px4)
    return ACCEPTED


def disarm(px4: Px4State, reason: str) -> None:
    """Stop the motors, on the ground or in flight."""
    v = px4.v
    if not v.armed:
        return
    v.bodies.armed[v.index] = False
    v.bodies.landed[v.index] = True
    controller_goals.idle(v)
    px4.intended = px4.after_disarm
    px4.latched = None
    px4.delay_until = None
    v.text(INFO, f"{reason}\t")
    v.environment.event("disarmed", v.system, reason=reason)
    evaluate(px4)


def terminate(px4: Px4State) -> None:
    """Stop the motors for good: flight termination."""
    v = px4.v
    px4.intended = px4.mode = "TERMINATION"
    px4.failsafe = True
    v.bodies.armed[v.index] = False
    v.text(EMERGENCY, "Flight termination active\t")
    v.environment.event("terminated", v.system)


def trigger(px4: Px4State, action: str) -> None:
    """Start a failsafe: Hold for COM_FAIL_ACT_T while a pilot could take over, then act."""
    v = px4.v
    if action == "DISARM":
        disarm(px4, "Disarmed by failsafe")
    elif action == "TERMINATION":
        terminate(px4)
    elif px4.latched != action:
        wait = v.parameters["COM_FAIL_ACT_T"] if action != "LOITER" else 0.0
        px4.latched = "LOITER" if wait > 0 else action
        px4.delayed = action
        px4.delay_until = v.now + wait
        v.text(CRITICAL, "Failsafe activated\t")
        if px4.mode == "LOITER" and px4.goal is not None:
            px4.goal = None
            controller_goals.hold(v)


def steer(px4: Px4State) -> None:
    """Update the goals of the active mode, and change the mode where it has ended."""
    _follow_up(px4, flight.steer(px4))


def evaluate(px4: Px4State) -> None:
    """Activate the user's mode, or the mode that failsafes and requirements select instead."""
    v = px4.v
    if px4.mode == "TERMINATION":
        return
    if not v.armed:
        _enter(px4, px4.intended, failsafe=False)
        return
    if px4.delay_until is not None and v.now >= px4.delay_until:
        px4.latched, px4.delay_until = px4.delayed, None
    selected, failsafe = px4.intended, False
    if px4.latched and px4.intended != "LAND":
        selected, failsafe = px4.latched, True
    if "offboard" in MODES[selected].requires and not checks.offboard_signal(px4):
        selected = OFFBOARD_LOSS.get(v.parameters.integer("COM_OBL_RC_ACT"), "POSCTL")
        failsafe = True
        if selected == "DISARM":
            disarm(px4, "Disarmed by failsafe")
            return
        if selected == "TERMINATION":
            terminate(px4)
            return
    while not checks.can_run(px4, selected):
        failsafe = True
        needs_pilot = "pilot" in MODES[selected].requires
        selected = FALLBACK.get(selected, "DESCEND" if needs_pilot else "RTL")
    _enter(px4, selected, failsafe)


def _enter(px4: Px4State, name: str, failsafe: bool) -> None:
    if name == px4.mode and failsafe == px4.failsafe:
        return
    v = px4.v
    if failsafe and not px4.failsafe and v.armed:
        v.text(CRITICAL, "Failsafe activated\t")
    px4.failsafe = failsafe
    if name == px4.mode:
        return
    px4.mode = name
    px4.landing = name in {"LAND", "DESCEND"}
    px4.stage = ""
    v.environment.event("mode", v.system, mode=name, failsafe=failsafe)
    if v.armed:
        _follow_up(px4, flight.begin(px4))


def _follow_up(px4: Px4State, following: str | None) -> None:
    """Change to the mode that follows; a take-off holds at its goal."""
    if following is None:
        return
    if px4.mode == "TAKEOFF":
        px4.intended = px4.after_disarm = following
        evaluate(px4)
    else:
        intend(px4, following)
