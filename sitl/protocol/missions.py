"""What ground stations upload: fences as polygons and circles.

Items of the mission protocol's fence list (MAV_CMD_NAV_FENCE_*) become `Area`s in world ENU; the
autopilot decides on the reaction to a breach. `sitl.autopilots.missions` takes the upload.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sitl.physics.geodesy import Geodesy

_POLYGON_IN, _POLYGON_OUT, _CIRCLE_IN, _CIRCLE_OUT = 5001, 5002, 5003, 5004


@dataclass(frozen=True)
class Area:
    """One fence: ``inside`` or outside a polygon, or a circle around its only corner (m)."""

    inside: bool
    corners: tuple[tuple[float, float], ...]
    radius: float = 0.0

    def contains(self, x: float, y: float) -> bool:
        """Return whether a point (world ENU) is on the permitted side of this fence."""
        if self.radius > 0:
            within = math.hypot(x - self.corners[0][0], y - self.corners[0][1]) <= self.radius
        else:
            within = _in_polygon(self.corners, x, y)
        return within == self.inside


def _in_polygon(corners: Sequence[tuple[float, float]], x: float, y: float) -> bool:
    """Return whether a point is in a polygon (even-odd rule with a ray to the east)."""
    within = False
    for (x1, y1), (x2, y2) in zip(corners, [*corners[1:], corners[0]], strict=True):
        if (y1 > y) != (y2 > y) and x < x1 + (y - y1) / (y2 - y1) * (x2 - x1):
            within = not within
    return within


def areas(items: Sequence[dict[str, Any]], geodesy: Geodesy) -> tuple[Area, ...] | None:
    """Return the fences of an uploaded list, None if the list is invalid."""
    fences = []
    rest = list(items)
    while rest:
        item = rest[0]
        command, amount = item["command"], item["param1"]
        if command in {_POLYGON_IN, _POLYGON_OUT}:
            if not (math.isfinite(amount) and 3 <= amount <= len(rest)):
                return None
            own, rest = rest[: int(amount)], rest[int(amount) :]
            if any((corner["command"], corner["param1"]) != (command, amount) for corner in own):
                return None
            corners = tuple(_place(corner, geodesy) for corner in own)
            fences.append(Area(command == _POLYGON_IN, corners))
        elif command in {_CIRCLE_IN, _CIRCLE_OUT}:
            if not (math.isfinite(amount) and amount > 0):
                return None
            fences.append(Area(command == _CIRCLE_IN, (_place(item, geodesy),), amount))
            rest = rest[1:]
        else:
            rest = rest[1:]
    return tuple(fences)


def _place(item: dict[str, Any], geodesy: Geodesy) -> tuple[float, float]:
    return geodesy.metres(item["x"] * 1e-7, item["y"] * 1e-7)


def breached(fences: Sequence[Area], x: float, y: float) -> bool:
    """Return whether a point is outside an inclusion, or inside an exclusion."""
    return not all(area.contains(x, y) for area in fences)
