"""``swarm verify``: tell from a flight's record what was flown."""

from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.table import Table

from swarm.certification.assess import assess
from swarm.cli.inputs import JSON, print_json
from swarm.cli.outcome import flown_object, print_adherence, print_flown
from swarm.flight.adherence import Adherence, adherence, adherence_object
from swarm.flight.flight_plan import Basis
from swarm.flight.tlog import Replayed
from swarm.ground.observations import (
    Observation,
    append_observation,
    parse_observation,
    recorded_observations,
)
from swarm.ground.record_reader import recorded_basis, recorded_flight, recorded_plan
from swarm.planning import Plan
from swarm.verification import TrackingStatistics, verify_trace


@click.command()
@click.argument("record", type=click.Path(path_type=Path))
@JSON
@click.option(
    "--observed",
    metavar="WORDS",
    help='Enter what was seen, for example "3_1 right by camera" or "unknot by Ann".',
)
@click.option(
    "--plot",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Draw where it was held, tracking errors and the mission clock (PNG).",
)
@click.pass_context
def verify(
    context: click.Context, record: Path, as_json: bool, observed: str | None, plot: Path | None
) -> None:
    """Recompute from RECORD (a flight's folder) which knot was flown, and how closely.

    Reads the positions that the vehicles reported and the setpoints that were sent from the .tlog,
    and judges them in the cable model against the recorded plan. Exit code 0 when they imply the
    knot that was asked for (and nobody saw another one) and cable was carried within its
    certificate, 1 when not.
    """
    plan = recorded_plan(record)
    basis = recorded_basis(record, plan)
    seen = recorded_observations(record)
    if observed is not None:
        seen.append(parse_observation(observed, datetime.now(UTC)))
    replayed = recorded_flight(record, plan)
    assessment, flown = assess(plan), verify_trace(plan, replayed.trace)
    kept = adherence(plan, replayed.trace, basis) if basis else None
    if observed is not None:
        append_observation(record, seen[-1])
    if plot:
        from swarm.reports.plots import plot_flight  # noqa: PLC0415 - slow to import

        plot_flight(plan, replayed.trace, plot)
    if as_json:
        found = {
            "record": str(record),
            "certificate": asdict(basis) if basis else None,
            "adherence": adherence_object(kept) if kept else None,
            **flown_object(flown, assessment),
            **_links_object(replayed),
            "observed": [asdict(one) for one in seen],
        }
        print_json(found)
    else:
        console = Console()
        _print_basis(basis, kept, console)
        print_flown(plan, flown, assessment, console)
        _print_tracking(flown.tracking, console)
        _print_links(replayed, console)
        _print_observations(plan, seen, console)
    agreed = seen[-1].agrees(plan.knot) if seen else True
    outside = kept is not None and not kept.within and basis is not None and basis.cable
    context.exit(0 if flown.as_planned and agreed and not outside else 1)


def _print_basis(basis: Basis | None, kept: Adherence | None, console: Console) -> None:
    if basis is None:
        words = "This record does not say what was certified, nor whether cable was carried."
        console.print(words, style="dim", highlight=False, soft_wrap=True)
        return
    if kept is not None:
        print_adherence(kept, console)
    console.print(f"Flown {basis.words}.", highlight=False, soft_wrap=True)


def _links_object(replayed: Replayed) -> dict[str, Any]:
    return {
        "systems": list(replayed.systems),
        "commands": [
            {
                "name": one.name,
                "sent": one.sent,
                "answered": one.answered,
                "repeated": one.repeated,
                "latency": {"median": one.median, "max": one.largest} if one.answered else None,
            }
            for one in replayed.commands
        ],
        "links": {
            str(system): {
                "received": replayed.received[system],
                "lost": replayed.lost[system],
            }
            for system in replayed.systems
        },
        "damaged": replayed.damaged,
        "log_notes": list(replayed.notes),
    }


def _print_tracking(errors: Sequence[TrackingStatistics], console: Console) -> None:
    """Print the tracking error of all in every phase, and of everybody in the fold."""
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
    console.print(table)


def _print_links(replayed: Replayed, console: Console) -> None:
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("command")
    for heading in ("sent", "answered", "repeated", "median", "largest"):
        table.add_column(heading, justify="right")
    for one in replayed.commands:
        known = one.answered > 0
        table.add_row(
            one.name,
            str(one.sent),
            str(one.answered),
            str(one.repeated),
            f"{1000 * one.median:.0f} ms" if known else "–",
            f"{1000 * one.largest:.0f} ms" if known else "–",
        )
    console.print(table)
    received, lost = sum(replayed.received.values()), sum(replayed.lost.values())
    share = lost / max(received + lost, 1)
    worst = max(replayed.lost, key=lambda system: replayed.lost[system], default=None)
    line = f"{received} packets received, {lost} lost ({share:.2%})"
    if worst is not None and replayed.lost[worst]:
        line += f", most from system {worst}: {replayed.lost[worst]}"
    console.print(line, style="dim", highlight=False, soft_wrap=True)
    for note in replayed.notes:
        console.print(f"[yellow]note[/] {note}", highlight=False, soft_wrap=True)


def _print_observations(plan: Plan, seen: list[Observation], console: Console) -> None:
    if not seen and len(plan.layout.lengths):
        words = 'Nobody has entered what was seen: --observed "3_1 right by camera"'
        console.print(words, style="dim", highlight=False, soft_wrap=True)
    for one in seen:
        style = "green" if one.agrees(plan.knot) else "bold red"
        hand = f" {one.chirality}-handed" if one.chirality else ""
        console.print(
            f"Observed: [{style}]{one.knot}{hand}[/] by {one.observer} ({one.time})",
            highlight=False,
            soft_wrap=True,
        )
