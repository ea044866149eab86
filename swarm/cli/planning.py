"""Planning with a progress line, shared by the commands that need a plan."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console

from swarm import planner, precompile
from swarm.certification.certificate import CertifiedPlan
from swarm.cli.inputs import JSON, MISSION, REPLAN, SET, VERBOSE, progress_bar
from swarm.errors import InputError, Problem, Refused
from swarm.flight.state import Found
from swarm.front import plan_cache
from swarm.front.files import is_plan_file, load_mission
from swarm.front.plan_files import load_certified
from swarm.mission import Mission
from swarm.mission.fleet import Fleet, mission_for
from swarm.planning import Plan
from swarm.reports.plan import plan_verdict, print_plan_summary
from swarm.reports.result import print_verdict

if TYPE_CHECKING:
    from swarm.simulation.training import Scenario


@dataclass(frozen=True)
class Source:
    """What a command was given: a mission to plan, or the name of a plan file.

    For a ``flight``, what it calls is compiled while the mission is planned.
    """

    given: Mission | str
    replan: bool
    flight: bool

    def planned(self) -> planner.PlanningResult:
        """Return the plan and its certificate, with a progress line."""
        if isinstance(self.given, Mission):
            return plan_mission(self.given, replan=self.replan, flight=self.flight)
        console = Console(stderr=True)
        with progress_bar(console, "certificate") as progress:
            planned, notice = load_certified(self.given, progress)
        if notice:
            console.print(notice, highlight=False, markup=False, soft_wrap=True)
        return planned


def load_source(
    name: str,
    overrides: tuple[str, ...],
    *,
    replan: bool = False,
    flight: bool = False,
    fleet: Fleet | None = None,
) -> Source:
    """Return the mission of a file or of a knot, or a plan file.

    A mission is planned for the tracking error of the ``fleet``, where that was measured and is
    larger than its own.

    Raises :class:`InputError` for a wrong mission, and for options that a plan file does not take.
    """
    if not is_plan_file(name):
        mission = load_mission(name, overrides)
        return Source(mission if fleet is None else _for_fleet(mission, fleet), replan, flight)
    refuse_with_plan_file(name, {"--set": overrides, "--replan": replan})
    return Source(name, replan, flight)


@dataclass(frozen=True)
class Given:
    """The mission of a command as it was given, and the options that go with every mission."""

    mission: str
    overrides: tuple[str, ...]
    replan: bool
    as_json: bool
    verbose: bool = False

    def source(self, *, flight: bool = False) -> Source:
        """Return what is to be planned; raises as :func:`load_source`."""
        return load_source(self.mission, self.overrides, replan=self.replan, flight=flight)

    def require_cleared(self, context: click.Context, planned: planner.PlanningResult) -> None:
        """Print the verdict of a plan as :func:`require_cleared`."""
        require_cleared(context, planned, verbose=self.verbose, as_json=self.as_json)


def with_mission(*, verbose: bool = True) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator: a command takes a mission with its options, as a :class:`Given`."""
    shared = [MISSION, SET, REPLAN, JSON, *([VERBOSE] if verbose else [])]

    def decorated(command: Callable[..., None]) -> Callable[..., None]:
        @wraps(command)
        def packed(*context: click.Context, **options: Any) -> None:
            names = [name for name in Given.__dataclass_fields__ if name in options]
            given = Given(**{name: options.pop(name) for name in names})
            command(*context, given, **options)

        for option in reversed(shared):
            packed = option(packed)
        return packed

    return decorated


def load_training(path: Path, console: Console) -> "Scenario":
    """Return the scenario of a training flight; what it has for trials is not flown, and said."""
    from swarm.simulation.training import read_training  # noqa: PLC0415 - slow to import

    scenario = read_training(path)
    if scenario.spreads:
        words = f"{path}: spread is for swarm trials; this flight has the scenario's faults alone"
        console.print(words, style="dim", highlight=False, markup=False, soft_wrap=True)
    return scenario


def refuse_with_plan_file(name: str, options: Mapping[str, object]) -> None:
    """Raise :class:`InputError` for the options that are given, none of which a plan file takes."""
    message = f"{name} is a plan file, which is not planned again"
    problems = [Problem(option, message) for option, value in options.items() if value]
    if problems:
        raise InputError(problems)


def _for_fleet(mission: Mission, fleet: Fleet) -> Mission:
    """Return the mission to plan for a fleet, and say so where that is another one."""
    planned = mission_for(mission, fleet)
    if planned is not mission:
        words = f"Planned for a tracking error of {planned.vehicles.tracking:g} m, as measured for "
        words += f"fleet {fleet.name}; {mission.name} has {mission.vehicles.tracking:g} m"
        Console(stderr=True).print(words, style="dim", highlight=False, soft_wrap=True)
    return planned


def plan_mission(
    mission: Mission, *, replan: bool = False, flight: bool = False
) -> planner.PlanningResult:
    """Return the plan of a mission and its certificate, cleared or not.

    A mission that was planned before is not planned again, unless with ``replan``. What a
    ``flight`` calls is compiled meanwhile, where that was not done before.
    """
    console = Console(stderr=True)
    with progress_bar(console) as progress:
        precompile.prepare(precompile.PLANNING, progress)
        before = None if replan else plan_cache.find(mission, progress)
        if before is None:
            precompile.prepare(planner.compiled_for(mission), progress)
            with precompile.compiling(precompile.FLIGHT if flight else ()) as finish:
                planned = planner.plan(mission, progress)
                plan_cache.store(mission, planned)
                finish(progress)
            return planned
    planned, computed = before
    words = f"Planned before ({computed.astimezone():%Y-%m-%d %H:%M}); --replan plans again"
    console.print(words, style="dim", highlight=False, soft_wrap=True)
    return planned


def rest_of_fold(plan: Plan, found: Found) -> CertifiedPlan:
    """Return the cleared plan of the rest of a fold; see :func:`swarm.planner.rest_of_fold`."""
    with progress_bar(Console(stderr=True)) as progress:
        precompile.prepare((*precompile.PLANNING, *precompile.OPTIMISATION), progress)
        return planner.rest_of_fold(plan, found.time, found.places, progress).certified()


def prepare_flight() -> None:
    """Compile what a flight calls, where that was not done before."""
    with progress_bar(Console(stderr=True)) as progress:
        precompile.prepare(precompile.FLIGHT, progress)


def require_cleared(
    context: click.Context, planned: planner.PlanningResult, *, verbose: bool, as_json: bool
) -> None:
    """Print the verdict of a plan that is about to be flown; a refused plan ends the command.

    Where the plan is refused, its errors are printed as by ``swarm plan``. With ``as_json`` nothing
    is printed, and the error is raised.
    """
    plan, assessment, console = planned.plan, planned.assessment, Console(quiet=as_json)
    if verbose or not assessment.cleared:
        print_plan_summary(plan, assessment, console, verbose=verbose)
    else:
        print_verdict(plan_verdict(plan, assessment), console)
    if as_json:
        planned.certified()
    elif not assessment.cleared:
        context.exit(Refused.exit_code)


def plan_paper_trajectory(mission: Mission) -> planner.PlanningResult:
    """Return the paper's own trajectory for a mission, and its certificate."""
    fold = mission.fold.model_copy(update={"method": "paper"})
    return plan_mission(mission.model_copy(update={"fold": fold}, deep=True))
