"""``swarm dry-run``: one simulated flight of a mission, in virtual time."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import click
from rich.console import Console

from swarm.cli.inputs import (
    FILE,
    OUTPUT,
    REPORT,
    SEED,
    print_json,
    refuse_option_conflicts,
)
from swarm.cli.planning import Given, load_training, prepare_flight, with_mission
from swarm.files import write_text
from swarm.flight.setup import FlightOptions
from swarm.mission.fleet import emulated_fleet
from swarm.reports.flight import flight_report, outcome_object, print_outcome
from swarm.reports.terminal import FlightScreen
from swarm.simulation.loop import Callbacks, simulate_flight
from swarm.verification import verify_trace


@click.command("dry-run")
@with_mission()
@SEED
@click.option(
    "--cable",
    type=click.Choice(["swinging", "static"]),
    help="Emulated cable: a chain of masses, or catenaries without inertia.  [default: swinging]",
)
@click.option("--no-cable", is_flag=True, help="Fly without cable; simulate the grips.")
@REPORT
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
    help="Faults to inject (YAML); with --trial, distributions of the conditions too.",
)
@click.pass_context
def dry_run(
    context: click.Context,
    given: Given,
    /,
    seed: int,
    cable: Literal["swinging", "static"] | None,
    no_cable: bool,
    report: Path | None,
    plot: Path | None,
    recording: Path | None,
    trial: int | None,
    scenario: Path | None,
) -> None:
    """Simulate a flight of MISSION (a mission or plan file, or the name of a knot) in virtual time.

    The flight software flies the built-in emulator; the same seed gives the same flight. swarm
    trials flies many, each under other conditions; --trial repeats one of them. With --scenario
    the team meets its faults without an operator, as a rehearsal of `swarm fly --scenario`.

    Exit code 0 if the flight is completed and implies the planned knot; 1 if the plan is refused
    or the knot is another one; 3 if a vehicle failed.

    Example: swarm dry-run missions/overhand.yaml --report flight.html
    """
    refuse_option_conflicts(
        {"cable": cable, "no_cable": no_cable, "trial": trial},
        {},
        [("cable", "no_cable"), ("cable", "trial"), ("no_cable", "trial")],
    )
    rehearsed = None
    if scenario is not None and trial is None:
        rehearsed = load_training(scenario, Console(quiet=given.as_json))
    planned = given.source(flight=True).planned()
    given.require_cleared(context, planned)
    prepare_flight()
    plan, assessment, flight_plan = planned.plan, planned.assessment, planned.certified()
    with FlightScreen(plan, Console(quiet=given.as_json)) as screen:
        callbacks = Callbacks(on_snapshot=screen.show, on_event=screen.event)
        if trial is None:
            fleet = emulated_fleet(plan.vehicles, seed=seed, cable=cable or "swinging")
            training = rehearsed.training(fleet.systems) if rehearsed is not None else None
            result = simulate_flight(
                flight_plan,
                fleet=fleet,
                seed=seed,
                faults=rehearsed.faults if rehearsed is not None else (),
                options=FlightOptions(no_cable=no_cable),
                callbacks=callbacks,
            )
            result = replace(result, training=training)
        else:
            from swarm.front.trials import load_scenario  # noqa: PLC0415 - slow to import
            from swarm.simulation.trials import fly_trial  # noqa: PLC0415

            spread, faults = load_scenario(scenario)
            _, result = fly_trial(
                flight_plan, spread, seed, trial, faults=faults, callbacks=callbacks
            )
    verification = verify_trace(plan, result.trace)
    outcome = outcome_object(plan, result, verification, assessment)
    if plot:
        from swarm.reports.plots import flight_figure, save  # noqa: PLC0415 - slow to import

        save(flight_figure(plan, result.trace), plot)
    if recording:
        from swarm.view.replay import write_flight  # noqa: PLC0415 - slow to import

        write_flight(plan, result.trace, result.events, recording)
    if report:
        write_text(report, flight_report(plan, assessment, outcome, result.trace, result.events))
    if given.as_json:
        print_json(outcome)
    else:
        print_outcome(plan, result, outcome, Console())
    error = result.error()
    if error is not None:
        raise error
    context.exit(0 if verification.as_planned else 1)
