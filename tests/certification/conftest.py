from pathlib import Path

import numpy as np
import pytest

from swarm.certification.assessment import Assessment
from swarm.certification.certificate import CertifiedPlan, certify
from swarm.geometry.motion import through_states
from swarm.mission import parse_mission
from swarm.planning import Gate, KnotLayout, KnotSummary, Phase, Plan
from tests.shared import shared

OVERHAND = """
schema: 1
name: overhand
knot: {gauss: "1- 2+ 3- 1+ 2- 3+", chirality: right}
"""


def recorded_overhand() -> Plan:
    """A plan of an overhand knot as an early planner made it, sampled every second.

    Kept as data, so that these tests fail for reasons of the certificate and not of the planner.
    """
    data = np.load(Path(__file__).with_name("overhand.npz"))
    states = [data[name].astype(float) for name in ("position", "velocity", "acceleration")]
    crossings = tuple((int(over), int(under)) for over, under in data["crossings"])
    return Plan(
        mission=parse_mission(OVERHAND, "overhand.yaml"),
        knot=KnotSummary("3_1", "right", "1- 2+ 3- 1+ 2- 3+", ()),
        layout=KnotLayout(
            data["corners"], data["sags"], data["lengths"], data["lanes"], crossings, 4.428
        ),
        motion=through_states(data["time"], *states),
        phases=tuple(
            Phase(str(name), float(start), float(end), str(cable), False)  # type: ignore[arg-type]
            for name, cable, (start, end) in zip(
                data["phase_name"], data["phase_cable"], data["phase_time"], strict=True
            )
        ),
        gates=(Gate(float(data["released"][0]), "released", 20.0),),
        path=data["corners"],
    )


@pytest.fixture(scope="session")
def overhand() -> Plan:
    return recorded_overhand()


@shared
def certified_overhand() -> CertifiedPlan:
    plan = recorded_overhand()
    return CertifiedPlan(plan, certify(plan))


@pytest.fixture(scope="session")
def overhand_assessed() -> Assessment:
    return certified_overhand().assessment
