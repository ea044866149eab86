"""Drills: flights in which something goes wrong, in virtual time, judged by what really is."""

from swarm.drills.flying import Drill, fly_drills
from swarm.drills.judging import Trial
from swarm.drills.rehearsal import PERSONALITIES, Personality
from swarm.drills.rows import CITED, ROWS, Cited, Row

__all__ = [
    "CITED",
    "PERSONALITIES",
    "ROWS",
    "Cited",
    "Drill",
    "Personality",
    "Row",
    "Trial",
    "fly_drills",
]
