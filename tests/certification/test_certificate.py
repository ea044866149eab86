"""A certificate belongs to one plan, and only certify creates one."""

import ast
import pickle
from dataclasses import replace
from pathlib import Path

import pytest

from swarm.certification.certificate import (
    Certificate,
    CertifiedPlan,
    without_cable,
)
from swarm.certification.clearances import PlanChecks
from swarm.certification.stream_loss import StreamLossModel, certify_stream_loss
from swarm.errors import Refused
from swarm.flight.bench_flight import hop, raised
from swarm.flight.conductor import Conductor
from swarm.flight.flight_plan import (
    Audit,
    CableFreeFlight,
    ComparisonFlight,
    basis_of,
    go,
    require_tracking,
)
from swarm.geometry.motion import Motion
from swarm.mission.fleet import emulated_fleet
from swarm.planning import digest
from tests.network import small_plan, uncleared

CERTIFIED = small_plan()
OTHER = small_plan(height=6.0)


def copied(plan):
    """The same plan with its own writable arrays."""
    motion = plan.motion
    return replace(plan, motion=Motion(motion.times.copy(), motion.coefficients.copy()))


def changed(plan):
    """The plan with one property changed at a time, each of which a check uses."""
    layout, mission = plan.layout, plan.mission
    bent = copied(plan)
    bent.motion.coefficients[3, 2, 1, 0] += 1e-12
    later = plan.motion.times.copy()
    later[-1] += 1e-9
    yield "motion", bent
    yield "times", replace(plan, motion=Motion(later, plan.motion.coefficients))
    yield "length", replace(plan, layout=replace(layout, lengths=layout.lengths * (1.0 + 1e-15)))
    yield "corner", replace(plan, layout=replace(layout, corners=layout.corners + 1e-9))
    yield "gates", replace(plan, gates=plan.gates[:-1])
    phases = (replace(plan.phases[0], cable="aloft"), *plan.phases[1:])
    yield "phases", replace(plan, phases=phases)
    clearance = mission.clearance.model_copy(update={"cable": 0.1})
    yield "clearance", replace(plan, mission=mission.model_copy(update={"clearance": clearance}))
    yield "knot", replace(plan, knot=replace(plan.knot, type="3_1"))


@pytest.mark.parametrize(
    "other", [pytest.param(other, id=name) for name, other in changed(CERTIFIED.plan)]
)
def test_a_certificate_is_for_exactly_its_plan(other):
    with pytest.raises(Refused, match="the certificate belongs to another plan"):
        CertifiedPlan(other, CERTIFIED.certificate)
    with pytest.raises(Refused, match="the certificate belongs to another plan"):
        ComparisonFlight(other, CERTIFIED.certificate)


def test_pictures_and_notes_are_not_part_of_a_plan():
    plan = replace(CERTIFIED.plan, notes=("drawn again",), path=CERTIFIED.plan.path + 1.0)
    assert digest(plan) == CERTIFIED.certificate.digest


def test_only_certify_creates_certificates():
    for key in (None, object(), True):
        with pytest.raises(TypeError, match="certificates are created only by"):
            Certificate(digest(OTHER.plan), CERTIFIED.assessment, 0.1, key)
    with pytest.raises(ValueError, match="must be specified"):
        replace(CERTIFIED.certificate, digest=digest(OTHER.plan))


def test_what_was_measured_counts_for_exactly_this_plan():
    plan = replace(
        OTHER.plan,
        motion=replace(OTHER.plan.motion, coefficients=OTHER.plan.motion.coefficients.copy()),
    )
    before = PlanChecks.of(plan).moments()
    assert PlanChecks.of(plan).moments() is before
    plan.motion.coefficients[:, 0, 0, 0] += 0.1
    assert PlanChecks.of(plan).moments() is not before


@pytest.mark.slow
def test_no_other_module_uses_the_construction_key():
    package = Path(__file__).parents[2] / "swarm"
    for path in package.rglob("*.py"):
        names = {
            getattr(node, "id", getattr(node, "attr", getattr(node, "name", None)))
            for node in ast.walk(ast.parse(path.read_text()))
        }
        if path.relative_to(package).as_posix() != "certification/certificate.py":
            assert "_CONSTRUCTION_KEY" not in names, path


def test_a_certificate_with_errors_is_refused():
    wrong = uncleared("clearance.vehicle=3.5")
    assert not wrong.certificate.cleared
    with pytest.raises(Refused, match="vehicle clearance: "):
        CertifiedPlan(wrong.plan, wrong.certificate)


def test_a_plan_that_is_modified_after_certification_is_refused():
    plan = copied(CERTIFIED.plan)
    certified = CertifiedPlan(plan, CERTIFIED.certificate)
    fleet = emulated_fleet(3)
    Conductor(certified, fleet)
    plan.motion.coefficients[:, 0, :, 2] -= 0.5
    with pytest.raises(Refused, match="the certificate belongs to another plan"):
        Conductor(certified, fleet)
    with pytest.raises(Refused, match="the certificate belongs to another plan"):
        go(certified, Audit((1, 2, 3), ()))


def test_a_stream_loss_certificate_of_another_plan_is_refused():
    other = certify_stream_loss(OTHER.plan, StreamLossModel())
    assert other.holds_for(OTHER.plan, StreamLossModel())
    assert not other.holds_for(CERTIFIED.plan, StreamLossModel())
    with pytest.raises(Refused, match="the audit worked out lost setpoints for another plan"):
        go(CERTIFIED, Audit((1, 2, 3), (), other))


def test_a_certified_plan_can_be_pickled():
    again = pickle.loads(pickle.dumps(CERTIFIED))  # noqa: S301 - our own
    again.check()
    assert again.certificate.findings == CERTIFIED.certificate.findings


def test_a_hop_carries_no_cable_and_names_its_check():
    flight = hop(CERTIFIED)
    assert isinstance(flight, CableFreeFlight)
    basis = basis_of(flight, cable=False)
    assert (basis.kind, basis.cable) == ("hop", False)
    assert basis.checked == (
        "a hop straight up and down, certified without cable for tracking errors of up to 0.1 m"
    )
    with pytest.raises(Refused, match="a hop flight carries no cable: none was checked"):
        basis_of(flight, cable=True)
    assert not Conductor(flight, emulated_fleet(3)).state.setup.carries_cable
    checks = {finding.check for finding in flight.certificate.findings}
    assert "scope" in checks


def test_vehicles_that_were_measured_with_larger_errors_fly_no_cable():
    measured = emulated_fleet(3).model_copy(update={"tracking": 0.14})
    carrying, without = (basis_of(CERTIFIED, cable=cable) for cable in (True, False))
    for most, shown in ((0.1, "0.1"), (0.1398, "0.139")):
        message = (
            "fleet emulator: vehicles were measured with a tracking error of 0.14 m, the plan "
            f"holds up to {shown} m: plan again with swarm plan --fleet"
        )
        with pytest.raises(Refused, match=message):
            require_tracking(replace(carrying, max_tracking_error=most), measured)
    require_tracking(without, measured)
    for enough in (None, 0.05, carrying.max_tracking_error):
        require_tracking(carrying, measured.model_copy(update={"tracking": enough}))


def test_a_raised_flight_gets_a_new_certificate():
    fleet = emulated_fleet(3).model_copy(update={"gripper": "none"})
    lifted = raised(CERTIFIED, fleet, no_cable=True)
    assert isinstance(lifted, CableFreeFlight)
    assert lifted.certificate.digest == digest(without_cable(lifted.plan))
    assert lifted.certificate.digest != CERTIFIED.certificate.digest
    assert basis_of(lifted, cable=False).checked.startswith("the plan raised for vehicles without")
    with pytest.raises(Refused, match="a raised flight carries no cable"):
        basis_of(lifted, cable=True)
    low = small_plan("workspace.ceiling=7")
    highest = low.plan.motion.at(low.plan.motion.times)[0][..., 2].max()
    assert highest + 1.0 + low.plan.mission.vehicles.grip_offset > 7.0
    assert raised(low, fleet, no_cable=True) is low
