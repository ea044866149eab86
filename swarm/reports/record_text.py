"""The verification of a flight record on the terminal."""

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from swarm.flight.tlog import Replayed
from swarm.ground.record_verification import Observation, VerifiedRecord
from swarm.planning import Plan
from swarm.reports.flight_text import print_adherence, print_verification
from swarm.verification import TrackingStatistics


def print_record(verified: VerifiedRecord, console: Console) -> None:
    """Print basis, implied knot, distances, tracking errors, links and observations."""
    if verified.basis is None:
        words = "The record does not state a certificate, nor whether cable was carried."
        console.print(words, style="dim", highlight=False, soft_wrap=True)
    else:
        if verified.adherence is not None:
            print_adherence(verified.adherence, console)
        console.print(f"Flown {verified.basis.words}.", highlight=False, soft_wrap=True)
    print_verification(
        verified.plan, verified.verification, verified.assessment, console,
        positions="world's positions" if verified.truth else "reported positions",
    )  # fmt: skip
    console.print(_tracking_table(verified.verification.tracking))
    _print_links(verified.log, console)
    _print_observations(verified.plan, verified.observations, console)


def _tracking_table(errors: Sequence[TrackingStatistics]) -> Table:
    """Return the tracking errors of all vehicles in every phase, and of each one in the fold."""
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("tracking error")
    for heading in ("RMS", "99.9 %", "largest"):
        table.add_column(heading, justify="right")
    for error in errors:
        if error.phase and not error.vehicle:
            name = f"{error.phase}, all"
        elif error.phase == "fold":
            name = f"fold, vehicle {error.vehicle}"
        else:
            continue
        sizes = (error.rms, error.p999, error.largest)
        table.add_row(name, *(f"{size:.3f} m" for size in sizes))
    return table


def _print_links(log: Replayed, console: Console) -> None:
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("command")
    for heading in ("sent", "acknowledged", "resent", "median latency", "largest"):
        table.add_column(heading, justify="right")
    for command in log.commands:
        latencies = (command.median, command.largest)
        table.add_row(
            command.name,
            *(str(count) for count in (command.sent, command.answered, command.repeated)),
            *(f"{1000 * time:.0f} ms" if command.answered else "–" for time in latencies),
        )
    console.print(table)
    received, lost = sum(log.received.values()), sum(log.lost.values())
    line = f"{received} packets received, {lost} lost ({lost / max(received + lost, 1):.2%})"
    worst = max(log.lost, key=lambda system: log.lost[system], default=None)
    if worst is not None and log.lost[worst]:
        line += f", most from system {worst}: {log.lost[worst]}"
    console.print(line, style="dim", highlight=False, soft_wrap=True)
    for note in log.notes:
        console.print(f"[yellow]note[/] {note}", highlight=False, soft_wrap=True)


def _print_observations(plan: Plan, observations: Sequence[Observation], console: Console) -> None:
    if not observations and len(plan.layout.lengths):
        words = 'No observation yet: add one with --observed "3_1 right by camera"'
        console.print(words, style="dim", highlight=False, soft_wrap=True)
    for observation in observations:
        style = "green" if observation.agrees(plan.knot) else "bold red"
        hand = f" {observation.chirality}-handed" if observation.chirality else ""
        console.print(
            f"Observed: [{style}]{observation.knot}{hand}[/] by {observation.observer} "
            f"({observation.time})",
            highlight=False,
            soft_wrap=True,
        )
