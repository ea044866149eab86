"""Drills: flights in which something goes wrong, in virtual time, judged by what really is."""

from swarm.drills.flying import Drill, Trial, fly_drills
from swarm.drills.rehearsal import PERSONALITIES, Personality
from swarm.drills.rows import ROWS, Row

__all__ = ["PERSONALITIES", "ROWS", "Drill", "Personality", "Row", "Trial", "fly_drills"]
