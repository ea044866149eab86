"""The motion of a plan as trajectory files of Crazyswarm2, one per vehicle.

A file has a header and one row per piece: its duration, then eight coefficients each of x, y, z and
yaw, lowest power first, of the time since the piece began (the ``uav_trajectory`` files that
Crazyswarm2 reads; https://www.bitcraze.io/documentation/repository/crazyflie-firmware/master/
functional-areas/trajectory_formats/ describes the polynomials).
"""

from collections.abc import Iterator

import numpy as np

from swarm.certification.certificate import CertifiedPlan
from swarm.geometry.motion import Motion

MEMORY = 31
"""Pieces that the trajectory memory of a Crazyflie holds: 4 KiB at 132 bytes (page above)."""
_POWERS = 8


def trajectory_files(plan: CertifiedPlan) -> dict[str, str]:
    """Return the text of ``vehicle_1.csv``… of a cleared plan, by name.

    Pieces are the plan's own polynomials, of degree five, without rounding: metres ENU of the grip
    points, which are at 0 where a vehicle stands. Yaw is 0.
    """
    motion = plan.plan.motion
    return {
        f"vehicle_{vehicle + 1}.csv": "\n".join(_rows(motion, vehicle)) + "\n"
        for vehicle in range(plan.plan.vehicles)
    }


def _rows(motion: Motion, vehicle: int) -> Iterator[str]:
    names = [f"{axis}^{power}" for axis in ("x", "y", "z", "yaw") for power in range(_POWERS)]
    yield ",".join(["duration", *names])
    for duration, piece in zip(np.diff(motion.times), motion.coefficients, strict=True):
        polynomials = np.zeros((4, _POWERS))
        polynomials[:3, : len(piece)] = piece[:, vehicle].T
        yield ",".join(map(repr, [float(duration), *polynomials.reshape(-1).tolist()]))
