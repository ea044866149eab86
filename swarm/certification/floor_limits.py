"""Certified conditions for cable on the floor: it lies, is drawn out, or descends without change.

Where they hold, the model of hanging cable is not needed.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.branch_and_bound import Boxes, Enclosure
from swarm.certification.motion_bounds import BoundedMotion, TeamStates

Floats = npt.NDArray[np.float64]

LYING = 0.25
"""Metres above the floor up to which a grip point holds cable that counts as lying on it."""

RIGID = 0.005
"""Metres by which a team may change its shape in what counts as a common vertical descent. No
distance relies on it: hanging strands are certified in the descent as in any other motion."""

BELOW = 1e-6
"""Metres by which a grip point may be below the floor: the last digit of motion files. No distance
relies on it."""


@dataclass(frozen=True, eq=False)
class DrawnOut:
    """Margins of a line's bends to 60° in plan view; per inner vehicle, metres.

    The projection of the shorter chord on the longer one, less half the shorter one's length.
    Strands of a line with smaller bends keep apart, whether they hang or lie below it.
    """

    motion: BoundedMotion

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, instant = boxes.instants()
        team = TeamStates.at(self.motion, time, half)
        middle = boxes.group + 1
        at, velocity = team.position[instant, middle], team.velocity[instant, middle]
        before = (at - team.position[instant, middle - 1])[:, :2]
        after = (team.position[instant, middle + 1] - at)[:, :2]
        sizes = np.stack([np.linalg.norm(chord, axis=1) for chord in (before, after)])
        along = np.einsum("bi,bi->b", before, after) / np.maximum(sizes.max(axis=0), 1e-12)
        growth = sum(
            team.drift(instant, other, velocity) + team.deviation[instant, middle]
            for other in (middle - 1, middle + 1)
        )
        high = along - 0.5 * sizes.min(axis=0)
        return Enclosure.over_time(high, 1.5 * np.asarray(growth), at)


@dataclass(frozen=True, eq=False)
class BesideRotors:
    """Margins of chords to the rims of the rotor discs at both ends; per segment, metres.

    Cable on the floor or below a chord stays out of both discs where the chord rises less than the
    line from a grip to the rim. At the segment's far end, for every displacement within the
    tracking radius.
    """

    motion: BoundedMotion
    tracking: float
    rim: float
    """Height of the disc over the grip, per metre from its axis to the rim."""

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, instant = boxes.instants()
        team = TeamStates.at(self.motion, time, half)
        first, last = boxes.group, boxes.group + 1
        step = team.position[instant, last] - team.position[instant, first]
        span, rise = np.hypot(step[:, 0], step[:, 1]), np.abs(step[:, 2])
        growth = team.drift(instant, last, team.velocity[instant, first])
        growth += team.deviation[instant, first]
        ball = 2.0 * self.tracking
        high = self.rim * (span - ball) - (rise + ball)
        middle = 0.5 * (team.position[instant, first] + team.position[instant, last])
        return Enclosure.over_time(high, (1.0 + self.rim) * growth, middle)


@dataclass(frozen=True, eq=False)
class RigidDescent:
    """Margins of a team's change of shape to RIGID while it descends; per vehicle, metres.

    ``starts`` (s,) are the times at which a descent begins.
    """

    motion: BoundedMotion
    starts: Floats

    def __call__(self, boxes: Boxes) -> Enclosure:
        """Enclose the margin in each box."""
        time, half, instant = boxes.instants()
        team = TeamStates.at(self.motion, time, half)
        begun = np.searchsorted(self.starts, time, side="right") - 1
        moved = team.position - self.motion.at(self.starts)[0][begun]
        moved[..., 2] -= moved[:, :1, 2].copy()
        down = team.velocity[instant, 0] * [0.0, 0.0, 1.0]
        doubt = team.drift(instant, boxes.group, down) + team.deviation[instant, 0]
        high = RIGID - np.linalg.norm(moved[instant, boxes.group], axis=-1)
        return Enclosure.over_time(high, doubt, team.position[instant, boxes.group])
