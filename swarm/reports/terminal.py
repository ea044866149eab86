"""The screen of a flight on the terminal; in a pipe, plain lines."""

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
from swarm.flight.stages import Stage
from swarm.planning import Plan
from swarm.reports import scene
from swarm.reports.flight_lines import (
    clock_line,
    key_line,
    margin_line,
    phase_line,
    wait_line,
)
from swarm.reports.formatting import (
    ROUTINE_KINDS,
    STATUS_TEXT_KINDS,
    clock,
    event_text,
    log_level,
    merge_events,
    metres,
    worst_vehicles,
)
from swarm.reports.status_texts import StatusTexts

STATE_STYLES: Final = {
    "idle": "dim",
    "armed": "green",
    "attached": "cyan",
    "off track": "bold yellow",
    "silent": "bold magenta",
}
LEVEL_STYLES: Final = {"ERROR": "bold red", "WARN": "yellow", "INFO": "default"}
LAST_EVENTS: Final = 6
"""Lines of events on the screen."""

OTHER_LINES: Final = 8
"""Lines that are neither vehicles nor events: four above the table, its head, a rule, the keys, and
one that stays free for the terminal's cursor."""

RECENT_EVENTS: Final = 200
"""Events that are kept for these lines, before they are merged."""

WAIT_INTERVAL: Final = 1.0
"""Seconds between two lines of what a team on the ground waits for."""


class FlightScreen:
    """The screen of a flight: phases, mission clock, the team, the last events, the keys.

    Use it as a context manager; pass every snapshot to :meth:`show` and every event to
    :meth:`event`. It redraws five times a second; before it is entered, and in a pipe, it prints
    events, phases, and what a team on the ground waits for as lines.
    Routine events (modes, arming, …) are not listed. Of the vehicles' texts only warnings and worse
    are shown, each once, with all vehicles that sent it. With ``keys`` the operator's keys are
    listed: where a terminal passes them on.
    """

    def __init__(self, plan: Plan, console: Console, *, keys: bool = False) -> None:
        self._plan, self._keys = plan, keys
        self._console = console
        self._events: deque[Event] = deque(maxlen=RECENT_EVENTS)
        self._snapshot: Snapshot | None = None
        self._printed: tuple[str, str | None] = ("", None)
        self._printed_at = -WAIT_INTERVAL
        self._texts = StatusTexts()
        self._live = (
            Live(
                console=console,
                auto_refresh=True,
                refresh_per_second=5,
                get_renderable=self.drawing,
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
        self._print_texts(self._texts.remaining())
        if self._live is not None:
            self._live.stop()

    def show(self, snapshot: Snapshot) -> None:
        """Show the team as it is now."""
        self._snapshot = snapshot
        self._print_texts(self._texts.due(snapshot.time))
        if not self._drawn:
            self._print_phase(snapshot)

    def event(self, event: Event) -> None:
        """Show an event."""
        if event.kind in ROUTINE_KINDS:
            return
        self._print_texts(self._texts.due(event.time))
        if event.kind in STATUS_TEXT_KINDS:
            self._texts.add(event)
            return
        if log_level(event) == "ERROR":
            self._print_texts(self._texts.remaining())  # a text may be the cause
        self._print([event])

    def _print_texts(self, texts: Sequence[Sequence[Event]]) -> None:
        for events in texts:
            self._print(events)

    def _print(self, events: Sequence[Event]) -> None:
        """Show the same event of several vehicles."""
        self._events.extend(events)
        if not self._drawn:
            others = [event.vehicle for event in events[1:] if event.vehicle is not None]
            self._console.print(_event_line(events[0], others), soft_wrap=True)

    def countdown(self, seconds: int) -> None:
        """Show the remaining seconds before take-off."""
        self.event(Event(-float(seconds), "countdown", f"take-off in {seconds} s"))

    @property
    def _drawn(self) -> bool:
        """Whether the terminal shows the screen, not lines."""
        return self._live is not None and self._live.is_started

    def _print_phase(self, snapshot: Snapshot) -> None:
        on_ground = snapshot.phase in {Stage.PREPARE, Stage.READY}
        waits = snapshot.waiting_for if on_ground else None
        (phase, before), since = self._printed, snapshot.time - self._printed_at
        if phase == snapshot.phase and (waits == before or since < WAIT_INTERVAL):
            return
        self._printed, self._printed_at = (snapshot.phase, waits), snapshot.time
        line = f"{clock(snapshot.time)} phase {snapshot.phase}"
        line += f": waiting for {waits}" if waits else ""
        self._console.print(line, soft_wrap=True, highlight=False, markup=False)

    def drawing(self) -> RenderableType:
        """Return the screen as it is now."""
        snapshot, parts = self._snapshot, list[RenderableType]()
        if snapshot is None:
            parts.append(
                Text("starting: links, numerical code, and the emulator if it flies", "dim")
            )
        else:
            parts += [
                clock_line(self._plan, snapshot),
                phase_line(self._plan, snapshot),
                wait_line(snapshot),
                margin_line(snapshot),
                team_table(snapshot, self._plan, self._console.height - LAST_EVENTS - OTHER_LINES),
            ]
        parts.append(Rule(style="dim"))
        parts += [
            _event_line(*merged) for merged in merge_events(list(self._events))[-LAST_EVENTS:]
        ]
        if snapshot is not None and self._keys and snapshot.phase != Stage.FINISHED:
            parts.append(key_line(snapshot.available))
        return Group(*parts)


def team_table(snapshot: Snapshot, plan: Plan, rows: int) -> Table:
    """Return the team's table; with more vehicles than ``rows``, those in the worst state."""
    tracking = scene.allowed_error(plan, snapshot.mission_time)
    states = scene.vehicle_states(snapshot, tracking)
    errors = scene.tracking_errors(snapshot)
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for name in ("vehicle", "state", "mode", "armed", "battery", "last packet", "error"):
        right = name in {"vehicle", "battery", "last packet", "error"}
        table.add_column(name, justify="right" if right else "left", no_wrap=True)
    shown = worst_vehicles(errors, snapshot.link_age, max(rows, 4))
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
    return line.append(event_text(event, others), LEVEL_STYLES[log_level(event)])
