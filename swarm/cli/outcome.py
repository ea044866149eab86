"""What a flight or a dry run comes to, for people and for scripts."""

from collections.abc import Iterable
from dataclasses import asdict
from math import isfinite
from typing import Any

from rich.console import Console
from rich.table import Table

from swarm.certification.assessment import Assessment, Tightest
from swarm.exports import tightest_object
from swarm.flight.adherence import Adherence, adherence_object
from swarm.flight.result import FlightResult
from swarm.planning import Plan
from swarm.verification import TrackingStatistics, Verification


def outcome_object(
    result: FlightResult, flown: Verification, assessment: Assessment
) -> dict[str, Any]:
    """Return a flight's outcome as one JSON-ready object, flown beside certified."""
    statistics = result.statistics
    return {
        "outcome": result.outcome.word,
        "explanation": result.outcome.explanation,
        "record": str(result.record) if result.record else None,
        "certificate": {**asdict(result.basis), "words": result.basis.words},
        "adherence": adherence_object(result.adherence),
        **flown_object(flown, assessment),
        "duration": statistics.duration,
        "setpoints": statistics.setpoints,
        "lateness": statistics.lateness,
        "cpu": statistics.cpu,
        "command_latency": statistics.command_latency,
        "lost": {str(sysid): count for sysid, count in statistics.lost.items()},
    }


def flown_object(flown: Verification, assessment: Assessment) -> dict[str, Any]:
    """Return what was flown, beside what was certified, as one JSON-ready object."""
    return {
        "knot": {
            "type": flown.knot,
            "chirality": flown.chirality,
            "gauss": flown.gauss,
            "as_planned": flown.as_planned,
        },
        "clearance": {
            name: {
                "flown": tightest_object(was) if was else None,
                "certified": tightest_object(certified),
            }
            for name, was, certified in _clearances(flown, assessment)
        },
        "largest_chord": flown.max_chord_ratio,
        "tracking": [
            {
                "phase": error.phase,
                "vehicle": error.vehicle,
                "rms": error.rms,
                "p999": error.p999,
                "max": error.largest,
            }
            for error in flown.tracking
        ],
        "notes": list(flown.notes),
    }


def print_outcome(
    plan: Plan, result: FlightResult, flown: Verification, assessment: Assessment, console: Console
) -> None:
    """Print what was flown: knot, clearances beside what was certified, tracking, timing.

    A flight outside its certificate is said first.
    """
    print_adherence(result.adherence, console)
    if not result.basis.cable and len(plan.layout.lengths):
        words = "Flown without cable: the knot below is what the positions would have tied."
        console.print(words, highlight=False, soft_wrap=True)
    print_flown(plan, flown, assessment, console)
    statistics = result.statistics
    line = f"{statistics.duration:.0f} s of flight, {statistics.setpoints} setpoints"
    if statistics.lateness:
        line += f", late by {statistics.lateness[0] * 1e3:.2f} ms (median), "
        line += f"{statistics.lateness[1] * 1e3:.1f} ms (99 %)"
    if statistics.cpu is not None:
        line += f", {statistics.cpu:.0%} of a core"
    console.print(line, style="dim", highlight=False, soft_wrap=True)


def print_flown(plan: Plan, flown: Verification, assessment: Assessment, console: Console) -> None:
    """Print the knot implied, the clearances beside what was certified, and the tracking.

    Without a cable, or before the fold, there is less to say: what there is not is left out.
    """
    if len(plan.layout.lengths):
        console.print(_knot_line(plan, flown), highlight=False, soft_wrap=True)
    table = _clearance_table(flown, assessment)
    if table.row_count:
        console.print(table)
    line = _tracking_line(flown.tracking, plan.mission.vehicles.tracking)
    console.print(line, highlight=False, soft_wrap=True)
    for note in flown.notes:
        console.print(f"[yellow]note[/] {note}", highlight=False, soft_wrap=True)


def print_adherence(kept: Adherence, console: Console) -> None:
    """Print one line where a flight was outside its certificate; nothing otherwise."""
    if not kept.within:
        line = f"[bold red]{kept.words[0].upper()}{kept.words[1:]}.[/]"
        console.print(line, highlight=False, soft_wrap=True)


def _knot_line(plan: Plan, flown: Verification) -> str:
    asked = f"{plan.knot.type} {_hand(plan.knot.chirality)}".strip() or "none"
    style = "green" if flown.as_planned else "bold red"
    if flown.knot == "unknown":
        return f"Which knot the cable has is [{style}]not known[/] (asked for: {asked})"
    implied = f"{flown.knot} {_hand(flown.chirality)}".strip()
    if not plan.knot.type and flown.knot == "0_1":
        implied = "none"
    return f"Knot implied by the reported positions: [{style}]{implied}[/] (asked for: {asked})"


def _clearances(
    flown: Verification, assessment: Assessment
) -> Iterable[tuple[str, Tightest | None, Tightest]]:
    yield "cable", flown.cable, assessment.cable
    yield "vehicle", flown.vehicle, assessment.vehicle
    yield "vehicle_cable", flown.vehicle_cable, assessment.vehicle_cable


def _clearance_table(flown: Verification, assessment: Assessment) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for heading in ("smallest distance", "flown", "certified", "required", "between"):
        table.add_column(heading, justify="left" if heading in {"smallest distance"} else "right")
    names = {"cable": "cable to cable", "vehicle": "vehicle to vehicle"}
    for name, was, certified in _clearances(flown, assessment):
        if was is None:
            continue  # nothing of this kind was seen, or there are no two things of it
        enough = was.distance >= certified.required
        table.add_row(
            names.get(name, "vehicle to cable"),
            f"[{'green' if enough else 'red'}]{was.distance:.2f} m[/]",
            f"{certified.distance:.2f} m" if isfinite(certified.distance) else "–",
            f"{certified.required:.2f} m",
            " and ".join(was.between),
        )
    return table


def _tracking_line(errors: tuple[TrackingStatistics, ...], ball: float) -> str:
    fold = [error for error in errors if error.phase == "fold" and error.vehicle]
    if not fold:
        return "The fold was not flown: no tracking error in it"
    worst = max(fold, key=lambda error: error.largest)
    together = [error for error in errors if error.phase == "fold" and error.vehicle == 0]
    rms = together[0].rms if together else max(error.rms for error in fold)
    style = "green" if worst.largest <= ball else "red"
    return (
        f"Tracking error in the fold: {rms:.3f} m RMS, [{style}]{worst.largest:.3f} m at most[/] "
        f"(vehicle {worst.vehicle}); certified for {ball:g} m"
    )


def _hand(chirality: str) -> str:
    return "" if chirality == "none" else f"{chirality}-handed"
