"""The simulated rope: hangs as a catenary, blocks at contact, and reports invalid runs."""

import json
from dataclasses import replace

import numpy as np
import pytest

from swarm import planner
from swarm.errors import Refused
from swarm.geometry.catenary import STANDARD_GRAVITY, solve_catenaries
from swarm.mission import mission_for_knot
from swarm.planning import KnotLayout, KnotSummary, Plan
from tests.network import small_plan

rope = pytest.importorskip("swarm.rope.simulation")

PLAN = small_plan(vehicles=3).plan


def across(height: float) -> Plan:
    """Two spans that cross in plan view, the second ``height`` metres over the first."""
    corners = np.array(
        [[0.0, -1.0, 5.0], [0.0, 1.0, 5.0], [-1.0, 1.0, 5.0 + height], [1.0, -0.2, 5.0 + height]]
    )
    lengths = np.array([2.6, 1.5, 2.8])
    layout = KnotLayout(corners, np.zeros(3), lengths, np.zeros(3), ((2, 0),), 0.0)
    return replace(PLAN, layout=layout, knot=KnotSummary("0_1", "none", "", ()))


def still(places: np.ndarray, seconds: float):
    return rope.Grips(np.array([0.0, seconds]), np.array([places, places]))


def test_a_rope_at_rest_hangs_as_the_catenary():
    start, end, length = np.array([0.0, 0.0, 5.0]), np.array([2.0, 0.0, 5.3]), 2.4
    line = np.array([start, end, end + np.array([2.0, 0.0, 0.0])])
    layout = replace(PLAN.layout, corners=line, lengths=np.array([length, 2.3]))
    run = rope.simulate_rope(replace(PLAN, layout=layout), still(line, 1.0), links=80)
    assert run.links == 80
    assert run.invalid == ()
    assert run.deviation.max() < 0.02
    drop = solve_catenaries(start, end, length).points(np.linspace(0, 1, 200))[:, 2].min()
    assert run.shape[:41, 2].min() == pytest.approx(drop, abs=0.01)


def test_sway_turns_a_strand_about_its_chord():
    """Tilted effective gravity turns a strand between level ends about its chord."""
    ends = np.array([[0.0, 0.0, 5.0], [2.0, 0.0, 5.0]])
    length, sideways = np.array([3.0]), np.tile([0.0, 2.0, 0.0], (2, 1))
    sag = float(solve_catenaries(*ends, length[0]).sag())
    turned = 2.0 * sag * np.sin(0.5 * np.arctan2(2.0, STANDARD_GRAVITY))
    assert rope.largest_swings(ends, sideways, length, 0.0) == pytest.approx(turned, rel=1e-3)
    at_rest = rope.largest_swings(ends, 0.0 * sideways, length, 2.0)
    assert at_rest >= turned * (1.0 - 1e-3)
    assert rope.largest_swings(ends, sideways, length, 2.0) == pytest.approx(
        turned + at_rest, rel=1e-3
    )


def test_residual_swing_is_reported_beyond_the_models_of_the_budget():
    line = np.array([[0.0, 0.0, 5.0], [2.0, 0.0, 5.0], [4.0, 0.0, 5.0]])
    layout = replace(PLAN.layout, corners=line, lengths=np.array([3.0, 2.02]))
    sag = float(solve_catenaries(line[0], line[1], 3.0).sag())
    rate = np.sqrt(STANDARD_GRAVITY / (0.8 * sag))  # of a parabola's swing about its chord
    times = np.arange(0.0, 8.0 * np.pi / rate, 0.02)
    aside = 0.5 / rate**2 * np.sin(rate * times)
    grips = rope.Grips(times, line + aside[:, None, None] * [0.0, 1.0, 0.0])
    run = rope.simulate_rope(replace(PLAN, layout=layout), grips, links=50)
    found = run.document()["deviation"]
    assert found["segment"] == 1
    assert found["largest"] == run.deviation.max() > 2.0 * found["allowed_swing"] > 0.0
    assert 0.0 < found["beyond_models"]["share"] < 0.5
    assert found["beyond_models"]["by"] == pytest.approx((run.deviation - run.allowed_swing).max())


def test_wind_tilts_the_rope_by_its_drag():
    line = np.array([[0.0, 0.0, 5.0], [2.0, 0.0, 5.0], [4.0, 0.0, 5.0]])
    layout = replace(PLAN.layout, corners=line, lengths=np.array([2.4, 2.4]))
    plan = replace(PLAN, layout=layout)
    wind = 6.0
    run = rope.simulate_rope(plan, still(line, 4.0), links=60, wind=(0.0, wind, 0.0))
    cable = plan.mission.cable
    tilt = 0.5 * 1.225 * 1.1 * cable.diameter * wind**2 / (cable.mass_per_length * 9.80665)
    low = run.shape[np.argmin(run.shape[:, 2])]
    # the slopes of the span have less wind across them, and it swings a little
    assert low[1] / (5.0 - low[2]) == pytest.approx(tilt, rel=0.2)


@pytest.mark.parametrize("contact", [True, False])
def test_strands_stop_each_other_only_with_contact(contact):
    """The strand above is lowered through the one below: with contact it must stay above."""
    plan = across(0.6)
    lowered = plan.layout.corners - [[0, 0, 0], [0, 0, 0], [0, 0, 0.9], [0, 0, 0.9]]
    grips = rope.Grips(np.array([0.0, 1.5, 2.0]), np.array([plan.layout.corners, lowered, lowered]))
    run = rope.simulate_rope(plan, grips, links=90, contact=contact)
    first, third = run.shape[:34], run.shape[53:]
    gaps = np.linalg.norm(first[:, None, :2] - third[None, :, :2], axis=2)
    under, over = np.unravel_index(gaps.argmin(), gaps.shape)
    higher = third[over, 2] - first[under, 2]
    if contact:
        assert run.contacts > 0
        assert higher > 0
        assert run.penetration < 0.5 * plan.mission.cable.diameter
    else:
        assert higher < -0.1
        assert run.contacts == 0
        assert run.invalid == ("contact is disabled: the resulting knot is no evidence",)


@pytest.mark.full
def test_a_tightened_overhand_keeps_its_knot():
    mission = mission_for_knot("overhand", ("finish=tighten",))
    plan = planner.plan(mission, robustness=False).plan
    run = rope.simulate_rope(plan, rope.planned_grips(plan))
    assert run.invalid == ()
    assert (run.knot, run.chirality, run.as_planned) == ("3_1", "right", True)
    assert run.span > 0.8 * plan.layout.lengths.sum()


def test_a_rope_that_is_pulled_taut_is_invalid():
    line = PLAN.layout.corners
    apart = line * [1.3, 1.0, 1.0]
    grips = rope.Grips(np.array([0.0, 1.0, 1.5]), np.array([line, apart, apart]))
    run = rope.simulate_rope(PLAN, grips, links=40)
    assert any("stretched" in reason for reason in run.invalid)
    assert not run.invalid[0].endswith(" is")


def test_links_are_distributed_by_length():
    counts = rope._distribute_links(np.array([1.0, 2.0, 7.0]), 100)
    assert counts.tolist() == [10, 20, 70]
    assert rope._distribute_links(np.array([0.1, 9.9]), 20).min() == 2


def test_a_rope_that_is_too_short_at_the_beginning_is_refused():
    with pytest.raises(Refused, match="begin too far apart"):
        rope.simulate_rope(PLAN, still(PLAN.layout.corners * [2.0, 1.0, 1.0], 1.0))


def test_the_planned_motion_is_that_of_fold_and_hold():
    grips = rope.planned_grips(PLAN)
    assert grips.times[0] == PLAN.phase("fold").start
    assert grips.times[-1] == PLAN.phase("hold").end
    middle = np.array([0.5 * (grips.times[0] + grips.times[-1])])
    assert np.allclose(grips.at(middle)[0], PLAN.motion.at(middle[0])[0], atol=1e-3)


def test_a_run_can_be_printed_as_json():
    run = rope.simulate_rope(PLAN, still(PLAN.layout.corners, 0.2), links=30)
    found = run.document()
    json.dumps(found, allow_nan=False)
    assert found["knot"]["type"] == "0_1"
    assert found["smallest_distance"] is None
