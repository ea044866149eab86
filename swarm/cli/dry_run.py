"""``swarm dry-run``: one simulated flight of a mission, in virtual time."""

from typing import Any

import click
from rich.console import Console

from swarm import planner
from swarm.cli.inputs import (
    FILE,
    JSON,
    MISSION,
    OUTPUT,
    REPLAN,
    SET,
    VERBOSE,
    print_json,
    refuse_option_conflicts,
)
from swarm.cli.planning import load_source, prepare_flight, require_cleared
from swarm.files import write_text
from swarm.flight.result import FlightResult
from swarm.flight.setup import FlightOptions
from swarm.mission.fleet import emulated_fleet
from swarm.reports.flight_json import outcome_object
from swarm.reports.flight_text import print_outcome
from swarm.reports.terminal import FlightScreen
from swarm.simulation.loop import Callbacks, simulate_flight
from swarm.verification import verify_trace


@click.command("dry-run")
@MISSION
@SET
@REPLAN
@JSON
@VERBOSE
@click.option("--seed", default=1, show_default=True, help="Seed of all random values.")
@click.option(
    "--cable",
    type=click.Choice(["swinging", "static"]),
    help="Emulated cable: a chain of masses, or catenaries without inertia.  [default: swinging]",
)
@click.option("--no-cable", is_flag=True, help="Fly without cable; simulate the grips.")
@click.option("--report", type=OUTPUT, help="Write a report (one HTML file).")
@click.option(
    "--plot", type=OUTPUT, help="Plot distances, tracking errors and mission clock (PNG)."
)
@click.option(
    "--recording", type=OUTPUT, help="Write a Rerun recording (.rrd) for swarm view FILE."
)
@click.option(
    "--trial", type=click.IntRange(0), help="Repeat one trial of swarm trials, by its number."
)
@click.option(
    "--scenario",
    type=FILE,
    help="With --trial: distributions of the conditions, and faults (YAML).",
)
@click.pass_context
def dry_run(
    context: click.Context,
    /,
    mission: str,
    overrides: tuple[str, ...],
    replan: bool,
    as_json: bool,
    verbose: bool,
    **options: Any,
) -> None:
    """Simulate a flight of MISSION (a mission or plan file, or the name of a knot) in virtual time.

    The flight software flies the built-in emulator; the same seed gives the same flight. swarm
    trials flies many, each under other conditions; --trial repeats one of them.

    Exit code 0 if the flight is completed and implies the planned knot; 1 if the plan is refused
    or the knot is another one; 3 if a vehicle failed.

    Example: swarm dry-run missions/overhand.yaml --report flight.html
    """
    refuse_option_conflicts(options, _REQUIRES, _EXCLUDES)
    planned = load_source(mission, overrides, replan=replan, flight=True).planned()
    require_cleared(context, planned, verbose=verbose, as_json=as_json)
    prepare_flight()
    with FlightScreen(planned.plan, Console(quiet=as_json)) as screen:
        result = _fly(planned, screen, options)
    _end(context, planned, result, options, as_json=as_json)


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
            fleet=emulated_fleet(count, seed=seed, cable=options["cable"] or "swinging"),
            seed=seed,
            options=FlightOptions(no_cable=options["no_cable"]),
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
    outcome = outcome_object(plan, result, verification, assessment)
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


_REQUIRES = {"scenario": ("trial",)}
"""Option → options of which it requires one."""
_EXCLUDES = (("cable", "no_cable"), ("cable", "trial"), ("no_cable", "trial"))
"""Pairs of options that exclude each other."""
