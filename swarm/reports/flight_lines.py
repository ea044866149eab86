"""The single lines of a flight's screen: clock, phases, what it waits for, margins, keys."""

from collections.abc import Mapping
from typing import Final

import numpy as np
from rich.text import Text

from swarm.flight.snapshot import Snapshot
from swarm.ground.operator import KEYS, KILL_KEY
from swarm.planning import Plan
from swarm.reports.formatting import clock, metres

BAR: Final = 8
"""Characters of the current phase's bar: all phases of the longest plan then fit into 80 columns
with their names shortened at the end only."""

_KEY_NAMES: Final = {"interrupt": ("^C", "end"), "kill": (KILL_KEY, "kill")} | {
    request: (key, request) for key, request in KEYS.items() if key != " "
}
_ORDER: Final = (
    "hold",
    "resume",
    "rewind",
    "land",
    "release",
    "rejoin",
    "abort",
    "kill",
    "interrupt",
)
_RARE: Final = frozenset({"rejoin"})
"""Commands that are listed only while they are possible."""


def clock_line(plan: Plan, snapshot: Snapshot) -> Text:
    """Return mission name, phase, mission clock, its rate, and the time to the end of the plan."""
    line = Text(f"{plan.mission.name}  ", "bold", overflow="ellipsis", no_wrap=True)
    line.append(snapshot.phase or "on the ground", "bold cyan")
    line.append(f"  {clock(snapshot.mission_time)} of {clock(plan.duration)}")
    if snapshot.rate < 0.0:
        line.append(f"  rewinding × {-snapshot.rate:.2f}", "yellow")
    elif not snapshot.waiting_for and not snapshot.held and snapshot.rate != 1.0:
        line.append(f"  clock × {snapshot.rate:.2f}", "yellow")
    if snapshot.remaining is not None:
        line.append(f"  {clock(snapshot.remaining)} to the end")
    return line.append(f"  record {clock(snapshot.time)}", "dim")


def phase_line(plan: Plan, snapshot: Snapshot) -> Text:
    """Return all phases of the plan: those that are done, a bar for this one, those to come."""
    line = Text(overflow="ellipsis", no_wrap=True)
    names = [phase.name for phase in plan.phases]
    if snapshot.phase not in names:
        return line.append("  ".join(names), "dim")
    now = names.index(snapshot.phase)
    for k, phase in enumerate(plan.phases):
        if k < now:
            line.append(f"✓ {phase.name}  ", "green")
        elif k > now:
            line.append(f"{phase.name}  ", "dim")
        else:
            share = (snapshot.mission_time - phase.start) / max(phase.duration, 1e-9)
            share = min(max(share, 0.0), 1.0)
            done = round(BAR * share)
            line.append(f"{phase.name} ", "bold cyan")
            line.append("━" * done, "cyan").append("─" * (BAR - done), "dim")
            line.append(f" {share:.0%}  ", "bold cyan")
    line.rstrip()
    return line


def wait_line(snapshot: Snapshot) -> Text:
    """Return why the team holds, or the gate at which it waits, with the time that is left."""
    line = Text(overflow="ellipsis", no_wrap=True)
    left = snapshot.time_left
    if snapshot.held:
        landing = "" if left is None else f", all land together in {left:.0f} s"
        line.append(f"hold{landing}: {snapshot.held}", "bold yellow")
    elif snapshot.waiting_for:
        seconds = "" if left is None else f", {left:.0f} s left"
        line.append(f"waiting{seconds}: for {snapshot.waiting_for}", "yellow")
    return line


def margin_line(snapshot: Snapshot) -> Text:
    """Return the smallest margin of the live monitor, and the distances."""
    line = Text(overflow="ellipsis", no_wrap=True)
    clearances = snapshot.clearances
    if clearances is None or not np.isfinite(clearances.margin):
        return line.append("margin –", "dim")
    margin = clearances.margin
    style = "bold red" if margin < 0 else "yellow" if margin < 0.1 else "green"
    line.append(f"margin {metres(margin)}", style)
    return line.append(
        f"  cable {metres(clearances.cable)}, vehicles {metres(clearances.vehicle)}, "
        f"tautest chord {clearances.chord:.0%}{_swing(snapshot)}",
        "dim",
    )


def _swing(snapshot: Snapshot) -> str:
    """Return the largest estimated stray of a strand now, and its segment; "" without one."""
    if snapshot.stray is None:
        return ""
    segment = int(np.argmax(snapshot.stray))
    return f", swing {metres(snapshot.stray[segment])} (segment {segment + 1})"


def key_line(available: Mapping[str, tuple[bool, str]]) -> Text:
    """Return the keys of all commands beside their names; those not possible now are faint."""
    line = Text(overflow="ellipsis", no_wrap=True)
    for request in _ORDER:
        key, name = _KEY_NAMES[request]
        possible, _ = available.get(request, (False, ""))
        if request in _RARE and not possible:
            continue
        line.append(" · " if line else "", "dim")
        line.append(key, "bold" if possible else "dim").append(
            f" {name}", "" if possible else "dim"
        )
    return line
