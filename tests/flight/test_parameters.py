"""The parameter table: no failsafe sends a tethered vehicle home."""

import pytest

from swarm.flight.parameters import judge, rules
from swarm.mission import Vehicles

PX4 = rules("px4", Vehicles())
ARDUPILOT = rules("ardupilot", Vehicles())

RETURNS = [
    ("px4", "NAV_RCL_ACT", 2),
    ("px4", "NAV_DLL_ACT", 2),
    ("px4", "COM_OBL_RC_ACT", 3),
    ("px4", "COM_LOW_BAT_ACT", 3),
    ("px4", "COM_FLTT_LOW_ACT", 3),
    ("px4", "COM_POS_LOW_ACT", 3),
    ("px4", "GF_ACTION", 3),
    ("ardupilot", "FS_GCS_ENABLE", 1),
    ("ardupilot", "FS_THR_ENABLE", 1),
    ("ardupilot", "BATT_FS_LOW_ACT", 2),
    ("ardupilot", "BATT_FS_CRT_ACT", 2),
    ("ardupilot", "FS_DR_ENABLE", 2),
    ("ardupilot", "FENCE_ACTION", 1),
]


def settled(table):
    return {rule.name: rule.should for rule in table}


@pytest.mark.parametrize("table", [PX4, ARDUPILOT], ids=["px4", "ardupilot"])
def test_what_the_table_sets_satisfies_the_table(table):
    wrong, good = judge(1, settled(table), table)
    assert wrong == []
    assert len(good) == len(table)


@pytest.mark.parametrize(("autopilot", "name", "value"), RETURNS)
def test_returning_to_launch_is_an_error_in_every_failsafe(autopilot, name, value):
    table = rules(autopilot, Vehicles())
    (row,), _ = judge(7, {**settled(table), name: value}, table)
    assert (row.name, row.severity, row.system) == (name, "error", 7)
    assert row.message.startswith(f"system 7: {name} is {value}, should be ")


def test_a_stream_that_may_be_lost_for_long_is_an_error():
    assert judge(1, {**settled(PX4), "COM_OF_LOSS_T": 1.0}, PX4)[0][0].severity == "error"
    assert judge(1, {**settled(ARDUPILOT), "GUID_TIMEOUT": 3.0}, ARDUPILOT)[0][0].should == 0.5


def test_a_fence_that_is_off_is_not_judged():
    values = {**settled(ARDUPILOT), "FENCE_ENABLE": 0.0, "FENCE_ACTION": 1.0}
    assert judge(1, values, ARDUPILOT)[0] == []


def test_a_parameter_that_is_not_there_is_a_warning():
    values = settled(PX4)
    del values["COM_WIND_MAX_ACT"]
    (row,), _ = judge(1, values, PX4)
    assert row.severity == "warning"
    assert "COM_WIND_MAX_ACT is not there" in row.message


def test_limits_follow_the_mission():
    fast = rules("px4", Vehicles(max_speed=15.0))
    names = {row.name for row in judge(1, settled(PX4), fast)[0]}
    assert "MPC_XY_VEL_MAX" in names
