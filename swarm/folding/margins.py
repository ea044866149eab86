"""Margins of a team's vehicles and strands, and how much they are missed."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary import MAX_CHORD_RATIO
from swarm.geometry.sensitivity import Sensitivity
from swarm.signatures import Floats1, Floats3, Floats4

Floats = npt.NDArray[np.float64]


class Margins(NamedTuple):
    """Clearances in metres, and the figures of vehicles and cable that distances depend on.

    ``cable`` is from axis to axis of two strands, ``vehicle`` and ``downwash`` between vehicles,
    ``vehicle_cable`` from a vehicle to a strand's axis. ``tracking`` is the radius of the tracking
    ball; ``radius`` and ``grip_offset`` describe the vehicle. ``exempt`` is the length of cable on
    either side of a grip that is not compared with the neighbouring segment. ``chord_ratio`` is the
    preferred chord of a moving segment as a share of its length, ``max_chord_ratio`` the largest
    one, of which two tracking errors are subtracted.
    """

    cable: float
    vehicle: float
    downwash: float
    vehicle_cable: float
    tracking: float
    radius: float
    grip_offset: float
    exempt: float = 0.0
    chord_ratio: float = 0.79
    max_chord_ratio: float = MAX_CHORD_RATIO


class PenaltyModel(NamedTuple):
    """Margins, and the tables by which strands respond to tracking errors."""

    margins: Margins
    tables: Sensitivity


class Team(NamedTuple):
    """A team at s moments: positions (s, n, 3) of its vehicles, and its strands (s, n − 1).

    ``points``, ``boxes`` and ``shapes`` are as in :class:`swarm.folding.outlines.Outlines`;
    ``response`` (s, n − 1, 2) as in :func:`swarm.folding.end_response.write_largest_responses`.
    """

    positions: Floats3
    points: Floats4
    boxes: Floats4
    shapes: Floats3
    response: Floats3


class Penalty(NamedTuple):
    """Missed margins of a team at s moments, in units of a margin, squared and summed.

    ``missed`` is (s,); ``gradient`` (s, n, 3) is half its derivative by all positions.
    """

    missed: Floats1
    gradient: Floats3
