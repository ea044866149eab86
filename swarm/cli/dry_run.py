"""``swarm dry-run``: the same conductor and packets against the emulator, in virtual time."""

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from swarm import planner
from swarm.cli.inputs import JSON, MISSION, SET, print_json, progress_bar
from swarm.errors import InputError
from swarm.files import write_text
from swarm.flight.result import FlightResult
from swarm.front.files import load_mission
from swarm.reports.flight_json import outcome_object
from swarm.reports.flight_text import print_outcome
from swarm.reports.plan_summary import plan_summary
from swarm.reports.terminal import FlightScreen
from swarm.simulation.loop import Callbacks, FlightOptions, simulate_flight
from swarm.verification import verify_trace

FILE = click.Path(dir_okay=False, path_type=Path)


@click.command("dry-run")
@MISSION
@SET
@JSON
@click.option("--seed", default=1, show_default=True, help="Seed of everything that is random.")
@click.option("--no-cable", is_flag=True, help="Fly with nothing attached, grips simulated.")
@click.option("--report", type=FILE, help="Write a page (HTML, needs no network) about it.")
@click.option("--plot", type=FILE, help="Draw distances, errors and the clock (PNG).")
@click.option("--recording", type=FILE, help="Keep it for Rerun (.rrd): swarm view FILE.")
@click.option(
    "--trials", type=click.IntRange(1, 100_000), help="Fly so many, each with other conditions."
)
@click.option(
    "--scenario",
    type=FILE,
    help="With --trials or --trial: what is drawn and which faults happen (YAML).",
)
@click.option("--trial", type=click.IntRange(0), help="Fly this one of the trials again, alone.")
@click.option(
    "--failures", is_flag=True, help="Let everything go wrong that can, and judge what follows."
)
@click.option(
    "--times", type=click.IntRange(1, 1000), help="With --failures: random times of each [2]."
)
@click.option(
    "--team",
    multiple=True,
    type=click.Choice(["px4", "ardupilot", "mixed"]),
    help="With --failures: only this kind of team; may be given many times.",
)
@click.option("--row", multiple=True, help="With --failures: only what has this in its name.")
@click.option("--jobs", type=click.IntRange(1, 1024), help="Trials at a time; all cores if absent.")
@click.option("--scheduler", metavar="tcp://HOST:PORT", help="Fly trials on this Dask cluster.")
@click.option(
    "--results",
    type=FILE,
    help="With --trials: one row per trial (Parquet). With --failures: a line for each that is "
    "flown, at once (JSON); what it holds already is not flown again.",
)
@click.option(
    "--compare", is_flag=True, help="With --trials or --rope: the paper's trajectory beside it."
)
@click.option(
    "--rope", is_flag=True, help="Move a rope of hundreds of links with contact instead (MuJoCo)."
)
@click.option("--links", type=click.IntRange(20, 5000), help="With --rope: how many links.")
@click.option(
    "--no-contact", is_flag=True, help="With --rope: let strands pass through; shows nothing."
)
@click.option(
    "--flown",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="RECORD",
    help="With --rope: move it as this flight's record says, not as planned.",
)
@click.pass_context
def dry_run(
    context: click.Context,
    /,
    mission: str,
    overrides: tuple[str, ...],
    as_json: bool,
    seed: int,
    **options: Any,
) -> None:
    """Fly MISSION (a file or a knot's name) against the emulator in virtual time, and report.

    The same seed gives the same flight. With --trials many are flown, each with its own wind,
    delays, losses, tracking, grip and length errors, and now and then a failing vehicle. With
    --failures everything that can go wrong does, one at a time, with all kinds of vehicles. With
    --rope the planned motion moves a rope with self-contact, whose knot is then identified.

    Exit code 0 when it went as planned and implies the knot, 1 when the plan is refused, another
    knot came out or a trial fell short, 3 when a vehicle failed.
    """
    _refuse_strays(options)
    loaded = load_mission(mission, overrides)
    console = Console(quiet=as_json)
    with progress_bar(Console(stderr=True)) as progress, _workers(options):
        planned = planner.plan(loaded, progress)
    if options["rope"]:
        from swarm.cli.rope import run_rope  # noqa: PLC0415 - needs an optional extra

        chosen = _chosen(options, "links", "no_contact", "flown", "plot", "report", "compare")
        run_rope(context, loaded, planned, as_json=as_json, **chosen)
        return
    plan_summary(planned.plan, planned.assessment, console)
    if options["failures"]:
        from swarm.cli.failures import run_failures  # noqa: PLC0415 - slow to import

        chosen = _chosen(options, "times", "team", "row", "jobs", "report", "results")
        run_failures(context, planned, seed=seed, as_json=as_json, **chosen)
        return
    if options["trials"] is not None:
        from swarm.cli.trials import run_trials  # noqa: PLC0415 - slow to import

        chosen = _chosen(
            options,
            "trials", "scenario", "jobs", "scheduler", "results", "plot", "report", "compare",
        )  # fmt: skip
        run_trials(context, loaded, planned, seed=seed, as_json=as_json, **chosen)
        return
    with FlightScreen(planned.plan, console) as screen:
        result = _fly(planned, screen, seed, options)
    flown = verify_trace(planned.plan, result.trace)
    outcome = outcome_object(result, flown, planned.assessment)
    if options["plot"]:
        from swarm.reports.plots import plot_flight  # noqa: PLC0415 - slow to import

        plot_flight(planned.plan, result.trace, options["plot"])
    if options["recording"]:
        from swarm.view.replay import write_flight  # noqa: PLC0415 - slow to import

        write_flight(planned.plan, result.trace, result.events, options["recording"])
    if options["report"]:
        from swarm.reports.flight_report import flight_report  # noqa: PLC0415 - slow to import

        page = flight_report(planned.plan, planned.assessment, outcome, result.trace, result.events)
        write_text(options["report"], page)
    if as_json:
        print_json(outcome)
    else:
        print_outcome(planned.plan, result, flown, planned.assessment, console)
    error = result.error()
    if error is not None:
        raise error
    context.exit(0 if flown.as_planned else 1)


def _workers(options: dict[str, Any]) -> AbstractContextManager[None]:
    """While a plan is made that many trials will fly, have the processes start that fly them."""
    if options["trials"] is None or options["scheduler"] is not None:
        return nullcontext()
    from swarm.simulation.monte_carlo import workers_starting  # noqa: PLC0415 - slow to import

    return workers_starting(options["jobs"])


def _chosen(options: dict[str, Any], *names: str) -> dict[str, Any]:
    return {name: options[name] for name in names}


def _fly(
    planned: planner.PlanningResult, screen: FlightScreen, seed: int, options: dict[str, Any]
) -> FlightResult:
    """One flight: as the plan expects the world, or under the conditions of one trial."""
    flight_plan = planned.certified()
    callbacks = Callbacks(on_snapshot=screen.show, on_event=screen.event)
    if options["trial"] is None:
        return simulate_flight(
            flight_plan,
            seed=seed,
            options=FlightOptions(no_cable=options["no_cable"]),
            callbacks=callbacks,
        )
    from swarm.cli.trials import load_scenario  # noqa: PLC0415 - slow to import
    from swarm.simulation.monte_carlo import fly_trial  # noqa: PLC0415 - slow to import

    spread, faults = load_scenario(options["scenario"])
    return fly_trial(
        flight_plan,
        spread,
        seed,
        options["trial"],
        faults=faults,
        callbacks=callbacks,
    )[1]


_NEEDS = {
    "scenario": ("trials", "trial"),
    "jobs": ("trials", "failures"),
    "times": ("failures",),
    "row": ("failures",),
    "team": ("failures",),
    "scheduler": ("trials",),
    "results": ("trials", "failures"),
    "compare": ("trials", "rope"),
    "links": ("rope",),
    "no_contact": ("rope",),
    "flown": ("rope",),
}
_APART = (
    ("trials", "trial"), ("trials", "rope"), ("trial", "rope"), ("jobs", "scheduler"),
    ("no_cable", "trials"), ("no_cable", "trial"), ("no_cable", "rope"),
    ("failures", "trials"), ("failures", "trial"), ("failures", "rope"), ("failures", "plot"),
    ("failures", "no_cable"), ("recording", "failures"),
    ("recording", "trials"), ("recording", "rope"), ("compare", "flown"),
)  # fmt: skip


def _refuse_strays(options: dict[str, Any]) -> None:
    """Refuse options that would do nothing, or that contradict each other."""
    given = {name for name, value in options.items() if value not in (None, False, ())}
    stray = [
        f"{_option(name)} needs {' or '.join(map(_option, needed))}"
        for name, needed in _NEEDS.items()
        if name in given and not given & set(needed)
    ]
    stray += [
        f"{_option(one)} and {_option(other)} do not go together"
        for one, other in _APART
        if {one, other} <= given
    ]
    if stray:
        raise InputError("\n".join(stray))


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")
