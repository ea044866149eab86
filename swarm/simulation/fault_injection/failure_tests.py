"""Drills: a flight in which something goes wrong, judged by what really happened.

A row says what goes wrong, in which part of the flight, and how it must end. Each trial starts from
a copy of the flight shortly before (both sides are state machines without sockets or clocks), takes
one fault, flies on in virtual time and is judged by the emulator's ground truth.
"""

import gc
import itertools
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from joblib import Parallel, delayed

from swarm.certification.certificate import CertifiedPlan
from swarm.mission.fleet import Fleet
from swarm.simulation.fault_injection.evaluation import FaultTrial, Judge, judged
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

Floats = npt.NDArray[np.float64]
_TIMES_PER_TASK, _ROWS_PER_TASK = 5, 13
AFTER = 12.0
"""Seconds after the end of a fault for which a team that simply goes on is watched."""
LONGEST = 200.0
STRONG_WIND = 6.0
"""m/s that blow at least, all of a sudden, where more wind is asked for than a plan stands."""


@dataclass(frozen=True)
class FailureTest:
    """All trials of one row with one personality."""

    row: FailureCase
    personality: TeamAutopilots
    trials: tuple[FaultTrial, ...]

    @property
    def passed(self) -> bool:
        """Whether every trial went as asked."""
        return all(not trial.problems for trial in self.trials)

    def document(self) -> dict[str, Any]:
        """Return the drill as plain data for JSON."""
        trials = self.trials
        noticed = [t.noticed for t in trials if t.noticed is not None]
        return {
            "row": self.row.name,
            "group": self.row.group,
            "personality": self.personality,
            "times": [round(t.at, 2) for t in trials],
            "detected_after": round(max(noticed), 3) if noticed else None,
            "response": _most_frequent([t.response for t in trials]),
            "clearance": _finite(min((t.clearance for t in trials), default=np.inf)),
            "apart": _finite(min((t.apart for t in trials), default=np.inf)),
            "chord_ratio": _finite(max((t.chord for t in trials), default=0.0) or np.inf),
            "strikes": sum(t.strikes for t in trials),
            "lost": max((t.lost for t in trials), default=0),
            "end": " or ".join(sorted({t.end for t in trials})),
            "passed": self.passed,
            "problems": [f"at {t.at:.1f} s: {words}" for t in trials for words in t.problems],
            "explained": self.row.why or None,
        }


def run_failure_tests(
    flight_plan: CertifiedPlan,
    *,
    rows: Sequence[FailureCase] = FAILURE_CASES,
    personalities: Sequence[TeamAutopilots] = TEAM_AUTOPILOTS,
    times: int = 3,
    seed: int = 1,
    jobs: int | None = None,
    tell: Callable[[int, int], None] | None = None,
    known: Iterable[CaseTrials] = (),
    keep: Callable[[CaseTrials], None] | None = None,
) -> tuple[FailureTest, ...]:
    """Fly every row at random times of its part of the flight, with each personality.

    ``times`` is the number of trials per row and personality; ``jobs`` processes fly them (None: as
    many as there are cores); ``tell`` is told how many trials are done, and of how many. What is
    ``known`` from an earlier run with the same plan and seed is not flown again; ``keep`` is given
    what is flown as it comes. The same seed gives the same drills, whichever else are flown beside
    them.
    """
    # one task flies one personality at a few times: the flight up to there is flown once
    counts = [min(_TIMES_PER_TASK, times - k) for k in range(0, times, _TIMES_PER_TASK)]
    tasks = [(p, count, (seed, k, TEAM_AUTOPILOTS.index(p))) for p in personalities
             for k, count in enumerate(counts)]  # fmt: skip
    total = len(rows) * len(personalities) * times
    wanted = {(row.name, p, seeds, count) for p, count, seeds in tasks for row in rows}
    found = {flown.key: flown for flown in known if flown.key in wanted}
    left = [
        (p, count, seeds, [row for row in rows if (row.name, p, seeds, count) not in found])
        for p, count, seeds in tasks
    ]
    flying = Parallel(n_jobs=jobs or -1, return_as="generator_unordered")(
        delayed(_fly_rows)(flight_plan, part, personality, count, seeds)
        for personality, count, seeds, these in left
        for part in _portions(these)
    )
    for flown in itertools.chain.from_iterable(flying):
        found[flown.key] = flown
        if keep is not None:
            keep(flown)
        if tell is not None:
            tell(sum(len(one.trials) for one in found.values()), total)
    trials: dict[tuple[str, TeamAutopilots], list[FaultTrial]] = {}
    for flown in found.values():
        trials.setdefault((flown.row, flown.personality), []).extend(flown.trials)
    return tuple(
        FailureTest(row, p, tuple(sorted(trials[row.name, p], key=lambda trial: trial.at)))
        for row in rows
        for p in personalities
    )


def _portions(rows: Sequence[FailureCase]) -> list[Sequence[FailureCase]]:
    return [rows[k : k + _ROWS_PER_TASK] for k in range(0, len(rows), _ROWS_PER_TASK)]


def _fly_rows(
    flight_plan: CertifiedPlan,
    rows: Sequence[FailureCase],
    personality: TeamAutopilots,
    times: int,
    seeds: tuple[int, int, int],
) -> list[CaseTrials]:
    """Fly some rows with one personality, all from the same moments."""
    fleet = failure_test_fleet(flight_plan.plan.vehicles, personality, seeds[0])
    stages: dict[Part, list[SteppedSimulation]] = {}
    flown = []
    gc.collect()
    gc.freeze()
    for row in rows:
        if row.part not in stages:
            rng = np.random.default_rng(seeds)
            stages[row.part] = list(_stages(flight_plan, fleet, row.part, times, rng, seeds[0]))
        victims = np.random.default_rng((*seeds, zlib.crc32(row.name.encode())))
        trials = []
        for stage in stages[row.part]:
            trials.append(
                fly_fault_trial(stage.copy(), row, int(victims.integers(flight_plan.plan.vehicles)))
            )
            # a flight's parts know each other: few objects, which Python is in no hurry to look
            # through, and large arrays
            gc.collect()
        flown.append(CaseTrials(row.name, personality, seeds, tuple(trials)))
    gc.unfreeze()
    return flown


def _stages(
    flight_plan: CertifiedPlan,
    fleet: Fleet,
    part: Part,
    times: int,
    rng: np.random.Generator,
    seed: int,
) -> Iterator[SteppedSimulation]:
    """Yield copies of a flight at random moments of one of its parts."""
    plan = flight_plan.plan
    if part == "fold":
        phase = plan.phase("fold")
        moments = np.sort(rng.uniform(phase.start + 0.5, phase.end - 0.5, times))
    else:
        condition = "gripped" if part == "grab" else "released"
        gate = next(gate.time for gate in plan.gates if gate.condition == condition)
        moments = np.sort(rng.uniform(gate - 1.5, gate - 0.1, times))
    flight = SteppedSimulation.of(flight_plan, fleet, seed)
    for moment in moments:
        while flight.conductor.clock.time < moment or not flight.quiet:
            flight.step()
            if flight.conductor.finished is not None:
                raise AssertionError(f"the flight ended early: {flight.conductor.finished}")
        yield flight.copy()


def fly_fault_trial(flight: SteppedSimulation, row: FailureCase, victim: int) -> FaultTrial:
    """Fly one trial to its end and judge it."""
    conductor, began = flight.conductor, flight.now
    system = conductor.flyers[victim].system
    at = conductor.clock.time
    flight.events.clear()
    for values in row.faults:
        target = {} if row.group == "world" else {"vehicle": "all" if row.whole_team else system}
        worst = _worst(flight.flight_plan, values["kind"], victim)
        flight.emulator.inject(Fault.model_validate({"at": began, **target, **values, **worst}))
    if row.lose:
        flight.keeps = FirstAckLoss(system)
    if row.station in {"interrupted", "interrupted twice"}:
        conductor.request("interrupt")
        if row.station == "interrupted twice":
            conductor.request("interrupt")
    judge, pace = Judge(flight, victim if row.hides else None), conductor.clock.rate
    slowed: float | None = None
    calm_since = began + row.lasts
    while flight.now < began + LONGEST:
        asleep = row.station == "killed" or (
            row.station == "asleep" and flight.now < began + row.lasts
        )
        flight.step(station=not asleep)
        judge.look()
        if row.by_hand and conductor.stage == "leave":
            flight.land_by_hand(system)
        usual = min(0.9, pace, conductor.stream_loss.rate_limit(conductor.clock.time))
        if slowed is None and abs(conductor.clock.rate) < usual - 0.1:
            slowed = flight.now - began
        if conductor.finished is not None:
            break
        if row.station == "killed":
            if not flight.emulator.truth().armed.any():
                break
        elif conductor.stage != "fly" or conductor.holding or conductor.waiting or judge.unseen:
            calm_since = flight.now
        elif flight.now - calm_since > AFTER and conductor.clock.rate > 0.05:
            break
    return judged(flight, row, judge, at, victim, began, slowed)


def _worst(flight_plan: CertifiedPlan, kind: str, victim: int) -> dict[str, Any]:
    """Return what a plan makes of a fault: wind half again as strong as the strongest that it is
    certified for, and strong in any case; a snag in the middle of a segment."""
    lengths = flight_plan.plan.layout.lengths
    if kind == "snag":
        segment = min(victim, len(lengths) - 1)
        return {"arc": float(lengths[:segment].sum() + 0.5 * lengths[segment])}
    if kind != "wind":
        return {}
    certified = max(
        flight_plan.assessment.robustness.wind or 0.0, flight_plan.plan.mission.wind.steady
    )
    speed = max(STRONG_WIND, 1.5 * certified)
    return {"steady": (speed, 0.0, 0.0), "gust": 0.1 * speed}


def _most_frequent(words: Sequence[str]) -> str:
    return max(sorted(set(words)), key=words.count) if words else ""


def _finite(value: float) -> float | None:
    return round(float(value), 3) if np.isfinite(value) else None
