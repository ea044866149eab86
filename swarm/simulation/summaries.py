"""Statistics of many trials, with confidence intervals, and their comparison with certificates."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from joblib import Parallel, delayed

from swarm.certification.clearances import families, moments_of
from swarm.certification.kinds import FIGURES, MEASURED, SWINGING, required_distances
from swarm.planning import Plan
from swarm.simulation.spread import Spread
from swarm.simulation.trials import Trial

Floats = npt.NDArray[np.float64]

RADIUS_STEP: Final = 0.01
"""Metres between the tracking radii for which the plan is certified again."""

CONFIDENCE: Final = 0.95
"""Level of every confidence interval."""

_MAX_RADIUS: Final = 1.0
"""Metres; larger tracking radii are not certified."""

_MIN_RADII: Final = 6
"""Number of radii from 0 to the largest tracking error, besides those of the trials."""

_WORST: Final = 5
"""Number of worst trials in a summary."""


@dataclass(frozen=True, eq=False)
class CertifiedClearances:
    """Certified bounds (k,) of ``distances`` for tracking radii (k,), metres, by their keys.

    A bound is −∞ where nothing is certified.
    """

    tracking_radius: Floats
    distances: Mapping[str, Floats]

    def at(self, error: float, name: str) -> float:
        """Return the bound of a clearance for a tracking error: that of the next larger radius.

        It is −∞ where the error is larger than every radius.
        """
        index = int(np.searchsorted(self.tracking_radius, error - 1e-12))
        bounds = self.distances[name]
        return float(bounds[index]) if index < len(bounds) else -math.inf


def certify_clearances(plan: Plan, trials: Sequence[Trial], jobs: int = 1) -> CertifiedClearances:
    """Return the certified clearances of a plan for the tracking errors of its trials.

    Smaller tracking radii are certified as well. The work, some tenths of a second per radius, is
    shared by ``jobs`` processes of this machine.
    """
    errors = [trial.tracking_error for trial in trials if trial.tracking_error is not None]
    steps = np.ceil(np.array(errors) / RADIUS_STEP - 1e-9)
    steps = steps[steps * RADIUS_STEP <= _MAX_RADIUS]
    smaller = np.linspace(0.0, steps.max(initial=1.0), _MIN_RADII).round()
    radii = RADIUS_STEP * np.unique(np.concatenate([smaller, steps]))
    keys = [
        key
        for key in MEASURED
        if key in FIGURES or any(trial.distances[key] is not None for trial in trials)
    ]
    bounds = Parallel(n_jobs=jobs)(
        delayed(_certified_clearances)(plan, float(radius), keys) for radius in radii
    )
    columns = np.array(bounds).reshape(-1, len(keys)).T
    return CertifiedClearances(radii, dict(zip(keys, columns, strict=True)))


def _certified_clearances(plan: Plan, tracking: float, keys: Sequence[str]) -> list[float]:
    """Return the certified bound of each clearance for a tracking radius, metres."""
    bounds = dict.fromkeys(keys, math.inf)
    for family in families(plan, tracking):
        if family.kind.flown in bounds:
            bounds[family.kind.flown] = min(moment.distance for moment in moments_of(family))
    return list(bounds.values())


def below_certificate(trials: Sequence[Trial], certified: CertifiedClearances) -> list[int]:
    """Return the numbers of the trials with a distance below the certified bound.

    The bound is that for the trial's own tracking error.
    """
    return [trial.number for trial in trials if _is_below(trial, certified)]


def _is_below(trial: Trial, certified: CertifiedClearances) -> bool:
    error = trial.tracking_error
    if error is None:
        return False
    return any(
        (distance := trial.distances[name]) is not None
        and distance < certified.at(error, name) - 1e-6
        for name in certified.distances
    )


def summary(
    plan: Plan,
    trials: Sequence[Trial],
    *,
    seed: int,
    spread: Spread,
    certified: CertifiedClearances | None = None,
) -> dict[str, Any]:
    """Return the statistics of trials as an object for JSON; distances in metres.

    Shares have Clopper-Pearson intervals, quantiles the intervals of order statistics, both at the
    level CONFIDENCE.
    """
    without = [trial for trial in trials if not trial.failure]
    with_failure = [trial for trial in trials if trial.failure]
    required = required_distances(plan.mission)
    required |= {key: kind.required(plan.mission) for key, kind in SWINGING.items()}
    document: dict[str, Any] = {
        "mission": plan.mission.name,
        "method": plan.mission.fold.method,
        "trials": len(trials),
        "seed": seed,
        "spread": spread.model_dump(mode="json"),
        "confidence": CONFIDENCE,
        "without_failure": {
            "trials": len(without),
            "completed": _share([trial.completed for trial in without]),
            "knot_as_planned": _share([trial.as_planned for trial in without]),
            "clearance": {
                name: {"required": required[name], **_distances(without, name)} for name in required
            },
            "tracking_error": _distribution([trial.tracking_error for trial in without]),
            "outside_tracking_radius": sum(
                trial.tracking_error is not None
                and trial.tracking_error > plan.mission.vehicles.tracking
                for trial in without
            ),
        },
        "with_failure": {
            "trials": len(with_failure),
            "completed": _share([trial.completed for trial in with_failure]),
            "clearance": {name: _distances(with_failure, name) for name in required},
        },
        "trials_with_rotor_strikes": sum(trial.rotor_strikes > 0 for trial in trials),
        "trials_with_collisions": sum(trial.collisions > 0 for trial in trials),
        "vehicles_lost": sum(trial.crashes for trial in trials),
        "reasons": _count(trial.reason for trial in trials if not trial.completed),
        "worst": [
            {
                "trial": trial.number,
                "cable": trial.distances["cable"],
                "outcome": trial.outcome,
                "reason": trial.reason,
                "failure": trial.failure,
            }
            for trial in worst_trials(plan, trials)
        ],
    }
    if certified is not None:
        document["certificate"] = {
            "tracking_radius": certified.tracking_radius.tolist(),
            **{
                name: [_finite(value) for value in bounds.tolist()]
                for name, bounds in certified.distances.items()
            },
            "compared": sum(trial.tracking_error is not None for trial in trials),
            "below": below_certificate(trials, certified),
        }
    return document


def worst_trials(plan: Plan, trials: Sequence[Trial]) -> list[Trial]:
    """Return the worst trials: by contacts and crashes, then incomplete ones, then by margin."""

    def order(trial: Trial) -> tuple[float, ...]:
        margins = [
            distance - kind.required(plan.mission)
            for name, kind in MEASURED.items()
            if kind.listed and (distance := trial.distances[name]) is not None
        ]
        damage = trial.rotor_strikes + trial.collisions + trial.crashes
        return (-damage, trial.completed, min(margins, default=math.inf), trial.number)

    return sorted(trials, key=order)[:_WORST]


def _count(words: Iterable[str]) -> dict[str, int]:
    """Return how often each word occurs, the most frequent first."""
    counts = Counter(words)
    return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def _share(flags: Sequence[bool]) -> dict[str, Any]:
    if not flags:
        return {"count": 0, "share": None, "interval": None}
    from scipy import stats  # noqa: PLC0415 - slow to import; trials do not need it

    count = sum(flags)
    interval = stats.binomtest(count, len(flags)).proportion_ci(CONFIDENCE, "exact")
    return {
        "count": count,
        "share": count / len(flags),
        "interval": [float(interval.low), float(interval.high)],
    }


def _distances(trials: Sequence[Trial], name: str) -> dict[str, Any]:
    return _distribution([trial.distances[name] for trial in trials])


def _distribution(samples: Iterable[float | None]) -> dict[str, Any]:
    values = np.sort([value for value in samples if value is not None])
    if not len(values):
        return {"count": 0}
    return {
        "count": len(values),
        "smallest": float(values[0]),
        "largest": float(values[-1]),
        "quantiles": {
            f"{share:g}": {
                "value": float(np.quantile(values, share)),
                "interval": _quantile_interval(values, share),
            }
            for share in (0.05, 0.5, 0.95)
        },
    }


def _quantile_interval(values: Floats, share: float) -> list[float | None]:
    """Return the interval of a quantile between two order statistics; None for an open end.

    The number of values below the quantile is binomial for every continuous distribution.
    """
    from scipy import stats  # noqa: PLC0415 - slow to import; trials do not need it

    count = len(values)
    outside = 0.5 * (1.0 - CONFIDENCE)
    low = int(stats.binom.ppf(outside, count, share)) - 1
    high = int(stats.binom.ppf(1.0 - outside, count, share))
    return [
        float(values[low]) if low >= 0 else None,
        float(values[high]) if high < count else None,
    ]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
