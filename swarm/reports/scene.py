"""The geometry that pictures show, as arrays: strands of cable, crossings, workspace, colours.

Pictures are drawn of bad data as well: a strand that is stretched beyond its length is straight,
and a strand with an unknown end is left out.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from swarm.flight.setup import LOOSE_ERROR
from swarm.flight.snapshot import Snapshot
from swarm.flight.trace import Trace
from swarm.geometry.catenary import MAX_CHORD_RATIO, solve_catenaries
from swarm.geometry.distance import strand_strand
from swarm.geometry.solids import Solid, solid_of
from swarm.planning import KnotLayout, Plan
from swarm.planning.cable_shape import laid_grip_points, planned_grip

Floats = npt.NDArray[np.float64]
Colours = npt.NDArray[np.uint8]

POINTS_PER_SEGMENT: Final = 25

SAMPLE_INTERVAL: Final = 0.5
"""Seconds between two sampled distances of strands; the certificate bounds them at every moment."""

AROUND: Final = 3.0
"""Metres around the flight in which planes of obstacles are drawn: about a segment's length."""
ROUND: Final = 24
"""Corners by which a cylinder is drawn."""

SILENT_AFTER: Final = 2.0
"""Seconds without a packet after which a vehicle is drawn as silent."""
EMPTY_BATTERY: Final = 0.2
"""Share of a battery below which it is shown in red."""

STATE_COLOURS: Final[dict[str, tuple[int, int, int]]] = {
    "idle": (120, 128, 140),
    "armed": (94, 196, 120),
    "attached": (86, 160, 255),
    "off track": (255, 140, 40),
    "silent": (235, 60, 140),
}
"""States of a vehicle in pictures, from normal to critical, with their colours."""


@dataclass(frozen=True)
class Crossing:
    """One crossing of the folded cable: the strands' points there (3,) and their segments, from 1.

    ``distance`` is the height of the over strand above the under strand, metres.
    """

    over: int
    under: int
    upper: Floats
    lower: Floats

    @property
    def distance(self) -> float:
        """Height of the over strand above the under strand, negative if below, metres."""
        return float(self.upper[2] - self.lower[2])


def joined(grips: Floats, lengths: Floats) -> Floats:
    """Return the grip points (…, n, 3) that segments of these lengths join: one without cable."""
    return grips[..., : len(lengths) + 1, :]


def strands(grips: Floats, lengths: Floats, points: int = POINTS_PER_SEGMENT) -> Floats:
    """Return the cable between grip points (…, n, 3) as polylines (…, n − 1, points, 3).

    Every segment is the catenary of its length (n − 1,), laid flat where it would pass below the
    floor (z = 0), straight where its chord is longer than its cable, NaN where an end is unknown.
    Without cable there are no lengths and no polylines.
    """
    grips = joined(grips, lengths)
    start, end = grips[..., :-1, :], grips[..., 1:, :]
    known = np.isfinite((start + end).sum(axis=-1, keepdims=True))
    start, end = np.where(known, start, 0.0), np.where(known, end, 0.0)
    chord = np.linalg.norm(end - start, axis=-1)
    drawn = solve_catenaries(start, end, np.maximum(lengths, chord * (1 + 1e-9)))
    shape = drawn.points(np.linspace(0.0, 1.0, points))
    shape[..., 2] = np.maximum(shape[..., 2], 0.0)
    return np.where(known[..., None], shape, np.nan)


def closest_strands(shapes: Floats) -> tuple[float, Floats] | None:
    """Return the smallest distance of strands (s, k, 3) that are not neighbours, and its points.

    The points are (2, 3). Pairs whose bounding boxes are farther apart than the distance of one
    pair are skipped. None where no two such strands have a known shape.
    """
    pairs = np.column_stack(np.triu_indices(len(shapes), 2))
    known = np.flatnonzero(np.isfinite(shapes.sum(axis=(1, 2))))
    pairs = pairs[np.isin(pairs, known).all(axis=1)]
    if not len(pairs):
        return None
    low, high = shapes.min(axis=1), shapes.max(axis=1)
    first, second = pairs.T
    gap = np.maximum(np.maximum(low[first] - high[second], low[second] - high[first]), 0.0)
    bound = np.linalg.norm(gap, axis=1)
    nearest = strand_strand(shapes, pairs[[bound.argmin()]]).distance[0]
    pairs = pairs[bound <= nearest]
    closest = strand_strand(shapes, pairs)
    best = int(closest.distance.argmin())
    positions = (closest.first[best], closest.second[best])
    ends = [_point_at(shapes[k], at) for k, at in zip(pairs[best], positions, strict=True)]
    return float(closest.distance[best]), np.array(ends)


def _point_at(strand: Floats, position: float) -> Floats:
    """Return the point of a polyline (k, 3) at an index of its pieces plus a fraction."""
    piece = min(int(position), len(strand) - 2)
    point: Floats = strand[piece] + (position - piece) * (strand[piece + 1] - strand[piece])
    return point


def tautness(grips: Floats, lengths: Floats) -> Floats:
    """Return chord over length (…, n − 1) of every segment; 1 is taut, NaN unknown."""
    chord = np.linalg.norm(np.diff(joined(grips, lengths), axis=-2), axis=-1)
    ratio: Floats = chord / lengths
    return ratio


def tautness_colours(ratio: Floats) -> Colours:
    """Return colours (…, 3): teal while slack, yellow from 0.9, red where taut; grey if unknown."""
    stops = np.array([0.0, 0.7, 0.9, MAX_CHORD_RATIO, 1.0])
    colours = np.array(
        [[70, 200, 190], [70, 200, 190], [245, 205, 80], [235, 60, 60], [235, 60, 60]], float
    )
    known = np.where(np.isfinite(ratio), ratio, 0.0)
    mixed = np.stack([np.interp(known, stops, colours[:, k]) for k in range(3)], axis=-1)
    mixed[~np.isfinite(ratio)] = 128
    return mixed.astype(np.uint8)


def allowed_error(plan: Plan, mission_time: float) -> float:
    """Return the tracking error in metres beyond which a vehicle is off track.

    The tracking radius, which counts against the certificate, only while cable is off the floor.
    """
    tracking = plan.mission.vehicles.tracking
    aloft = plan.phase_at(mission_time).cable in {"lifting", "aloft"}
    return tracking if aloft else max(tracking, LOOSE_ERROR)


def vehicle_states(snapshot: Snapshot, tracking: float) -> list[str]:
    """Return each vehicle's worst state, a key of :data:`STATE_COLOURS`.

    A vehicle is off track beyond the ``tracking`` radius (metres), and silent without packets.
    """
    error = tracking_errors(snapshot)
    grip_states = [
        "attached" if gripped else "armed" if armed else "idle"
        for gripped, armed in zip(snapshot.gripped, snapshot.armed, strict=True)
    ]
    silent = ~(snapshot.link_age <= SILENT_AFTER)
    off = (error > tracking) & (tracking > 0) & np.array(snapshot.armed)
    return [
        "silent" if is_silent or reported == "silent" else "off track" if is_off else state
        for reported, state, is_silent, is_off in zip(
            snapshot.states, grip_states, silent, off, strict=True
        )
    ]


def tracking_errors(snapshot: Snapshot) -> Floats:
    """Return the distance (n,) of every grip point to its setpoint in metres, NaN if unknown."""
    errors: Floats = np.linalg.norm(snapshot.position - snapshot.setpoint, axis=-1)
    return errors


def follow_grips(
    previous: Floats, was_gripped: npt.NDArray[np.bool_], snapshot: Snapshot
) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Return the cable's grip points (n, 3) after a snapshot, and which vehicles hold them (n,).

    A gripped point moves with its vehicle. A released point lies on the floor below the place of
    the release; its fall is not modelled.
    """
    gripped = np.asarray(snapshot.gripped, dtype=bool)
    known = np.isfinite(snapshot.position).all(axis=-1)
    moved = np.where((gripped & known)[:, None], snapshot.position, previous)
    released = was_gripped & ~gripped
    moved[released, 2] = 0.0
    return moved, gripped


def shown_strands(
    snapshot: Snapshot, held: Floats, gripped: npt.NDArray[np.bool_], lengths: Floats, points: int
) -> Floats:
    """Return the cable of a snapshot (n − 1, k, 3): as estimated where all hold it, else hanging.

    ``held`` and ``gripped`` are those of :func:`follow_grips`; ``points`` per hanging strand.
    """
    if snapshot.cable is not None and gripped.all():
        return snapshot.cable
    return strands(held, lengths, points)


def planned_cable(plan: Plan, times: Floats) -> Floats:
    """Return the cable's grip points (k, n, 3) at mission times (k,), as :func:`follow_grips`."""
    position = plan.motion.at(times)[0]
    gripped = planned_grip(plan, times)
    held = np.where(gripped[:, None, None], position, laid_grip_points(plan))
    if gripped.any():
        last = times[gripped][-1]
        held[times > last] = plan.motion.at(last)[0] * [1.0, 1.0, 0.0]
    return held


def flown_cable(plan: Plan, trace: Trace) -> Floats:
    """Return the cable's grip points (k, n, 3) in a flight: as reported, gripped as planned."""
    gripped = planned_grip(plan, trace.mission_time)[:, None, None]
    return np.where(gripped, trace.position, planned_cable(plan, trace.mission_time))


def crossings(layout: KnotLayout) -> list[Crossing]:
    """Return the crossings of the folded cable, with the points of both strands."""
    crossings = []
    for over, under in layout.crossings:
        share = crossing_shares(layout.corners[:, :2], over, under)
        points = [
            solve_catenaries(layout.corners[k], layout.corners[k + 1], layout.lengths[k]).at_span(s)
            for k, s in zip((over, under), share, strict=True)
        ]
        crossings.append(Crossing(over + 1, under + 1, points[0], points[1]))
    return crossings


def workspace_lines(plan: Plan) -> dict[str, list[Floats]]:
    """Return what bounds the workspace as line strips (k, 3), by name; metres.

    The geofence: on the floor, at the ceiling, and its posts; the edges of obstacles, and planes as
    far as they are within AROUND of the flight.
    """
    workspace = plan.mission.workspace
    lines = {}
    if workspace.fence is not None:
        lines["fence"] = _prism_lines(np.array(workspace.fence), 0.0, workspace.ceiling)
    for obstacle in workspace.obstacles:
        lines[f"obstacle {obstacle.name}"] = _obstacle_lines(plan, solid_of(obstacle))
    return {name: strips for name, strips in lines.items() if strips}


def _obstacle_lines(plan: Plan, solid: Solid) -> list[Floats]:
    if np.isinf(solid.half_x):
        places = plan.motion.at(plan.motion.times)[0].reshape(-1, 3)
        normal = np.array([solid.normal_x, solid.normal_y, solid.normal_z])
        low, high = places.min(axis=0) - AROUND, places.max(axis=0) + AROUND
        return _plane_lines(normal, solid.high, low * [1.0, 1.0, 0.0], high)
    angle = 2.0 * np.pi * np.arange(0.5, ROUND) / ROUND
    # the corners of a box are its quarters of a circle without a radius
    side = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    local = np.sign(side) * [solid.half_x, solid.half_y] + solid.radius * side
    sides = ROUND // 4
    local = local if solid.radius > 0.0 else local[::sides]
    turned = np.array([[solid.cosine, solid.sine], [-solid.sine, solid.cosine]])
    corners = local @ turned + [solid.x, solid.y]
    return _prism_lines(corners, solid.low, solid.high, sides if solid.radius > 0.0 else 1)


def _plane_lines(normal: Floats, height: float, low: Floats, high: Floats) -> list[Floats]:
    """Return the border of the part of a plane p·n = ``height`` that is in a box; none outside."""
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    across /= np.linalg.norm(across)
    axes = np.stack([across, np.cross(normal, across)])
    middle = 0.5 * (low + high)
    middle += (height - middle @ normal) * normal
    ring = (
        middle + np.linalg.norm(high - low) * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) @ axes
    )
    for axis in range(3):
        for sign, bound in ((1.0, high[axis]), (-1.0, -low[axis])):
            beyond = sign * ring[:, axis] - bound
            kept = []
            for k in range(len(ring)):
                here, there = beyond[k - 1], beyond[k]
                if here * there < 0.0:
                    kept.append(ring[k - 1] + here / (here - there) * (ring[k] - ring[k - 1]))
                if there <= 0.0:
                    kept.append(ring[k])
            ring = np.array(kept).reshape(-1, 3)
    return [np.vstack([ring, ring[:1]])] if len(ring) else []


def _prism_lines(corners: Floats, low: float, high: float, every: int = 1) -> list[Floats]:
    """Return the edges of a prism over a polygon (k, 2): both rings, then ``every`` upright one."""
    ring = np.vstack([corners, corners[:1]])
    rings = [np.column_stack([ring, np.full(len(ring), height)]) for height in (low, high)]
    return rings + [np.array([[*corner, low], [*corner, high]]) for corner in corners[::every]]


def thrust_quaternions(acceleration: Floats) -> Floats:
    """Return the shortest rotations (…, 4), xyzw, from upright to the thrust of accelerations."""
    thrust = acceleration + np.array([0.0, 0.0, 9.80665])
    thrust = thrust / np.linalg.norm(thrust, axis=-1, keepdims=True)
    turned = np.stack(
        [-thrust[..., 1], thrust[..., 0], np.zeros_like(thrust[..., 0]), 1.0 + thrust[..., 2]],
        axis=-1,
    )
    unit: Floats = turned / np.linalg.norm(turned, axis=-1, keepdims=True)
    return unit


def crossing_shares(corners: Floats, first: int, second: int) -> tuple[float, float]:
    """Return the shares of two chords at which they cross in plan view."""
    a, b = corners[first], corners[second]
    u, w = corners[first + 1] - a, corners[second + 1] - b
    share = np.linalg.solve(np.column_stack([u, -w]), b - a)
    return float(share[0]), float(share[1])


def planned_strand_distances(plan: Plan, step: float = SAMPLE_INTERVAL) -> tuple[Floats, Floats]:
    """Return times (k,) and the smallest surface distance (k,) of strands aloft, metres.

    The motion is the planned one without tracking errors.
    """
    aloft = [phase for phase in plan.phases if phase.cable == "aloft"]
    start, end = aloft[0].start, aloft[-1].end
    times = np.linspace(start, end, max(2, round((end - start) / step) + 1))
    return times, smallest_strand_distances(plan, plan.motion.at(times)[0])


def smallest_strand_distances(plan: Plan, grips: Floats) -> Floats:
    """Return the smallest surface distance (k,) of strands between grip points (k, n, 3), metres.

    Neighbouring segments meet at a grip point and are left out.
    """
    shapes = strands(grips, plan.layout.lengths, POINTS_PER_SEGMENT)
    first, second = np.triu_indices(plan.vehicles - 1, 2)
    closest = strand_strand(shapes, np.column_stack([first, second])).distance.min(axis=1)
    surface: Floats = closest - plan.mission.cable.diameter
    return surface


def sampling_step(trace: Trace) -> int:
    """Return the number of instants of the trace between two points of the sampled curves."""
    if len(trace.time) < 2:
        return 1
    return max(1, round(SAMPLE_INTERVAL / float(np.median(np.diff(trace.time)))))


def fold_and_hold(trace: Trace) -> npt.NDArray[np.bool_]:
    """Return at which instants (k,) of fold and hold every vehicle's position is reported."""
    aloft = np.isin(np.array(trace.phase, dtype=str), ["fold", "hold"])
    return aloft & np.isfinite(trace.position).all(axis=(1, 2))
