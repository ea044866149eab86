import pytest

from swarm.mission import parse_mission
from swarm.plans import Plan, make_plan
from swarm.preflight.assess import assess
from swarm.preflight.findings import Assessment

OVERHAND = """
schema: 1
name: overhand
knot: {gauss: "1- 2+ 3- 1+ 2- 3+", chirality: right}
"""


@pytest.fixture(scope="session")
def overhand() -> Plan:
    """Our own plan of an overhand knot with the default mission."""
    return make_plan(parse_mission(OVERHAND, "overhand.yaml"))


@pytest.fixture(scope="session")
def overhand_assessed(overhand: Plan) -> Assessment:
    return assess(overhand)
