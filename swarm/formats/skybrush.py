"""The motion of a plan as a show file of Skybrush (.skyc): a ZIP archive with ``show.json``.

The trajectory of a vehicle is a list of ``[time, [x, y, z], control points]``: cubic Bézier curves
from one point to the next, which Skybrush Viewer and Skybrush Live read
(https://github.com/skybrush-io/skybrush.js, show-format). Times are whole milliseconds: Skybrush
Server rounds durations to them.
"""

import io
import json
import zipfile
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm.certification.certificate import CertifiedPlan
from swarm.geometry.motion import Motion

Floats = npt.NDArray[np.float64]
Milliseconds = npt.NDArray[np.int64]

TOLERANCE = 0.0005
"""Metres between the plan and its cubics: half a millimetre, to which Skybrush rounds points."""
_DIGITS = 4
"""Digits after the point of a metre."""
_ROUNDING = 0.5 * 10.0**-_DIGITS * 3.0**0.5
"""Metres by which rounding moves a point, and so a curve, at most."""
_SHARES = np.linspace(0.0, 1.0, 9)[1:-1]
"""Where in a cubic its error is looked for; that of a quintic has at most two largest values."""
_WRITTEN = (1980, 1, 1, 0, 0, 0)
"""Date of the archive's member: the same plan makes the same file."""


@dataclass(frozen=True, eq=False)
class Cubics:
    """Cubic Bézier curves of n points: ``times`` (k + 1,) in milliseconds, ``points`` (k, 4, n, 3).

    ``error`` is their largest distance from the motion, metres, at the moments that were looked at.
    """

    times: Milliseconds
    points: Floats
    error: float


def show_file(plan: CertifiedPlan) -> tuple[bytes, float]:
    """Return a cleared plan as a .skyc file, and its largest distance from the plan, metres.

    The distance is that at the moments of :data:`_SHARES`, and what rounding adds. Heights are
    those of the grip points, which are at 0 where a vehicle stands. Waits at gates, yaw, lights and
    the cable are not in it.
    """
    cubics = fitted(plan.plan.motion)
    title = plan.plan.mission.name
    drones = [_drone(cubics, vehicle) for vehicle in range(plan.plan.vehicles)]
    show = {
        "version": 1,
        "settings": {},
        "swarm": {"drones": drones},
        "environment": {"type": "outdoor"},
        "meta": {"title": title},
    }
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        member = zipfile.ZipInfo("show.json", _WRITTEN)
        member.compress_type = zipfile.ZIP_DEFLATED
        archive.writestr(member, json.dumps(show, separators=(",", ":")))
    return file.getvalue(), cubics.error + _ROUNDING


def _drone(cubics: Cubics, vehicle: int) -> dict[str, Any]:
    points = np.round(cubics.points[:, :, vehicle], _DIGITS) + 0.0  # no −0
    seconds = (cubics.times / 1000.0).tolist()
    places: list[Any] = [[seconds[0], points[0, 0].tolist(), []]]
    places += [
        [time, curve[3], [curve[1], curve[2]]]
        for time, curve in zip(seconds[1:], points.tolist(), strict=True)
    ]
    trajectory = {"version": 1, "takeoffTime": 0, "points": places}
    settings = {"name": str(vehicle + 1), "home": places[0][1], "trajectory": trajectory}
    return {"type": "generic", "settings": settings}


def fitted(motion: Motion, tolerance: float = TOLERANCE) -> Cubics:
    """Return cubics through states of a motion from time 0, not farther than ``tolerance`` from it.

    They meet at whole milliseconds with equal velocities. Each is halved until it is near enough
    at :data:`_SHARES`, or lasts one millisecond.
    """
    ends = np.append(np.floor(motion.times[:-1] * 1000.0), np.ceil(motion.times[-1] * 1000.0))
    times = np.unique(ends.astype(np.int64))
    while True:
        points = _through(motion, times)
        error = _errors(motion, times, points)
        split = (error > tolerance) & (np.diff(times) > 1)
        if not split.any():
            return Cubics(times, points, float(error.max()))
        middles = times[:-1][split] + np.diff(times)[split] // 2
        times = np.sort(np.concatenate([times, middles]))


def _through(motion: Motion, times: Milliseconds) -> Floats:
    """Return the control points (k, 4, n, 3) of cubics with the motion's places and velocities."""
    place, velocity, _ = motion.at(times / 1000.0)
    third = np.diff(times)[:, None, None] / 3000.0
    first, last = place[:-1], place[1:]
    return np.stack(
        [first, first + velocity[:-1] * third, last - velocity[1:] * third, last], axis=1
    )


def _errors(motion: Motion, times: Milliseconds, points: Floats) -> Floats:
    """Return the largest distance (k,) of any vehicle's cubic from its motion, metres."""
    s = _SHARES[:, None]
    weights = np.hstack([(1 - s) ** 3, 3 * s * (1 - s) ** 2, 3 * s**2 * (1 - s), s**3])
    moments = (times[:-1, None] + np.diff(times)[:, None] * _SHARES) / 1000.0
    apart = np.einsum("sb,kbnx->ksnx", weights, points) - motion.at(moments)[0]
    errors: Floats = np.linalg.norm(apart, axis=-1).max(axis=(1, 2))
    return errors
