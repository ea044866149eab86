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
from rich.padding import Padding
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from swarm.flight.snapshot import Event, Snapshot
from swarm.plans import Plan
from swarm.preflight.findings import Assessment, Finding, Tightest
from swarm.view import scene
from swarm.view.words import ROUTINE, clip_rows, clock, level, merged, metres, seconds, sentence

SEVERITY_STYLES: Final = {"error": "bold red", "warning": "yellow", "info": "dim"}
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


def plan_summary(plan: Plan, assessment: Assessment, console: Console) -> None:
    """Print a plan's figures and what the checks found, the worst first."""
    console.print(_headline(plan, assessment))
    console.print(Padding(_figures(plan, assessment), (0, 0, 0, 2), expand=False))
    console.print(Padding(_clearances(assessment), (1, 0, 0, 2), expand=False))
    findings(assessment, console)


def findings(assessment: Assessment, console: Console) -> None:
    """Print what the checks have to say, errors before warnings before remarks."""
    if assessment.findings:
        console.print(Padding(findings_table(assessment.findings), (1, 0, 0, 2), expand=False))
    errors = sum(finding.severity == "error" for finding in assessment.findings)
    verdict = (
        Text("Cleared: certified in the quasi-static cable model.", "green")
        if assessment.cleared
        else Text(f"Refused: {errors} error{'s' if errors > 1 else ''}.", "bold red")
    )
    console.print(Padding(verdict, (1, 0, 0, 0), expand=False))


def _headline(plan: Plan, assessment: Assessment) -> Text:
    hand = f", {plan.knot.chirality}-handed" if plan.knot.chirality != "none" else ""
    line = Text(f"{plan.mission.name}: ", "bold")
    line.append(f"knot {plan.knot.type}{hand}", "bold")
    if (assessment.knot, assessment.chirality) != (plan.knot.type, plan.knot.chirality):
        line.append(f"; the planned cable is {assessment.knot}, {assessment.chirality}", "bold red")
    return line


def _figures(plan: Plan, assessment: Assessment) -> Table:
    layout = plan.layout
    fold = plan.phase("fold")
    robustness = assessment.robustness
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim")
    table.add_column()
    table.add_row("Gauss code", plan.knot.gauss)
    grid = f", cell {metres(layout.cell)}" if layout.cell > 0 else ""
    size = len(plan.knot.grid_columns)
    table.add_row("Layout", f"{size}×{size} grid{grid}" if size else "given corners")
    table.add_row("Vehicles", str(plan.vehicles))
    lengths = layout.lengths
    table.add_row(
        "Cable",
        f"{metres(lengths.sum())} in {len(lengths)} segments of "
        f"{metres(lengths.min())} to {metres(lengths.max())}",
    )
    table.add_row("Sags", f"{metres(layout.sags.min())} to {metres(layout.sags.max())}")
    table.add_row(
        "Duration", f"{seconds(plan.duration)}, of which the fold {seconds(fold.end - fold.start)}"
    )
    tracking = plan.mission.vehicles.tracking
    ball = metres(tracking) if tracking > 0 else "0 (geometry only)"
    limits = [f"certified for {ball}"]
    if robustness.tracking is not None:
        limits.append(f"would hold up to {metres(robustness.tracking)}")
    table.add_row("Tracking error", ", ".join(limits))
    if robustness.wind is not None:
        table.add_row("Steady wind", f"would hold up to {robustness.wind:.1f} m/s")
    return table


def _clearances(assessment: Assessment) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("Smallest distance")
    for name in ("kept", "required", "at"):
        table.add_column(name, justify="right")
    table.add_column("between")
    for kind, tightest in (
        ("cable to cable", assessment.cable),
        ("vehicle to vehicle", assessment.vehicle),
        ("vehicle to cable", assessment.vehicle_cable),
    ):
        table.add_row(kind, *_tightest(tightest))
    return table


def _tightest(tightest: Tightest) -> tuple[RenderableType, ...]:
    if not np.isfinite(tightest.distance):
        return ("–", metres(tightest.required), "–", "–")
    fine = tightest.distance >= tightest.required
    return (
        Text(metres(tightest.distance), "green" if fine else "bold red"),
        metres(tightest.required),
        seconds(tightest.time),
        " and ".join(tightest.between),
    )


def findings_table(found: tuple[Finding, ...]) -> Table:
    """Return a table of findings, errors before warnings before remarks."""
    order = list(SEVERITY_STYLES)
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("Finding", no_wrap=True)
    table.add_column("check", no_wrap=True)
    table.add_column("says", ratio=1)
    table.add_column("at", justify="right", no_wrap=True)
    for finding in sorted(found, key=lambda finding: order.index(finding.severity)):
        when = "" if finding.at_time is None else seconds(finding.at_time)
        severity = Text(finding.severity, SEVERITY_STYLES[finding.severity])
        table.add_row(severity, finding.check, Text(finding.message), when)
    return table


class FlightScreen:
    """One screen while flying: phase, mission clock, the team, the last events.

    Use it as a context manager, :meth:`show` it every snapshot (it redraws a few times a second)
    and tell it every :meth:`event`. In a pipe it prints events and phases as lines. What every
    vehicle does in every flight (modes, arming, …) is in the table, not among the events.
    """

    def __init__(self, plan: Plan, console: Console) -> None:
        self._plan = plan
        self._console = console
        self._events: deque[Event] = deque(maxlen=RECENT_EVENTS)
        self._snapshot: Snapshot | None = None
        self._said: str | None = None
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
        if self._live is not None:
            self._live.stop()

    def show(self, snapshot: Snapshot) -> None:
        """Show the team as it is now."""
        self._snapshot = snapshot
        if self._live is None:
            self._say_phase(snapshot)

    def event(self, event: Event) -> None:
        """Show something that happened."""
        if event.kind in ROUTINE:
            return
        if self._live is None:
            self._console.print(_event_line(event), soft_wrap=True)
            return
        self._events.append(event)

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
