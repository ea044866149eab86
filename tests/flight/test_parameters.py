"""The parameter table: no failsafe sends a tethered vehicle home."""

import math

import pytest

from sitl.autopilots.ardupilot import PARAMETERS as ARDUPILOT_PARAMETERS
from sitl.autopilots.px4 import PARAMETERS as PX4_PARAMETERS
from swarm.certification.stream_loss import StreamLossModel
from swarm.flight.conductor import Conductor
from swarm.flight.flight_plan import Audit, go
from swarm.flight.parameters import (
    evaluate,
    fleet_requirements,
    plan_requirements,
    rules,
    stream_loss_findings,
    stream_loss_model,
)
from swarm.flight.stages import Stage
from swarm.mission import Vehicles
from swarm.mission.fleet import emulated_fleet
from tests.network import small_plan

FLEET = emulated_fleet(3)
ASKED = fleet_requirements(Vehicles(), FLEET)
PX4 = rules("px4", ASKED)
ARDUPILOT = rules("ardupilot", ASKED)

RETURNS = [
    ("px4", "NAV_RCL_ACT", 2),
    ("px4", "NAV_DLL_ACT", 2),
    ("px4", "COM_OBL_RC_ACT", 3),
    ("px4", "COM_LOW_BAT_ACT", 3),
    ("px4", "COM_FLTT_LOW_ACT", 3),
    ("px4", "COM_POS_LOW_ACT", 3),
    ("px4", "GF_ACTION", 3),
    ("px4", "COM_ACT_FAIL_ACT", 3),
    ("px4", "COM_FLT_TIME_MAX", 600),
    ("ardupilot", "FS_GCS_ENABLE", 1),
    ("ardupilot", "FS_THR_ENABLE", 1),
    ("ardupilot", "BATT_FS_LOW_ACT", 2),
    ("ardupilot", "BATT_FS_CRT_ACT", 2),
    ("ardupilot", "FS_DR_ENABLE", 2),
    ("ardupilot", "FENCE_ACTION", 1),
]


def settled(table):
    return {
        rule.name: rule.should if isinstance(rule.should, int | float) else rule.should(0.0)
        for rule in table
    }


@pytest.mark.parametrize("table", [PX4, ARDUPILOT], ids=["px4", "ardupilot"])
def test_what_the_table_sets_satisfies_the_table(table):
    wrong, good = evaluate(1, settled(table), table)
    assert wrong == []
    assert len(good) == len(table)


@pytest.mark.parametrize(("autopilot", "name", "value"), RETURNS)
def test_returning_to_launch_is_an_error_in_every_failsafe(autopilot, name, value):
    table = rules(autopilot, ASKED)
    (row,), _ = evaluate(7, {**settled(table), name: value}, table)
    assert (row.name, row.severity, row.system) == (name, "error", 7)
    assert row.message.startswith(f"system 7: {name} is {value}, should be ")


def test_a_stream_that_may_be_lost_for_long_is_an_error():
    assert evaluate(1, {**settled(PX4), "COM_OF_LOSS_T": 1.0}, PX4)[0][0].severity == "error"
    assert evaluate(1, {**settled(ARDUPILOT), "GUID_TIMEOUT": 3.0}, ARDUPILOT)[0][0].should == 0.5


def test_a_fence_that_is_off_is_not_judged():
    values = {**settled(ARDUPILOT), "FENCE_ENABLE": 0.0, "FENCE_ACTION": 1.0}
    assert evaluate(1, values, ARDUPILOT)[0] == []


def test_a_parameter_that_is_not_there_is_a_warning():
    values = settled(PX4)
    del values["COM_WIND_MAX_ACT"]
    (row,), _ = evaluate(1, values, PX4)
    assert row.severity == "warning"
    assert "COM_WIND_MAX_ACT is missing" in row.message


def test_limits_follow_the_mission():
    fast = rules("px4", fleet_requirements(Vehicles(max_speed=15.0), FLEET))
    names = {row.name for row in evaluate(1, settled(PX4), fast)[0]}
    assert "MPC_XY_VEL_MAX" in names


def test_all_vehicles_land_after_the_teams_own_time():
    values = {**settled(PX4), "COM_DL_LOSS_T": 10.0}
    (row,), _ = evaluate(1, values, PX4)
    # PX4 notices 2 s later than that (tests/sitl/test_silence.py)
    assert (row.should, row.severity) == (FLEET.limits.hold - 2.0, "error")
    (row,), _ = evaluate(1, {**settled(ARDUPILOT), "FS_GCS_TIMEOUT": 5.0}, ARDUPILOT)
    # an ArduCopter hovers for 4 s before a failsafe's landing (tests/sitl/test_alone.py)
    assert row.should == FLEET.limits.hold - 4.0


def test_without_global_position_no_hold_is_required():
    indoors = rules(
        "px4", fleet_requirements(Vehicles(), FLEET.model_copy(update={"frame": "shared"}))
    )
    assert evaluate(1, {**settled(indoors), "COM_OBL_RC_ACT": 4}, indoors)[0] == []
    assert evaluate(1, {**settled(PX4), "COM_OBL_RC_ACT": 4}, PX4)[0][0].severity == "error"


def test_bits_are_set_and_cleared_and_the_others_left():
    (row,), _ = evaluate(1, {**settled(ARDUPILOT), "FS_OPTIONS": 48.0}, ARDUPILOT)
    assert row.should == 20.0
    (row,), _ = evaluate(1, {**settled(PX4), "COM_RCL_EXCEPT": 3.0}, PX4)
    assert row.should == 7.0


def test_requirements_follow_from_the_plan():
    plan = small_plan().plan
    asked = plan_requirements(plan, FLEET)
    assert 0.0 < asked.down <= asked.speed <= plan.mission.vehicles.max_speed
    assert asked.acceleration <= plan.mission.vehicles.max_acceleration + 0.1


@pytest.mark.parametrize(
    ("autopilot", "name", "falls_short", "good"),
    [
        ("px4", "MPC_LAND_ALT2", 5.0, 14.0),
        ("px4", "MPC_LAND_ALT1", 10.0, 15.0),
        ("ardupilot", "LAND_ALT_LOW", 1000.0, 1400.0),
    ],
)
def test_a_team_that_flies_high_comes_down_at_one_speed_all_the_way(
    autopilot, name, falls_short, good
):
    table = rules(autopilot, plan_requirements(small_plan(height=12.0).plan, FLEET))
    (row,), _ = evaluate(1, {**settled(table), name: falls_short}, table)
    assert (row.name, row.should, row.severity) == (name, good, "warning")
    low = rules(autopilot, plan_requirements(small_plan(height=3.0).plan, FLEET))
    assert evaluate(1, {**settled(low), name: falls_short}, low)[0] == []


@pytest.mark.parametrize(
    ("table", "name"), [(PX4, "COM_DISARM_PRFLT"), (ARDUPILOT, "DISARM_DELAY")]
)
def test_a_disarm_timer_is_long_or_off(table, name):
    for value, wrong in ((0.0, False), (-1.0, False), (10.0, False), (5.0, True)):
        found, _ = evaluate(1, {**settled(table), name: value}, table)
        assert [row.name for row in found] == ([name] if wrong else [])


@pytest.mark.parametrize("table", [PX4, ARDUPILOT], ids=["px4", "ardupilot"])
def test_emulated_vehicles_have_every_required_parameter(table):
    emulated = PX4_PARAMETERS if table is PX4 else ARDUPILOT_PARAMETERS
    assert {rule.name for rule in table} <= emulated.keys()


def test_how_vehicles_coast_is_read_from_their_parameters():
    quick = ("px4", {"COM_OF_LOSS_T": 0.2, "COM_OBL_RC_ACT": 5.0})
    lands = ("px4", {"COM_OF_LOSS_T": 0.5, "COM_OBL_RC_ACT": 4.0})
    other = ("ardupilot", {"GUID_TIMEOUT": 0.3})
    silent = ("ardupilot", {})
    limits = FLEET.limits
    found = stream_loss_model([quick, lands, other, silent], limits)
    assert found.timeout == (0.2, 0.5, 0.3, 0.5)
    assert found.descent == (0.0, limits.silence * limits.descent, 0.0, 0.0)
    assert found.silence == limits.silence
    assert found.returns == (False, False, True, True)
    assert stream_loss_model([("px4", {})] * 3, limits) == StreamLossModel(silence=limits.silence)


@pytest.mark.slow
def test_a_team_of_which_some_would_land_and_others_hold_is_refused():
    flight_plan = small_plan()
    plan = flight_plan.plan
    lands = ("px4", {"COM_OF_LOSS_T": 0.5, "COM_OBL_RC_ACT": 4.0})
    holds = ("ardupilot", {"GUID_TIMEOUT": 0.5})
    model = stream_loss_model([lands, holds, lands], FLEET.limits)
    _, findings = stream_loss_findings(flight_plan, model)
    (error,) = [finding for finding in findings if finding.severity == "error"]
    assert "vehicle 1, vehicle 3 would land at once and the others would hold" in error.message
    late = ("px4", {"COM_OF_LOSS_T": 2.0, "COM_OBL_RC_ACT": 4.0})
    model = stream_loss_model([late, late, late], FLEET.limits)
    certificate, findings = stream_loss_findings(flight_plan, model)
    assert not [finding for finding in findings if finding.severity == "error"]
    # and how long the flight takes at the pace that this allows
    (long,) = [finding.message for finding in findings if finding.check == "endurance"]
    assert certificate.delay > 1.0
    seconds = plan.flight_duration + certificate.delay
    assert long.startswith(f"{seconds:.0f} s of flight with the rate limits of the clock, ")


def test_the_flight_keeps_the_pace_that_the_audited_vehicles_allow():
    flight_plan = small_plan()
    known, _ = stream_loss_findings(
        flight_plan, StreamLossModel((0.1, 0.5, 0.5), FLEET.limits.silence)
    )
    conductor = Conductor(flight_plan, FLEET)
    assert conductor.state.stream_loss.model == StreamLossModel(silence=FLEET.limits.silence)
    conductor.state.stage = Stage.READY
    conductor.start(go(flight_plan, Audit((1, 2, 3), (), known)))
    assert conductor.state.stream_loss is known


def test_the_common_pace_of_landing_is_one_that_both_autopilots_document():
    """MPC_LAND_SPEED has 0.6 m/s as its least, LAND_SPEED 30 to 200 cm/s."""
    demands = fleet_requirements(Vehicles(), FLEET)
    wanted = {r.name: r.should for kind in ("px4", "ardupilot") for r in rules(kind, demands)}
    assert wanted["MPC_LAND_SPEED"] >= 0.6
    assert 30 <= wanted["LAND_SPEED"] <= 200
    assert wanted["LAND_SPEED"] == pytest.approx(100.0 * wanted["MPC_LAND_SPEED"])


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_no_number_is_wrong(autopilot, value):
    table = rules(autopilot, fleet_requirements(Vehicles(), emulated_fleet(1)))
    wrong, good = evaluate(1, {rule.name: value for rule in table}, table)
    assert not good
    assert {(row.name, row.severity) for row in wrong} == {
        (rule.name, rule.severity) for rule in table
    }
    assert all(math.isfinite(row.should) for row in wrong)
