"""Planning with a progress line, shared by the commands that need a plan."""

import click
from rich.console import Console

from swarm import planner
from swarm.cli.inputs import progress_bar
from swarm.errors import Refused
from swarm.mission import Mission
from swarm.reports.findings_text import print_verdict
from swarm.reports.plan_summary import print_plan_summary
from swarm.reports.verdicts import plan_verdict


def plan_mission(mission: Mission) -> planner.PlanningResult:
    """Return the plan of a mission and its certificate, cleared or not."""
    with progress_bar(Console(stderr=True)) as progress:
        return planner.plan(mission, progress)


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
