"""Flight of an uploaded mission: waypoints, take-off, land, return, gripper, speed, delays.

Both autopilots use it in their AUTO modes. Unknown commands are skipped, as autopilots do.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from sitl.autopilots import controller_goals
from sitl.protocol.gripper import GripperRequest
from sitl.protocol.vehicle import Vehicle

_WAYPOINT, _LOITER, _LOITER_TIME, _RETURN, _LAND, _TAKEOFF, _DELAY = 16, 17, 19, 20, 21, 22, 93
_JUMP, _SPEED, _GRIPPER, _SCRIPT_DELAY = 177, 178, 211, 112
_RELATIVE = {3, 6, 10, 11}
_NOWHERE = 2**31 - 1
_MOST_STEPS = 600
FLYING, LANDING, RETURNING, DONE = "flying", "landing", "returning", "done"


def starts_with_takeoff(v: Vehicle) -> bool:
    """Return whether the current item is a take-off."""
    items, seq = v.mission[0], v.mission_progress.seq
    return seq < len(items) and items[seq]["command"] == _TAKEOFF


def steer(v: Vehicle, acceptance: float) -> str:
    """Set the controller goals of the current item; return FLYING, LANDING, RETURNING or DONE.

    ``acceptance`` is the distance in metres at which a waypoint is reached.
    """
    progress = v.mission_progress
    for _ in range(_MOST_STEPS):
        items = v.mission[0]
        if progress.seq >= len(items):
            return DONE
        item = items[progress.seq]
        if item["command"] == _RETURN:
            return RETURNING
        done = _STEPS.get(item["command"], _skip)(v, item, acceptance)
        if not done:
            return LANDING if item["command"] == _LAND and progress.goal is None else FLYING
        v.send("MISSION_ITEM_REACHED", seq=progress.seq)
        progress.advance()
        v.send("MISSION_CURRENT", seq=progress.seq)
    return DONE


def _place(v: Vehicle, item: dict[str, Any]) -> Any:
    """Return an item's position (world ENU); the estimate replaces coordinates not given."""
    place = np.array(v.estimated())
    if item["x"] not in {0, _NOWHERE} or item["y"] not in {0, _NOWHERE}:
        place[:2] = v.environment.geodesy.metres(item["x"] * 1e-7, item["y"] * 1e-7)
    if math.isfinite(item["z"]):
        home = v.home if v.home is not None else v.origin
        relative = item["frame"] in _RELATIVE
        place[2] = item["z"] + (home[2] if relative else -v.environment.geodesy.altitude)
    return place


def _go(v: Vehicle, item: dict[str, Any], acceptance: float) -> bool:
    """Fly to an item's position; return whether the vehicle is there."""
    progress = v.mission_progress
    if progress.goal is None:
        progress.goal = _place(v, item)
        controller_goals.go(v, progress.goal)
        if math.isfinite(item["param4"]) and item["param4"] and item["command"] == _WAYPOINT:
            v.bodies.goal_yaw[v.index] = math.pi / 2 - math.radians(item["param4"])
    away = progress.goal - v.estimated()
    return bool(np.hypot(away[0], away[1]) < acceptance and abs(away[2]) < max(0.5, acceptance))


def _wait(v: Vehicle, seconds: float) -> bool:
    """Return whether ``seconds`` have passed since the first call for this item."""
    progress = v.mission_progress
    if progress.wait_until is None:
        progress.wait_until = v.now + (seconds if math.isfinite(seconds) else 0.0)
    return v.now >= progress.wait_until


def _waypoint(v: Vehicle, item: dict[str, Any], acceptance: float) -> bool:
    there = v.mission_progress.wait_until is not None or _go(v, item, acceptance)
    return there and _wait(v, max(item["param1"], 0.0))


def _loiter(v: Vehicle, item: dict[str, Any], acceptance: float) -> bool:
    _go(v, item, acceptance)
    return False


def _delay(v: Vehicle, item: dict[str, Any], _: float) -> bool:
    return _wait(v, max(item["param1"], 0.0))


def _take_off(v: Vehicle, item: dict[str, Any], _: float) -> bool:
    progress = v.mission_progress
    if progress.goal is None:
        progress.goal = _place(v, item)
        progress.goal[:2] = v.estimated()[:2]
        controller_goals.go(v, progress.goal)
    return bool(v.estimated()[2] > progress.goal[2] - 0.5)


def _land(v: Vehicle, item: dict[str, Any], acceptance: float) -> bool:
    """Fly over the landing point at the present height, then clear the goal: the mode lands."""
    progress = v.mission_progress
    if progress.wait_until is None:
        if progress.goal is None:
            progress.goal = _place(v, {**item, "z": math.nan})
            controller_goals.go(v, progress.goal)
        away = progress.goal - v.estimated()
        if np.hypot(away[0], away[1]) >= min(acceptance, 1.0):
            return False
        progress.wait_until = v.now
    progress.goal = None
    return False


def _jump(v: Vehicle, item: dict[str, Any], _: float) -> bool:
    progress = v.mission_progress
    left = progress.jumps.setdefault(progress.seq, int(item["param2"]))
    if left != 0 and math.isfinite(item["param1"]):
        progress.jumps[progress.seq] = left - 1
        target = int(item["param1"])
        if 0 <= target < len(v.mission[0]):
            progress.seq = max(target, progress.first) - 1
    return True


def _speed(v: Vehicle, item: dict[str, Any], _: float) -> bool:
    controller_goals.set_speed(v, item["param2"])
    return True


def _gripper(v: Vehicle, item: dict[str, Any], _: float) -> bool:
    if v.mission_progress.wait_until is None:
        v.gripper.start(GripperRequest(v.now + 0.5, item["param2"] == 1.0))
    return _wait(v, 1.0)


def _skip(_: Vehicle, __: dict[str, Any], ___: float) -> bool:
    return True


_STEPS: dict[int, Callable[[Vehicle, dict[str, Any], float], bool]] = {
    _WAYPOINT: _waypoint,
    _LOITER: _loiter,
    _LOITER_TIME: _waypoint,
    _TAKEOFF: _take_off,
    _LAND: _land,
    _DELAY: _delay,
    _SCRIPT_DELAY: _delay,
    _JUMP: _jump,
    _SPEED: _speed,
    _GRIPPER: _gripper,
}
