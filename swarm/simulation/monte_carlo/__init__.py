"""Monte Carlo simulation: many flights of a plan, each under conditions that are drawn anew.

Seed and number determine a trial, so each one can be flown again alone.
"""

from swarm.simulation.monte_carlo.parallel import fly_trials, workers_starting
from swarm.simulation.monte_carlo.spread import (
    FAILURES,
    Conditions,
    FaultKind,
    Spread,
    draw,
    read_scenario,
    trial_scenario_schema,
)
from swarm.simulation.monte_carlo.summaries import (
    CONFIDENCE,
    RADIUS_STEP,
    CertifiedClearances,
    below_certificate,
    certify_clearances,
    summary,
    worst_trials,
)
from swarm.simulation.monte_carlo.trial import (
    COLUMNS,
    DISTANCES,
    SAMPLE_INTERVAL,
    Trial,
    fly_trial,
    table_rows,
)

__all__ = [
    "COLUMNS",
    "CONFIDENCE",
    "DISTANCES",
    "FAILURES",
    "RADIUS_STEP",
    "SAMPLE_INTERVAL",
    "CertifiedClearances",
    "Conditions",
    "FaultKind",
    "Spread",
    "Trial",
    "below_certificate",
    "certify_clearances",
    "draw",
    "fly_trial",
    "fly_trials",
    "read_scenario",
    "summary",
    "table_rows",
    "trial_scenario_schema",
    "workers_starting",
    "worst_trials",
]
