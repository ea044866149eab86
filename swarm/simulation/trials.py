"""One trial: a simulated flight under drawn conditions, and its results."""

import functools
import gc
import json
import signal
import threading
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from joblib import Parallel, delayed, parallel_config

from swarm.certification.kinds import MEASURED, SWINGING, Flown, swinging_distances
from swarm.errors import InputError, Problem, reason
from swarm.flight.conductor import Conductor
from swarm.flight.flight_plan import FlightPlan
from swarm.flight.result import FlightResult
from swarm.flight.setup import FlightOptions
from swarm.flight.trace import Trace
from swarm.mission.fleet import Fleet, emulated_fleet
from swarm.planning import Plan
from swarm.simulation.loop import (
    DEFAULT_OPTIONS,
    NO_CALLBACKS,
    Callbacks,
    Emulator,
    Fault,
    simulate_flight,
)
from swarm.simulation.spread import Conditions, Spread, draw
from swarm.simulation.workers import parallel_workers, process_count
from swarm.verification import verify_trace
from swarm.version import __version__

Floats = npt.NDArray[np.float64]

SAMPLE_INTERVAL: Final = 0.4
"""Seconds of flight between two samples of a trial's distances."""

DISTANCES: Final = (*MEASURED, *SWINGING)
"""Keys of the distances of a trial, as its files have them."""
_SHARES: Final = np.linspace(0.0, 1.0, 25)
_ROUNDING: Final = 1e-6


@dataclass(frozen=True)
class Trial:
    """The results of one trial.

    Distances are in metres, times in seconds, wind and gusts in m/s. ``distances`` has
    the smallest ones in fold and hold by their keys: "cable", "vehicle" and others of
    :data:`.kinds.MEASURED`, of the same things as in the certificate, in the cable model between
    the true positions of the vehicles; "emulated_cable" and others of :data:`.kinds.SWINGING` of
    the emulator's cable, with its errors, wind and sway. ``tracking_error`` is the largest distance
    of a vehicle from its setpoint in fold and hold. These are None where the cable was never aloft,
    or the certificate of a kind does not apply in the fold.

    ``reason`` is the first failure or the outcome, "" where the trial is completed. ``failure`` is
    the drawn failure with its vehicle, "" for none.
    """

    number: int
    outcome: str
    reason: str
    explanation: str
    knot: str
    as_planned: bool
    distances: Mapping[str, float | None]
    tracking_error: float | None
    rotor_strikes: int
    collisions: int
    crashes: int
    wind: float
    gust: float
    failure: str
    failure_time: float | None
    duration: float

    @property
    def completed(self) -> bool:
        """Whether the flight ended as planned and implies the planned knot."""
        return self.outcome == "done" and self.as_planned


def table_rows(trials: Iterable[Trial]) -> list[dict[str, Any]]:
    """Return trials as rows of a table, sorted by number."""
    ordered = sorted(trials, key=lambda trial: trial.number)
    rows = [{**vars(trial), **trial.distances} for trial in ordered]
    return [{column: row[column] for column in COLUMNS} for row in rows]


COLUMNS: Final = tuple(
    column
    for field in fields(Trial)
    for column in (DISTANCES if field.name == "distances" else (field.name,))
)


@dataclass(frozen=True, eq=False)
class _Sample:
    """The true state at one moment of fold or hold.

    ``grips`` (n, 3) are the grip points in order along the cable, ``strands`` (n − 1, 25, 3) the
    emulator's cable between them, None where a vehicle does not hold it.
    """

    time: float
    mission_time: float
    phase: str
    grips: Floats
    strands: Floats | None


class _GroundTruthSampler:
    """Samples the emulator's ground truth while the cable is folded and held."""

    def __init__(self) -> None:
        self._next_time = 0.0
        self.samples: list[_Sample] = []
        self.rotor_strikes = self.collisions = self.crashes = 0
        self._counted_contacts = 0
        self._crashed: set[int] = set()

    def __call__(self, conductor: Conductor, emulator: Emulator, now: float) -> None:
        if now < self._next_time:
            return
        self._next_time = now + SAMPLE_INTERVAL
        self._count_contacts(emulator)
        phase = conductor.phase.name if conductor.stage == "execute" else ""
        if phase not in {"fold", "hold"} or _at_release(conductor):
            return
        grips, held, cable = emulator.grips_and_cable()
        ids = [vehicle.system for vehicle in emulator.vehicles]
        order = [ids.index(system) for system in conductor.state.roster.systems]
        arcs = held[order]
        strands = None
        if np.isfinite(arcs).all() and emulator.rope is not None:
            sampled = arcs[:-1, None] + _SHARES * np.diff(arcs)[:, None]
            strands = np.stack(
                [np.interp(sampled, emulator.rope.arc, cable[:, i]) for i in range(3)], -1
            )
        sample = _Sample(now, conductor.clock.time, phase, grips[order], strands)
        self.samples.append(sample)

    def _count_contacts(self, emulator: Emulator) -> None:
        contacts = emulator.contacts
        self.rotor_strikes = len(contacts.strikes)
        for contact in contacts.contacts[self._counted_contacts :]:
            if contact["kind"] == "vehicles":
                self.collisions += 1
            elif contact["kind"] == "crash":
                self._crashed.update(contact["vehicles"])
        self._counted_contacts = len(contacts.contacts)
        self.crashes = len(self._crashed)


def _at_release(conductor: Conductor) -> bool:
    """Return whether the mission clock has reached the gate at which grippers open.

    The clock stops within a rounding error of the gate.
    """
    return any(
        gate.condition == "released" and conductor.clock.time >= gate.time - _ROUNDING
        for gate in conductor.state.setup.gates
    )


def fly_trial(
    flight_plan: FlightPlan,
    spread: Spread,
    seed: int,
    trial: int,
    *,
    fleet: Fleet | None = None,
    faults: Sequence[Fault] = (),
    options: FlightOptions = DEFAULT_OPTIONS,
    callbacks: Callbacks = NO_CALLBACKS,
) -> tuple[Trial, FlightResult]:
    """Fly one trial; return its results and those of its flight.

    ``options`` and ``callbacks`` are as for :func:`swarm.simulation.loop.simulate_flight`, but
    ``callbacks.on_step`` is not called.
    """
    plan = flight_plan.plan
    fleet = fleet or emulated_fleet(plan.vehicles)
    conditions = draw(plan, fleet, spread, seed, trial, faults)
    sampler = _GroundTruthSampler()
    result = simulate_flight(
        flight_plan,
        fleet=fleet,
        world=conditions.world,
        faults=conditions.faults,
        options=options,
        callbacks=replace(callbacks, on_step=sampler),
    )
    return _trial_result(plan, trial, conditions, sampler, result), result


def _trial_result(
    plan: Plan,
    number: int,
    conditions: Conditions,
    sampler: _GroundTruthSampler,
    result: FlightResult,
) -> Trial:
    failures = [event.message for event in result.events if event.kind == "failure"]
    reason = failures[0].partition(":")[0] if failures else ""
    if not reason and result.outcome.word != "done":
        reason = result.outcome.word
    distances: dict[str, float | None] = dict.fromkeys(DISTANCES)
    tracking_error = None
    knot, as_planned = "unknown", False
    samples = sampler.samples
    if samples:
        times = np.array([sample.time for sample in samples])
        mission_times = np.array([sample.mission_time for sample in samples])
        position = np.array([sample.grips for sample in samples])
        setpoint = plan.motion.at(mission_times)[0]
        phases = tuple(sample.phase for sample in samples)
        flown = verify_trace(plan, Trace(times, mission_times, position, setpoint, phases))
        knot, as_planned = flown.knot, flown.as_planned
        held = [k for k, sample in enumerate(samples) if sample.strands is not None]
        shapes = np.array([samples[k].strands for k in held]) if held else None
        hanging = Flown(mission_times[held], position[held], setpoint[held], shapes)
        measured = {**flown.distances, **swinging_distances(plan, hanging)}
        for name, tightest in measured.items():
            distances[name] = None if tightest is None else tightest.distance
        tracking_error = float(np.linalg.norm(position - setpoint, axis=-1).max())
        if samples[-1].strands is None and len(plan.layout.lengths):
            knot, as_planned = "released", False
    if not reason and not as_planned:
        reason = f"knot: {knot}"
    return Trial(
        number=number,
        outcome=result.outcome.word,
        reason=reason,
        explanation=result.outcome.explanation,
        knot=knot,
        as_planned=as_planned,
        distances=distances,
        tracking_error=tracking_error,
        rotor_strikes=sampler.rotor_strikes,
        collisions=sampler.collisions,
        crashes=sampler.crashes,
        wind=conditions.wind,
        gust=conditions.gust,
        failure=conditions.failure,
        failure_time=conditions.failure_time,
        duration=result.statistics.duration,
    )


FlyTrial = Callable[[int], tuple[Trial, FlightResult]]
"""Flies the trial of a number."""


def fly_trials(
    flight_plan: FlightPlan,
    spread: Spread,
    *,
    seed: int,
    trials: Iterable[int],
    faults: Sequence[Fault] = (),
    jobs: int | None = None,
    scheduler: str | None = None,
    open_loop: bool = False,
) -> Generator[Trial, None, None]:
    """Yield trials as they complete, in any order.

    They run in ``jobs`` processes of this machine (None: one per core), or on the workers of the
    Dask cluster at ``scheduler`` (tcp://host:port). ``open_loop`` is as in
    :class:`swarm.flight.setup.FlightOptions`. Closing the iterator aborts the running trials.
    Raises :class:`SwarmError` where the cluster's packages are missing or its scheduler does not
    answer.
    """
    options = FlightOptions(open_loop=open_loop)
    fly = functools.partial(fly_trial, flight_plan, spread, seed, faults=faults, options=options)
    if scheduler is None and process_count(jobs) == 1:
        for trial in trials:
            yield fly(trial)[0]
        return
    with parallel_workers(jobs, scheduler):
        yield from _parallel(fly, trials)


@contextmanager
def workers_starting(jobs: int | None) -> Iterator[None]:
    """Start the processes of :func:`fly_trials` in the background and load their modules.

    A process takes three seconds of a core to start; planning leaves a core idle. The processes
    ignore interrupts, which the parent process handles.
    """
    count = process_count(jobs)
    if count == 1 or threading.current_thread() is not threading.main_thread():
        yield
        return
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with parallel_config(backend="loky", n_jobs=count):
            parallel = Parallel(return_as="generator_unordered")
            starting = parallel(delayed(_freeze_loaded_objects)() for _ in range(count))
    finally:
        signal.signal(signal.SIGINT, handler)
    try:
        yield
        for _ in starting:
            pass
    finally:
        _close(starting)


def _parallel(fly: FlyTrial, trials: Iterable[int]) -> Generator[Trial, None, None]:
    parallel = Parallel(return_as="generator_unordered")
    results = parallel(delayed(_fly_in_worker)(fly, trial) for trial in trials)
    try:
        yield from results
    finally:
        _close(results)


def _close(results: Generator[Any, None, None]) -> None:
    """Abort the running tasks, without joblib's warning about them."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "[0-9]+ tasks ", UserWarning)
        results.close()


@functools.cache
def _freeze_loaded_objects() -> None:
    """Exclude the loaded modules from garbage collection, and collect less often.

    A full collection takes a tenth of a second, in every other trial.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 10, 10)


def _fly_in_worker(fly: FlyTrial, trial: int) -> Trial:
    """Return one trial; interrupts are ignored, because the parent process handles them."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    _freeze_loaded_objects()
    result = fly(trial)[0]
    # The objects of a flight refer to each other in cycles and hold large arrays.
    gc.collect()
    return result


def results_table(flown: Sequence[tuple[Plan, Sequence[Trial]]], seed: int, spread: Spread) -> Any:
    """Return the trials of plans as a :class:`pyarrow.Table`.

    The columns are ``method``, ``seed`` and the fields of :class:`Trial`.
    """
    import pyarrow as pa  # noqa: PLC0415 - slow to import

    table = pa.Table.from_pylist(
        [
            {"method": plan.mission.fold.method, "seed": seed, **row}
            for plan, trials in flown
            for row in table_rows(trials)
        ]
    )
    metadata = {
        "swarm": __version__,
        "mission": json.dumps(flown[0][0].mission.document()),
        "spread": json.dumps(spread.model_dump(mode="json")),
    }
    return table.replace_schema_metadata(metadata)


def write_results(
    path: Path, flown: Sequence[tuple[Plan, Sequence[Trial]]], seed: int, spread: Spread
) -> None:
    """Write :func:`results_table` as Parquet; raise :class:`InputError` where that fails."""
    import pyarrow.parquet as pq  # noqa: PLC0415 - slow to import

    try:
        pq.write_table(results_table(flown, seed, spread), path)
    except OSError as error:
        raise InputError([Problem(str(path), reason(error))]) from None
