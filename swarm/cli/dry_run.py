"""``swarm dry-run``: simulated flights of a mission, in virtual time."""

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from swarm import planner
from swarm.cli.inputs import JSON, MISSION, SET, print_json, refuse_option_conflicts
from swarm.cli.planning import plan_mission
from swarm.files import write_text
from swarm.flight.result import FlightResult
from swarm.flight.setup import Options
from swarm.front.files import load_mission
from swarm.mission.fleet import emulated_fleet
from swarm.reports.flight_json import outcome_object
from swarm.reports.flight_text import print_outcome
from swarm.reports.plan_summary import print_plan_summary
from swarm.reports.terminal import FlightScreen
from swarm.simulation.loop import Callbacks, simulate_flight
from swarm.verification import verify_trace

FILE = click.Path(dir_okay=False, path_type=Path)


@click.command("dry-run")
@MISSION
@SET
@JSON
@click.option("--seed", default=1, show_default=True, help="Seed of all random values.")
@click.option(
    "--cable",
    type=click.Choice(["static", "swinging"]),
    help="Emulated cable: catenaries without inertia, or a chain of masses.  [default: static]",
)
@click.option("--no-cable", is_flag=True, help="Fly without cable; simulate the grips.")
@click.option("--report", type=FILE, help="Write a report (one HTML file).")
@click.option("--plot", type=FILE, help="Plot distances, tracking errors and mission clock (PNG).")
@click.option("--recording", type=FILE, help="Write a Rerun recording (.rrd) for swarm view FILE.")
@click.option(
    "--trials",
    type=click.IntRange(1, 100_000),
    help="Fly this many trials, each under other conditions.",
)
@click.option(
    "--scenario",
    type=FILE,
    help="With --trials or --trial: distributions of the conditions, and faults (YAML).",
)
@click.option("--trial", type=click.IntRange(0), help="Repeat one trial, by its number.")
@click.option("--failures", is_flag=True, help="Run failure tests: one injected fault per flight.")
@click.option(
    "--times", type=click.IntRange(1, 1000), help="With --failures: random times per fault [2]."
)
@click.option(
    "--team",
    multiple=True,
    type=click.Choice(["px4", "ardupilot", "mixed"]),
    help="With --failures: autopilots of the team; can be repeated.",
)
@click.option("--row", multiple=True, help="With --failures: only cases whose name contains this.")
@click.option("--jobs", type=click.IntRange(1, 1024), help="Parallel processes [one per core].")
@click.option("--scheduler", metavar="tcp://HOST:PORT", help="Fly trials on this Dask cluster.")
@click.option(
    "--results",
    type=FILE,
    help="With --trials: write one row per trial (Parquet). With --failures: append each result "
    "(JSON lines); results that the file holds are not flown again.",
)
@click.option(
    "--compare", is_flag=True, help="With --trials or --rope: also fly the paper's trajectory."
)
@click.option(
    "--rope", is_flag=True, help="Simulate a rope of hundreds of links with contact (MuJoCo)."
)
@click.option("--links", type=click.IntRange(20, 5000), help="With --rope: number of links.")
@click.option(
    "--no-contact", is_flag=True, help="With --rope: no contact; strands pass through each other."
)
@click.option(
    "--flown",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="RECORD",
    help="With --rope: use the reported motion of this flight record instead of the plan.",
)
@click.pass_context
def dry_run(
    context: click.Context,
    /,
    mission: str,
    overrides: tuple[str, ...],
    as_json: bool,
    **options: Any,
) -> None:
    """Simulate a flight of MISSION (a file or the name of a knot) in virtual time.

    The flight software flies the built-in emulator; the same seed gives the same flight. --trials
    flies many flights, each with its own wind, delays, packet loss, tracking, grip and length
    errors, and sometimes a failing vehicle. --failures injects every known fault, one at a time,
    with PX4, ArduPilot and mixed teams. --rope moves a rope with self-contact along the planned
    motion and identifies its knot.

    Exit code 0 if the flight is completed and implies the planned knot; 1 if the plan is refused,
    the knot is another one or a trial failed; 3 if a vehicle failed.

    Example: swarm dry-run missions/overhand.yaml --trials 100 --report trials.html
    """
    refuse_option_conflicts(options, _REQUIRES, _EXCLUDES)
    loaded = load_mission(mission, overrides)
    with _workers(options):
        planned = plan_mission(loaded)
    if options["rope"]:
        from swarm.cli.rope import RopeOptions, run_rope  # noqa: PLC0415 - needs an optional extra

        run_rope(context, planned, RopeOptions(**_of(RopeOptions, options)), as_json=as_json)
        return
    console = Console(quiet=as_json)
    print_plan_summary(planned.plan, planned.assessment, console)
    if options["failures"]:
        from swarm.cli.failures import FailureOptions, run_failures  # noqa: PLC0415 - slow to import

        failures = FailureOptions(**_of(FailureOptions, options))
        run_failures(context, planned, failures, as_json=as_json)
    elif options["trials"] is not None:
        from swarm.cli.trials import TrialOptions, run_trials  # noqa: PLC0415 - slow to import

        run_trials(context, planned, TrialOptions(**_of(TrialOptions, options)), as_json=as_json)
    else:
        with FlightScreen(planned.plan, console) as screen:
            result = _fly(planned, screen, options)
        _end(context, planned, result, options, as_json=as_json)


def _of(kind: Any, options: dict[str, Any]) -> dict[str, Any]:
    """Return the options that are fields of a dataclass."""
    return {name: options[name] for name in kind.__dataclass_fields__}


def _workers(options: dict[str, Any]) -> AbstractContextManager[None]:
    """Start the processes that fly the trials while the plan is computed."""
    if options["trials"] is None or options["scheduler"] is not None:
        return nullcontext()
    from swarm.simulation.monte_carlo import workers_starting  # noqa: PLC0415 - slow to import

    return workers_starting(options["jobs"])


def _fly(
    planned: planner.PlanningResult, screen: FlightScreen, options: dict[str, Any]
) -> FlightResult:
    """Return one flight, under nominal conditions or under those of one trial."""
    flight_plan = planned.certified()
    callbacks = Callbacks(on_snapshot=screen.show, on_event=screen.event)
    if options["trial"] is None:
        count, seed = flight_plan.plan.vehicles, options["seed"]
        return simulate_flight(
            flight_plan,
            fleet=emulated_fleet(count, seed=seed, cable=options["cable"] or "static"),
            seed=seed,
            options=Options(no_cable=options["no_cable"]),
            callbacks=callbacks,
        )
    from swarm.front.trials import load_scenario  # noqa: PLC0415 - slow to import
    from swarm.simulation.monte_carlo import fly_trial  # noqa: PLC0415 - slow to import

    spread, faults = load_scenario(options["scenario"])
    return fly_trial(
        flight_plan,
        spread,
        options["seed"],
        options["trial"],
        faults=faults,
        callbacks=callbacks,
    )[1]


def _end(
    context: click.Context,
    planned: planner.PlanningResult,
    result: FlightResult,
    options: dict[str, Any],
    *,
    as_json: bool,
) -> None:
    """Write the files of a flight, print its outcome, and exit with its code."""
    plan, assessment = planned.plan, planned.assessment
    verification = verify_trace(plan, result.trace)
    outcome = outcome_object(result, verification, assessment)
    if options["plot"]:
        from swarm.reports.plots import plot_flight  # noqa: PLC0415 - slow to import

        plot_flight(plan, result.trace, options["plot"])
    if options["recording"]:
        from swarm.view.replay import write_flight  # noqa: PLC0415 - slow to import

        write_flight(plan, result.trace, result.events, options["recording"])
    if options["report"]:
        from swarm.reports.flight_report import flight_report  # noqa: PLC0415 - slow to import

        page = flight_report(plan, assessment, outcome, result.trace, result.events)
        write_text(options["report"], page)
    if as_json:
        print_json(outcome)
    else:
        print_outcome(plan, result, verification, assessment, Console())
    error = result.error()
    if error is not None:
        raise error
    context.exit(0 if verification.as_planned else 1)


_REQUIRES = {
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
"""Option → options of which it requires one."""
_EXCLUDES = (
    ("trials", "trial"), ("trials", "rope"), ("trial", "rope"), ("jobs", "scheduler"),
    ("no_cable", "trials"), ("no_cable", "trial"), ("no_cable", "rope"),
    ("failures", "trials"), ("failures", "trial"), ("failures", "rope"), ("failures", "plot"),
    ("failures", "no_cable"), ("recording", "failures"),
    ("recording", "trials"), ("recording", "rope"), ("compare", "flown"),
    ("cable", "no_cable"), ("cable", "trials"), ("cable", "trial"), ("cable", "failures"),
    ("cable", "rope"),
)  # fmt: skip
"""Pairs of options that exclude each other."""
