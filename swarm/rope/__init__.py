"""A rope in MuJoCo beside a plan (extra ``rope``): inertia, contact, drag and wind.

No part of the certificate. One function moves a rope: :func:`simulate_rope`, by the grip points
that :func:`planned_grips` or :func:`flown_grips` return.
"""

from swarm.rope.model import Grips
from swarm.rope.simulation import RopeRun, flown_grips, planned_grips, simulate_rope

__all__ = ["Grips", "RopeRun", "flown_grips", "planned_grips", "simulate_rope"]
