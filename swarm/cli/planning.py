"""Planning with a progress line, shared by the commands that need a plan."""

from rich.console import Console

from swarm import planner
from swarm.cli.inputs import progress_bar
from swarm.mission import Mission


def plan_mission(mission: Mission) -> planner.PlanningResult:
    """Return the plan of a mission and its certificate, cleared or not."""
    with progress_bar(Console(stderr=True)) as progress:
        return planner.plan(mission, progress)


def plan_paper_trajectory(mission: Mission) -> planner.PlanningResult:
    """Return the paper's own trajectory for a mission, and its certificate."""
    fold = mission.fold.model_copy(update={"method": "paper"})
    return plan_mission(mission.model_copy(update={"fold": fold}, deep=True))
