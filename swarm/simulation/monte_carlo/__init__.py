"""Many dry runs of one plan: what is drawn for each, how each went, and what all of them say.

A trial is a rehearsal in a world that is not quite what the plan expects. Seed and number of a
trial decide everything in it, so that any of them can be flown again alone.
"""

from swarm.simulation.monte_carlo.parallel import fly_trials, processes, workers_starting
from swarm.simulation.monte_carlo.spread import (
    FAILURES,
    Conditions,
    FailureKind,
    Spread,
    draw,
    read_scenario,
    trial_scenario_schema,
)
from swarm.simulation.monte_carlo.summaries import (
    CONFIDENCE,
    RADIUS_STEP,
    Certificates,
    below_certificate,
    certificates,
    summary,
    worst,
)
from swarm.simulation.monte_carlo.trial import (
    CLEARANCES,
    COLUMNS,
    SAMPLE_INTERVAL,
    Trial,
    fly_trial,
    rows,
)

__all__ = [
    "CLEARANCES",
    "COLUMNS",
    "CONFIDENCE",
    "FAILURES",
    "RADIUS_STEP",
    "SAMPLE_INTERVAL",
    "Certificates",
    "Conditions",
    "FailureKind",
    "Spread",
    "Trial",
    "below_certificate",
    "certificates",
    "draw",
    "fly_trial",
    "fly_trials",
    "processes",
    "read_scenario",
    "rows",
    "summary",
    "trial_scenario_schema",
    "workers_starting",
    "worst",
]
