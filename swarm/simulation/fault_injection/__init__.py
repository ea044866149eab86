"""Fault injection: simulated flights with faults, evaluated by the emulator's ground truth."""

from swarm.simulation.fault_injection.evaluation import FaultTrial
from swarm.simulation.fault_injection.failure_cases import (
    FAILURE_CASES,
    SYSTEM_FAILURE_CASES,
    FailureCase,
    SystemFailureCase,
)
from swarm.simulation.fault_injection.failure_tests import (
    FailureTest,
    FailureTestSettings,
    run_failure_tests,
)
from swarm.simulation.fault_injection.stepped_simulation import TEAM_AUTOPILOTS, TeamAutopilots

__all__ = [
    "FAILURE_CASES",
    "SYSTEM_FAILURE_CASES",
    "TEAM_AUTOPILOTS",
    "FailureCase",
    "FailureTest",
    "FailureTestSettings",
    "FaultTrial",
    "SystemFailureCase",
    "TeamAutopilots",
    "run_failure_tests",
]
