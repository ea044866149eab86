"""Uploaded missions: the mission protocol (missions, fences, rally points), and their flight.

Rally points are stored only. Both autopilots fly a mission's waypoints, take-off, landing, return,
gripper, speed and delays in their AUTO modes; unknown commands are skipped, as autopilots do.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from sitl.protocol import missions
from sitl.protocol.vehicle import GripperRequest, Vehicle, scaled_degrees
from sitl.protocol.wire import Link

_MISSION_TIMEOUT = 5.0
_LARGEST_MISSION = 500


def _send_count(v: Vehicle, message: Any, link: Link) -> None:
    kind = message.mission_type
    v.answer("MISSION_COUNT", message, link, count=len(v.mission.get(kind, [])), mission_type=kind)


def _send_item(v: Vehicle, message: Any, link: Link) -> None:
    items = v.mission.get(message.mission_type, [])
    if message.seq >= len(items):
        _acknowledge(v, message, link, dialect.MAV_MISSION_INVALID_SEQUENCE)
        return
    item = dict(items[message.seq])
    if message.get_type() == "MISSION_REQUEST_INT":
        v.answer("MISSION_ITEM_INT", message, link, **item)
    else:
        item["x"], item["y"] = item["x"] * 1e-7, item["y"] * 1e-7
        v.answer("MISSION_ITEM", message, link, **item)


def _acknowledge(v: Vehicle, message: Any, link: Link, result: int) -> None:
    v.answer("MISSION_ACK", message, link, type=result, mission_type=message.mission_type)


def _start_upload(v: Vehicle, message: Any, link: Link) -> None:
    kind = message.mission_type
    if kind not in v.mission or message.count > _LARGEST_MISSION:
        _acknowledge(v, message, link, dialect.MAV_MISSION_NO_SPACE)
    elif message.count == 0:
        _acknowledge(v, message, link, _store(v, kind, []))
    else:
        v.upload = {"kind": kind, "count": message.count, "items": [], "at": v.now}
        _request_item(v, message, link)


def _request_item(v: Vehicle, message: Any, link: Link) -> None:
    seq, kind = len(v.upload["items"]), v.upload["kind"]
    v.answer("MISSION_REQUEST_INT", message, link, seq=seq, mission_type=kind)


_ITEM_FIELDS = (
    "seq", "frame", "command", "current", "autocontinue", "param1", "param2", "param3", "param4",
    "x", "y", "z", "mission_type",
)  # fmt: skip


def _receive_item(v: Vehicle, message: Any, link: Link) -> None:
    upload = v.upload
    if not upload or v.now - upload["at"] > _MISSION_TIMEOUT:
        _acknowledge(v, message, link, dialect.MAV_MISSION_ERROR)
        return
    if message.seq != len(upload["items"]):
        _request_item(v, message, link)
        return
    item = {name: getattr(message, name) for name in _ITEM_FIELDS}
    if message.get_type() == "MISSION_ITEM":
        item["x"], item["y"] = scaled_degrees(item["x"]), scaled_degrees(item["y"])
    upload["items"].append(item)
    upload["at"] = v.now
    if len(upload["items"]) < upload["count"]:
        _request_item(v, message, link)
        return
    v.upload = {}
    result = _store(v, upload["kind"], upload["items"])
    _acknowledge(v, message, link, result)


def _store(v: Vehicle, kind: int, items: list[dict[str, Any]]) -> int:
    """Store a complete list; return the MAV_MISSION_RESULT."""
    if kind == dialect.MAV_MISSION_TYPE_FENCE:
        fence = missions.areas(items, v.environment.geodesy)
        if fence is None:
            return int(dialect.MAV_MISSION_ERROR)
        v.fence = fence
    v.mission[kind] = items
    if kind == dialect.MAV_MISSION_TYPE_MISSION:
        v.mission_progress.restart()
    return int(dialect.MAV_MISSION_ACCEPTED)


def _set_current(v: Vehicle, message: Any, link: Link) -> None:
    if v.mission_progress.jump_to(message.seq, len(v.mission[0])):
        v.send("MISSION_CURRENT", link, seq=message.seq)


def _clear(v: Vehicle, message: Any, link: Link) -> None:
    kinds = list(v.mission) if message.mission_type == 255 else [message.mission_type]
    for kind in set(kinds) & set(v.mission):
        _store(v, kind, [])
    _acknowledge(v, message, link, dialect.MAV_MISSION_ACCEPTED)


HANDLERS: dict[str, Callable[[Vehicle, Any, Link], None]] = {
    "MISSION_REQUEST_LIST": _send_count,
    "MISSION_REQUEST": _send_item,
    "MISSION_REQUEST_INT": _send_item,
    "MISSION_COUNT": _start_upload,
    "MISSION_ITEM": _receive_item,
    "MISSION_ITEM_INT": _receive_item,
    "MISSION_SET_CURRENT": _set_current,
    "MISSION_CLEAR_ALL": _clear,
}


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


def steer_mission(v: Vehicle, acceptance: float) -> str:
    """Set the controller goals of the current item; return FLYING, LANDING, RETURNING or DONE.

    ``acceptance`` is the distance in metres at which a waypoint is reached.
    """
    progress = v.mission_progress
    for _ in range(_MOST_STEPS):
        items = v.mission[0]
        if progress.seq >= len(items):
            break
        item = items[progress.seq]
        if item["command"] == _RETURN:
            return RETURNING
        done = _STEPS.get(item["command"], _skip)(v, item, acceptance)
        if not done:
            return LANDING if item["command"] == _LAND and progress.goal is None else FLYING
        v.send("MISSION_ITEM_REACHED", seq=progress.seq)
        progress.advance()
        v.send("MISSION_CURRENT", seq=progress.seq)
    progress.restart()
    return DONE


def _place(v: Vehicle, item: dict[str, Any]) -> Any:
    """Return an item's position (world ENU); the estimate replaces coordinates not given."""
    place = np.array(v.estimated())
    if item["x"] not in {0, _NOWHERE} or item["y"] not in {0, _NOWHERE}:
        place[:2] = v.environment.geodesy.metres(item["x"] * 1e-7, item["y"] * 1e-7)
    if math.isfinite(item["z"]):
        relative = item["frame"] in _RELATIVE
        place[2] = item["z"] + (v.home_height() if relative else -v.environment.geodesy.altitude)
    return place


def _go(v: Vehicle, item: dict[str, Any], acceptance: float) -> bool:
    """Fly to an item's position; return whether the vehicle is there."""
    progress = v.mission_progress
    if progress.goal is None:
        progress.goal = _place(v, item)
        v.go(progress.goal)
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
        v.go(progress.goal)
    return bool(v.estimated()[2] > progress.goal[2] - 0.5)


def _land(v: Vehicle, item: dict[str, Any], acceptance: float) -> bool:
    """Fly over the landing point at the present height, then clear the goal: the mode lands."""
    progress = v.mission_progress
    if progress.wait_until is None:
        if progress.goal is None:
            progress.goal = _place(v, {**item, "z": math.nan})
            v.go(progress.goal)
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
    v.set_speed(item["param2"])
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
