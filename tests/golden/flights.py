"""Goldens of whole flights: every setpoint packet byte for byte, and a sample that people can read.

The plans are built without an optimiser. What changes here was changed by the phases around the
fold, the flight, the setpoints or the emulator, and not by the search for a plan.
"""

import hashlib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from swarm.mission.fleet import emulated_fleet
from tests.golden.environment import environment
from tests.golden.wire import Reader, is_setpoint
from tests.network import Network, small_plan

SAMPLE_EVERY = 1.0
"""Seconds between two lines of setpoints."""
SAME_PLACE = 0.3
"""Metres by which a sampled setpoint may differ on another CPU: where last bits differ, a gate may
open a tick or two (0.05 s each) sooner or later, at 2 m/s and three gates one after the other."""
SAME_TIME = 0.5
"""Seconds, likewise."""


@dataclass
class Taped(Network):
    """A flight that remembers which phase of the plan each packet was sent in."""

    phases: list[str] = field(default_factory=list)

    def once(self) -> None:
        """One step of virtual time."""
        super().once()
        stage = self.conductor.stage
        name = self.conductor.phase.name if stage == "execute" else stage
        self.phases += [name] * (len(self.sent) - len(self.phases))


def _calm() -> Taped:
    return Taped(small_plan(vehicles=3), emulated_fleet(3, ("px4",)))


def _poor_links() -> Taped:
    """Both autopilots on links that lose, delay, double and reorder packets."""
    fleet = emulated_fleet(3, ("ardupilot", "px4"), seed=7)
    links = {"delay": 0.06, "jitter": 0.08, "loss": 0.05, "duplication": 0.05}
    return Taped(small_plan(vehicles=3), fleet, seed=7, early=0.02, **links)


def _indoors() -> Taped:
    """Five vehicles in the frame of motion capture that put the cable back where it lay."""
    plan = small_plan("finish=unfold", vehicles=5)
    fleet = emulated_fleet(5, ("px4", "ardupilot")).model_copy(update={"frame": "shared"})
    return Taped(plan, fleet, seed=3)


FLIGHTS: Mapping[str, Callable[[], Taped]] = {
    "three-px4-calm": _calm,
    "three-mixed-poor-links": _poor_links,
    "five-mixed-indoors-unfold": _indoors,
}


def make(name: str) -> str:
    """Fly a case and return its golden."""
    flight = FLIGHTS[name]()
    outcome = flight.run(most=600.0)
    setpoints = [
        (time, system, data, phase)
        for (time, system, data), phase in zip(flight.sent, flight.phases, strict=True)
        if is_setpoint(data)
    ]
    lines = [
        f"# flight: {name}",
        f"# environment: {environment()}",
        f"outcome {outcome.word if outcome else 'none'}",
        f"ended {flight.now:.2f} s",
        f"setpoints {len(setpoints)}",
        "",
        "# SHA-256 of the setpoint packets to each vehicle in each phase, in the order of sending",
        *_hashes(setpoints),
        "",
        "# setpoints once a second: time, phase, then x y z of each vehicle, m, its own NED",
        *_samples(setpoints),
    ]
    return "\n".join(lines) + "\n"


Setpoint = tuple[float, int, bytes, str]


def _hashes(setpoints: list[Setpoint]) -> list[str]:
    found: dict[tuple[str, int], list[bytes]] = {}
    for _, system, data, phase in setpoints:
        found.setdefault((phase, system), []).append(data)
    return [
        f"{phase:<9} vehicle {system:<2} {len(packets):>5} packets "
        f"{hashlib.sha256(b''.join(packets)).hexdigest()}"
        for (phase, system), packets in found.items()
    ]


def _samples(setpoints: list[Setpoint]) -> list[str]:
    """The first setpoint to each vehicle in each second; a dash where it was sent none."""
    reader = Reader()
    systems = sorted({system for _, system, _, _ in setpoints})
    seconds: dict[int, dict[int, Any]] = {}
    phases: dict[int, str] = {}
    for time, system, data, phase in setpoints:
        second = seconds.setdefault(int(time // SAMPLE_EVERY), {})
        phases.setdefault(int(time // SAMPLE_EVERY), phase)
        if system not in second:
            (second[system],) = reader.messages(data)
    return [
        f"{number * SAMPLE_EVERY:6.1f} {phases[number]:<9}"
        + "".join(f" | {_place(second.get(system))}" for system in systems)
        for number, second in seconds.items()
    ]


def _place(message: Any) -> str:
    if message is None:
        return f"{'–':>8} {'–':>8} {'–':>8}"
    # a zero has no sign in a file that people read
    return " ".join(f"{value + 0.0:8.3f}" for value in (message.x, message.y, message.z))


def disagreements(old: str, new: str) -> list[str]:
    """Return where two goldens differ by more than another CPU explains."""
    before, after = _Parsed(old), _Parsed(new)
    words = []
    if before.outcome != after.outcome:
        words.append(f"outcome: expected {before.outcome}, got {after.outcome}")
    if before.phases != after.phases:
        words.append(f"phases: expected {before.phases}, got {after.phases}")
    if abs(before.ended - after.ended) > SAME_TIME:
        words.append(f"end: expected {before.ended:.2f} s ± {SAME_TIME} s, got {after.ended:.2f} s")
    largest, time = largest_difference(before.samples, after.samples)
    if largest > SAME_PLACE:
        words.append(f"setpoints: {largest:.3f} m apart at {time:.0f} s, more than {SAME_PLACE} m")
    return words


def differences(old: str, new: str) -> list[str]:
    """Return what a renewal changes, in figures."""
    before, after = _Parsed(old), _Parsed(new)
    words = []
    for what in ("outcome", "ended", "setpoints"):
        was, now = getattr(before, what), getattr(after, what)
        if was != now:
            words.append(f"{what}: {was} → {now}")
    other = sum(before.hashes.get(key) != value for key, value in after.hashes.items())
    gone = len(before.hashes.keys() - after.hashes.keys())
    if other or gone:
        words.append(f"packets: {other} of {len(after.hashes)} hashes differ, {gone} are gone")
    largest, time = largest_difference(before.samples, after.samples)
    if largest:
        words.append(f"setpoints: largest difference {largest:.3f} m, at {time:.0f} s")
    return words


class _Parsed:
    """A golden, read again."""

    def __init__(self, text: str) -> None:
        values = dict(re.findall(r"^(outcome|ended|setpoints) (\S+)", text, re.M))
        self.outcome = values.get("outcome", "")
        self.ended = float(values.get("ended", "nan"))
        self.setpoints = int(values.get("setpoints", 0))
        found = re.findall(r"^(\S+) +vehicle (\d+) +\d+ packets (\w+)$", text, re.M)
        self.hashes = {(phase, system): value for phase, system, value in found}
        self.phases = list(dict.fromkeys(phase for phase, _, _ in found))
        self.samples = {
            float(time): _numbers(rest)
            for time, rest in re.findall(r"^ *(\d+\.\d) \S+ +\|(.*)$", text, re.M)
        }


def _numbers(text: str) -> np.ndarray:
    words = text.replace("|", " ").replace("–", "nan").split()
    return np.array(words, dtype=np.float64).reshape(-1, 3)


def largest_difference(
    before: Mapping[float, np.ndarray], after: Mapping[float, np.ndarray]
) -> tuple[float, float]:
    """Return the largest distance in metres between two flights' samples, and when.

    Seconds that only one of the flights has are left out; another team is infinitely far away.
    """
    largest, when = 0.0, 0.0
    for time in sorted(before.keys() & after.keys()):
        if before[time].shape != after[time].shape:
            return float("inf"), time
        apart = np.linalg.norm(before[time] - after[time], axis=1)
        apart = apart[np.isfinite(apart)]
        if apart.size and apart.max() > largest:
            largest, when = float(apart.max()), time
    return largest, when
