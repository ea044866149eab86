"""What the distances of a team's vehicles and strands depend on."""

from typing import NamedTuple

from swarm.geometry.catenary import MAX_CHORD_RATIO


class Margins(NamedTuple):
    """Clearances in metres, and what else the distances of a team depend on.

    ``cable`` counts from axis to axis of two strands, ``vehicle`` and ``downwash`` between
    vehicles, ``vehicle_cable`` from a vehicle to a strand's axis. ``tracking`` is the radius of the
    tracking ball; ``radius`` and ``grip_offset`` describe the vehicle. ``exempt`` is how much
    cable on either side of a vehicle need not keep apart from the neighbouring segment's.
    ``chord_ratio`` is the preferred chord of a segment in motion, as a share of its length, and
    ``max_chord_ratio`` the largest one, less what two tracking errors add.
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
