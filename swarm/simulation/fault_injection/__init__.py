"""Drills: flights in which something goes wrong, in virtual time, judged by what really is."""

from swarm.simulation.fault_injection.flying import FailureTest, run_failure_tests
from swarm.simulation.fault_injection.judging import Trial
from swarm.simulation.fault_injection.rehearsal import PERSONALITIES, Personality
from swarm.simulation.fault_injection.rows import CITED, ROWS, Cited, Row

__all__ = [
    "CITED",
    "PERSONALITIES",
    "ROWS",
    "Cited",
    "FailureTest",
    "Personality",
    "Row",
    "Trial",
    "run_failure_tests",
]
