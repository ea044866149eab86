"""Motion as piecewise quintics: the one form in which everything here moves.

All grip points share the breakpoints, so that a setpoint of the whole team is one lookup and one
polynomial. Time scaling to speed and acceleration limits lives here too.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """Piecewise quintics of n points.

    ``times`` (k + 1,) are the increasing breakpoints in seconds, ``coefficients`` (k, 6, n, 3) the
    polynomials of each piece in the time since its start, lowest power first, in metres ENU.
    """

    times: Floats
    coefficients: Floats

    def at(self, times: npt.ArrayLike) -> tuple[Floats, Floats, Floats]:
        """Return position, velocity and acceleration, each (…, n, 3), at times (…,).

        Outside the motion the nearest end is held at rest.
        """
        asked = np.asarray(times, dtype=np.float64)
        inside = np.clip(asked, self.times[0], self.times[-1])
        piece = np.searchsorted(self.times[1:-1], inside, side="right")
        u = (inside - self.times[piece])[..., None, None]
        c = np.moveaxis(self.coefficients[piece], -3, 0)
        position = c[0] + u * (c[1] + u * (c[2] + u * (c[3] + u * (c[4] + u * c[5]))))
        velocity = c[1] + u * (2 * c[2] + u * (3 * c[3] + u * (4 * c[4] + u * 5 * c[5])))
        acceleration = 2 * c[2] + u * (6 * c[3] + u * (12 * c[4] + u * 20 * c[5]))
        moving = ((asked >= self.times[0]) & (asked <= self.times[-1]))[..., None, None]
        return position, np.where(moving, velocity, 0.0), np.where(moving, acceleration, 0.0)


def through_states(
    times: Floats, position: Floats, velocity: Floats, acceleration: Floats
) -> Motion:
    """Return the C² motion through states at given times (quintic Hermite interpolation).

    ``times`` (k + 1,); states (k + 1, n, 3) in metres, m/s and m/s².
    """
    duration = np.diff(times)[:, None, None]
    p0, p1 = position[:-1], position[1:]
    v0, v1 = velocity[:-1] * duration, velocity[1:] * duration
    a0, a1 = acceleration[:-1] * duration**2, acceleration[1:] * duration**2
    step = p1 - p0
    unit = np.stack(
        [
            p0,
            v0,
            a0 / 2,
            10 * step - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1,
            -15 * step + 8 * v0 + 7 * v1 + 1.5 * a0 - a1,
            6 * step - 3 * (v0 + v1) - 0.5 * (a0 - a1),
        ],
        axis=1,
    )
    powers = np.diff(times)[:, None] ** np.arange(6)
    return Motion(times, unit / powers[:, :, None, None])


def joined(first: Motion, second: Motion) -> Motion:
    """Return two motions one after the other, the second shifted in time to follow the first."""
    shifted = second.times - second.times[0] + first.times[-1]
    return Motion(
        np.concatenate([first.times, shifted[1:]]),
        np.concatenate([first.coefficients, second.coefficients]),
    )
