"""Contingency windows, stops, loads, the budget and robustness, against analytic figures."""

import math
from dataclasses import replace

import numpy as np
import pytest

from swarm.certification.air import (
    deepest_sinking,
    induced_speed,
    jet_speed,
    sinkings,
    wind_down,
)
from swarm.certification.assessment import assess, contingencies_of, downwash_findings
from swarm.certification.budget import _closest, _pressed, budgets
from swarm.certification.clearances import (
    Robustness,
    certified,
    confirmed,
    failure_in_wind,
    largest_tracking,
    largest_wind,
    tightest_moments,
)
from swarm.certification.contingency_windows import contingency_windows, longest_stop
from swarm.certification.loads import failed_vehicle_load, loads, stuck_gripper_load
from swarm.planning import Gate, Phase
from tests.certification.synthetic import moving, plan_of

LINE = [[0, 0, 5.0], [2.5, 0, 5.0], [5.0, 0, 5.0]]


def still(places, lengths, *overrides):
    return plan_of(moving([0, 4], [places, places]), lengths, *overrides)


def test_a_line_of_vehicles_can_land_and_release_at_any_time():
    found = contingency_windows(still(LINE, [3.0, 3.0]))
    assert found.land.all()
    assert found.release.all()
    assert found.share(found.land, 0.0, 4.0) == 1.0
    assert found.longest_wait(found.land, 0.0, 4.0) == 0.0


def test_a_vehicle_under_a_strand_prevents_landing_and_release():
    """Vehicle 4 passes under segment 1 from 3 s to 5 s or so, and beyond."""
    high = [[0, 0, 9.0], [3.0, 0, 9.0]]
    places = [[*high, [1.5, y - 2.4, 3.0], [1.5, y, 3.0]] for y in (-6.0, -6.0, 6.0, 6.0)]
    plan = plan_of(moving([0, 1, 7, 8], places), [3.5, 12.0, 3.0])
    found = contingency_windows(plan)
    assert not found.can_release(4.0)
    assert not found.can_land(4.0)
    assert found.can_release(0.5)
    assert 0.1 < found.share(found.release, 0.0, 8.0) < 0.95
    under = found.time[~found.release]
    assert found.longest_wait(found.release, 0.0, 8.0) == pytest.approx(
        0.5 * (under[-1] - under[0]), abs=0.6
    )


def test_vehicles_above_each_other_cannot_land():
    found = contingency_windows(still([[0, 0, 8.0], [2.2, 0, 8.0], [2.4, 0, 5.0]], [3.0, 4.0]))
    assert not found.land.any()


def test_a_release_under_cable_is_refused():
    places = [[0, 0, 9.0], [3.0, 0, 9.0], [1.5, -2.4, 3.0], [1.5, 0, 3.0]]
    plan = still(places, [3.5, 12.0, 3.0])
    released = replace(
        plan,
        phases=(*plan.phases, Phase("finish", 4.0, 4.0, "free", False)),
        gates=(Gate(4.0, "released", 20.0),),
    )
    found = [f for f in assess(released).findings if f.check == "release"]
    assert [finding.severity for finding in found] == ["error"]


def test_the_longest_stop_is_that_of_the_fastest_vehicle():
    places = [[[0, 0, 5.0], [2.5, 0, 5.0]], [[6, 0, 5.0], [8.5, 0, 5.0]]]
    stop = longest_stop(plan_of(moving([0, 9], places), [3.0]))
    fastest = 1.875 * 6.0 / 9.0
    assert stop.time == pytest.approx(fastest / 1.0, rel=1e-3)
    assert stop.distance == pytest.approx(fastest**2 / 2.0, rel=1e-3)
    assert stop.at_time == pytest.approx(4.5, abs=0.1)


def test_loads_are_the_weight_of_the_cable():
    plan = still(LINE, [3.0, 3.4], "vehicles.tracking=0")
    found = loads(plan)
    weight = 0.012 * 9.80665
    assert found.vertical.sum(axis=1) == pytest.approx(6.4 * weight)
    assert found.vertical[0] == pytest.approx([1.5 * weight, 3.2 * weight, 1.7 * weight])


def test_a_failed_vehicle_hangs_on_both_neighbours():
    found = failed_vehicle_load(still(LINE, [3.0, 3.0]))
    assert found is not None
    # At an end one neighbour carries all of it; between two, T = W / 2cos, span 5 m of 6 m.
    whole = 1.5 * 9.80665
    assert found.force >= whole
    slope = math.sqrt(9 - 6.25) / 2.5
    shared = whole / 2 * math.hypot(1.0, 1.0 / slope)
    assert found.force < whole + 1.0
    assert shared < whole


def test_a_stuck_gripper_carries_the_cable_down_to_the_floor():
    plan = still(LINE, [3.0, 9.0])
    assert stuck_gripper_load(plan) is None
    released = replace(plan, gates=(Gate(4.0, "released", 20.0),))
    found = stuck_gripper_load(released)
    assert found is not None
    assert found.vehicle == 1
    assert found.force == pytest.approx((3.0 + 5.0) * 0.012 * 9.80665)


def crossed(gap, *overrides):
    """Two strands that cross at right angles, one ``gap`` below the other, high up."""
    far = [[-30.0, 30.0, 60.0], [-30.0, -30.0, 60.0]]
    crossing = [[-1.5, 0, 60.0 + gap], [1.5, 0, 60.0 + gap]]
    places = [[0, -1.5, 60.0], [0, 1.5, 60.0], *far, *crossing]
    return still(places, [3.5, 50.0, 66.0, 50.0, 3.5], *overrides)


def test_the_budget_separates_tracking_and_tolerance():
    plan = crossed(1.0)
    moment = tightest_moments(plan, checks=("cable clearance",))[0]
    (row,) = budgets(plan, [moment])
    assert row.between == ("segment 1", "segment 5")
    assert row.tracking == pytest.approx(0.2)
    # The certificate includes tracking and its amplification only.
    assert row.available - row.tracking - row.amplification >= moment.distance - 0.01
    assert row.available - row.tracking - row.amplification <= moment.distance + 0.15
    # A centimetre of cable more lets a strand sag by a little more than half a centimetre.
    assert 0.01 < row.length < 0.03
    assert row.grip == row.wind == 0.0
    assert row.wash < 1e-4, "no vehicle is above these strands"
    assert row.remaining == pytest.approx(row.available - row.effects - 0.15)


def test_wind_and_gusts_separate_strands_only_by_their_difference():
    plan = crossed(1.0, "wind.steady=3.0")
    (calm,) = budgets(plan, tightest_moments(plan, checks=("cable clearance",))[:1])
    gusty = crossed(1.0, "wind.steady=3.0", "wind.gust=3.0")
    (rough,) = budgets(gusty, tightest_moments(gusty, checks=("cable clearance",))[:1])
    assert calm.wind < 0.15 < rough.wind


def test_the_wind_tilts_a_cable_by_its_drag():
    """17° at 3 m/s and 41° at 5 m/s for 12 g/m and 6 mm."""
    plan = crossed(1.0)
    for speed, degrees in ((0.0, 0.0), (3.0, 17.0), (5.0, 41.0)):
        down = np.array(wind_down(plan, speed, 0.3))
        assert np.linalg.norm(down) == pytest.approx(1.0)
        assert math.degrees(math.acos(-down[2])) == pytest.approx(degrees, abs=0.7)


def test_the_largest_tracking_error_holds_and_a_larger_one_does_not():
    plan = crossed(1.0)
    most = largest_tracking(plan)
    assert most is not None
    assert certified(plan, tracking=most)
    assert not certified(plan, tracking=most + 0.01)
    assert largest_tracking(crossed(0.1)) is None


def test_a_wind_across_the_vehicles_blows_strands_together():
    """Side by side, a taut and a slack strand lean by different amounts."""
    side = [[0, 0, 60], [3, 0, 60], [40, -20, 60], [40, 30, 60], [3, 1.2, 59.4], [0, 1.2, 59.4]]
    plan = still(side, [5.0, 50.0, 60.0, 55.0, 3.2], "vehicles.tracking=0.02")
    assert failure_in_wind(plan, 0.0) is None
    assert failure_in_wind(plan, 8.0) is not None


def test_recorded_robustness_is_confirmed_only_where_it_holds():
    side = [[0, 0, 60], [3, 0, 60], [40, -20, 60], [40, 30, 60], [3, 1.2, 59.4], [0, 1.2, 59.4]]
    plan = still(side, [5.0, 50.0, 60.0, 55.0, 3.2], "vehicles.tracking=0.02")
    assert confirmed(plan, Robustness(0.02, 0.0)) == Robustness(0.02, 0.0)
    assert confirmed(plan, Robustness(0.9, 8.0)) == Robustness(None, None)
    assert confirmed(plan, Robustness(None, None)) == Robustness(None, None)


def test_strands_without_margin_tolerate_no_wind():
    side = [[0, 0, 60], [3, 0, 60], [40, -20, 60], [40, 30, 60], [3, 1.2, 59.4], [0, 1.2, 59.4]]

    def keeping(clearance):
        lengths = [5.0, 50.0, 60.0, 55.0, 3.2]
        return still(side, lengths, "vehicles.tracking=0.02", f"clearance.cable={clearance}")

    low, high = 1.12, 1.17
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if certified(keeping(middle), tracking=0.02) else (low, middle)
    # in parallel planes, 1.2 m apart, with errors of 0.02 m at both strands
    assert 1.12 < low < high < 1.17
    assert largest_wind(keeping(low), tightest_moments(keeping(low))) == 0.0


def test_the_jet_below_a_vehicle_slows_and_widens():
    mission = still(LINE, [3.0, 3.0]).mission
    below, axis = np.array([-1.0, 1.0, 4.0, 8.0]), np.zeros(4)
    speed = jet_speed(mission, below, axis)
    # 1.5 kg on a disc of 0.25 m: 5.5 m/s through it, twice that below, less from six diameters on
    assert induced_speed(mission) == pytest.approx(5.53, abs=0.01)
    assert speed[0] == 0.0
    assert speed[1] == pytest.approx(11.06, abs=0.02)
    assert speed[3] == pytest.approx(0.5 * speed[2])
    aside = jet_speed(mission, below, np.full(4, 1.0))
    assert aside[1] / speed[1] < aside[2] / speed[2] < aside[3] / speed[3] < 1.0


def test_a_vehicle_that_passes_under_another_sinks_for_a_while():
    start = [[0, 0, 9.0], [3.0, 0, 5.0], [6.0, 0, 5.0]]
    under = [[0, 0, 9.0], [0.2, 0, 5.0], [3.2, 0, 5.0]]
    plan = plan_of(moving([0, 4, 30], [start, under, under]), [6.0, 4.0])
    found = deepest_sinking(plan)
    assert (found.vehicle, found.above) == (1, 0)
    assert found.below == pytest.approx(4.0)
    assert 2.0 < found.time < 8.0, "the autopilot compensates while the others stay"
    assert 0.2 < found.depth < 1.0
    assert deepest_sinking(still(LINE, [3.0, 3.0])) is None
    (finding,) = downwash_findings(plan)
    assert finding.severity == "warning"
    assert "m of sinking for vehicle 2, 4.0 m below vehicle 1 in downwash of " in finding.message


def test_a_vehicle_that_enters_a_jet_sinks_as_the_poles_of_its_autopilot_say():
    """The response to a step of 1 / (s³ + 4s² + 6s + 2), from its partial fractions."""
    places = [[0, 0, 9.0], [0.8, 0, 5.0], [3.8, 0, 5.0]]
    plan = still(places, [6.0, 4.0])
    poles = np.roots([1.0, 4.0, 6.0, 2.0])
    residues = 1.0 / (3.0 * poles**2 + 8.0 * poles + 6.0)
    response = (residues * np.exp(poles * np.arange(0.0, 4.0, 0.01)[:, None])).sum(axis=1).real
    speed = float(jet_speed(plan.mission, np.array(4.0), np.array(0.8)))
    depth = 9.80665 * speed / (2.0 * induced_speed(plan.mission)) * response.max()
    assert 0.05 < depth < 0.5
    (found,) = sinkings(plan, 0.99 * depth)
    assert found.depth == pytest.approx(depth, rel=0.01)
    assert (found.vehicle, found.above, found.below) == (1, 0, pytest.approx(4.0))
    assert not sinkings(plan, 1.01 * depth)
    laid = replace(plan, phases=tuple(replace(one, cable="floor") for one in plan.phases))
    assert not sinkings(laid, 0.01)


def test_contingencies_are_reported_with_their_windows():
    contingencies, findings = contingencies_of(still(LINE, [3.0, 3.0]))
    assert (contingencies.land.share, contingencies.land.wait) == (1.0, 0.0)
    assert contingencies.release.share == 1.0
    assert [finding.message for finding in findings][:2] == [
        "100% of the time aloft, all can land together",
        "100% of the time aloft, all can release",
    ]
    under = [[0, 0, 5.0], [2.0, 0, 5.0], [1.0, 0, 1.5]]
    contingencies, findings = contingencies_of(still(under, [2.4, 6.0]))
    assert not contingencies.release.share
    assert findings[1].severity == "warning"
    assert findings[1].message == "0% of the time aloft, all can release"


def test_neighbours_share_the_movement_of_their_grip():
    """Two strands from one grip: an error of that grip moves both, and parts them little."""
    plan = still([[-1.5, 0.0, 60.0], [0.0, 0.0, 60.0], [-1.5, 1.2, 60.0]], [3.0, 3.5])
    moment = tightest_moments(plan, checks=("neighbouring segments",))[0]
    (row,) = budgets(plan, [moment])
    assert row.tracking + row.amplification < 0.2
    assert row.available - row.tracking - row.amplification == pytest.approx(
        moment.distance, abs=0.06
    )


def test_downwash_that_parts_two_strands_is_not_counted():
    """A vehicle above a crossing presses the upper strand down; the lower one may be spared."""
    above = crossed(0.6)
    moment = tightest_moments(above, checks=("cable clearance",))[0]
    (row,) = budgets(above, [moment])
    assert row.wash < 1e-4
    time, (one, other) = moment.time, (0, 4)
    place = above.motion.at(time)[0].copy()
    place[2] = [0.0, 0.0, 61.5]
    _, strands = _closest(above, place, [one, other])
    pressed = [float(_pressed(above, place, strand) @ strand.normal) for strand in strands]
    upper = 0 if strands[0].normal[2] > 0 else 1
    assert abs(pressed[0]) > 0.01
    assert abs(pressed[1]) > 0.01
    towards = max(0.0, -pressed[0]) + max(0.0, pressed[1])
    assert towards == pytest.approx(abs(pressed[upper]), abs=1e-9)
