"""Flies an uploaded mission: waypoints, take-off, land, return, and a few things to do on the way.

Both autopilots' AUTO modes have one `Route`. Commands that are not known are passed over, as
autopilots do with what does not concern them.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from sitl import controller_goals
from sitl.vehicle import Vehicle

_WAYPOINT, _LOITER, _LOITER_TIME, _RETURN, _LAND, _TAKEOFF, _DELAY = 16, 17, 19, 20, 21, 22, 93
_JUMP, _SPEED, _GRIPPER, _SCRIPT_DELAY = 177, 178, 211, 112
_RELATIVE = {3, 6, 10, 11}
_NOWHERE = 2**31 - 1
_MOST_STEPS = 600
FLYING, LANDING, RETURNING, DONE = "flying", "landing", "returning", "done"


class Route:
    """Where a vehicle is in its mission; ``first`` is the item that it begins with."""

    def __init__(self, vehicle: Vehicle, first: int) -> None:
        self.v = vehicle
        self.first = first
        self.restart()

    def restart(self) -> None:
        """Begin at the first item next time."""
        self.seq = self.first
        self.goal: Any = None
        self.wait_until: float | None = None
        self.jumps: dict[int, int] = {}

    def jump_to(self, seq: int) -> bool:
        """Go on with another item; False if there is none."""
        if not 0 <= seq < len(self.v.mission[0]):
            return False
        self.seq = max(seq, self.first)
        self.goal = self.wait_until = None
        return True

    @property
    def lifts(self) -> bool:
        """Whether the item that comes next is a take-off."""
        items = self.v.mission[0]
        return self.seq < len(items) and items[self.seq]["command"] == _TAKEOFF

    def steer(self, acceptance: float) -> str:
        """Set goals as the mission says; ``acceptance`` is how near counts as there (m)."""
        for _ in range(_MOST_STEPS):
            items = self.v.mission[0]
            if self.seq >= len(items):
                return DONE
            item = items[self.seq]
            if item["command"] == _RETURN:
                return RETURNING
            done = _STEPS.get(item["command"], _pass_over)(self, item, acceptance)
            if not done:
                return LANDING if item["command"] == _LAND and self.goal is None else FLYING
            self._reached()
        return DONE

    def _reached(self) -> None:
        self.v.send("MISSION_ITEM_REACHED", seq=self.seq)
        self.seq += 1
        self.goal = self.wait_until = None
        self.v.send("MISSION_CURRENT", seq=self.seq)

    def _place(self, item: dict[str, Any]) -> Any:
        """World ENU of an item; what it leaves open is where the vehicle is or was heading."""
        v = self.v
        place = np.array(v.estimated())
        if item["x"] not in {0, _NOWHERE} or item["y"] not in {0, _NOWHERE}:
            place[:2] = v.around.geodesy.metres(item["x"] * 1e-7, item["y"] * 1e-7)
        if math.isfinite(item["z"]):
            home = v.home if v.home is not None else v.origin
            relative = item["frame"] in _RELATIVE
            place[2] = item["z"] + (home[2] if relative else -v.around.geodesy.altitude)
        return place

    def go(self, item: dict[str, Any], acceptance: float) -> bool:
        """Fly to an item's place; whether the vehicle is there."""
        v = self.v
        if self.goal is None:
            self.goal = self._place(item)
            controller_goals.go(v, self.goal)
            if math.isfinite(item["param4"]) and item["param4"] and item["command"] == _WAYPOINT:
                v.bodies.goal_yaw[v.index] = math.pi / 2 - math.radians(item["param4"])
        away = self.goal - v.estimated()
        return bool(np.hypot(away[0], away[1]) < acceptance and abs(away[2]) < max(0.5, acceptance))

    def wait(self, seconds: float) -> bool:
        """Stay for some seconds, counted from the first time of asking; whether they are over."""
        if self.wait_until is None:
            self.wait_until = self.v.now + (seconds if math.isfinite(seconds) else 0.0)
        return self.v.now >= self.wait_until


def _waypoint(route: Route, item: dict[str, Any], acceptance: float) -> bool:
    there = route.wait_until is not None or route.go(item, acceptance)
    return there and route.wait(max(item["param1"], 0.0))


def _loiter(route: Route, item: dict[str, Any], acceptance: float) -> bool:
    route.go(item, acceptance)
    return False


def _delay(route: Route, item: dict[str, Any], _: float) -> bool:
    return route.wait(max(item["param1"], 0.0))


def _take_off(route: Route, item: dict[str, Any], _: float) -> bool:
    v = route.v
    if route.goal is None:
        route.goal = route._place(item)
        route.goal[:2] = v.estimated()[:2]
        controller_goals.go(v, route.goal)
    return bool(v.estimated()[2] > route.goal[2] - 0.5)


def _land(route: Route, item: dict[str, Any], acceptance: float) -> bool:
    """Fly over the place at the present height, then leave the rest to the autopilot's landing."""
    v = route.v
    if route.wait_until is None:
        if route.goal is None:
            route.goal = route._place({**item, "z": math.nan})
            controller_goals.go(v, route.goal)
        away = route.goal - v.estimated()
        if np.hypot(away[0], away[1]) >= min(acceptance, 1.0):
            return False
        route.wait_until = v.now
    route.goal = None
    return False


def _jump(route: Route, item: dict[str, Any], _: float) -> bool:
    left = route.jumps.setdefault(route.seq, int(item["param2"]))
    if left != 0 and math.isfinite(item["param1"]):
        route.jumps[route.seq] = left - 1
        target = int(item["param1"])
        if 0 <= target < len(route.v.mission[0]):
            route.seq = max(target, route.first) - 1
    return True


def _speed(route: Route, item: dict[str, Any], _: float) -> bool:
    v = route.v
    if math.isfinite(item["param2"]) and item["param2"] > 0:
        v.bodies.speed_limit[v.index] = min(item["param2"], v.spec.max_speed)
        v.bodies.touch()
    return True


def _gripper(route: Route, item: dict[str, Any], _: float) -> bool:
    if route.wait_until is None:
        route.v.start_gripper(item["param2"] == 1.0, None, 0, 0, 0.5)
    return route.wait(1.0)


def _pass_over(_: Route, __: dict[str, Any], ___: float) -> bool:
    return True


_STEPS: dict[int, Callable[[Route, dict[str, Any], float], bool]] = {
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
