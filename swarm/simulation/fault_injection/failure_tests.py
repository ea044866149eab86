"""Failure tests: simulated flights into which one fault is injected.

Each trial starts from a copy of the flight shortly before the fault (conductor and emulator are
state machines without sockets or clocks), and is flown on in virtual time.
"""

import gc
import itertools
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from joblib import Parallel, delayed

from swarm.certification.certificate import CertifiedPlan
from swarm.flight.flight_plan import FlightPlan
from swarm.mission.fleet import Fleet
from swarm.simulation.fault_injection.evaluation import (
    FaultTrial,
    GroundTruthMonitor,
    Injection,
    evaluate,
)
from swarm.simulation.fault_injection.failure_cases import FAILURE_CASES, FailureCase, Part
from swarm.simulation.fault_injection.results_file import CaseTrials
from swarm.simulation.fault_injection.stepped_simulation import (
    TEAM_AUTOPILOTS,
    FirstAckLoss,
    SteppedSimulation,
    TeamAutopilots,
    failure_test_fleet,
)
from swarm.simulation.loop import Fault
from swarm.simulation.workers import parallel_workers

OBSERVATION_TIME: Final = 12.0
"""Seconds after the end of a fault during which a flight that continues is observed."""

MAX_TRIAL_TIME: Final = 200.0
"""Seconds after which a trial is ended."""

MIN_STRONG_WIND: Final = 6.0
"""Least wind, m/s, of the case with more wind than is certified."""
MAX_STRONG_WIND: Final = 15.0
"""Largest wind, m/s, of this case. Drag takes 3 of the 4 m/s² by which emulated vehicles accelerate
then, cable and gusts most of the rest: of 24 flights of `two_carry`, vehicles were lost in none in
15 and in 16 m/s, in two in 17 m/s."""

_SLOWED: Final = 8.0 / 9.0
"""Share of the usual rate below which the clock has slowed: 0.8 of 0.9, and as much of a rate that
lost setpoints limit."""

_TIMES_PER_TASK: Final = 5
_CASES_PER_TASK: Final = 13


@dataclass(frozen=True)
class FailureTestSettings:
    """The cases to test, the autopilots of the teams, and the random ``times`` per case and team.

    The same ``seed`` gives the same trials of a case, also with other cases beside it.
    """

    cases: Sequence[FailureCase] = FAILURE_CASES
    autopilots: Sequence[TeamAutopilots] = TEAM_AUTOPILOTS
    times: int = 3
    seed: int = 1


@dataclass(frozen=True)
class FailureTest:
    """All trials of one case with one team."""

    case: FailureCase
    autopilots: TeamAutopilots
    trials: tuple[FaultTrial, ...]

    @property
    def passed(self) -> bool:
        """Whether every trial meets the requirements of the case."""
        return all(not trial.problems for trial in self.trials)

    def document(self) -> dict[str, Any]:
        """Return the test as an object for JSON; distances in metres, times in seconds."""
        trials = self.trials
        detections = [t.detected_after for t in trials if t.detected_after is not None]
        strand_distance = min((t.strand_distance for t in trials), default=np.inf)
        vehicle_distance = min((t.vehicle_distance for t in trials), default=np.inf)
        chord_ratio = max((t.chord_ratio for t in trials), default=0.0)
        return {
            "case": self.case.name,
            "group": self.case.group,
            "autopilots": self.autopilots,
            "times": [round(t.mission_time, 2) for t in trials],
            "detected_after": round(max(detections), 3) if detections else None,
            "response": _most_frequent([t.response for t in trials]),
            "strand_distance": _finite(strand_distance),
            "vehicle_distance": _finite(vehicle_distance),
            "chord_ratio": _finite(chord_ratio or np.inf),
            "rotor_strikes": sum(t.rotor_strikes for t in trials),
            "vehicles_lost": max((t.vehicles_lost for t in trials), default=0),
            "end": " or ".join(sorted({t.end for t in trials})),
            "passed": self.passed,
            "problems": [
                f"at {t.mission_time:.1f} s: {problem}" for t in trials for problem in t.problems
            ],
            "explanation": self.case.explanation or None,
        }


@dataclass(frozen=True)
class _Task:
    """Some cases that one process flies with one team, from the same moments of one flight."""

    cases: tuple[FailureCase, ...]
    autopilots: TeamAutopilots
    times: int
    seeds: tuple[int, int, int]

    def key(self, case: FailureCase) -> tuple[str, TeamAutopilots, tuple[int, int, int], int]:
        return case.name, self.autopilots, self.seeds, self.times


def run_failure_tests(
    flight_plan: CertifiedPlan,
    settings: FailureTestSettings,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int, int], None] | None = None,
    earlier_results: Iterable[CaseTrials] = (),
    on_result: Callable[[CaseTrials], None] | None = None,
) -> tuple[FailureTest, ...]:
    """Fly every case at random times of its part of the flight, with each team.

    ``jobs`` processes share the work (None: one per core), or the workers of the Dask cluster at
    ``scheduler`` (tcp://host:port). ``progress(done, total)`` receives the
    number of trials. Trials in ``earlier_results``, from a run with the same plan and seed, are not
    flown again; ``on_result`` receives the new ones as they complete.
    """
    tasks = _tasks(settings)
    keys = {task.key(case) for task in tasks for case in task.cases}
    results = {one.key: one for one in earlier_results if one.key in keys}
    total = len(settings.cases) * len(settings.autopilots) * settings.times
    parts = [
        part
        for task in tasks
        for part in _parts(task, [case for case in task.cases if task.key(case) not in results])
    ]
    with parallel_workers(jobs, scheduler):
        new_results = Parallel(return_as="generator_unordered")(
            delayed(_fly_cases)(flight_plan, part) for part in parts
        )
        for result in itertools.chain.from_iterable(new_results):
            results[result.key] = result
            if on_result is not None:
                on_result(result)
            if progress is not None:
                progress(sum(len(one.trials) for one in results.values()), total)
    trials: dict[tuple[str, TeamAutopilots], list[FaultTrial]] = {}
    for result in results.values():
        trials.setdefault((result.case, result.autopilots), []).extend(result.trials)
    return tuple(
        FailureTest(case, team, tuple(sorted(trials[case.name, team], key=_by_mission_time)))
        for case in settings.cases
        for team in settings.autopilots
    )


def _by_mission_time(trial: FaultTrial) -> float:
    return trial.mission_time


def _tasks(settings: FailureTestSettings) -> list[_Task]:
    """Return a task per team and few random times, so that each flies its flight only once."""
    first_times = range(0, settings.times, _TIMES_PER_TASK)
    counts = [min(_TIMES_PER_TASK, settings.times - first) for first in first_times]
    return [
        _Task(tuple(settings.cases), team, count, (settings.seed, k, TEAM_AUTOPILOTS.index(team)))
        for team in settings.autopilots
        for k, count in enumerate(counts)
    ]


def _parts(task: _Task, cases: Sequence[FailureCase]) -> Iterator[_Task]:
    """Yield the task with some of its cases at a time."""
    for first in range(0, len(cases), _CASES_PER_TASK):
        yield replace(task, cases=tuple(cases[first : first + _CASES_PER_TASK]))


def _fly_cases(flight_plan: CertifiedPlan, task: _Task) -> list[CaseTrials]:
    fleet = failure_test_fleet(flight_plan.plan.vehicles, task.autopilots, task.seeds[0])
    starts: dict[Part, list[SteppedSimulation]] = {}
    results = []
    gc.collect()
    gc.freeze()
    for case in task.cases:
        if case.part not in starts:
            starts[case.part] = list(_starts(flight_plan, fleet, case.part, task))
        vehicles = np.random.default_rng((*task.seeds, zlib.crc32(case.name.encode())))
        trials = []
        for start in starts[case.part]:
            vehicle = int(vehicles.integers(flight_plan.plan.vehicles))
            trials.append(fly_fault_trial(start.copy(), case, vehicle))
            # The objects of a flight refer to each other in cycles and hold large arrays.
            gc.collect()
        results.append(CaseTrials(case.name, task.autopilots, task.seeds, tuple(trials)))
    gc.unfreeze()
    return results


def _starts(
    flight_plan: CertifiedPlan, fleet: Fleet, part: Part, task: _Task
) -> Iterator[SteppedSimulation]:
    """Yield copies of a flight at random moments of one of its parts."""
    plan = flight_plan.plan
    if part == "fold":
        phase = plan.phase("fold")
        begin, end = phase.start + 0.5, phase.end - 0.5
    else:
        condition = "gripped" if part == "grab" else "released"
        gate = next(gate.time for gate in plan.gates if gate.condition == condition)
        begin, end = gate - 1.5, gate - 0.1
    rng = np.random.default_rng(task.seeds)
    flight = SteppedSimulation.create(flight_plan, fleet, task.seeds[0])
    for moment in np.sort(rng.uniform(begin, end, task.times)):
        while flight.conductor.clock.time < moment or not flight.can_be_copied:
            flight.step()
            if flight.conductor.finished is not None:
                raise AssertionError(f"the flight ended early: {flight.conductor.finished}")
        yield flight.copy()


def fly_fault_trial(flight: SteppedSimulation, case: FailureCase, vehicle: int) -> FaultTrial:
    """Inject a case's fault at the vehicle of an index, fly on to the end, and evaluate."""
    conductor, began = flight.conductor, flight.now
    mission_time = conductor.clock.time
    _inject(flight, case, vehicle)
    rate = conductor.clock.rate
    monitor = GroundTruthMonitor(flight, case, vehicle)
    slowed_after: float | None = None
    undisturbed_since = began + case.duration
    while flight.now < began + MAX_TRIAL_TIME:
        stalled = case.station_fault == "stalled" and flight.now < began + case.duration
        flight.step(station=not stalled and case.station_fault != "killed")
        monitor.sample(detected=case.slows_clock and slowed_after is not None)
        if case.pilot_lands and conductor.stage == "contingency":
            flight.land_by_pilot(conductor.flyers[vehicle].system)
        usual_rate = min(0.9, rate, conductor.state.stream_loss.rate_limit(conductor.clock.time))
        if slowed_after is None and abs(conductor.clock.rate) < _SLOWED * usual_rate:
            slowed_after = flight.now - began
        if conductor.finished is not None:
            break
        if case.station_fault == "killed":
            if not flight.emulator.truth().armed.any():
                break
        elif (
            conductor.stage != "execute"
            or conductor.holding
            or conductor.state.progress.waiting
            or monitor.hidden_slip
        ):
            undisturbed_since = flight.now
        elif flight.now - undisturbed_since > OBSERVATION_TIME and conductor.clock.rate > 0.05:
            break
    return evaluate(flight, Injection(case, vehicle, began, mission_time, slowed_after), monitor)


def _inject(flight: SteppedSimulation, case: FailureCase, vehicle: int) -> None:
    conductor, system = flight.conductor, flight.conductor.flyers[vehicle].system
    flight.events.clear()
    fault = case.fault
    if fault is not None:
        target: dict[str, Any] = {"vehicle": "all" if case.whole_team else system}
        if case.group == "world":
            target = _world_fault(flight.flight_plan, fault["kind"], vehicle)
        flight.emulator.inject(Fault.model_validate({"at": flight.now, **target, **fault}))
    if case.lost_message:
        flight.delivers = FirstAckLoss(system)
    if case.station_fault in {"interrupted", "interrupted twice"}:
        conductor.request("interrupt")
        if case.station_fault == "interrupted twice":
            conductor.request("interrupt")


def _world_fault(flight_plan: FlightPlan, kind: str, vehicle: int) -> dict[str, Any]:
    """Return the values of a fault that depend on the plan.

    Wind is half again as strong as the certified wind, from :data:`MIN_STRONG_WIND` to
    :data:`MAX_STRONG_WIND`; a snag is in the middle of a segment.
    """
    lengths = flight_plan.plan.layout.lengths
    if kind == "snag":
        segment = min(vehicle, len(lengths) - 1)
        return {"arc": float(lengths[:segment].sum() + 0.5 * lengths[segment])}
    if kind != "wind":
        return {}
    certified = max(
        flight_plan.assessment.robustness.wind or 0.0, flight_plan.plan.mission.wind.steady
    )
    speed = min(max(MIN_STRONG_WIND, 1.5 * certified), MAX_STRONG_WIND)
    return {"steady": (speed, 0.0, 0.0), "gust": 0.1 * speed}


def _most_frequent(words: Sequence[str]) -> str:
    """Return the most frequent word, the first in the alphabet of several."""
    return max(sorted(set(words)), key=words.count) if words else ""


def _finite(value: float) -> float | None:
    return round(float(value), 3) if np.isfinite(value) else None
