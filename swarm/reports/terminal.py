"""The screen of a flight on the terminal; in a pipe, plain lines.

Lines are the clock, phases, what it waits for, margins, keys, and the texts of vehicles
(STATUSTEXT), each text once.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from types import TracebackType
from typing import Final, Self

import numpy as np
import numpy.typing as npt
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from swarm.certification.findings import numbers
from swarm.flight.snapshot import Event, Snapshot
from swarm.flight.stages import Stage
from swarm.ground.operator import KEYS, KILL_KEY
from swarm.planning import Plan
from swarm.reports import scene
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
from swarm.verification import closest_pairs

Floats = npt.NDArray[np.float64]

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
    if snapshot.landing is not None:
        line.append(f"  all landed in {clock(snapshot.landing)}")
    elif snapshot.remaining is not None:
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
    remaining = snapshot.time_left
    if snapshot.held:
        landing = "" if remaining is None else f", all land together in {remaining:.0f} s"
        line.append(f"hold{landing}: {snapshot.held}", "bold yellow")
    elif snapshot.waiting_for:
        seconds = "" if remaining is None else f", {remaining:.0f} s left"
        if snapshot.missing and len(snapshot.missing) < len(snapshot.modes):
            seconds += f", missing {numbers(snapshot.missing)}"
        line.append(f"waiting{seconds}: for {snapshot.waiting_for}", "yellow")
    return line


def margin_line(plan: Plan, snapshot: Snapshot) -> Text:
    """Return the smallest margin of the live monitor with its kind, the distances, and the closest
    vehicles."""
    line = Text(overflow="ellipsis", no_wrap=True)
    clearances = snapshot.clearances
    if clearances is None or not np.isfinite(clearances.margin):
        return line.append("margin –", "dim")
    margin = clearances.margin
    style = "bold red" if margin < 0 else "yellow" if margin < 0.1 else "green"
    line.append(f"margin {metres(margin)}", style)
    (closest, *_), between = closest_pairs(plan, snapshot.position, cable=False) or (None,), ""
    if closest is not None:
        between = f" ({' and '.join(name.split()[-1] for name in closest.between)})"
    return line.append(
        f" {clearances.kind}  cable {metres(clearances.cable)}, "
        f"vehicles {metres(clearances.vehicle)}{between}, "
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
    """Return the keys of all commands beside their names; those not possible now are faint.

    The line fits 80 columns, with rare commands in it, too.
    """
    line = Text(overflow="ellipsis", no_wrap=True)
    possible_now = {request for request, (possible, _) in available.items() if possible}
    separator = "  " if _RARE & possible_now else " · "
    for request in _ORDER:
        key, name = _KEY_NAMES[request]
        possible = request in possible_now
        if request in _RARE and not possible:
            continue
        line.append(separator if line else "", "dim")
        line.append(key, "bold" if possible else "dim").append(
            f" {name}", "" if possible else "dim"
        )
    return line


SHOWN_KINDS: Final = frozenset({"text warning", "text error"})
"""Kinds of texts for the screen: warnings and worse. The record has all kinds."""

WINDOW: Final = 2.0
"""Seconds of flight time for which a text waits for the same text of other vehicles. Nine
ArduCopter 4.6.2 took 1.1 s to report that they had found a ground station."""


@dataclass
class StatusTexts:
    """Texts that wait for the same text of other vehicles; repeated texts are dropped."""

    _waiting: dict[tuple[str, str], list[Event]] = field(default_factory=dict)
    _seen: set[tuple[str, str, int | None]] = field(default_factory=set)

    def add(self, event: Event) -> None:
        """Add a text; a repeated text, and one that the screen does not show, is dropped."""
        key = event.kind, event.message, event.vehicle
        if event.kind in SHOWN_KINDS and key not in self._seen:
            self._seen.add(key)
            self._waiting.setdefault((event.kind, event.message), []).append(event)

    def due(self, now: float) -> list[list[Event]]:
        """Return the texts that have waited for :data:`WINDOW`: each text's events in order."""
        return self._take(now - WINDOW)

    def remaining(self) -> list[list[Event]]:
        """Return all texts that wait."""
        return self._take(float("inf"))

    def _take(self, until: float) -> list[list[Event]]:
        due = [key for key, events in self._waiting.items() if events[0].time <= until]
        return [self._waiting.pop(key) for key in due]


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
    :meth:`event`. It redraws five times a second; before it is entered, in a pipe, and in a
    terminal that cannot move its cursor (TERM=dumb), it prints events, phases, and what a team on
    the ground waits for as lines.
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
        self._size = console.size
        self._live = (
            Live(
                console=console,
                auto_refresh=True,
                refresh_per_second=5,
                get_renderable=self.drawing,
            )
            if console.is_terminal and not console.is_dumb_terminal
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
        self._follow_size()
        if not self._drawn:
            self._print_phase(snapshot)

    def _follow_size(self) -> None:
        """Draw anew from the top in a terminal that has become smaller.

        Its lines are folded or have left it then: how far up the drawing began is not known.
        """
        before, self._size = self._size, self._console.size
        smaller = self._size.width < before.width or self._size.height < before.height
        if smaller and self._live is not None and self._drawn:
            self._live.stop()
            self._console.clear()
            self._live.start()

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
        if self._keys and phase != snapshot.phase:
            names = [
                _KEY_NAMES[name] for name in _ORDER if snapshot.available.get(name, (False,))[0]
            ]
            line += "".join(f" · {key} {name}" for key, name in names)
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
                margin_line(self._plan, snapshot),
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
    """Return the team's table; with more vehicles than ``rows``, two of them in each row, with
    what matters most; where that is not enough, those in the worst state."""
    tracking = scene.allowed_error(plan, snapshot.mission_time)
    states = scene.vehicle_states(snapshot, tracking)
    errors = scene.tracking_errors(snapshot)
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    if len(errors) > max(rows, 4):
        return _table_of_two(table, snapshot, errors, states, max(rows, 4))
    for name in ("vehicle", "state", "mode", "height", "battery", "last packet", "error"):
        right = name not in {"state", "mode"}
        table.add_column(name, justify="right" if right else "left", no_wrap=True)
    for i in range(len(errors)):
        age = snapshot.link_age[i]
        battery = snapshot.battery[i]
        off = errors[i] > tracking > 0
        table.add_row(
            str(i + 1),
            Text(states[i], STATE_STYLES[states[i]]),
            snapshot.modes[i] or "–",
            metres(float(snapshot.position[i, 2])),
            Text(
                f"{battery:.0%}" if np.isfinite(battery) else "–",
                "red" if battery < scene.EMPTY_BATTERY else "",
            ),
            Text(f"{age:.1f} s" if np.isfinite(age) else "never", _age_style(age)),
            Text(metres(errors[i]), "bold yellow" if off else ""),
        )
    return table


def _table_of_two(
    table: Table, snapshot: Snapshot, errors: Floats, states: Sequence[str], rows: int
) -> Table:
    """Return a table with two vehicles in each row: number, state, height and error."""
    for name in ("", "state", "height", "error") * 2:
        table.add_column(name, justify="left" if name == "state" else "right", no_wrap=True)
    shown = worst_vehicles(errors, snapshot.link_age, 2 * rows)
    half = (len(shown) + 1) // 2
    cells = [
        (
            str(i + 1),
            Text(states[i], STATE_STYLES[states[i]]),
            metres(float(snapshot.position[i, 2])),
            metres(errors[i]),
        )
        for i in shown
    ]
    if len(shown) < len(errors):
        cells.append(("", Text(f"and {len(errors) - len(shown)} more", "dim"), "", ""))
    for first, second in zip_longest(cells[:half], cells[half:], fillvalue=("",) * 4):
        table.add_row(*first, *second)
    return table


def _age_style(age: float) -> str:
    return "" if age <= 1.0 else "yellow" if age <= scene.SILENT_AFTER else "bold magenta"


def _event_line(event: Event, others: Sequence[int] = ()) -> Text:
    line = Text(overflow="ellipsis", no_wrap=True)
    line.append(f"{clock(event.time)} ", "dim")
    return line.append(event_text(event, others), LEVEL_STYLES[log_level(event)])
