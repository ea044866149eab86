"""Plans that are broken on purpose are refused, each for its own reason."""

from dataclasses import replace

import numpy as np
import pytest

from swarm.certification.assessment import assess, endurance_findings
from swarm.certification.certificate import CertifiedPlan, certify
from swarm.errors import Refused
from swarm.geometry.motion import Motion, concatenate, through_states
from swarm.planning import Plan
from tests.certification.synthetic import moving, plan_of
from tests.network import small_plan


def errors(plan):
    """Errors of a plan: check → messages."""
    found = {}
    for finding in assess(plan).findings:
        if finding.severity == "error":
            found.setdefault(finding.check, []).append(finding.message)
    return found


def changed(plan: Plan, change) -> Plan:
    """The plan with positions (k, n, 3) changed by a function of times (k,) and positions."""
    times = np.unique(np.concatenate([plan.motion.times, [phase.end for phase in plan.phases]]))
    states = [change(times, state, order) for order, state in enumerate(plan.motion.at(times))]
    return replace(plan, motion=through_states(times, *states))


@pytest.mark.slow
def test_the_recorded_overhand_is_cleared(overhand_assessed):
    assert [f.message for f in overhand_assessed.findings if f.severity == "error"] == []
    assert overhand_assessed.cleared
    assert (overhand_assessed.knot, overhand_assessed.chirality) == ("3_1", "right")
    cable = overhand_assessed.distances["cable"]
    assert cable.distance >= cable.required == 0.15
    tightest = [f for f in overhand_assessed.findings if f.check == "tightest"]
    assert len(tightest) == 5
    assert all(f.at_time is not None and f.where is not None for f in tightest)


@pytest.mark.slow
def test_a_mirrored_knot_has_the_wrong_code_and_chirality(overhand):
    mirror = np.array([-1.0, 1.0, 1.0])
    mirrored = replace(
        overhand, motion=Motion(overhand.motion.times, overhand.motion.coefficients * mirror)
    )
    found = errors(mirrored)
    assert set(found) == {"crossing code", "knot type"}
    assert "left-handed" in found["knot type"][0]


@pytest.mark.slow
def test_swapped_lanes_make_strands_meet(overhand):
    """Strands pass below instead of above during the fold; the end is right."""
    fold = overhand.phase("fold")
    height = overhand.layout.corners[:, 2].mean()

    def swapped(times, state, order):
        folding = (times > fold.start + 1e-9) & (times < fold.end - 1e-9)
        state = state.copy()
        state[folding, :, 2] = (2 * height if order == 0 else 0.0) - state[folding, :, 2]
        return state

    found = errors(changed(overhand, swapped))
    assert "strands meet" in found
    assert "crossing code" not in found
    assert "knot type" not in found


def test_a_shortened_segment_is_taut(overhand):
    lengths = overhand.layout.lengths.copy()
    lengths[3] *= 0.85
    found = errors(replace(overhand, layout=replace(overhand.layout, lengths=lengths)))
    assert any("length of segment 4 " in message for message in found["taut"])
    assert not any("length of segment 2 " in message for message in found["taut"])


def test_a_vehicle_that_is_late_by_seconds_is_refused_for_its_own_segments(overhand):
    fold = overhand.phase("fold")

    def late(times, state, order):
        waiting = np.clip(times - 3.0, fold.start, None)
        delayed = np.where(
            times < fold.start, times, np.where(times > fold.end + 3, times, waiting)
        )
        state = state.copy()
        state[:, 4] = overhand.motion.at(delayed)[order][:, 4]
        return state

    found = errors(changed(overhand, late))
    assert set(found) & {"taut", "cable clearance", "neighbouring segments"}
    text = " ".join(message for messages in found.values() for message in messages)
    assert "segment 4" in text or "segment 5" in text


def test_a_whip_near_taut_between_coarse_samples_is_caught():
    """Out to 0.995 of the cable and back within 0.3 s, once in 20 s."""
    near, far = [[0, 0, 5.0], [2.6, 0, 5.0]], [[0, 0, 5.0], [2.985, 0, 5.0]]
    plan = plan_of(
        moving([0, 9.15, 9.3, 9.45, 20], [near, near, far, near, near]), [3.0],
        "vehicles.tracking=0.005", "vehicles.max_speed=50", "vehicles.max_acceleration=100",
        "clearance.vehicle=0.3",
    )  # fmt: skip
    assert np.all(plan.motion.at(np.arange(0, 20, 0.5))[0][:, 1, 0] < 2.7)
    found = errors(plan)
    assert set(found) == {"taut"}
    assert "at 9.30 s" in found["taut"][0]


def test_limits_of_speed_and_acceleration_with_the_braking_reserve():
    places = [[[0, 0, 5.0], [2.5, 0, 5.0]], [[6, 0, 5.0], [8.5, 0, 5.0]]]
    # A quintic over 6 m in T seconds reaches 1.875·6/T m/s and 5.7735·6/T² m/s².
    for duration, wrong in (
        (6.0, set()),
        (5.8, {"acceleration"}),
        (5.5, {"speed", "acceleration"}),
    ):
        plan = plan_of(moving([0, duration], places), [3.0])
        assert set(errors(plan)) == wrong, duration
    assert "1 m/s² allowed (2 less 1 to brake)" in errors(plan)["acceleration"][0]


def test_endurance_includes_the_rate_limits_of_the_clock():
    # Vehicles that brake weakly stop late when one of them loses its setpoints.
    plan = small_plan().plan
    weak = plan.mission.vehicles.model_copy(update={"braking_acceleration": 0.1})
    plan = replace(plan, mission=plan.mission.model_copy(update={"vehicles": weak}))
    assessed = assess(plan)
    slowed = assessed.stream_loss.delay
    assert slowed > 4.0
    (endurance_,) = [f for f in assessed.findings if f.check == "endurance"]
    flight = f"{plan.flight_duration + slowed:.0f} s of flight with the rate limits of the clock"
    assert (endurance_.severity, endurance_.message.startswith(flight)) == ("info", True)
    endurance = plan.flight_duration + 0.5 * slowed
    vehicles = plan.mission.vehicles.model_copy(update={"endurance": endurance})
    short = replace(plan, mission=plan.mission.model_copy(update={"vehicles": vehicles}))
    assert [f.severity for f in endurance_findings(short, slowed)] == ["error"]


def test_payload_and_endurance():
    still = moving([0, 10], [[[0, 0, 50.0], [30, 0, 50.0], [60, 0, 50.0]]] * 2)
    found = errors(plan_of(still, [34.0, 34.0], "cable.mass_per_length=0.15"))
    assert "N of cable force on vehicle 2; " in found["payload"][0]
    long = moving([0, 70], [[[0, 0, 50.0], [30, 0, 50.0], [60, 0, 50.0]]] * 2)
    assert set(
        errors(plan_of(long, [34.0, 34.0], "cable.mass_per_length=0.01", "vehicles.endurance=60"))
    ) == {"endurance"}


def test_refusal_carries_every_error(overhand):
    lengths = overhand.layout.lengths * 0.9
    broken = replace(overhand, layout=replace(overhand.layout, lengths=lengths))
    assessment = assess(broken)
    with pytest.raises(Refused) as refusal:
        CertifiedPlan(broken, certify(broken))
    wrong = [finding for finding in assessment.findings if finding.severity == "error"]
    assert len(str(refusal.value).splitlines()) == len(wrong) > 1


def test_a_plan_without_tracking_errors_is_reported_as_geometry_only():
    places = [[[0, 0, 5.0], [2.5, 0, 5.0]], [[3, 0, 5.0], [5.5, 0, 5.0]]]
    exact = plan_of(moving([0, 6], places), [3.0], "vehicles.tracking=0")
    scope = [f.message for f in assess(exact).findings if f.check == "scope"]
    assert "geometry only" in scope[0]


def test_a_velocity_that_jumps_is_refused():
    """Two quintics that meet at the same place with different velocities."""
    still = np.zeros((2, 2, 3))
    places = np.array([[[0, 0, 5.0], [2.5, 0, 5.0]], [[3.0, 0, 5.0], [5.5, 0, 5.0]]])
    speed = still.copy()
    speed[1, 1, 0] = 0.2
    there = through_states(np.array([0.0, 9.0]), places, speed, still)
    back = through_states(np.array([9.0, 18.0]), places[::-1], still, still)
    found = errors(plan_of(concatenate(there, back), [3.0]))
    assert found == {"smoothness": ["0.2 m/s jump in the velocity of vehicle 2"]}


def test_a_single_vehicle_without_cable_is_checked_by_its_motion_alone():
    plan = plan_of(moving([0, 6], [[[0, 0, 5.0]], [[2, 0, 5.0]]]), [], cable="free")
    assessment = assess(plan)
    assert assessment.cleared
    assert assessment.knot == "0_1"
    late = plan_of(moving([0, 1], [[[0, 0, 5.0]], [[2, 0, 5.0]]]), [], cable="free")
    assert set(errors(late)) == {"speed", "acceleration"}


def test_two_vehicles_that_carry_one_strand_tie_nothing():
    places = [[[0, 0, 5.0], [2.5, 0, 5.0]], [[3, 0, 5.0], [5.5, 0, 5.0]]]
    assessment = assess(plan_of(moving([0, 6], places), [3.0]))
    assert assessment.cleared
    assert (assessment.knot, assessment.chirality, assessment.gauss) == ("0_1", "none", "")
