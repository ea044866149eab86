"""Goldens of failures: the transcript of every failure case.

Every case is flown from the same moment of a small flight, by a team of PX4 and by one of ArduPilot
vehicles; the fault is injected at the vehicle in the middle.
"""

import json
import re
from collections.abc import Mapping, Sequence
from difflib import SequenceMatcher, unified_diff
from functools import cache

from swarm.flight.conductor import Conductor
from swarm.flight.world import emulated_world
from swarm.simulation.failure_cases import FAILURE_CASES, FailureCase, Part
from swarm.simulation.failure_tests import FaultTrial, fly_fault_trial
from swarm.simulation.loop import parse_world
from swarm.simulation.stepped_simulation import (
    SteppedSimulation,
    TeamAutopilots,
    failure_test_fleet,
    set_audited_parameters,
)
from tests.golden.environment import environment
from tests.golden.transcripts import fault_line, transcript
from tests.golden.wire import Tapped, numbers_of
from tests.network import small_plan

TEAMS: tuple[TeamAutopilots, ...] = ("px4", "ardupilot")
VICTIM = 1
SEED = 1
INTO_FOLD, BEFORE_GATE = 3.0, 1.0
"""Seconds: faults come so long after the fold began, or before the gate of their part."""
SAME_TIME = 0.5
"""Seconds by which an event may come sooner or later on another CPU: values cross limits and are
looked at every 0.05 s, vehicles report every 0.1 to 0.5 s."""
_SHOWN = 12
"""Lines of a difference that are shown; the rest is counted."""


def name_of(case: FailureCase) -> str:
    """Return the name of a case's file."""
    return re.sub(r"[^a-z0-9.]+", "-", case.name.lower().replace("%", "percent")).strip("-")


NAMES: Mapping[str, FailureCase] = {name_of(case): case for case in FAILURE_CASES}


def make(name: str, teams: Sequence[TeamAutopilots] = TEAMS) -> str:
    """Fly a case with each team and return its golden, or the part of some teams."""
    case = NAMES[name]
    lines = [f"# failure: {case.name}", f"# environment: {environment()}"]
    for team in teams:
        lines += ["", *_flown(case, team)]
    return "\n".join(lines) + "\n"


def of_team(text: str, team: TeamAutopilots) -> str:
    """Return the part of a golden that :func:`make` returns for one team."""
    heading, *flown = text.removesuffix("\n").split("\n\n")
    (part,) = [each for each in flown if each.startswith(f"# team {team} ")]
    return f"{heading}\n\n{part}\n"


def _flown(case: FailureCase, team: TeamAutopilots) -> list[str]:
    stage = _stage(team, case.part)
    flight = stage.copy()
    since, at = flight.now, flight.conductor.clock.time
    trial = fly_fault_trial(flight, case, VICTIM)
    emulator = flight.emulator
    assert isinstance(emulator, Tapped)
    heading = f"# team {team} · vehicle {VICTIM + 1} · {case.part}, mission time {at:.2f} s"
    after = transcript(emulator.wire, flight.events, since + 1e-6)
    return [heading, fault_line(_fault(case)), *after, _verdict(trial)]


@cache
def _stage(team: TeamAutopilots, part: Part) -> SteppedSimulation:
    """Return a flight shortly before something goes wrong in that part of it."""
    flight_plan = small_plan(vehicles=3)
    fleet = failure_test_fleet(3, team, SEED)
    world = emulated_world(flight_plan.plan, fleet, with_cable=True, seed=SEED)
    emulator = Tapped(parse_world(json.dumps(world)))
    set_audited_parameters(emulator, flight_plan, fleet)
    flight = SteppedSimulation(flight_plan, fleet, Conductor(flight_plan, fleet), emulator)
    moment = _moment(flight, part)
    while flight.conductor.clock.time < moment or not flight.can_be_copied:
        assert flight.conductor.finished is None, flight.conductor.finished
        flight.step()
        # two seconds show the state of the vehicles before the fault
        emulator.wire[:] = [one for one in emulator.wire if one.time > flight.now - 2.0]
    return flight


def _moment(flight: SteppedSimulation, part: Part) -> float:
    plan = flight.flight_plan.plan
    if part == "fold":
        return plan.phase("fold").start + INTO_FOLD
    condition = "gripped" if part == "grab" else "released"
    return next(gate.time for gate in plan.gates if gate.condition == condition) - BEFORE_GATE


def _fault(case: FailureCase) -> str:
    """Return the fault of a case in words."""
    words = []
    if case.fault is not None:
        keys = [f"{k}={v}" for k, v in case.fault.items() if k != "kind"]
        words.append(" ".join([case.fault["kind"], *keys]))
    if case.station_fault:
        words.append(f"ground station {case.station_fault}")
    if case.lost_message:
        words.append(f"one {case.lost_message} is lost")
    target = " · all vehicles" if case.whole_team else ""
    return ", ".join(words) + target


def _verdict(trial: FaultTrial) -> str:
    detection = "not detected"
    if trial.detected_after is not None:
        detection = f"detected after {trial.detected_after:.2f} s"
    problems = "; ".join(trial.problems) or "as required"
    return (
        f"== {trial.end} · {detection} · {trial.rotor_strikes} rotor strikes · "
        f"{trial.vehicles_lost} vehicles lost "
        f"· {problems}"
    )


# Comparing


def disagreements(old: str, new: str) -> list[str]:
    """Return where two transcripts differ by more than another CPU explains.

    Every event and command must come as often, for the same vehicles and at nearly the same times;
    figures in their words are not compared. What vehicles say in between is left to the last bits.
    """
    words: list[str] = []
    before, after = _sections(old), _sections(new)
    if list(before) != list(after):
        return [f"teams: expected {', '.join(before)}, got {', '.join(after)}"]
    for team, lines in before.items():
        was, now = _answers(lines), _answers(after[team])
        for answer in [*was, *(one for one in now if one not in was)]:
            expected, got = was.get(answer, []), now.get(answer, [])
            close = [abs(a - b) <= SAME_TIME for a, b in zip(expected, got, strict=False)]
            if len(expected) != len(got) or not all(close):
                words.append(f"{team}: {answer}: expected {_times(expected)}, got {_times(got)}")
    return words


def _times(times: Sequence[float]) -> str:
    return "after " + ", ".join(f"{time:.2f}" for time in times) + " s" if times else "never"


def differences(old: str, new: str) -> list[str]:
    """Return what a renewal changes: lines that are gone (−) and new (+), and ends that differ."""
    before, after = _body(old), _body(new)
    if before == after:
        return []
    gone, new_lines = 0, 0
    for code, a, b, c, d in SequenceMatcher(None, before, after, autojunk=False).get_opcodes():
        if code != "equal":
            gone, new_lines = gone + b - a, new_lines + d - c
    return [f"lines: {gone} removed, {new_lines} added", *_diff(before, after)]


def _diff(before: Sequence[str], after: Sequence[str]) -> list[str]:
    lines = [
        line
        for line in unified_diff(before, after, lineterm="", n=0)
        if not line.startswith(("---", "+++", "@@"))
    ]
    more = [f"… and {len(lines) - _SHOWN} lines more"] if len(lines) > _SHOWN else []
    return lines[:_SHOWN] + more


def _body(text: str) -> list[str]:
    return [line for line in text.splitlines() if not line.startswith("# environment")]


def _sections(text: str) -> dict[str, list[str]]:
    sections: dict[str, list[str]] = {}
    for line in text.splitlines():
        if found := re.match(r"# team (\w+)", line):
            sections[found[1]] = lines = []
        elif sections:
            lines.append(line)
    return sections


_ANSWER = re.compile(
    r"<< +(?P<time>-?\d+\.\d+)  (?:event|command) +(?P<words>.*?)"
    r"(?: ×(?P<count>\d+))?(?: · (?:of|to) (?P<systems>[\d–, ]+))?$"
)


def _answers(lines: Sequence[str]) -> dict[str, list[float]]:
    """Events and commands of each vehicle, with their times; and the end, without its figures."""
    found: dict[str, list[float]] = {}
    for line in lines:
        if answer := _ANSWER.match(line):
            words = re.sub(r"\d+\.\d+", "#", answer["words"])
            systems = numbers_of(answer["systems"]) if answer["systems"] else [0]
            for system in systems:
                about = f"{words} · vehicle {system}" if system else words
                times = [float(answer["time"])] * int(answer["count"] or 1)
                found.setdefault(about, []).extend(times)
        elif line.startswith("== "):
            found[line.split(" · ")[0]] = [0.0]
    return found
