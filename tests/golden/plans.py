"""Goldens of plans and certificates: a digest, and the figures by which a person judges a plan."""

import json
import math
from collections import Counter
from pathlib import Path
from typing import Any

from swarm import planner
from swarm.certification.assessment import Assessment
from swarm.errors import Refused
from swarm.mission import Mission, mission_for_knot, parse_mission
from swarm.planning import digest
from tests.golden.environment import environment

MISSIONS = Path(__file__).parents[2] / "missions"

# Another CPU rounds the last bits in another direction, and the planner's optimiser and its choice
# between cells then take another path. Which knot is tied and by how many vehicles must not depend
# on that, nor whether the plan is cleared; how much cable and time it takes may, by a little.
EXACT = ("mission", "knot", "vehicles", "cleared", "phases")
RELATIVE = {"cable, m": 0.02, "fold, s": 0.05, "duration, s": 0.05}
DECIMALS = 4


def mission_of(name: str) -> Mission:
    """Return the mission of a case: a file below missions/ (``…yaml``) or a knot's name.

    Knots are planned as by ``swarm knots --plan``: a negative clearance budget is accepted.
    """
    if name.endswith(".yaml"):
        return parse_mission((MISSIONS / name).read_text(encoding="utf-8"), name)
    return mission_for_knot(name, ["limits.accept_negative_budget=true"])


def make(name: str, *, robustness: bool) -> str:
    """Plan and certify a mission; return its golden as JSON.

    ``robustness`` asks for e* and w*, which take a dozen certificates more.
    """
    mission = mission_of(name)
    record: dict[str, Any] = {"environment": environment(), "mission": mission.name}
    try:
        planned = planner.plan(mission, robustness=robustness)
    except Refused:
        record |= {"cleared": False, "refused": "no motion was found"}
    else:
        plan, found = planned.plan, planned.assessment
        record |= {
            "digest": digest(plan),
            "cleared": found.cleared,
            "knot": f"{found.knot} {found.chirality}",
            "vehicles": plan.vehicles,
            "figures": {
                "cable, m": _rounded(plan.layout.lengths.sum()),
                "cell, m": _rounded(plan.layout.cell),
                "fold, s": _rounded(plan.phase("fold").end - plan.phase("fold").start),
                "duration, s": _rounded(plan.duration),
                **_figures(found),
            },
            "phases": {phase.name: _rounded(phase.end - phase.start) for phase in plan.phases},
            "tightest": _tightest(found),
            "findings": _findings(found),
        }
    return json.dumps(record, indent=1, ensure_ascii=False) + "\n"


def _figures(found: Assessment) -> dict[str, float | None]:
    figures: dict[str, float | None] = {
        "strand distance, m": _rounded(found.distances["cable"].distance),
        "vehicle distance, m": _rounded(found.distances["vehicle"].distance),
        "vehicle-cable distance, m": _rounded(found.distances["vehicle_cable"].distance),
        "e*, m": _rounded(found.robustness.tracking),
        "w*, m/s": _rounded(found.robustness.wind),
    }
    if found.contingencies is not None:
        figures |= {
            "window to land, share": _rounded(found.contingencies.land.share),
            "window to land, longest wait, s": _rounded(found.contingencies.land.wait),
            "window to release, share": _rounded(found.contingencies.release.share),
            "window to release, longest wait, s": _rounded(found.contingencies.release.wait),
            "longest stop, s": _rounded(found.contingencies.stop_time),
            "longest stop, m": _rounded(found.contingencies.stop_distance),
        }
    if found.stream_loss is not None and len(found.stream_loss.times):
        figures |= {
            "stream loss, slowest clock rate": _rounded(found.stream_loss.rates.min()),
            "stream loss, delay, s": _rounded(found.stream_loss.delay),
            "stream loss, smallest margin, m": _rounded(found.stream_loss.worst.margin),
        }
    return figures


def _tightest(found: Assessment) -> dict[str, str]:
    """The tightest moment of each check; its unit is the check's (m, m/s or m/s²)."""
    worst = {m.check: m for m in sorted(found.moments, key=lambda m: m.margin, reverse=True)}
    return {
        check: f"{m.distance:.{DECIMALS}f} of {m.required:g}, "
        f"{' – '.join(name for name in m.between if name)}, {m.time:.2f} s"
        for check, m in sorted(worst.items())
    }


def _findings(found: Assessment) -> dict[str, int]:
    counts = Counter(f"{finding.severity}: {finding.check}" for finding in found.findings)
    return dict(sorted(counts.items()))


def _rounded(value: float | None) -> float | None:
    """Round for a file; None where there is nothing to tell: no pair, or not worked out."""
    if value is None or not math.isfinite(value):
        return None
    return round(float(value), DECIMALS)


def disagreements(old: str, new: str) -> list[str]:
    """Return where two goldens differ by more than another CPU explains."""
    before, after = json.loads(old), json.loads(new)
    words = [
        f"{key}: expected {_told(before, key)}, got {_told(after, key)}"
        for key in EXACT
        if _told(before, key) != _told(after, key)
    ]
    for key, share in RELATIVE.items():
        was, now = before.get("figures", {}).get(key), after.get("figures", {}).get(key)
        if (was is None) != (now is None) or (was and abs(now - was) > share * was):
            words.append(f"{key}: expected {was} ± {share:.0%}, got {now}")
    return words


def _told(record: dict[str, Any], key: str) -> Any:
    """Of phases only the names count: their times are compared as figures."""
    return list(record.get(key, {})) if key == "phases" else record.get(key)


def differences(old: str, new: str) -> list[str]:
    """Return what a renewal changes, in figures."""
    before, after = json.loads(old), json.loads(new)
    words = [
        f"{key}: {_short(before.get(key))} → {_short(after.get(key))}"
        for key in ("mission", "cleared", "refused", "knot", "vehicles", "digest")
        if before.get(key) != after.get(key)
    ]
    for group in ("figures", "phases", "findings", "tightest"):
        was, now = _values(before, group), _values(after, group)
        words += [
            f"{key}: {_change(was.get(key), now.get(key))}"
            for key in [*was, *(key for key in now if key not in was)]
            if was.get(key) != now.get(key)
        ]
    return words


def _values(record: dict[str, Any], group: str) -> dict[str, Any]:
    """The figures of a group: of tightest moments the distance, of phases what no figure says."""
    values = record.get(group, {})
    if group == "tightest":
        return {f"least {check}": float(words.split()[0]) for check, words in values.items()}
    if group == "phases":
        return {f"phase {name}, s": value for name, value in values.items() if name != "fold"}
    return dict(values)


def _short(value: Any) -> str:
    return f"{value[:12]}…" if isinstance(value, str) and len(value) == 64 else str(value)


def _change(was: Any, now: Any) -> str:
    words = f"{'–' if was is None else was} → {'–' if now is None else now}"
    if isinstance(was, float) and isinstance(now, float) and was:
        words += f" ({(now - was) / abs(was):+.1%})"
    return words
