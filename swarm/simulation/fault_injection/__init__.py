"""Drills: flights in which something goes wrong, in virtual time, judged by what really is."""

from swarm.simulation.fault_injection.failure_cases import (
    FAILURE_CASES,
    SYSTEM_FAILURE_CASES,
    FailureCase,
    SystemFailureCase,
)
from swarm.simulation.fault_injection.flying import FailureTest, run_failure_tests
from swarm.simulation.fault_injection.judging import FaultTrial
from swarm.simulation.fault_injection.rehearsal import PERSONALITIES, Personality

__all__ = [
    "FAILURE_CASES",
    "PERSONALITIES",
    "SYSTEM_FAILURE_CASES",
    "FailureCase",
    "FailureTest",
    "FaultTrial",
    "Personality",
    "SystemFailureCase",
    "run_failure_tests",
]
