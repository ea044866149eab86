"""What many trials say: distributions with confidence, and whether certificates told the truth."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from joblib import Parallel, delayed

from swarm.certification.clearances import tightest_moments
from swarm.planning import Plan
from swarm.simulation.monte_carlo.spread import Spread
from swarm.simulation.monte_carlo.trial import CLEARANCES, Trial

Floats = npt.NDArray[np.float64]

RADIUS_STEP: Final = 0.01
"""Metres between the tracking errors for which certificates are compared with trials."""

CONFIDENCE: Final = 0.95
_CHECKS: Final = ("cable clearance", "vehicle clearance", "vehicle-cable clearance")
_HOPELESS: Final = 1.0
_BETWEEN: Final = 6
_WORST: Final = 5


@dataclass(frozen=True, eq=False)
class Certificates:
    """What is certified for tracking errors ``radius`` (k,): smallest distances (k,), metres.

    −∞ where the certificate holds for nothing any more.
    """

    radius: Floats
    cable: Floats
    vehicle: Floats
    vehicle_cable: Floats

    def at(self, error: float, name: str) -> float:
        """Return what was certified for an error: at the next larger radius that was looked at."""
        index = int(np.searchsorted(self.radius, error - 1e-12))
        return float(getattr(self, name)[index]) if index < len(self.radius) else -math.inf


def certificates(plan: Plan, trials: Sequence[Trial], jobs: int = 1) -> Certificates:
    """Certify a plan for the tracking errors that its trials had, and for smaller ones.

    ``jobs`` processes of this machine share the work, which is some tenths of a second per error.
    """
    errors = [trial.error for trial in trials if trial.error is not None]
    had = np.ceil(np.array(errors) / RADIUS_STEP - 1e-9)
    had = had[had * RADIUS_STEP <= _HOPELESS]
    between = np.linspace(0.0, had.max(initial=1.0), _BETWEEN).round()
    radius = RADIUS_STEP * np.unique(np.concatenate([between, had]))
    rows = Parallel(n_jobs=jobs)(delayed(_certified)(plan, float(one)) for one in radius)
    table = np.array(rows).reshape(-1, len(_CHECKS))
    return Certificates(radius, *table.T)


def _certified(plan: Plan, tracking: float) -> list[float]:
    """Smallest distances of each kind that are certified for a tracking error, metres."""
    moments = tightest_moments(plan, tracking=tracking, checks=_CHECKS)
    return [
        min((one.distance for one in moments if one.check == check), default=math.inf)
        for check in _CHECKS
    ]


def below_certificate(trials: Sequence[Trial], certified: Certificates) -> list[int]:
    """Return the numbers of the trials that came closer than was certified for their error."""
    return [
        trial.number
        for trial in trials
        if trial.error is not None
        and any(
            was is not None and was < certified.at(trial.error, name) - 1e-6
            for name in CLEARANCES
            for was in [getattr(trial, name)]
        )
    ]


def summary(
    plan: Plan,
    trials: Sequence[Trial],
    *,
    seed: int,
    spread: Spread,
    certified: Certificates | None = None,
) -> dict[str, Any]:
    """Return what the trials say as one JSON-ready object; distances in metres.

    Distributions are of the trials in which no vehicle failed. Intervals of shares are those of
    Clopper and Pearson, of quantiles those of order statistics, at CONFIDENCE.
    """
    sound = [trial for trial in trials if not trial.failing]
    failing = [trial for trial in trials if trial.failing]
    required = {name: getattr(plan.mission.clearance, name) for name in CLEARANCES}
    required["hung"] = plan.mission.clearance.cable
    told: dict[str, Any] = {
        "mission": plan.mission.name,
        "method": plan.mission.fold.method,
        "trials": len(trials),
        "seed": seed,
        "spread": spread.model_dump(mode="json"),
        "confidence": CONFIDENCE,
        "no_vehicle_failing": {
            "trials": len(sound),
            "completed": _share([trial.completed for trial in sound]),
            "knot_as_planned": _share([trial.as_planned for trial in sound]),
            "clearance": {
                name: {"required": required[name], **_distribution(sound, name)}
                for name in required
            },
            "tracking_error": _distribution(sound, "error"),
            "left_the_tracking_ball": sum(
                trial.error is not None and trial.error > plan.mission.vehicles.tracking
                for trial in sound
            ),
        },
        "one_vehicle_failing": {
            "trials": len(failing),
            "completed": _share([trial.completed for trial in failing]),
            "clearance": {name: _distribution(failing, name) for name in required},
        },
        "trials_with_strikes": sum(trial.strikes > 0 for trial in trials),
        "trials_with_collisions": sum(trial.collisions > 0 for trial in trials),
        "vehicles_lost": sum(trial.crashed for trial in trials),
        "reasons": _counted(trial.reason for trial in trials if not trial.completed),
        "worst": [
            {
                "trial": trial.number,
                "cable": trial.cable,
                "outcome": trial.outcome,
                "reason": trial.reason,
                "failing": trial.failing,
            }
            for trial in worst(plan, trials)
        ],
    }
    if certified is not None:
        told["certificate"] = {
            "radius": certified.radius.tolist(),
            **{
                name: [_finite(value) for value in getattr(certified, name).tolist()]
                for name in CLEARANCES
            },
            "compared": sum(trial.error is not None for trial in trials),
            "below": below_certificate(trials, certified),
        }
    return told


def worst(plan: Plan, trials: Sequence[Trial]) -> list[Trial]:
    """Return the trials worth looking at first: harm, then failure, then the smallest margin."""

    def badness(trial: Trial) -> tuple[float, ...]:
        left = [
            was - getattr(plan.mission.clearance, name)
            for name in CLEARANCES
            if (was := getattr(trial, name)) is not None
        ]
        harm = trial.strikes + trial.collisions + trial.crashed
        return (-harm, trial.completed, min(left, default=math.inf), trial.number)

    return sorted(trials, key=badness)[:_WORST]


def _counted(words: Iterable[str]) -> dict[str, int]:
    found: dict[str, int] = {}
    for word in words:
        found[word] = found.get(word, 0) + 1
    return dict(sorted(found.items(), key=lambda item: (-item[1], item[0])))


def _share(flags: Sequence[bool]) -> dict[str, Any]:
    if not flags:
        return {"count": 0, "share": None, "interval": None}
    from scipy import stats  # noqa: PLC0415 - slow to import, and trials need none of it

    count = sum(flags)
    interval = stats.binomtest(count, len(flags)).proportion_ci(CONFIDENCE, "exact")
    return {
        "count": count,
        "share": count / len(flags),
        "interval": [float(interval.low), float(interval.high)],
    }


def _distribution(trials: Sequence[Trial], name: str) -> dict[str, Any]:
    values = np.sort([was for trial in trials if (was := getattr(trial, name)) is not None])
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
    """Interval of a quantile from the order statistics around it; None where it is open.

    The number of values below the quantile is binomial, whatever their distribution.
    """
    from scipy import stats  # noqa: PLC0415 - slow to import, and trials need none of it

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
