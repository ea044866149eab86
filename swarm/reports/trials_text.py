"""The summary of many trials on the terminal."""

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table

from swarm.reports.findings_text import print_verdict
from swarm.reports.verdicts import trials_verdict
from swarm.reports.wording import TRIAL_DISTANCES


def print_trials(summary: Mapping[str, Any], console: Console) -> None:
    """Print the verdict, completion, distances with intervals, contacts, causes, the worst trials.

    ``summary`` is the JSON object of :func:`swarm.simulation.monte_carlo.summary`.
    """
    sound, failing = summary["without_failure"], summary["with_failure"]
    name = "the paper's trajectory" if summary["method"] == "paper" else "this plan"
    print_verdict(trials_verdict(summary), console)
    lines = [
        f"\n[bold]{summary['trials']} trials of {name}[/], seed {summary['seed']}",
        f"completed, no vehicle failing: {_share(sound['completed'], sound['trials'])}",
    ]
    if failing["trials"]:
        share = _share(failing["completed"], failing["trials"])
        lines.append(f"completed, one vehicle failing: {share}")
    _print(lines, console)
    console.print(_distances(sound["clearance"]))
    _print([*_details(summary), *_worst(summary)], console)


def _print(lines: list[str], console: Console) -> None:
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True)


def _distances(clearance: Mapping[str, Any]) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("smallest distance")
    for heading in ("required", "worst trial", "5 % below", "half below"):
        table.add_column(heading, justify="right", no_wrap=True)
    for kind, values in clearance.items():
        if values["count"]:
            required = f"{values['required']:.2f} m"
            table.add_row(TRIAL_DISTANCES[kind], required, *_distribution(values))
    return table


def _details(summary: Mapping[str, Any]) -> list[str]:
    sound = summary["without_failure"]
    lines = []
    error = sound["tracking_error"]
    if error["count"]:
        lines.append(
            f"tracking errors: up to {error['quantiles']['0.5']['value']:.2f} m in half of the "
            f"trials, {error['largest']:.2f} m in the worst; {sound['outside_tracking_radius']} of "
            f"{sound['trials']} trials exceeded the certified tracking radius"
        )
    lines.append(
        f"trials with rotor strikes: {summary['trials_with_rotor_strikes']}, with collisions: "
        f"{summary['trials_with_collisions']}; vehicles lost: {summary['vehicles_lost']}"
    )
    lines += [f"not completed: {count} × {cause}" for cause, count in summary["reasons"].items()]
    return lines


def _worst(summary: Mapping[str, Any]) -> list[str]:
    lines = []
    for trial in summary["worst"][:3]:
        # a plan without two strands apart has no distance of its cable
        cable = "" if trial["cable"] is None else f"cable {trial['cable']:.2f} m"
        details = ", ".join(filter(None, (cable, trial["failure"], trial["reason"])))
        words = f" ({details})" if details else ""
        lines.append(f"among the worst: trial {trial['trial']}{words}")
    if summary["method"] != "paper":
        lines.append(
            f"to repeat the worst: swarm dry-run … --seed {summary['seed']} --trial "
            f"{summary['worst'][0]['trial']} --recording trial.rrd"
        )
    return lines


def _share(share: Mapping[str, Any], trials: int) -> str:
    if share["interval"] is None:
        return "no trials"
    low, high = share["interval"]
    return f"{share['count']} of {trials} ({low:.1%} to {high:.1%} at 95 % confidence)"


def _distribution(values: Mapping[str, Any]) -> list[str]:
    cells = [f"{values['smallest']:.2f} m"]
    for share in ("0.05", "0.5"):
        quantile = values["quantiles"][share]
        low, high = quantile["interval"]
        known = low is not None and high is not None
        interval = f" ({low:.2f} to {high:.2f})" if known else ""
        cells.append(f"{quantile['value']:.2f} m{interval}")
    return cells
