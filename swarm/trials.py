"""Many dry runs of one plan: what is drawn for each, how each went, and what all of them say.

A trial is a rehearsal in a world that is not quite what the plan expects. Seed and number of a
trial decide everything in it, so that any of them can be flown again alone.
"""

import json
import math
import os
import signal
import sys
import threading
from collections.abc import Generator, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
from joblib import Parallel, delayed, parallel_config
from pydantic import Field
from scipy import stats

from swarm.borders import Section, number, parse_yaml, validate
from swarm.errors import InputError, Problem, SwarmError
from swarm.fleet import Fleet, emulated_fleet
from swarm.flight.conductor import Conductor
from swarm.flight.result import FlightResult
from swarm.flight.trace import Trace
from swarm.flight.world import emulated_world
from swarm.plans import Plan
from swarm.preflight.certificate import tightest_moments
from swarm.preflight.findings import Assessment, ProvenPlan
from swarm.rehearse import Emulator, Fault, faults_from, rehearse, scenario_schema
from swarm.verify import closest_strands, judge

Floats = npt.NDArray[np.float64]
Random = np.random.Generator

SAMPLE_INTERVAL: Final = 0.4
"""Seconds of flight between the moments at which a trial's distances are taken."""

RADIUS_STEP: Final = 0.01
"""Metres between the tracking errors for which certificates are compared with trials."""

CONFIDENCE: Final = 0.95
CLEARANCES: Final = ("cable", "vehicle", "vehicle_cable")
_CHECKS: Final = ("cable clearance", "vehicle clearance", "vehicle-cable clearance")
_SHARES: Final = np.linspace(0.0, 1.0, 25)
_ROUNDING: Final = 1e-6
_BOOT: Final = 30.0
_HOPELESS: Final = 1.0
_BETWEEN: Final = 6
_WORST: Final = 5


FailureKind = Literal[
    "motor_loss", "weak_thrust", "link", "leave_offboard", "gripper_slip", "freeze", "reboot",
    "gripper_stuck_open", "gripper_stuck_shut", "gps_loss", "position_loss", "disarm", "pilot",
    "believes_landed", "barometer_drift", "gps_jump", "battery",
]  # fmt: skip

FAILURES: Final[tuple[FailureKind, ...]] = (
    "motor_loss", "weak_thrust", "link", "leave_offboard", "gripper_slip", "freeze", "reboot",
)  # fmt: skip


class Spread(Section):
    """What is drawn anew for every trial, and from which distributions."""

    wind: float = number(
        0.5, "m/s", "Steady wind: uniform from 0 to this (or wind.steady, if larger), any heading.",
        least=0.0, most=20.0,
    )  # fmt: skip
    gust: float = number(
        0.2, "m/s", "Dryden intensity of gusts: uniform from 0 to this (or wind.gust, if larger).",
        least=0.0, most=10.0,
    )  # fmt: skip
    loss: float = number(
        0.02, "", "Share of packets that a vehicle's link loses: uniform from 0 to this, each.",
        least=0.0, most=1.0,
    )  # fmt: skip
    latency: float = number(
        0.03, "s", "Delay of a vehicle's link, each way: uniform from 0 to this, each.",
        least=0.0, most=5.0,
    )  # fmt: skip
    jitter: float = number(
        0.02, "s", "Spread of that delay from packet to packet: uniform from 0 to this, each.",
        least=0.0, most=5.0,
    )  # fmt: skip
    mass: float = number(
        0.05, "", "Standard deviation of a vehicle's mass as a share of vehicles.mass, which is "
        "what makes vehicles track differently; cut off at twice this.",
        least=0.0, most=0.4,
    )  # fmt: skip
    grip: float = number(
        0.01, "metres", "Standard deviation of where along the cable each vehicle grips; cut off "
        "at twice this.",
        least=0.0, most=1.0,
    )  # fmt: skip
    length: float = number(
        1.0, "", "Error of each segment's length: uniform within this many cable.length_tolerance.",
        least=0.0, most=100.0,
    )  # fmt: skip
    failing: float = number(
        0.1, "", "Share of trials in which one vehicle fails, in one of the ways of `failures`.",
        least=0.0, most=1.0,
    )  # fmt: skip
    failures: tuple[FailureKind, ...] = Field(
        FAILURES, description="Kinds of failure, as in `faults`; all equally likely."
    )


def read_scenario(text: str, source: str) -> tuple[Spread, tuple[Fault, ...]]:
    """Turn a scenario file's text into what is drawn for trials and the faults of every trial.

    It is the emulator's scenario, in which ``spread`` may say more. Raises :class:`InputError` with
    every problem.
    """
    document = parse_yaml(text, source)
    if not isinstance(document, dict):
        raise InputError([Problem(source, "expected keys: schema, faults, spread")])
    faults = {key: value for key, value in document.items() if key != "spread"}
    spread = validate(Spread, document.get("spread") or {}, f"{source}: spread")
    return spread, faults_from(json.dumps({"faults": [], **faults}, default=str), source)


def trial_scenario_schema() -> dict[str, Any]:
    """Return the JSON schema of scenario files with ``spread``, for editors."""
    schema = scenario_schema()
    spread = Spread.model_json_schema(by_alias=True)
    schema["properties"]["spread"] = {
        **spread, "description": "What trials draw anew each time; the rest keeps its default.",
    }  # fmt: skip
    schema["required"] = [key for key in schema.get("required", []) if key != "faults"]
    return schema


@dataclass(frozen=True)
class Conditions:
    """What was drawn for one trial: the emulator's world, its faults, and both in short.

    ``wind`` in m/s, ``failing`` names the vehicle that fails and how ("" where none does),
    ``failing_at`` is the flight's time of it in seconds.
    """

    world: Mapping[str, Any]
    faults: tuple[Fault, ...]
    wind: float
    gust: float
    failing: str
    failing_at: float | None


@dataclass(frozen=True)
class Trial:
    """How one trial went; one row of the results.

    ``outcome`` and ``reason`` in words. ``cable``, ``vehicle`` and ``vehicle_cable`` are the
    smallest distances in fold and hold, metres, of what the certificate speaks of: the cable in
    the cable model between the places where the vehicles really were. ``hung`` is the smallest
    distance of strands of the emulator's own cable, with its errors, wind and sway. ``error`` is
    the largest distance of a vehicle from its place in the plan then. None where nothing is known,
    the cable never having been aloft.
    """

    number: int
    outcome: str
    reason: str
    explanation: str
    knot: str
    as_planned: bool
    cable: float | None
    vehicle: float | None
    vehicle_cable: float | None
    hung: float | None
    error: float | None
    strikes: int
    collisions: int
    crashed: int
    wind: float
    gust: float
    failing: str
    failing_at: float | None
    duration: float

    @property
    def completed(self) -> bool:
        """Whether the flight was done as planned, and implies the knot of the plan."""
        return self.outcome == "done" and self.as_planned


def flown_anyway(plan: Plan, assessment: Assessment) -> ProvenPlan:
    """Return a plan for trials whatever the checks say of it: its errors become warnings.

    For comparisons in the emulator only; nothing real is flown by :mod:`swarm.trials`.
    """
    findings = tuple(
        replace(found, severity="warning") if found.severity == "error" else found
        for found in assessment.findings
    )
    return ProvenPlan(plan, replace(assessment, findings=findings))


def draw(
    plan: Plan, fleet: Fleet, spread: Spread, seed: int, trial: int, faults: Sequence[Fault] = ()
) -> Conditions:
    """Draw the conditions of a trial; the same seed and number give the same ones.

    ``faults`` happen in every trial, beside what is drawn.
    """
    rng = np.random.default_rng([seed, trial])
    mission = plan.mission
    count = plan.vehicles
    tolerance = spread.length * mission.cable.length_tolerance
    grips = _bounded(rng, spread.grip, count)
    lengths = plan.layout.lengths + tolerance * rng.uniform(-1.0, 1.0, count - 1) + np.diff(grips)
    laid = replace(plan, layout=replace(plan.layout, lengths=lengths))
    world = emulated_world(laid, fleet, with_cable=True, seed=int(rng.integers(2**31)))
    speed = float(rng.uniform(0.0, max(spread.wind, mission.wind.steady)))
    heading = float(rng.uniform(0.0, 2.0 * math.pi))
    gust = float(rng.uniform(0.0, max(spread.gust, mission.wind.gust)))
    world["wind"] = {
        "steady": [speed * math.cos(heading), speed * math.sin(heading), 0.0],
        "gust": gust,
    }
    drawn = list(faults)
    for vehicle, share in zip(world["vehicles"], _bounded(rng, spread.mass, count), strict=True):
        vehicle["mass"] *= 1.0 + float(share)
        trouble = {
            name: float(rng.uniform(0.0, getattr(spread, name)))
            for name in ("loss", "latency", "jitter")
        }
        if any(trouble.values()):
            drawn.append(Fault(at=0.0, kind="link", vehicle=vehicle["id"], **trouble))
    failing = _failure(plan, fleet, spread, rng)
    if failing is not None:
        drawn.append(failing)
    return Conditions(
        world=world,
        faults=tuple(drawn),
        wind=speed,
        gust=gust,
        failing=f"vehicle {failing.vehicle}: {failing.kind}" if failing else "",
        failing_at=failing.at if failing else None,
    )


def _bounded(rng: Random, sigma: float, count: int) -> Floats:
    return np.clip(rng.normal(0.0, sigma, count), -2.0 * sigma, 2.0 * sigma)


def _failure(plan: Plan, fleet: Fleet, spread: Spread, rng: Random) -> Fault | None:
    if rng.uniform() >= spread.failing or not spread.failures:
        return None
    kind = str(rng.choice(spread.failures))
    details: dict[str, Any] = {
        "weak_thrust": {"fraction": float(rng.uniform(0.4, 0.9))},
        "link": {"loss": 1.0, "duration": float(rng.uniform(0.5, 10.0))},
        "freeze": {"duration": float(rng.uniform(0.5, 10.0))},
    }.get(kind, {})
    return Fault(
        at=float(rng.uniform(0.0, plan.duration + _BOOT)),
        kind=kind,
        vehicle=int(rng.choice(fleet.systems[: plan.vehicles])),
        **details,
    )


class _Witness:
    """Takes down what really is, while the cable is folded and held."""

    def __init__(self) -> None:
        self._next = 0.0
        self.rows: list[tuple[float, float, str, Floats, Floats | None]] = []
        self.strikes = self.collisions = self.crashed = 0
        self._told = 0
        self._fallen: set[int] = set()

    def __call__(self, flight: Conductor, emulator: Emulator, now: float) -> None:
        if now < self._next:
            return
        self._next = now + SAMPLE_INTERVAL
        self._count(emulator)
        phase = flight.phase.name if flight.stage == "fly" else ""
        if phase not in {"fold", "hold"} or _lets_go(flight):
            return
        truth = emulator.truth()
        order = [truth.ids.index(system) for system in flight.systems]
        arcs = truth.grip_arc[order]
        hung = None
        if np.isfinite(arcs).all() and emulator.rope is not None:
            wanted = arcs[:-1, None] + _SHARES * np.diff(arcs)[:, None]
            hung = np.stack(
                [np.interp(wanted, emulator.rope.arc, truth.cable[:, i]) for i in range(3)], -1
            )
        self.rows.append((now, flight.clock.time, phase, truth.position[order], hung))

    def _count(self, emulator: Emulator) -> None:
        contacts = emulator.contacts
        self.strikes = len(contacts.strikes)
        for one in contacts.contacts[self._told :]:
            if one["kind"] == "vehicles":
                self.collisions += 1
            elif one["kind"] == "crash":
                self._fallen.update(one["vehicles"])
        self._told = len(contacts.contacts)
        self.crashed = len(self._fallen)


def _lets_go(flight: Conductor) -> bool:
    """Whether the team has come to where grippers are opened, a hair before the hold's end or not.

    The clock stops within a rounding of the gate, and the gate lies within one of the hold's end.
    """
    return any(
        gate.condition == "released" and flight.clock.time >= gate.time - _ROUNDING
        for gate in flight.gates
    )


def fly_trial(
    proven: ProvenPlan,
    spread: Spread,
    seed: int,
    trial: int,
    *,
    fleet: Fleet | None = None,
    faults: Sequence[Fault] = (),
    **watching: Any,
) -> tuple[Trial, FlightResult]:
    """Fly one trial; ``watching`` goes to :func:`swarm.rehearse.rehearse`."""
    plan = proven.plan
    fleet = fleet or emulated_fleet(plan.vehicles)
    conditions = draw(plan, fleet, spread, seed, trial, faults)
    witness = _Witness()
    result = rehearse(
        proven,
        fleet=fleet,
        world=conditions.world,
        faults=conditions.faults,
        observer=witness,
        **watching,
    )
    return _told(plan, trial, conditions, witness, result), result


def _told(
    plan: Plan, trial: int, conditions: Conditions, witness: _Witness, result: FlightResult
) -> Trial:
    failures = [event.message for event in result.events if event.kind == "failure"]
    reason = failures[0].partition(":")[0] if failures else ""
    if not reason and result.outcome.word != "done":
        reason = result.outcome.word
    measured: dict[str, Any] = dict.fromkeys((*CLEARANCES, "hung", "error"))
    knot, as_planned = "unknown", False
    if witness.rows:
        times, mission_times, phases, places, hung = zip(*witness.rows, strict=True)
        really, when = np.array(places), np.array(mission_times)
        meant = plan.motion.at(when)[0]
        flown = judge(plan, Trace(np.array(times), when, really, meant, phases))
        knot, as_planned = flown.knot, flown.as_planned
        for name in CLEARANCES:
            tightest = getattr(flown, name)
            measured[name] = None if tightest is None else tightest.distance
        measured["error"] = float(np.linalg.norm(really - meant, axis=-1).max())
        measured["hung"] = _closest(plan, [strands for strands in hung if strands is not None])
        if hung[-1] is None:
            knot, as_planned = "let go", False
    if not reason and not as_planned:
        reason = f"knot: {knot}"
    return Trial(
        number=trial,
        outcome=result.outcome.word,
        reason=reason,
        explanation=result.outcome.explanation,
        knot=knot,
        as_planned=as_planned,
        strikes=witness.strikes,
        collisions=witness.collisions,
        crashed=witness.crashed,
        wind=conditions.wind,
        gust=conditions.gust,
        failing=conditions.failing,
        failing_at=conditions.failing_at,
        duration=result.statistics.duration,
        **measured,
    )


def _closest(plan: Plan, strands: list[Floats]) -> float | None:
    """Smallest distance, surface to surface, of strands that share no vehicle; None without."""
    pairs = np.stack(np.triu_indices(plan.vehicles - 1, 2), axis=1)
    if not strands or not len(pairs):
        return None
    nearest, _, _ = closest_strands(np.array(strands), pairs)
    return max(nearest - plan.mission.cable.diameter, 0.0)


def fly_trials(
    proven: ProvenPlan,
    spread: Spread,
    *,
    seed: int,
    trials: Iterable[int],
    faults: Sequence[Fault] = (),
    jobs: int | None = None,
    scheduler: str | None = None,
) -> Generator[Trial, None, None]:
    """Fly trials in parallel; yields each as soon as it is done, in no order.

    ``jobs`` processes of this machine (None: as many as it has cores), or the workers of the Dask
    cluster whose ``scheduler`` is given (tcp://host:port). Closing the iterator ends what is being
    flown. Raises :class:`SwarmError` where the cluster's packages are missing or it is not there.
    """
    if scheduler is None and jobs == 1:
        for trial in trials:
            yield fly_trial(proven, spread, seed, trial, faults=faults)[0]
        return
    if scheduler is None:
        with parallel_config(backend="loky", n_jobs=jobs or os.cpu_count() or 1):
            yield from _parallel(proven, spread, seed, trials, faults)
        return
    with _cluster(scheduler), parallel_config(backend="dask"):
        yield from _parallel(proven, spread, seed, trials, faults)


def _cluster(scheduler: str) -> AbstractContextManager[Any]:
    """Return a client of the Dask cluster whose scheduler is given."""
    # Dask takes any package named snappy for the compressor; knot theorists have SnapPy, which
    # is none, and importing Dask would fail.
    known = sys.modules.get("snappy")
    sys.modules["snappy"] = None  # type: ignore[assignment]
    try:
        from distributed import Client  # noqa: PLC0415 - an optional extra
    except ImportError:
        raise SwarmError(
            "trials on a cluster need more packages: pip install 'swarm-ground-station[cluster]'"
        ) from None
    finally:
        if known is None:
            del sys.modules["snappy"]
        else:
            sys.modules["snappy"] = known
    try:
        client: AbstractContextManager[Any] = Client(scheduler, timeout=10)
    except (OSError, ValueError) as error:
        raise SwarmError(f"no Dask scheduler at {scheduler}: {error}") from None
    return client


def _parallel(
    proven: ProvenPlan,
    spread: Spread,
    seed: int,
    trials: Iterable[int],
    faults: Sequence[Fault],
) -> Generator[Trial, None, None]:
    work = Parallel(return_as="generator_unordered")
    done = work(delayed(_in_worker)(proven, spread, seed, trial, faults) for trial in trials)
    try:
        yield from done
    finally:
        done.close()


def _in_worker(
    proven: ProvenPlan, spread: Spread, seed: int, trial: int, faults: Sequence[Fault]
) -> Trial:
    """One trial in a worker: an interrupt is the parent's to answer."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return fly_trial(proven, spread, seed, trial, faults=faults)[0]


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


def certificates(plan: Plan, trials: Sequence[Trial]) -> Certificates:
    """Certify a plan for the tracking errors that its trials had, and for smaller ones."""
    errors = [trial.error for trial in trials if trial.error is not None]
    had = np.ceil(np.array(errors) / RADIUS_STEP - 1e-9)
    had = had[had * RADIUS_STEP <= _HOPELESS]
    between = np.linspace(0.0, had.max(initial=1.0), _BETWEEN).round()
    radius = RADIUS_STEP * np.unique(np.concatenate([between, had]))
    rows = []
    for tracking in radius:
        moments = tightest_moments(plan, tracking=float(tracking), checks=_CHECKS)
        rows.append(
            [
                min((one.distance for one in moments if one.check == check), default=math.inf)
                for check in _CHECKS
            ]
        )
    table = np.array(rows).reshape(-1, len(_CHECKS))
    return Certificates(radius, *table.T)


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


def rows(trials: Iterable[Trial]) -> list[dict[str, Any]]:
    """Return trials as rows of a table, in the order of their numbers."""
    return [asdict(trial) for trial in sorted(trials, key=lambda trial: trial.number)]


COLUMNS: Final = tuple(field.name for field in fields(Trial))
