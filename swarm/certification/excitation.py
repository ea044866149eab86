"""Swing that tracking errors excite: an estimate from their spectrum, outside the certificate.

Tracking errors within the radius count as slow in the certificate. At a strand's own frequencies
they excite its modes, of which each is an oscillator with one degree of freedom, driven by the mean
of both ends. Air damps it in proportion to its amplitude.
"""

import math

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary import STANDARD_GRAVITY

Floats = npt.NDArray[np.float64]

DENSITY, CORNER, SLOPE = 2.5e-5, 0.6, 3.5
"""Spectral density of the tracking errors of one grip point along one axis, m²/Hz, one-sided, up to
the corner in Hz, and the power with which it falls above: emulated vehicles whose largest error is
MEASURED_AT, in a dry run of the overhand with the swinging cable (0.35 to 1.5 Hz)."""

MEASURED_AT = 0.1
"""Largest tracking error in that dry run, metres: densities are proportional to its square."""

DAMPING = 0.16
"""Damping ratio of the lateral mode per metre of amplitude: 4 % at 0.25 m (lumped masses)."""

PARTICIPATION = 4.0 / math.pi
"""Movement of the middle of a strand in its first mode for a movement of both ends."""

DEVIATIONS = 3.0
"""Standard deviations that count: exceeded 0.3 % of the time."""


def density(frequency: float, tracking: float) -> float:
    """Return the spectral density of tracking errors at a frequency (Hz), in m²/Hz."""
    share = (tracking / MEASURED_AT) ** 2
    return float(share * DENSITY * min(1.0, (CORNER / frequency) ** SLOPE))


def lateral_frequency(sag: float) -> float:
    """Return the first lateral frequency (Hz) of a strand with a sag in metres (Irvine 1981)."""
    return math.sqrt(STANDARD_GRAVITY / (0.8 * max(sag, 1e-3))) / (2.0 * math.pi)


def deviation(frequency: float, tracking: float) -> float:
    """Return the standard deviation of a mode's largest movement, metres.

    That of a lightly damped oscillator, σ² = Γ²·S·πf / 4ζ (Crandall and Mark 1963, 2.3), with half
    the density for the mean of two ends, and the damping ratio of the amplitude √2·σ.
    """
    drive = PARTICIPATION**2 * 0.5 * density(frequency, tracking) * math.pi * frequency
    return math.cbrt(drive / (4.0 * DAMPING * math.sqrt(2.0)))


def variance_along(
    normal: Floats, chord: Floats, sag: float, fraction: float, tracking: float
) -> float:
    """Return the variance (m²) of the movement of a point of a strand along a unit vector (3,).

    ``chord`` (3,) joins its ends. Of the first lateral mode, and of the first antisymmetric one in
    the plane of the strand, of twice the frequency.
    """
    across = np.array([-chord[1], chord[0], 0.0])
    size = float(np.linalg.norm(across))
    lateral = abs(float(across @ normal)) / size if size > 1e-9 else 1.0
    own = lateral_frequency(sag)
    aside = deviation(own, tracking) * math.sin(math.pi * fraction) * lateral
    within = deviation(2.0 * own, tracking) * math.sin(2.0 * math.pi * fraction)
    return aside**2 + within**2 * (1.0 - min(lateral, 1.0) ** 2)
