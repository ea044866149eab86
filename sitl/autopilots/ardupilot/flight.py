"""Controller goals of ArduCopter's autonomous modes."""

import numpy as np

from sitl.autopilots import controller_goals, mission_flight
from sitl.autopilots.ardupilot import modes
from sitl.autopilots.ardupilot.state import ArduPilotState
from sitl.autopilots.ardupilot.tables import AUTO, GUIDED, LAND, RTL
from sitl.autopilots.mission_flight import DONE, LANDING, RETURNING


def _land(copter: ArduPilotState) -> None:
    """Descend, faster above LAND_ALT_LOW over home; a failsafe's landing waits before it."""
    v, p = copter.v, copter.v.parameters
    if v.now < copter.descend_at:
        return
    home = v.home[2] if v.home is not None else v.origin[2]
    high = float(v.estimated()[2] - home) > p["LAND_ALT_LOW"] / 100.0
    rate = p["WPNAV_SPEED_DN"] if high else p["LAND_SPEED"]
    v.bodies.set_climb_rate(v.index, -rate / 100.0)


def _return(copter: ArduPilotState) -> None:
    """Climb, fly home, wait RTL_LOIT_TIME, land."""
    v, p = copter.v, copter.v.parameters
    if v.home is None:
        return
    here, home = v.estimated(), v.home
    away = float(np.hypot(*(home - here)[:2]))
    if copter.stage == "":
        top = max(float(here[2]), float(home[2]) + p["RTL_ALT"] / 100.0)
        copter.goal = np.array([here[0], here[1], top])
        copter.stage = "climb"
        controller_goals.go(v, copter.goal)
    elif copter.stage == "climb" and here[2] > copter.goal[2] - 0.5:
        copter.goal = np.array([home[0], home[1], copter.goal[2]])
        copter.stage = "home"
        controller_goals.go(v, copter.goal)
    elif copter.stage == "home" and away < 0.5:
        copter.stage, copter.stage_at = "wait", v.now
    elif copter.stage == "wait" and v.now - copter.stage_at > p["RTL_LOIT_TIME"] / 1000.0:
        copter.stage, copter.landing = "land", True
        controller_goals.descend(v, p["LAND_SPEED"] / 100.0, steer=True)
    elif copter.stage == "land":
        _land(copter)


def _guided(copter: ArduPilotState) -> None:
    """Stop when no setpoint has arrived for GUID_TIMEOUT."""
    v = copter.v
    if copter.submode not in {"posvel", "velocity", "acceleration"}:
        return
    if v.now - copter.setpoint_at > v.parameters["GUID_TIMEOUT"]:
        b, i = v.bodies, v.index
        b.goal_moves[i] = 0.0
        goal = (*b.goal_position[i], *[0.0] * 6)
        if copter.submode != "posvel":
            goal = (*v.estimated(), *[0.0] * 6)
        copter.submode = "stopped"
        b.set_goal(i, goal)


def _fly_mission(copter: ArduPilotState) -> None:
    v, p = copter.v, copter.v.parameters
    if copter.submode != "auto":
        return
    if copter.stage == "land":
        _land(copter)
        return
    result = mission_flight.steer(v, p["WPNAV_RADIUS"] / 100.0)
    if result == RETURNING:
        modes.change(copter, RTL)
    elif result == DONE:
        v.mission_progress.restart()
        copter.submode = "done"
        controller_goals.hold(v)
    elif result == LANDING:
        copter.stage, copter.landing = "land", True
        controller_goals.descend(v, p["LAND_SPEED"] / 100.0, steer=True)


def steer(copter: ArduPilotState) -> None:
    """Update the goals of the active mode."""
    step = _STEPS.get(copter.mode)
    if step is not None:
        step(copter)


_STEPS = {GUIDED: _guided, RTL: _return, LAND: _land, AUTO: _fly_mission}
