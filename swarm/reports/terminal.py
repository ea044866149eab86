"""What the terminal shows: the plan and its findings, and one quiet screen while flying.

In a pipe the same is said in plain lines.
"""

from collections import deque
from collections.abc import Sequence
from types import TracebackType
from typing import Final, Self

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from swarm.flight.snapshot import Event, Snapshot
from swarm.planning import Plan
from swarm.reports import scene
from swarm.reports.formatting import (
    ROUTINE,
    TEXTS,
    clip_rows,
    clock,
    level,
    merged,
    metres,
    sentence,
)
from swarm.reports.status_texts import Texts

STATE_STYLES: Final = {
    "idle": "dim",
    "armed": "green",
    "holding": "cyan",
    "off track": "bold yellow",
    "silent": "bold magenta",
}
LEVEL_STYLES: Final = {"ERROR": "bold red", "WARN": "yellow", "INFO": "default"}
LAST_EVENTS: Final = 6
RECENT_EVENTS: Final = 200


class FlightScreen:
    """One screen while flying: phase, mission clock, the team, the last events.

    Use it as a context manager, :meth:`show` it every snapshot (it redraws a few times a second)
    and tell it every :meth:`event`. In a pipe it prints events and phases as lines. What every
    vehicle does in every flight (modes, arming, …) is in the table, not among the events. Of the
    vehicles' own texts only warnings and worse are shown, each once, with all that say it.
    """

    def __init__(self, plan: Plan, console: Console) -> None:
        self._plan = plan
        self._console = console
        self._events: deque[Event] = deque(maxlen=RECENT_EVENTS)
        self._snapshot: Snapshot | None = None
        self._said: str | None = None
        self._texts = Texts()
        self._live = (
            Live(
                console=console, auto_refresh=True, refresh_per_second=5, get_renderable=self._draw
            )
            if console.is_terminal
            else None
        )

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start(refresh=False)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._say_texts(self._texts.rest())
        if self._live is not None:
            self._live.stop()

    def show(self, snapshot: Snapshot) -> None:
        """Show the team as it is now."""
        self._snapshot = snapshot
        self._say_texts(self._texts.due(snapshot.time))
        if self._live is None:
            self._say_phase(snapshot)

    def event(self, event: Event) -> None:
        """Show something that happened."""
        if event.kind in ROUTINE:
            return
        self._say_texts(self._texts.due(event.time))
        if event.kind in TEXTS:
            self._texts.hear(event)
            return
        if level(event) == "ERROR":
            self._say_texts(self._texts.rest())  # which may be its cause
        self._say([event])

    def _say_texts(self, texts: Sequence[Sequence[Event]]) -> None:
        for events in texts:
            self._say(events)

    def _say(self, events: Sequence[Event]) -> None:
        """Say what happened to several vehicles at about the same time."""
        if self._live is None:
            others = [event.vehicle for event in events[1:] if event.vehicle is not None]
            self._console.print(_event_line(events[0], others), soft_wrap=True)
        else:
            self._events.extend(events)

    def countdown(self, left: int) -> None:
        """Show the seconds that are left before take-off."""
        self.event(Event(-float(left), "countdown", f"take-off in {left} s"))

    def _say_phase(self, snapshot: Snapshot) -> None:
        if snapshot.phase == self._said:
            return
        self._said = snapshot.phase
        line = f"{clock(snapshot.time)} phase {snapshot.phase}"
        self._console.print(line, soft_wrap=True, highlight=False, markup=False)

    def _draw(self) -> RenderableType:
        parts: list[RenderableType] = []
        if self._snapshot is not None:
            parts += [
                _flight_line(self._plan, self._snapshot),
                _margin_line(self._snapshot),
                team_table(self._snapshot, self._plan, self._console.height - LAST_EVENTS - 7),
            ]
        parts.append(Rule(style="dim"))
        parts += [_event_line(*said) for said in merged(list(self._events))[-LAST_EVENTS:]]
        return Group(*parts)


def _flight_line(plan: Plan, snapshot: Snapshot) -> Text:
    line = Text(f"{plan.mission.name}  ", "bold", overflow="ellipsis", no_wrap=True)
    line.append(snapshot.phase or "on the ground", "bold cyan")
    line.append(f"  {clock(snapshot.mission_time)} of {clock(plan.duration)}")
    if snapshot.waiting_for:
        line.append(f"  waiting for: {snapshot.waiting_for}", "yellow")
    elif snapshot.rate != 1.0:
        line.append(f"  clock × {snapshot.rate:.2f}", "yellow")
    line.append(f"  record {clock(snapshot.time)}", "dim")
    return line


def _margin_line(snapshot: Snapshot) -> Text:
    line = Text(overflow="ellipsis", no_wrap=True)
    found = snapshot.clearances
    if found is not None and np.isfinite(found.margin):
        style = "bold red" if found.margin < 0 else "yellow" if found.margin < 0.1 else "green"
        line.append(f"margin {metres(found.margin)}", style)
        line.append(
            f"  cable {metres(found.cable)}, vehicles {metres(found.vehicle)}, "
            f"tautest chord {found.chord:.0%}  ",
            "dim",
        )
    windows = [wish for wish, (is_open, _) in snapshot.available.items() if is_open]
    return line.append(f"you can: {', '.join(windows)}" if windows else "", "dim")


def team_table(snapshot: Snapshot, plan: Plan, rows: int) -> Table:
    """Return the team's table in at most ``rows`` rows; with more vehicles the worst ones."""
    tracking = plan.mission.vehicles.tracking
    states = scene.vehicle_states(snapshot, tracking)
    errors = scene.tracking_errors(snapshot)
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for name in ("vehicle", "state", "mode", "armed", "battery", "heard", "error"):
        right = name in {"vehicle", "battery", "heard", "error"}
        table.add_column(name, justify="right" if right else "left", no_wrap=True)
    shown = clip_rows(errors, snapshot.link_age, max(rows, 4))
    for i in shown:
        age = snapshot.link_age[i]
        battery = snapshot.battery[i]
        off = errors[i] > tracking > 0
        table.add_row(
            str(i + 1),
            Text(states[i], STATE_STYLES[states[i]]),
            snapshot.modes[i] or "–",
            "armed" if snapshot.armed[i] else "–",
            Text(f"{battery:.0%}" if np.isfinite(battery) else "–", "red" if battery < 0.2 else ""),
            Text(f"{age:.1f} s" if np.isfinite(age) else "never", _age_style(age)),
            Text(metres(errors[i]), "bold yellow" if off else ""),
        )
    if len(shown) < len(errors):
        table.add_row("", Text(f"and {len(errors) - len(shown)} more", "dim"))
    return table


def _age_style(age: float) -> str:
    return "" if age <= 1.0 else "yellow" if age <= scene.SILENT_AFTER else "bold magenta"


def _event_line(event: Event, others: Sequence[int] = ()) -> Text:
    line = Text(overflow="ellipsis", no_wrap=True)
    line.append(f"{clock(event.time)} ", "dim")
    return line.append(sentence(event, others), LEVEL_STYLES[level(event)])
