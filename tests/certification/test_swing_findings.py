"""The planned swing of the cable: in the findings, against ``fold.swing``, and in a shaped plan."""

from dataclasses import replace

import numpy as np
import pytest

from swarm.certification.swing_findings import PlannedSwing, planned_swing, swing_findings
from swarm.mission import Mission, mission_for_knot
from swarm.planner import plan as make_plan
from swarm.planning import Plan


def with_limit(plan: Plan, limit: float | None) -> Plan:
    fold = plan.mission.fold.model_copy(update={"swing": limit})
    return replace(plan, mission=plan.mission.model_copy(update={"fold": fold}))


@pytest.fixture(scope="module")
def shaped() -> Plan:
    mission: Mission = mission_for_knot("3_1", ["fold.swing=0.06"])
    result = make_plan(mission, robustness=False)
    assert result.certificate.cleared
    assert [each.severity for each in result.assessment.findings if each.check == "swing"] == [
        "info"
    ]
    return result.plan


def test_a_shaped_fold_keeps_its_limit(shaped: Plan) -> None:
    found = planned_swing(shaped)
    assert found is not None
    assert 0.02 < found.largest <= 0.06
    fold = shaped.phase("fold")
    assert found.times[0] == pytest.approx(fold.start)
    assert found.times[-1] == pytest.approx(shaped.phase("hold").end, abs=0.2)


def test_an_unshaped_fold_swings_four_times_as_far(overhand: Plan) -> None:
    found = planned_swing(overhand)
    assert found is not None
    assert found.largest > 0.2


@pytest.mark.parametrize(
    ("limit", "severity"), [(0.06, "info"), (0.005, "error"), (None, "warning")]
)
def test_the_finding_is_an_error_beyond_the_limit(
    shaped: Plan, limit: float | None, severity: str
) -> None:
    found = planned_swing(shaped)
    (finding,) = swing_findings(with_limit(shaped, limit), found)
    assert finding.severity == severity
    assert "swings up to 0.0" in finding.message
    assert ("fold.swing allows 0.005 m" in finding.message) is (severity == "error")


def test_the_finding_names_segment_and_time(shaped: Plan) -> None:
    distance = np.zeros((3, 2))
    distance[1, 1] = 0.2
    found = PlannedSwing(np.array([50.0, 50.1, 50.2]), distance)
    (finding,) = swing_findings(shaped, found)
    assert finding.at_time == 50.1
    assert "0.20 m away from its catenary (segment 2), at 33% of the moments" in finding.message
    assert swing_findings(shaped, None) == []


def test_a_plan_with_a_chord_longer_than_its_cable_has_no_swing(shaped: Plan) -> None:
    lengths = shaped.layout.lengths.copy()
    lengths[3] *= 0.5
    assert planned_swing(replace(shaped, layout=replace(shaped.layout, lengths=lengths))) is None
