"""The outcome of a flight, and the verification of a flight record: JSON, terminal and page.

What is flown is described once, by the JSON object: lengths in metres, times in seconds.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Console

from swarm.certification.assessment import Assessment
from swarm.certification.findings import numbers
from swarm.certification.kinds import FIGURES
from swarm.exports import tightest_object
from swarm.flight.result import FlightResult, adherence_object, skipped_words
from swarm.flight.snapshot import Event
from swarm.flight.swinging import flown_swing, swing_object
from swarm.flight.tlog import Replayed
from swarm.flight.trace import Trace
from swarm.flight.training import training_object
from swarm.ground.record_verification import VerifiedRecord
from swarm.planning import Plan
from swarm.reports import scene
from swarm.reports.formatting import (
    DISTANCES,
    ROUTINE_KINDS,
    came_to,
    capitalized,
    certified,
    clock,
    event_text,
    knot_in_words,
    log_level,
    merge_events,
    metres,
    seconds,
    together,
)
from swarm.reports.result import (
    Cell,
    Level,
    Table,
    Verdict,
    Words,
    compared,
    drawn,
    print_verdict,
    say,
)
from swarm.verification import Verification

Document = Mapping[str, Any]
NONE = Cell("none", "dim")


def outcome_object(
    plan: Plan, result: FlightResult, verification: Verification, assessment: Assessment
) -> dict[str, Any]:
    """Return the outcome of a flight of a plan, with flown beside certified distances."""
    statistics = result.statistics
    lateness, latency = statistics.lateness, statistics.command_latency
    return {
        "outcome": result.outcome.word,
        "explanation": result.outcome.explanation,
        "record": str(result.record) if result.record else None,
        "certificate": {**asdict(result.basis), "description": result.basis.words},
        "adherence": adherence_object(result.adherence),
        **verification_object(verification, assessment),
        "swing": swing_object(flown_swing(plan, result.trace)),
        "duration": statistics.duration,
        "setpoints": statistics.setpoints,
        "setpoint_gap": {"seconds": statistics.gap[0], "at": statistics.gap[1]},
        "setpoint_lateness": {"median": lateness[0], "p99": lateness[1]} if lateness else None,
        "cpu_load": statistics.cpu,
        "command_latency": {"median": latency[0], "max": latency[1]} if latency else None,
        "packets_lost": {str(system): count for system, count in statistics.lost.items()},
        "training": training_object(result.training, result.events),
        "skipped_steps": list(result.skipped),
    }


def verification_object(verification: Verification, assessment: Assessment) -> dict[str, Any]:
    """Return the implied knot, flown beside certified distances, and the tracking errors.

    Clearances of things that the plan does not have, as a fence, are left out, but for FIGURES.
    """
    pairs = {
        figure: (flown, assessment.certified(figure))
        for figure, flown in verification.distances.items()
    }
    clearance = {
        figure: {
            "flown": tightest_object(flown) if flown else None,
            "certified": tightest_object(held),
        }
        for figure, (flown, held) in pairs.items()
        if flown or figure in FIGURES or math.isfinite(held.distance)
    }
    return {
        "knot": {
            "type": verification.knot,
            "chirality": verification.chirality,
            "gauss": verification.gauss,
            "as_planned": verification.as_planned,
        },
        "clearance": clearance,
        "max_chord_ratio": verification.max_chord_ratio,
        "tracking_error": [
            {
                "phase": error.phase,
                "vehicle": error.vehicle,
                "rms": error.rms,
                "p999": error.p999,
                "max": error.largest,
            }
            for error in verification.tracking
        ],
        "notes": list(verification.notes),
    }


def record_object(verified: VerifiedRecord) -> dict[str, Any]:
    """Return the verification of a record, its link statistics and its observations."""
    return {
        "record": str(verified.record),
        "certificate": asdict(verified.basis) if verified.basis else None,
        "adherence": adherence_object(verified.adherence) if verified.adherence else None,
        **verification_object(verified.verification, verified.assessment),
        **_link_statistics(verified.log),
        "observations": [asdict(observation) for observation in verified.observations],
        "training": training_object(verified.training, verified.events),
        "skipped_steps": list(verified.skipped),
    }


def _link_statistics(log: Replayed) -> dict[str, Any]:
    return {
        "systems": list(log.known.systems),
        "commands": [
            {
                "name": command.name,
                "sent": command.sent,
                "acknowledged": command.answered,
                "resent": command.repeated,
                "latency": {"median": command.median, "max": command.largest}
                if command.answered
                else None,
            }
            for command in log.commands
        ],
        "links": {
            str(system): {
                "packets_received": log.received[system],
                "packets_lost": log.lost[system],
            }
            for system in log.known.systems
        },
        "damaged_packets": log.damaged,
        "log_notes": list(log.notes),
    }


def flight_verdict(plan: Plan, outcome: Document) -> Verdict:
    """Return how a flight ended, the implied knot, and every way in which it missed its plan."""
    adherence = outcome["adherence"]
    problems = [
        came_to(kind, flown["distance"], flown["required"])
        for kind, both in outcome["clearance"].items()
        if (flown := both["flown"]) and flown["distance"] < flown["required"]
    ]
    as_planned = outcome["outcome"] == "done" and outcome["knot"]["as_planned"]
    sentences = [f"{outcome['outcome']}: {outcome['explanation']}"]
    sentences += [_implied_in_words(plan, outcome["knot"]), *problems]
    if not adherence["within"]:
        sentences.insert(0, adherence["words"])
    level: Level = "good" if as_planned and adherence["within"] and not problems else "bad"
    tracking = plan.mission.vehicles.tracking
    largest = _largest_fold_error(outcome)
    if adherence["within"] and largest is not None and largest > tracking > 0:
        sentences.append(
            f"the tracking error in the fold reached {largest:.3f} m, more than {tracking:g} m"
        )
        level = "warn" if level == "good" else level
    return Verdict(level, " ".join(f"{capitalized(words)}." for words in sentences if words))


def _implied_in_words(plan: Plan, knot: Document) -> str:
    """Return the knot that the reported positions imply.

    It is "" without a cable, and for a cable without a knot that was to have none.
    """
    if not len(plan.layout.lengths):
        return ""
    if knot["type"] == "unknown":
        return "The knot of the cable is not known"
    untied = knot["type"] == "0_1" and not plan.knot.type
    if untied and knot["as_planned"]:
        return ""
    implied = "no knot" if untied else knot_in_words(knot["type"], knot["chirality"])
    unplanned = "" if knot["as_planned"] else ", not the planned knot"
    return f"In the cable model, the reported positions imply {implied}{unplanned}"


def _largest_fold_error(outcome: Document) -> float | None:
    """Return the largest tracking error in the fold, metres; None where the fold was not flown."""
    errors = [error["max"] for error in outcome["tracking_error"] if error["phase"] == "fold"]
    return max(errors, default=None)


def clearance_table(clearance: Document) -> Table:
    """Return flown beside certified distances; no row where none was flown.

    A clearance of two things that the plan does not have has no row, nor has one that only another
    row's things are certified for: of two segments, those that follow each other.
    """
    measured = [both["certified"] for both in clearance.values() if both["flown"]]
    rows: list[tuple[str | Cell, ...]] = []
    for figure, both in clearance.items():
        flown, held = both["flown"], both["certified"]
        if flown is None and (held["distance"] is None or held in measured):
            continue
        figures = certified(held["distance"]), metres((flown or held)["required"])
        if flown is None:
            rows.append((DISTANCES[figure], "unknown", *figures, "", ""))
            continue
        distance = compared(metres(flown["distance"]), flown["distance"], flown["required"])
        at, between = seconds(flown["time"]), together(flown["between"])
        rows.append((DISTANCES[figure], distance, *figures, at, between))
    if all(both["flown"] is None for both in clearance.values()):
        rows = []
    columns = ("smallest distance", "flown", "certified", "required", "at mission time", "between")
    return Table(columns, rows, numbers=range(1, 6))


def training_words(training: Document | None) -> str:
    """Return that faults were injected, by which scenario; "" where none were."""
    if training is None:
        return ""
    return (
        f"Training with emulated vehicles: {training['scenario']} injected faults "
        f"(SHA-256 {training['digest']})."
    )


def training_table(training: Document) -> Table:
    """Return when each injected fault began and was detected, and the operator's answer to it."""
    rows = [_training_row(fault) for fault in training["faults"]]
    columns = ("fault", "began", "detected", "the team", "the operator")
    return Table(columns, rows, numbers=(1,), whole=(1,))


def _training_row(fault: Document) -> tuple[Words, ...]:
    lasting = f"for {fault['duration']:g} s" if fault["duration"] is not None else ""
    parts = [part for part in (fault["details"], lasting) if part]
    what = f"{fault['kind']} ({', '.join(parts)})" if parts else fault["kind"]
    affected = fault["vehicles"]
    if affected:
        what = f"vehicle{'s' if len(affected) > 1 else ''} {numbers(affected)}: {what}"
    if not fault["began"]:
        return what, "not begun", "", "", ""
    seen, asked = fault["detected"], fault["operator"]
    detected = f"after {seen['after']:.1f} s: {seen['message']}" if seen else NONE
    team = tuple(
        f"after {event['after']:.1f} s: {event['message'].partition(':')[0]}"
        for event in fault["team"]
    )
    answer: Words = NONE
    if asked:
        since = "detection" if asked["since"] == "detection" else "the fault"
        answer = (
            f"{asked['request']}, {asked['reaction_time']:.1f} s after {since}",
            Cell(f"by {asked['author']}", "small"),
        )
    return what, clock(fault["time"]), detected, team or NONE, answer


def tracking_table(document: Document, plan: Plan, vehicle_phase: str = "") -> Table:
    """Return the tracking errors of all vehicles in every phase, and of each one in one phase.

    Beside them stands what is allowed: the certified radius while cable is off the floor, else the
    error at which the clock stands still. Errors above it are marked.
    """
    adherence = document["adherence"]
    beyond: Level = "warn" if adherence is None or adherence["within"] else "bad"
    allowed = {phase.name: scene.allowed_error(plan, phase.start) for phase in plan.phases}
    certified = plan.mission.vehicles.tracking
    rows: list[tuple[str | Cell, ...]] = []
    for error in document["tracking_error"]:
        phase = error["phase"]
        if phase and not error["vehicle"]:
            name = f"{phase}, all"
        elif phase and phase == vehicle_phase:
            name = f"{phase}, vehicle {error['vehicle']}"
        else:
            continue
        rms, most, largest = (f"{error[key]:.3f} m" for key in ("rms", "p999", "max"))
        limit = allowed[phase]
        words = f"{limit:g} m" if limit == certified else f"{limit:g} m, no cable in the air"
        marked = error["max"] > limit > 0
        rows.append((name, rms, most, Cell(largest, beyond) if marked else largest, words))
    return Table(("tracking error", "RMS", "99.9 %", "largest", "allowed"), rows, numbers=(1, 2, 3))


def print_outcome(plan: Plan, result: FlightResult, outcome: Document, console: Console) -> None:
    """Print the verdict, flown beside certified distances, tracking error and timing."""
    if result.stall:
        say(console, f"[bold red]{capitalized(result.stall)}.[/]")
    print_verdict(flight_verdict(plan, outcome), console)
    _print_skipped(outcome["skipped_steps"], console)
    _print_training(outcome["training"], console)
    if not result.basis.cable and len(plan.layout.lengths):
        words = "Flown without cable: the knot above is the one that these positions would tie."
        say(console, words)
    _print_measurements(plan, outcome, console)
    swing = flown_swing(plan, result.trace)
    if swing is not None:
        say(console, f"Swing of the cable: {swing.words}")
    statistics = result.statistics
    line = f"{statistics.duration:.0f} s of flight, {statistics.setpoints} setpoints, "
    line += f"at most {statistics.gap[0]:.2f} s apart"
    if statistics.lateness:
        line += f", late by {statistics.lateness[0] * 1e3:.2f} ms (median), "
        line += f"{statistics.lateness[1] * 1e3:.1f} ms (99 %)"
    if statistics.cpu is not None:
        line += f", {statistics.cpu:.0%} of a core"
    say(console, line, style="dim")


def _print_skipped(steps: Sequence[str], console: Console) -> None:
    if steps:
        say(console, f"[yellow]{capitalized(skipped_words(steps))}.[/]")


def _print_training(training: Document | None, console: Console) -> None:
    if training is not None:
        say(console, training_words(training))
        console.print(drawn(training_table(training)))


def print_verification(
    plan: Plan, document: Document, console: Console, *, positions: str = "reported positions"
) -> None:
    """Print the knot that ``positions`` imply, distances beside certified ones, tracking errors.

    Lines that do not apply, without a cable or before the fold, are left out.
    """
    if len(plan.layout.lengths):
        say(console, _knot_line(plan, document["knot"], positions))
    _print_measurements(plan, document, console)


def _print_measurements(plan: Plan, document: Document, console: Console) -> None:
    table = clearance_table(document["clearance"]).without(4)
    if table.rows:
        console.print(drawn(table))
    say(console, _tracking_line(document["tracking_error"], plan.mission.vehicles.tracking))
    say(console, *(f"[yellow]note[/] {note}" for note in document["notes"]))


def _knot_line(plan: Plan, knot: Document, positions: str) -> str:
    planned = f"{plan.knot.type} {_hand(plan.knot.chirality)}".strip() or "none"
    style = "green" if knot["as_planned"] else "bold red"
    if knot["type"] == "unknown":
        return f"The knot of the cable is [{style}]unknown[/] (planned: {planned})"
    implied = f"{knot['type']} {_hand(knot['chirality'])}".strip()
    if not plan.knot.type and knot["type"] == "0_1":
        implied = "none"
    return f"Knot implied by the {positions}: [{style}]{implied}[/] (planned: {planned})"


def _tracking_line(errors: Sequence[Document], tracking_radius: float) -> str:
    in_fold = {error["vehicle"]: error for error in errors if error["phase"] == "fold"}
    vehicles = [error for vehicle, error in in_fold.items() if vehicle]
    if not vehicles:
        return "The fold was not flown: it has no tracking error"
    worst = max(vehicles, key=lambda error: float(error["max"]))
    style = "green" if worst["max"] <= tracking_radius else "red"
    return (
        f"Tracking error in the fold: {in_fold[0]['rms']:.3f} m RMS, [{style}]{worst['max']:.3f} m "
        f"at most[/] (vehicle {worst['vehicle']}); certified for {tracking_radius:g} m"
    )


def _hand(chirality: str) -> str:
    return "" if chirality == "none" else f"{chirality}-handed"


def print_record(verified: VerifiedRecord, document: Document, console: Console) -> None:
    """Print basis, implied knot, distances, tracking errors, links and observations.

    ``document`` is the JSON object of the record.
    """
    if verified.basis is None:
        words = "The record does not state a certificate, nor whether cable was carried."
        say(console, words, style="dim")
    else:
        if verified.adherence is not None and not verified.adherence.within:
            say(console, f"[bold red]{capitalized(verified.adherence.words)}.[/]")
        say(console, f"Flown {verified.basis.words}.")
    _print_skipped(document["skipped_steps"], console)
    _print_training(document["training"], console)
    positions = "world's positions" if verified.truth else "reported positions"
    print_verification(verified.plan, document, console, positions=positions)
    console.print(drawn(tracking_table(document, verified.plan, "fold")))
    console.print(drawn(_commands_table(document["commands"])))
    _print_links(verified.log, console)
    _print_observations(verified, console)


def _commands_table(commands: Iterable[Document]) -> Table:
    rows = []
    for command in commands:
        latency = command["latency"]
        times = [f"{1000 * latency[key]:.0f} ms" if latency else "–" for key in ("median", "max")]
        counts = [str(command[key]) for key in ("sent", "acknowledged", "resent")]
        rows.append((command["name"], *counts, *times))
    columns = ("command", "sent", "acknowledged", "resent", "median latency", "largest")
    return Table(columns, rows, numbers=range(1, 6))


def _print_links(log: Replayed, console: Console) -> None:
    received, lost = sum(log.received.values()), sum(log.lost.values())
    line = f"{received} packets received, {lost} lost ({lost / max(received + lost, 1):.2%})"
    worst = max(log.lost, key=lambda system: log.lost[system], default=None)
    if worst is not None and log.lost[worst]:
        line += f", most from system {worst}: {log.lost[worst]}"
    say(console, line, style="dim")
    say(console, *(f"[yellow]note[/] {note}" for note in log.notes))


def _print_observations(verified: VerifiedRecord, console: Console) -> None:
    if not verified.observations and len(verified.plan.layout.lengths):
        words = 'No observation yet: add one with --observed "3_1 right by camera"'
        say(console, words, style="dim")
    for observation in verified.observations:
        style = "green" if observation.agrees(verified.plan.knot) else "bold red"
        hand = f" {observation.chirality}-handed" if observation.chirality else ""
        say(
            console,
            f"Observed: [{style}]{observation.knot}{hand}[/] by {observation.observer} "
            f"({observation.time})",
        )


def flight_report(
    plan: Plan,
    assessment: Assessment,
    outcome: Document,
    trace: Trace,
    events: Iterable[Event],
) -> str:
    """Return the page of a flight or of a dry run.

    ``outcome`` is the JSON object that ``swarm fly --json`` prints.
    """
    from swarm.reports import pages  # noqa: PLC0415 - slow to import
    from swarm.reports.motion_view import flown_motion  # noqa: PLC0415
    from swarm.reports.plots import flight_pictures  # noqa: PLC0415

    levels: dict[str, Level] = {"ERROR": "bad", "WARN": "warn", "INFO": ""}
    shown = merge_events(event for event in events if event.kind not in ROUTINE_KINDS)
    happened = [
        (clock(event.time), Cell(event_text(event, others), levels[log_level(event)]))
        for event, others in shown
    ]
    training, skipped = outcome.get("training"), outcome.get("skipped_steps")
    sections = [
        pages.Section("Training", [training_table(training)] if training else []),
        pages.Section("Smallest distances", [clearance_table(outcome["clearance"])]),
        pages.Section("Notes", paragraphs=outcome["notes"]),
        pages.Section("Pictures", pictures=flight_pictures(plan, trace), least="26rem"),
        pages.Section("Tracking error", [tracking_table(outcome, plan)]),
        pages.Section("Events", [Table(("time", "event"), happened, numbers=(0,))]),
        pages.plan_section(plan, assessment),
    ]
    return pages.page(
        "Flight",
        plan.mission.name,
        "flight",
        flight_verdict(plan, outcome),
        sections,
        about=[
            f"Planned knot: {knot_in_words(plan.knot.type, plan.knot.chirality)}",
            f"Flown {outcome['certificate']['description']}.",
            *([training_words(training)] if training else []),
            *([f"{capitalized(skipped_words(skipped))}."] if skipped else []),
        ],
        figures=_figures(plan, outcome),
        motion=flown_motion(plan, outcome, trace),
    )


def _figures(plan: Plan, outcome: Document) -> list[tuple[str, object]]:
    chord, lateness = outcome["max_chord_ratio"], outcome["setpoint_lateness"]
    late = f"{lateness['median'] * 1e3:.1f}, {lateness['p99'] * 1e3:.1f}" if lateness else "–"
    return [
        ("vehicles", plan.vehicles),
        ("duration of the flight", seconds(outcome["duration"])),
        ("largest tracking error in the fold", metres(_largest_fold_error(outcome))),
        ("chord of the tautest segment", "–" if chord is None else f"{chord:.1%}"),
        ("setpoints sent", outcome["setpoints"]),
        ("longest time between setpoints", f"{outcome['setpoint_gap']['seconds']:.2f} s"),
        ("ms late (median, 99 %)", late),
        ("packets lost", sum(outcome["packets_lost"].values())),
    ]
