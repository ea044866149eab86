"""Convex solids: boxes turned about the vertical, upright cylinders, half-spaces.

Every solid is what an upright column and a slab have in common, a row of twelve numbers
(:class:`Solid`). The signed distance of a point from it is then that of a rounded rectangle in plan
view and that along the slab's normal together: exact, convex, and it changes by at most a metre per
metre. Compiled.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.geometry.distance import Vector, difference, dot, moved
from swarm.jit import compiled, inner
from swarm.mission import Mission
from swarm.mission.mission import BoxObstacle, CylinderObstacle, HalfSpaceObstacle, Obstacle
from swarm.signatures import Floats1, Floats2, contiguous

Floats = npt.NDArray[np.float64]

_BISECTIONS = 8
"""Halvings of a chord where its nearest point is looked for: every point gives a true bound, and
the nearest one the best."""


class Solid(NamedTuple):
    """A column and a slab; metres.

    The column is a rectangle around ``x``, ``y`` with half sides ``half_x`` along (``cosine``,
    ``sine``) and ``half_y`` across, and all within ``radius`` of it; the slab has ``low`` ≤ p·n ≤
    ``high`` for the unit normal n. Either is without bounds (infinite) or n is straight up.
    """

    x: float
    y: float
    cosine: float
    sine: float
    half_x: float
    half_y: float
    radius: float
    normal_x: float
    normal_y: float
    normal_z: float
    low: float
    high: float


def upright_box(
    centre: tuple[float, float], size: tuple[float, float], turn: float, low: float, high: float
) -> Solid:
    """Return a box around ``centre`` from a height to another, turned left by ``turn`` radians."""
    turned = math.cos(turn), math.sin(turn)
    return Solid(*centre, *turned, 0.5 * size[0], 0.5 * size[1], 0.0, 0.0, 0.0, 1.0, low, high)


def upright_cylinder(centre: tuple[float, float], radius: float, low: float, high: float) -> Solid:
    """Return an upright cylinder from a height to another."""
    return Solid(*centre, 1.0, 0.0, 0.0, 0.0, radius, 0.0, 0.0, 1.0, low, high)


def half_space(point: Vector, normal: Vector) -> Solid:
    """Return all behind the plane through a point; its normal, of any length, leads out of it."""
    length = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    x, y, z = normal[0] / length, normal[1] / length, normal[2] / length
    high = x * point[0] + y * point[1] + z * point[2]
    return Solid(0.0, 0.0, 1.0, 0.0, np.inf, np.inf, 0.0, x, y, z, -np.inf, high)


def solid_of(obstacle: Obstacle) -> Solid:
    """Return an obstacle of a mission as a solid."""
    match obstacle:
        case BoxObstacle(centre=centre, size=size, turn=turn, bottom=low, top=high):
            return upright_box(centre, size, math.radians(turn), low, high)
        case CylinderObstacle(centre=centre, radius=radius, bottom=low, top=high):
            return upright_cylinder(centre, radius, low, high)
        case HalfSpaceObstacle(point=point, normal=normal):
            return half_space(point, normal)


def obstacles_of(mission: Mission) -> Floats2:
    """Return the obstacles of a mission for compiled code, (m, 12)."""
    return rows([solid_of(obstacle) for obstacle in mission.workspace.obstacles])


def rows(solids: Sequence[Solid]) -> Floats2:
    """Return solids for compiled code, (m, 12)."""
    return np.array(solids, dtype=np.float64).reshape(-1, len(Solid._fields))


def grown(solids: Floats, radius: float, height: float) -> Floats2:
    """Return solids (m, 12) from which a point is as far as an upright cylinder is from these.

    The cylinder stands on the point: its axis is from there to ``height`` above it.
    """
    copies = contiguous(np.array(solids))
    level, up = np.hypot(copies[:, 7], copies[:, 8]), copies[:, 9] * height
    copies[:, 6] += radius
    copies[:, 10] -= radius * level + np.maximum(up, 0.0)
    copies[:, 11] += radius * level - np.minimum(up, 0.0)
    return copies


def distances(solids: Floats, points: Floats) -> Floats:
    """Return the distances (…,) of points (…, 3) from solids (…, 12); negative inside."""
    shape = np.broadcast_shapes(solids.shape[:-1], points.shape[:-1])
    distance = np.empty(shape)
    _write_distances(_table(solids, shape), _table(points, shape), distance.reshape(-1))
    return distance


def _table(values: Floats, shape: tuple[int, ...]) -> Floats2:
    """Return rows for compiled code, as many as a shape has places."""
    width = values.shape[-1]
    return contiguous(np.broadcast_to(values, (*shape, width)).reshape(-1, width))


def planes_between(solids: Floats, chords: Floats) -> tuple[Floats, Floats]:
    """Return :func:`plane_between` of solids (b, 12) and chords (b, 2, 3).

    The normals (b, 3) of the planes, and where they are along them (b,).
    """
    planes = np.empty((len(chords), 4))
    _write_planes(contiguous(solids), contiguous(chords.reshape(-1, 6)), planes)
    return planes[:, :3], planes[:, 3]


@compiled
def _write_distances(solids: Floats2, points: Floats2, distance: Floats1) -> None:
    for k in range(len(points)):
        distance[k] = plane_beside(solids[k], (points[k, 0], points[k, 1], points[k, 2]))[1]


@compiled
def _write_planes(solids: Floats2, ends: Floats2, plane: Floats2) -> None:
    for b in range(len(ends)):
        near, far = (ends[b, 0], ends[b, 1], ends[b, 2]), (ends[b, 3], ends[b, 4], ends[b, 5])
        _, normal, wall = plane_between(solids[b], near, far)
        plane[b, 0], plane[b, 1], plane[b, 2], plane[b, 3] = normal[0], normal[1], normal[2], wall


@inner
def plane_beside(solid: Floats1, point: Vector) -> tuple[Vector, float]:
    """Return the derivative of the distance of a point from a solid, and that distance.

    The whole solid is behind the plane across the derivative, at that distance from the point.
    """
    x, y = point[0] - solid[0], point[1] - solid[1]
    along, across = solid[2] * x + solid[3] * y, solid[2] * y - solid[3] * x
    ahead, aside = abs(along) - solid[4], abs(across) - solid[5]
    if ahead > 0.0 and aside > 0.0:
        level = math.hypot(ahead, aside)
        ahead, aside = ahead / level, aside / level
    elif ahead >= aside:
        level, ahead, aside = ahead, 1.0, 0.0
    else:
        level, ahead, aside = aside, 0.0, 1.0
    level -= solid[6]
    ahead, aside = math.copysign(ahead, along), math.copysign(aside, across)
    east, north = solid[2] * ahead - solid[3] * aside, solid[3] * ahead + solid[2] * aside
    normal = solid[7], solid[8], solid[9]
    height = dot(normal, point)
    up, sign = height - solid[11], 1.0
    if solid[10] - height > up:
        up, sign = solid[10] - height, -1.0
    if level > 0.0 and up > 0.0:
        distance = math.hypot(level, up)
        level, sign = level / distance, sign * up / distance
        return (level * east, level * north, sign * solid[9]), distance
    if level >= up:
        return (east, north, 0.0), level
    return (sign * solid[7], sign * solid[8], sign * solid[9]), up


@inner
def plane_between(solid: Floats1, near: Vector, far: Vector) -> tuple[float, Vector, float]:
    """Return a plane with a solid behind it, at about the nearest point of a chord.

    The fraction of the chord, the unit normal away from the solid, and where the plane is along it.
    """
    step, begin, end = difference(far, near), 0.0, 1.0
    normal, distance = plane_beside(solid, near)
    if dot(normal, step) >= 0.0:
        return 0.0, normal, dot(normal, near) - distance
    normal, distance = plane_beside(solid, far)
    if dot(normal, step) <= 0.0:
        return 1.0, normal, dot(normal, far) - distance
    # the distance is convex along the chord
    for _ in range(_BISECTIONS):
        here = 0.5 * (begin + end)
        point = moved(near, here, step)
        normal, distance = plane_beside(solid, point)
        if dot(normal, step) < 0.0:
            begin = here
        else:
            end = here
    return here, normal, dot(normal, point) - distance
