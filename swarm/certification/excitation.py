"""Swing that tracking errors excite: an estimate from their spectrum, outside the certificate.

Tracking errors within the radius count as slow in the certificate. At a strand's own frequencies
they excite its modes. A strand hangs as an inextensible chain: its modes are those of the chain
about the catenary, each an oscillator that is driven by the acceleration of the shapes that follow
the ends slowly (pseudo-static modes: Clough and Penzien 1993, 26-2). Air damps them, all the more
where the strand moves through it.

The tube of all changes is for vehicles exactly on the plan. Those of a flight err within the
tracking radius, and so excite the strands: a flown cable may swing by both together.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.certification.swing_tube import SwingTube
from swarm.geometry.catenary import STANDARD_GRAVITY, Catenaries, solve_catenaries
from swarm.geometry.lumped_mass import cable_model
from swarm.jit import allocates, compiled, inner
from swarm.planning import Plan
from swarm.signatures import Floats1, Floats2

Floats = npt.NDArray[np.float64]

DENSITY, CORNER, SLOPE = 2.5e-5, 0.6, 3.5
"""Spectral density of the tracking errors of one grip point along one axis, m²/Hz, one-sided, up to
the corner in Hz, and the power with which it falls above: emulated vehicles whose largest error is
MEASURED_AT, in a dry run of the overhand with the swinging cable (0.35 to 1.5 Hz)."""

MEASURED_AT = 0.1
"""Largest tracking error in that dry run, metres: densities are proportional to its square."""

DEVIATIONS = 3.0
"""Standard deviations that count: exceeded 0.3 % of the time."""

STEP = 0.5
"""Seconds between the speeds of a strand through the air; a period lasts 1 s or longer."""

_LINKS = 12
"""Links of the chain: with 48 of them the three lowest frequencies differ by about 1 %."""

_LINEARIZED = 4.0 / 3.0
"""Equivalent linear drag of a random velocity in a plane over its root mean square: with |v|
Rayleigh distributed, E|v|³/E|v|² is 1.33 of it; along a line 1.60, which damps more."""

_ROUNDS = 12
"""Rounds of damping and amplitude, each of which halves the error."""

_UNDAMPED = 1e-6
"""Least damping ratio, for modes in which nothing moves across the cable."""


@dataclass(frozen=True, eq=False)
class Modes:
    """Modes of a strand about its catenary, per unit of mass per length.

    ``frequencies`` (k,) in Hz, lowest first; ``shapes`` (joints, 3, k), normalized by mass;
    ``participation`` (k, 6), the drive per acceleration of the first and of the last end; ``mass``
    of a joint.
    """

    frequencies: Floats
    shapes: Floats
    participation: Floats
    mass: float

    def along(self, fraction: float, normal: Floats) -> Floats:
        """Return the movement (k,) along a unit vector (3,) of the point at a share of length."""
        links = len(self.shapes) - 1
        first = min(int(fraction * links), links - 1)
        share = fraction * links - first
        point = (1.0 - share) * self.shapes[first] + share * self.shapes[first + 1]
        movement: Floats = normal @ point
        return movement


def density(frequency: Floats, tracking: float) -> Floats:
    """Return the spectral density of tracking errors at frequencies (…,) in Hz, in m²/Hz."""
    share = (tracking / MEASURED_AT) ** 2
    spectrum: Floats = share * DENSITY * (CORNER / np.maximum(frequency, CORNER)) ** SLOPE
    return spectrum


def modes(strand: Catenaries, links: int = _LINKS) -> Modes:
    """Return the modes of one strand, a batch (1,), that hangs still between fixed ends.

    Links keep their length; where their ends move across them, the stiffness of a link of length l
    under tension T is T/l.
    """
    joints = strand.points(np.linspace(0.0, 1.0, links + 1))[0]
    size, parameter = float(strand.length[0]) / links, float(strand.parameter[0])
    arc = (np.arange(links) + 0.5) * size + float(strand.slope[0]) * parameter
    tension = STANDARD_GRAVITY * np.hypot(parameter, arc)
    along = np.diff(joints, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    difference = np.diff(np.eye(links + 1), axis=0)
    stiffness = np.kron((difference.T * (tension / size)) @ difference, np.eye(3))
    stretch = (difference[:, :, None] * along[:, None, :]).reshape(links, -1)
    inner, ends = np.arange(3, 3 * links), np.r_[0:3, 3 * links : 3 * links + 3]
    own, held = stiffness[np.ix_(inner, inner)], stretch[:, inner]
    free = np.linalg.svd(held)[2][links:].T
    squares, vectors = np.linalg.eigh(free.T @ own @ free / size)
    system = np.block([[own, held.T], [held, np.zeros((links, links))]])
    moved = -np.concatenate([stiffness[np.ix_(inner, ends)], stretch[:, ends]])
    slow = np.linalg.solve(system, moved)[: len(inner)]
    flat = free @ vectors / math.sqrt(size)
    shapes = np.zeros((links + 1, 3, len(squares)))
    shapes[1:-1] = flat.reshape(links - 1, 3, -1)
    frequencies = np.sqrt(squares) / (2.0 * math.pi)
    return Modes(frequencies, shapes, size * flat.T @ slow, size)


@dataclass(frozen=True)
class Variances:
    """Variances (m²) of the swing at a moment of the plan, and after a long hold there."""

    moving: float
    held: float


def variances_along(
    modes: Modes, at: tuple[float, Floats], tracking: float, drag: float, speeds: Floats
) -> Variances:
    """Return the variances of the swing of a point of a strand along a unit vector.

    ``at`` is its share of the length and the vector (3,). ``drag`` is ½ρ·C·d / μ in 1/m,
    ``speeds`` (k,) those of the strand across the air before the moment, STEP seconds apart, since
    it came aloft at rest.

    """
    moving, held = modal_variances(modes, tracking, drag, speeds)
    weights = modes.along(*at) ** 2
    return Variances(float(weights @ moving), float(weights @ held))


def speeds_across(places: Floats, velocities: Floats) -> Floats:
    """Return the speeds (k,) of a strand across its chord, by its two ends (k, 2, 3), m/s."""
    chord = np.diff(places, axis=1)[:, 0]
    chord /= np.linalg.norm(chord, axis=1, keepdims=True)
    mean = velocities.mean(axis=1)
    across = mean - np.einsum("ki,ki->k", mean, chord)[:, None] * chord
    speeds: Floats = np.linalg.norm(across, axis=1)
    return speeds


def largest_deviation(modes: Modes, variances: Floats) -> float:
    """Return the largest standard deviation of any joint in any direction, metres.

    ``variances`` (k,) are those of the modes, as of :func:`modal_variances`.
    """
    spread = np.einsum("jxk,jyk,k->jxy", modes.shapes, modes.shapes, variances)
    return math.sqrt(max(float(np.linalg.eigvalsh(spread).max()), 0.0))


def modal_variances(
    modes: Modes, tracking: float, drag: float, speeds: Floats
) -> tuple[Floats, Floats]:
    """Return the variances (k,) of a strand's modes in motion, and after a long hold.

    ``drag`` and ``speeds`` as for :func:`variances_along`. With the damping ratio ζ, the variance
    of a mode of frequency f approaches Γ²·S·πf / 4ζ (Crandall and Mark 1963, 2.3) with the time
    constant 1 / 4πζf.
    """
    frequency = modes.frequencies
    drive = (modes.participation**2).sum(axis=1) * density(frequency, tracking)
    drive *= math.pi * frequency / 4.0
    square = np.ascontiguousarray((modes.shapes**2).sum(axis=1))
    driven = _Driven(frequency, drive, square, drag * modes.mass)
    moving, held = np.zeros_like(drive), drive / 0.01
    _settle(driven, held)
    _follow(driven, np.ascontiguousarray(speeds), moving)
    return moving, held


class _Driven(NamedTuple):
    """Modes (k,) with frequencies in Hz and ``drive``; the squares of their shapes (joints, k);
    and the drag in 1/m times the mass of a joint, per mass per length."""

    frequency: Floats1
    drive: Floats1
    square: Floats2
    drag: float


@compiled
@allocates
def _settle(driven: _Driven, variances: Floats1) -> None:
    """Write the variances (k,) after a long hold over a first guess of them."""
    ratios = np.empty_like(variances)
    for _ in range(_ROUNDS):
        _write_damping(driven, variances, 0.0, ratios)
        for k in range(len(variances)):
            variances[k] = np.sqrt(variances[k] * driven.drive[k] / ratios[k])


@compiled
@allocates
def _follow(driven: _Driven, speeds: Floats1, variances: Floats1) -> None:
    """Let variances (k,) follow the speeds (m,), STEP seconds each."""
    ratios = np.empty_like(variances)
    for speed in speeds:
        _write_damping(driven, variances, speed, ratios)
        for k in range(len(variances)):
            rest = np.exp(-4.0 * math.pi * ratios[k] * driven.frequency[k] * STEP)
            variances[k] = variances[k] * rest + driven.drive[k] / ratios[k] * (1.0 - rest)


@inner
def _write_damping(driven: _Driven, variances: Floats, speed: float, ratios: Floats) -> None:
    """Write the damping ratios (k,) of modes with these variances, in air of a speed."""
    frequency, _, square, drag = driven
    ratios[:] = 0.0
    for joint in range(len(square)):
        shaken = speed * speed
        for k in range(len(ratios)):
            rate = _LINEARIZED * 2.0 * math.pi * frequency[k]
            shaken += rate * rate * variances[k] * square[joint, k]
        for k in range(len(ratios)):
            ratios[k] += np.sqrt(shaken) * square[joint, k]
    for k in range(len(ratios)):
        ratio = drag * ratios[k] / (4.0 * math.pi * frequency[k])
        ratios[k] = max(ratio, _UNDAMPED)


_APART, _MOST = 2.5, 40
"""Seconds between the moments whose excited swing is computed, at least, and their largest number:
the places of the strands and their speeds decide it, which change within several seconds. A moment
of nineteen vehicles takes 0.05 s."""

_PAST = 60.0
"""Seconds of the motion before a moment that count: with 2 % of critical damping at 0.4 Hz they
leave a four-hundredth of the variance."""


def allowed_swing(plan: Plan, tube: SwingTube, times: Floats) -> Floats:
    """Return how far strands may swing at mission times (k,), metres (k, n − 1).

    The radius of the tube, and three standard deviations of the swing that tracking errors of the
    plan's tracking radius excite, in any direction, at the joint that swings farthest.
    """
    first, last = float(tube.times[0]), float(tube.times[-1])
    count = int(np.clip((last - first) / _APART, 1, _MOST))
    moments = np.linspace(first, last, count + 1)
    excited = DEVIATIONS * np.array([_excited_swing(plan, tube.start, t) for t in moments.tolist()])
    radius = np.array([tube.all_changes.strands(time) for time in times.tolist()])
    between = [np.interp(times, moments, strand) for strand in excited.T]
    allowed: Floats = radius.reshape(len(times), -1) + np.stack(between, axis=1)
    return allowed


def _excited_swing(plan: Plan, since: float, time: float) -> Floats:
    """Return the largest standard deviation of each strand's excited swing (n − 1,), metres."""
    cable, lengths = plan.mission.cable, plan.layout.lengths
    drag = cable_model(cable.mass_per_length, cable.diameter).normal_drag
    place, velocity, _ = plan.motion.at(np.arange(max(since, time - _PAST), time, STEP))
    now = plan.motion.at(time)[0]
    deviations = np.empty(len(lengths))
    for k, length in enumerate(lengths.tolist()):
        strand = modes(solve_catenaries(now[k][None], now[k + 1][None], np.array([length])))
        speeds = speeds_across(place[:, k : k + 2], velocity[:, k : k + 2])
        moving, _ = modal_variances(strand, plan.mission.vehicles.tracking, drag, speeds)
        deviations[k] = largest_deviation(strand, moving)
    return deviations
