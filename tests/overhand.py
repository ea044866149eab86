"""The plan of `missions/overhand.yaml`, made once in a run of the tests."""

from pathlib import Path

from swarm import planner
from swarm.mission import parse_mission
from swarm.planner import PlanningResult
from tests.shared import shared

OVERHAND = Path(__file__).parents[1] / "missions" / "overhand.yaml"


@shared
def planned_overhand() -> PlanningResult:
    """The mission as it is, planned and certified, with e* and w*."""
    return planner.plan(parse_mission(OVERHAND.read_text(encoding="utf-8"), str(OVERHAND)))
