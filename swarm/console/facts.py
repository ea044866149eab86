"""What the console shows, as JSON objects: the plan once, the team ten times a second.

Everything comes from the snapshots that the terminal shows, too. A page only lays out these facts:
words, limits and colours are decided here.
"""

import math
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from swarm.certification.distances import Tightest
from swarm.certification.findings import in_common
from swarm.flight.snapshot import Checked, Event, Snapshot
from swarm.flight.stages import CheckStep, Stage
from swarm.geometry.catenary import MAX_CHORD_RATIO
from swarm.mission.fleet import Fleet
from swarm.planning import Plan
from swarm.planning.cable_shape import laid_grip_points
from swarm.reports import scene
from swarm.reports.formatting import (
    ROUTINE_KINDS,
    STATUS_TEXT_KINDS,
    event_text,
    log_level,
    metres,
    together,
)
from swarm.verification import closest_pairs

Floats = npt.NDArray[np.float64]
Level = Literal["good", "warn", "bad", "idle"]

POINTS: Final = 17
"""Points of a strand in a picture: its curve is drawn through them."""
LOW_BATTERY: Final = 0.3
"""Share of a battery below which it is shown as low."""
OLD_PACKET: Final = 1.0
"""Seconds without a packet after which a link is shown as late."""
NEAR_LIMIT: Final = 0.1
"""Metres above a limit within which a distance is shown as near it."""
NEAR_ERROR: Final = 0.6
"""Share of the allowed tracking error from which the clock slows, and an error is shown."""

_FIXES: Final = {
    0: "no receiver", 1: "no fix", 2: "2-D fix", 3: "3-D fix", 4: "DGPS", 5: "RTK float",
    6: "RTK fixed", 7: "static", 8: "PPP",
}  # fmt: skip
"""GPS_FIX_TYPE in words."""

_ANSWERS: Final = ("go", "refuse")
"""Commands that answer the question before a flight: they are shown on the ground only."""
COMMANDS: Final = (
    *_ANSWERS, "hold", "resume", "rewind", "land", "release", "rejoin", "abort", "interrupt",
)  # fmt: skip
"""The buttons, in their order; kill is apart."""


_CHECK: Final = frozenset(CheckStep)


@dataclass(frozen=True)
class Rates:
    """How many packets each vehicle (n,) had sent at a time, and how many came a second before."""

    time: float
    received: Floats
    rate: Floats

    INTERVAL = 2.0
    """Seconds between two counts."""

    @classmethod
    def first(cls, snapshot: Snapshot) -> "Rates":
        """Return the counts of the first snapshot; rates are not known then."""
        return cls(snapshot.time, snapshot.received, np.full(len(snapshot.received), np.nan))

    def counted(self, snapshot: Snapshot) -> "Rates":
        """Return the counts after another snapshot, the same before the interval has passed."""
        passed = snapshot.time - self.time
        if passed < self.INTERVAL or len(self.received) != len(snapshot.received):
            return self
        rate = (snapshot.received - self.received) / passed
        return Rates(snapshot.time, snapshot.received, rate)


def plan_facts(plan: Plan, fleet: Fleet | None) -> dict[str, Any]:
    """Return what does not change in a flight: plan, workspace, pads, and where north is.

    ``north`` is the direction of north in the mission's axes, radians from x towards y; None where
    the fleet does not say it.
    """
    workspace, times = plan.mission.workspace, np.arange(0.0, plan.duration, 0.5)
    places = plan.motion.at(np.concatenate([times, [plan.duration]]))[0]
    origin = fleet.origin if fleet else None
    emulated = fleet is not None and fleet.emulated is not None
    heading = origin.heading if origin else 0.0 if emulated else None
    low, high = places.min(axis=(0, 1)), places.max(axis=(0, 1))
    return {
        **fleet_facts(fleet),
        "name": plan.mission.name,
        "words": ", ".join(plan.figures().values()),
        "vehicles": plan.vehicles,
        "duration": plan.duration,
        "phases": [
            {"name": phase.name, "start": phase.start, "end": phase.end} for phase in plan.phases
        ],
        "pads": _places(plan.motion.at(0.0)[0]),
        "low": _places(low),
        "high": _places(high),
        "paths": [_places(path[:, :3]) for path in np.moveaxis(places, 1, 0)],
        "lines": {
            name: [_places(strip) for strip in strips]
            for name, strips in scene.workspace_lines(plan).items()
        },
        "ceiling": workspace.ceiling,
        "north": None if heading is None else math.pi / 2 + math.radians(heading),
        "radius": plan.mission.vehicles.radius,
        "grip": plan.mission.vehicles.grip_offset,
        "cable": 0.5 * plan.mission.cable.diameter,
    }


def fleet_facts(fleet: Fleet | None) -> dict[str, Any]:
    """Return what does not change in a check of a fleet without a plan."""
    return {
        "kind": "plan",
        "name": fleet.name if fleet else "",
        "words": f"{len(fleet.vehicles)} vehicles" if fleet else "",
        "vehicles": len(fleet.vehicles) if fleet else 0,
        "duration": None,
        "phases": [],
        "emulated": fleet is not None and fleet.emulated is not None,
        "paths": None,
        "commands": list(COMMANDS),
    }


def event_facts(event: Event) -> dict[str, Any] | None:
    """Return an event of the list; None for those that only the record has, as on the terminal."""
    if event.kind in ROUTINE_KINDS or event.kind in STATUS_TEXT_KINDS - {
        "text warning",
        "text error",
    }:
        return None
    level = {"ERROR": "bad", "WARN": "warn", "INFO": "idle"}[log_level(event)]
    words = event_text(event)
    return {"kind": "event", "time": event.time, "of": event.kind, "words": words, "level": level}


def checked_facts(checked: Checked) -> dict[str, Any]:
    """Return what the check on the ground has found, as the terminal lists it: errors first."""
    levels: dict[str, Level] = {"error": "bad", "warning": "warn", "info": "idle"}
    order = list(levels)
    rows = sorted(in_common(checked.findings), key=lambda row: order.index(row.severity))
    return {
        "kind": "checked",
        "rows": [
            {"level": levels[row.severity], "check": row.check, "words": row.message}
            for row in rows
        ],
        "phases": [
            {"name": name, "start": k, "end": k + 1} for k, name in enumerate(checked.steps)
        ],
    }


def state_facts(plan: Plan | None, snapshot: Snapshot, rates: Rates) -> dict[str, Any]:
    """Return the team at the moment of a snapshot; ``rates`` are those of the links.

    In a check, which may have no plan, the vehicles are in the order of the fleet.
    """
    if plan is None or snapshot.phase in _CHECK:
        allowed, margins, strands = 0.0, list[dict[str, Any]](), np.empty((0, POINTS, 3))
    else:
        allowed = scene.allowed_error(plan, snapshot.mission_time)
        aloft = snapshot.clearances is not None and snapshot.clearances.chord > 0.0
        margins = [_pair(pair) for pair in closest_pairs(plan, snapshot.position, cable=aloft)]
        strands = _cable(plan, snapshot)
    return {
        "kind": "state",
        "time": snapshot.time,
        "phase": snapshot.phase,
        "mission": snapshot.mission_time,
        "rate": snapshot.rate,
        "slowed_by": snapshot.slowed_by,
        "landing": snapshot.landing,
        "wait": _wait(snapshot),
        "windows": [_window(name, seconds) for name, seconds in snapshot.windows.items()],
        "margins": [*margins, *_monitored(snapshot)],
        "rows": [_row(snapshot, rates, k, allowed) for k in range(len(snapshot.modes))],
        "commands": {
            name: list(answer)
            for name, answer in snapshot.available.items()
            if name not in _ANSWERS or _on_ground(snapshot)
        },
        "strands": [_places(strand) for strand in strands],
        "ground": _on_ground(snapshot),
        "over": snapshot.phase == Stage.FINISHED,
    }


def _on_ground(snapshot: Snapshot) -> bool:
    return snapshot.phase in {Stage.PREPARE, Stage.READY, *_CHECK}


def _wait(snapshot: Snapshot) -> dict[str, Any] | None:
    """Return why the clock does not run, who is missing, and the seconds until that ends."""
    seconds = _number(snapshot.time_left)
    if snapshot.held:
        then = "then all land together"
        return {"words": f"hold: {snapshot.held}", "missing": [], "left": seconds, "then": then}
    if snapshot.waiting_for:
        checking = snapshot.phase in _CHECK
        words = snapshot.waiting_for if checking else f"waiting for {snapshot.waiting_for}"
        missing = [] if checking else list(snapshot.missing)
        return {"words": words, "missing": missing, "left": seconds, "then": "left"}
    return None


def _window(name: str, seconds: float | None) -> dict[str, Any]:
    """Return a way out of the plan, in words: now, in some seconds, or not any more."""
    when = (
        "not in the rest of the plan"
        if seconds is None
        else "now"
        if seconds == 0.0
        else f"in {seconds:.0f} s"
    )
    level: Level = "good" if seconds == 0.0 else "idle"
    return {"words": f"{name} {when}", "level": level}


def _pair(closest: Tightest) -> dict[str, Any]:
    between = together(closest.between)
    return _distance(between, closest.distance, closest.required)


def _distance(between: str, distance: float, limit: float) -> dict[str, Any]:
    off = distance - limit
    level: Level = "bad" if off < 0.0 else "warn" if off < NEAR_LIMIT else "good"
    return {
        "between": between,
        "distance": metres(distance),
        "limit": f"at least {metres(limit)}",
        "level": level,
    }


def _monitored(snapshot: Snapshot) -> list[dict[str, Any]]:
    """Return the smallest margin of the live monitor, now and a moment ahead, and the tautest
    segment."""
    seen = snapshot.clearances
    if seen is None or not math.isfinite(seen.margin):
        return []
    margin = seen.margin
    level: Level = "bad" if margin < 0.0 else "warn" if margin < NEAR_LIMIT else "good"
    margins = [
        {
            "between": f"smallest margin ({seen.kind})",
            "distance": metres(margin),
            "limit": "at least 0.00 m",
            "level": level,
        }
    ]
    if seen.chord > 0.0:
        margins.append(
            {
                "between": "tautest segment",
                "distance": f"{seen.chord:.0%}",
                "limit": f"at most {MAX_CHORD_RATIO:.0%} of its length",
                "level": "bad" if seen.chord > MAX_CHORD_RATIO else "good",
            }
        )
    return margins


def _row(snapshot: Snapshot, rates: Rates, k: int, allowed: float) -> dict[str, Any]:
    """Return the row of a vehicle, with what is wrong in words."""
    position, age = snapshot.position[k], float(snapshot.link_age[k])
    error = float(np.linalg.norm(position - snapshot.setpoint[k]))
    wrong, level = _wrong(snapshot, k, error, allowed)
    total = _at(snapshot.received, k) + _at(snapshot.lost, k)
    return {
        "number": snapshot.numbers[k] if snapshot.numbers else k + 1,
        "level": level,
        "state": snapshot.states[k],
        "why": "; ".join(wrong),
        "mode": snapshot.modes[k],
        "armed": snapshot.armed[k],
        "place": _places(position),
        "target": _places(snapshot.setpoint[k]),
        "height": _number(float(position[2])),
        "error": _number(error),
        "allowed": allowed if allowed > 0.0 else None,
        "battery": _number(float(snapshot.battery[k])),
        "voltage": _number(_at(snapshot.voltage, k)),
        "fix": _position_source(snapshot, k),
        "age": _number(age),
        "rate": _number(_at(rates.rate, k)),
        "loss": _number(_at(snapshot.lost, k) / total) if total > 0.0 else None,
        "gripped": snapshot.gripped[k],
    }


def _wrong(snapshot: Snapshot, k: int, error: float, allowed: float) -> tuple[list[str], Level]:
    """Return what is wrong with a vehicle, in words, and how much."""
    on_ground = _on_ground(snapshot)
    age, battery = float(snapshot.link_age[k]), float(snapshot.battery[k])
    problem = snapshot.problems[k] if snapshot.problems else ""
    bad, warn = list[str](), list[str]()
    if not math.isfinite(age):
        bad.append("never received")
    elif age > scene.SILENT_AFTER:
        bad.append(f"no packet for {age:.1f} s")
    elif age > OLD_PACKET:
        warn.append(f"no packet for {age:.1f} s")
    if problem and not bad:
        (warn if on_ground else bad).append(problem)
    if snapshot.armed[k] and allowed > 0.0 and not on_ground:
        words = f"{metres(error)} from its setpoint, {metres(allowed)} allowed"
        if error > allowed:
            bad.append(words)
        elif error > NEAR_ERROR * allowed:
            warn.append(words)
    if battery < scene.EMPTY_BATTERY:
        bad.append(f"battery {battery:.0%}")
    elif battery < LOW_BATTERY:
        warn.append(f"battery {battery:.0%}")
    if snapshot.phase == CheckStep.BODIES and not bad:
        moved = bool(snapshot.numbers) and snapshot.numbers[k] in snapshot.missing
        return [], "warn" if moved else "idle"
    if bad or warn:
        return [*bad, *warn], "bad" if bad else "warn"
    ready = snapshot.armed[k] or snapshot.states[k] == "ready"
    return [], "good" if ready else "idle"


def _position_source(snapshot: Snapshot, k: int) -> str:
    """Return how a vehicle knows its place: fix and satellites, or the age of its last position."""
    fix, satellites = int(_at(snapshot.fix, k, -1.0)), int(_at(snapshot.satellites, k, -1.0))
    if fix > 1:
        return _FIXES.get(fix, f"fix {fix}") + (f", {satellites} sat." if satellites >= 0 else "")
    age = _at(snapshot.position_age, k)
    if math.isfinite(age):
        return f"position {age:.1f} s old"
    return _FIXES.get(fix, "no position")


def _cable(plan: Plan, snapshot: Snapshot) -> Floats:
    """Return points of the strands: as estimated aloft, laid before the grip, none once released.

    Without an estimate the held cable hangs in catenaries.
    """
    lengths = plan.layout.lengths
    if not len(lengths):
        return np.empty((0, POINTS, 3))
    if snapshot.cable is not None:
        return snapshot.cable
    gripped = np.array(snapshot.gripped, dtype=bool)
    if gripped.any():
        grips = np.where(gripped[:, None], snapshot.position, laid_grip_points(plan))
        return scene.strands(grips, lengths, POINTS)
    first = min((gate.time for gate in plan.gates if gate.condition == "gripped"), default=0.0)
    if snapshot.mission_time <= first:
        return scene.strands(laid_grip_points(plan), lengths, POINTS)
    return np.empty((0, POINTS, 3))


def _at(values: Floats, k: int, unknown: float = math.nan) -> float:
    return float(values[k]) if k < len(values) else unknown


def _number(value: float | None, digits: int = 3) -> float | None:
    """Return a number as JSON has it: None where it is not known."""
    return None if value is None or not math.isfinite(value) else round(value, digits)


def _places(points: Floats) -> Any:
    """Return points as lists with millimetres; None for what is not known."""
    rounded = np.round(points, 3).astype(object)
    rounded[~np.isfinite(points)] = None
    return rounded.tolist()
