"""Many simulated flights of a plan: the verdict, distances with intervals; terminal and page.

``summary`` is everywhere the JSON object that ``swarm trials --json`` prints
(:func:`swarm.simulation.summaries.summary`).
"""

import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Console

from swarm.certification.assessment import Assessment
from swarm.planning import Plan
from swarm.reports.formatting import DISTANCES, came_to, capitalized, counted, metres
from swarm.reports.result import Cell, Table, Verdict, compared, drawn, picture, print_verdict, say

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Document = Mapping[str, Any]


def trials_verdict(summary: Document) -> Verdict:
    """Return how many trials were completed and kept the certificate, and the worst of the rest."""
    intact, certificate = summary["without_failure"], summary["certificate"]
    count, trials = intact["completed"]["count"], intact["trials"]
    below = len(certificate["below"])
    words = (
        f"{count} of {trials} trials without a failure were completed as planned; {below} "
        f"of {certificate['compared']} came closer than certified for their tracking error."
    )
    struck, collided = summary["trials_with_rotor_strikes"], summary["trials_with_collisions"]
    losses = [
        f"{counted(struck, 'trial')} with rotor strikes" if struck else "",
        f"{counted(collided, 'trial')} with collisions" if collided else "",
        f"{counted(summary['vehicles_lost'], 'vehicle')} lost" if summary["vehicles_lost"] else "",
    ]
    close = [
        came_to(kind, values["smallest"], values["required"])
        for kind, values in intact["clearance"].items()
        if values["count"] and values["smallest"] < values["required"]
    ]
    worst = [*close, *filter(None, losses)]
    if worst:
        words += f" Worst: {'; '.join(worst)}."
    if count < trials or below:
        return Verdict("bad", words)
    return Verdict("warn" if worst else "good", words)


def distances_table(summary: Document) -> Table:
    """Return the distributions of the smallest distances in the trials without a failure."""
    rows: list[tuple[str | Cell, ...]] = []
    for kind, values in summary["without_failure"]["clearance"].items():
        if not values["count"]:
            continue
        smallest = compared(metres(values["smallest"]), values["smallest"], values["required"])
        cells = [_quantile(values["quantiles"][share]) for share in ("0.05", "0.5")]
        rows.append((DISTANCES[kind], metres(values["required"]), smallest, *cells))
    columns = ("smallest distance", "required", "worst trial", "5 % below", "half below")
    return Table(columns, rows, numbers=(1, 2, 3, 4), whole=(1, 2, 3, 4))


def _quantile(quantile: Document) -> str:
    """Return a quantile with its interval, where that is known."""
    low, high = quantile["interval"]
    known = low is not None and high is not None
    return metres(quantile["value"]) + (f" ({low:.2f} to {high:.2f})" if known else "")


def _trajectory(summary: Document) -> str:
    return "the paper's trajectory" if summary["method"] == "paper" else "this plan"


def print_trials(summary: Document, console: Console, given: Sequence[str]) -> None:
    """Print verdict, completion, distances with intervals, contacts, causes, the worst trials.

    ``given`` are the arguments of the command that determine the trials: mission and scenario.
    """
    sound, failing = summary["without_failure"], summary["with_failure"]
    print_verdict(trials_verdict(summary), console)
    say(
        console,
        f"\n[bold]{summary['trials']} trials of {_trajectory(summary)}[/], seed {summary['seed']}",
        f"completed, no vehicle failing: {_share(sound['completed'], sound['trials'])}",
    )
    if failing["trials"]:
        share = _share(failing["completed"], failing["trials"])
        say(console, f"completed, one vehicle failing: {share}")
    console.print(drawn(distances_table(summary)))
    error = sound["tracking_error"]
    if error["count"]:
        say(
            console,
            f"tracking errors: up to {error['quantiles']['0.5']['value']:.2f} m in half of the "
            f"trials, {error['largest']:.2f} m in the worst; {sound['outside_tracking_radius']} of "
            f"{sound['trials']} trials exceeded the certified tracking radius",
        )
    say(
        console,
        f"trials with rotor strikes: {summary['trials_with_rotor_strikes']}, with collisions: "
        f"{summary['trials_with_collisions']}; vehicles lost: {summary['vehicles_lost']}",
        *(f"not completed: {count} × {cause}" for cause, count in summary["reasons"].items()),
    )
    for trial in summary["worst"][:3]:
        # a plan without two strands apart has no distance of its cable
        cable = "" if trial["cable"] is None else f"cable {trial['cable']:.2f} m"
        details = ", ".join(filter(None, (cable, trial["failure"], trial["reason"])))
        words = f" ({details})" if details else ""
        say(console, f"among the worst: trial {trial['trial']}{words}")
    if summary["method"] != "paper":
        line = f"to repeat the worst: {_repetition(summary, given)}"
        console.print(line, soft_wrap=True, highlight=False, markup=False)


def _repetition(summary: Document, given: Sequence[str]) -> str:
    """Return the command that repeats the worst trial, for a shell."""
    worst = summary["worst"][0]["trial"]
    options = ("--seed", str(summary["seed"]), "--trial", str(worst), "--recording", "trial.rrd")
    return shlex.join(["swarm", "dry-run", *given, *options])


def _share(share: Document, trials: int) -> str:
    if share["interval"] is None:
        return "no trials"
    low, high = share["interval"]
    return f"{share['count']} of {trials} ({low:.1%} to {high:.1%} at 95 % confidence)"


def trials_report(
    plan: Plan,
    assessment: Assessment,
    summaries: Sequence[Document],
    figures: Sequence["Figure"],
    given: Sequence[str],
) -> str:
    """Return the page of many trials: distributions, pictures, worst trials, and the plan.

    The first of the ``summaries`` is that of this plan; ``figures`` are drawn from them. ``given``
    are arguments as for :func:`print_trials`.
    """
    from swarm.reports import pages  # noqa: PLC0415 - slow to import
    from swarm.simulation.spread import unit  # noqa: PLC0415

    summary = summaries[0]
    pictures = [picture(figure, "Smallest distances of all trials") for figure in figures]
    worst = [
        (
            str(trial["trial"]),
            metres(trial["cable"]),
            trial["outcome"],
            trial["failure"] or "–",
            trial["reason"] or "–",
        )
        for trial in summary["worst"]
    ]
    worst_columns = ("trial", "cable to cable", "outcome", "injected failure", "reason")
    spread = [
        (name, ", ".join(value) if isinstance(value, list) else f"{value:g} {unit(name)}".strip())
        for name, value in summary["spread"].items()
    ]
    low, high = summary["without_failure"]["completed"]["interval"] or (0.0, 1.0)
    sections = [
        pages.Section("Pictures", pictures=pictures),
        *(
            pages.Section(
                capitalized(_trajectory(each)),
                [distances_table(each), _reasons_table(each)],
            )
            for each in summaries
        ),
        pages.Section(
            "Worst trials",
            [Table(worst_columns, worst, numbers=(0, 1))],
            f"To repeat the worst: {_repetition(summary, given)}",
        ),
        pages.Section("Distributions", [Table(("key of the scenario's spread", "value"), spread)]),
        pages.plan_section(plan, assessment),
    ]
    return pages.page(
        "Trials",
        plan.mission.name,
        f"{summary['trials']} simulated flights",
        trials_verdict(summary),
        sections,
        about=[f"Seed {summary['seed']}; virtual time, emulated vehicles and cable"],
        figures=[
            ("trials", summary["trials"]),
            ("of them with a failure", summary["with_failure"]["trials"]),
            (f"completed, {summary['confidence']:.0%} interval", f"{low:.1%} to {high:.1%}"),
            ("with rotor strikes", summary["trials_with_rotor_strikes"]),
            ("with collisions of vehicles", summary["trials_with_collisions"]),
            ("vehicles lost", summary["vehicles_lost"]),
        ],
    )


def _reasons_table(summary: Document) -> Table:
    rows = [(reason, str(count)) for reason, count in summary["reasons"].items()]
    return Table(("reason of incomplete trials", "trials"), rows, numbers=(1,))
