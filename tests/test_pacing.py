"""The timing of folds: rates that are lowered in time, smooth, and no faster than before."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm.certification.stream_loss import sampled_rates
from swarm.mission.mission import mission_for_knot
from swarm.planner.pacing import PacedPlan, Pacing, slowed_for_swing, timed_for_losses
from swarm.planning.candidates import make_plan
from swarm.planning.shaping import shaper_for
from tests.test_shaping import carry

SHAPER = shaper_for(np.array([0.6, 1.4]))


def pacing() -> Pacing:
    motion, _ = carry(12.0)
    at = np.linspace(0.0, motion.times[-1], round(motion.times[-1] / 0.05) + 1)
    return Pacing(motion, SHAPER, at, np.ones(len(at)), np.ones(len(at)))


@given(st.floats(0.0, 11.0), st.floats(0.3, 0.99))
@settings(max_examples=30, deadline=None)
def test_a_lower_rate_holds_where_it_was_asked_for_and_time_goes_on(
    moment: float, rate: float
) -> None:
    before = pacing()
    times = np.arange(0.0, 15.0, 0.25)
    asked = np.where(np.abs(times - moment) < 0.3, rate, 1.0)
    after = before.slowed_for_loss(times, asked)
    first, last = before.paced, after.paced
    assert (np.diff(last.time) > 0.0).all()
    assert (last.rate <= first.rate + 1e-12).all()
    assert (last.rate >= 0.2 - 1e-9).all()
    around = np.abs(first.time + 0.5 * SHAPER.delays[-1] - moment) < 0.3
    assert (last.rate[around] <= max(rate, 0.75) + 0.02).all()
    # The rate changes within half a second or more: accelerations along the path stay small.
    assert np.abs(last.slope).max() <= (1.0 - rate) * 1.01 + 1e-9


def test_a_much_lower_rate_is_reached_step_by_step() -> None:
    """A slower motion is shaped less, and may pass where no rate helped before."""
    times, slowed = np.arange(0.0, 15.0, 0.25), pacing()
    least = []
    for _ in range(7):
        slowed = slowed.slowed_for_loss(times, np.where(np.abs(times - 7.0) < 0.3, 0.3, 1.0))
        least.append(slowed.loss.min())
    assert least == pytest.approx([0.75, 0.75**2, 0.75**3, 0.75**4, 0.75**5, 0.2, 0.2])


def test_slowing_for_the_swing_acts_before_the_swing_only() -> None:
    before = pacing()
    times = np.arange(0.0, 15.0, 0.1)
    after = before.slowed_for_swing(times, np.where(times > 12.0, 2.0, 0.5), 0.3)
    early = before.at < 12.0 - SHAPER.delays[-1] - 6.1
    assert early.sum() > 10
    assert after.paced.rate[early] == pytest.approx(1.0, abs=1e-6)
    assert after.paced.rate[-1] < 0.7


def test_no_round_raises_a_rate_that_another_lowered_further() -> None:
    before, times = pacing(), np.arange(0.0, 15.0, 0.1)
    everywhere = np.full(len(times), 100.0)
    slowest = before.slowed_for_swing(times, everywhere, 0.2)
    again = slowest.slowed_for_swing(times, everywhere, 0.3)
    assert slowest.swing == pytest.approx(0.2)
    assert again.swing == pytest.approx(0.2)


def test_slowing_that_lost_setpoints_do_not_need_is_undone_where_it_was_slowed() -> None:
    before, times = pacing(), np.arange(0.0, 60.0, 0.25)
    slow = before.slowed_for_loss(times, np.full(len(times), 0.3))
    as_allowed = slow.quicker_for_loss(times, np.ones(len(times)))
    assert as_allowed.loss == pytest.approx(slow.loss)
    slower = slow.quicker_for_loss(times, np.full(len(times), 0.9))
    assert slower.loss == pytest.approx(0.9 * slow.loss)
    quick = slow
    for _ in range(4):
        quick = quick.quicker_for_loss(times, np.full(len(times), 2.0))
        assert quick.loss.max() <= 1.0
    assert quick.loss == pytest.approx(1.0)


@pytest.mark.slow
def test_a_fold_beyond_the_endurance_is_slowed_no_more_than_losses_need() -> None:
    # of 5_2, which is slowed by 5 to 7 s too much: that of 4_1 depends on the CPU, 0.05 to 0.2 s
    plan = make_plan(mission_for_knot("5_2"))
    usual = timed_for_losses(plan).plan
    vehicles = plan.mission.vehicles.model_copy(update={"endurance": usual.flight_duration - 1.0})
    mission = plan.mission.model_copy(update={"vehicles": vehicles})
    quick = timed_for_losses(replace(plan, mission=mission)).plan
    assert quick.flight_duration < vehicles.endurance
    assert sampled_rates(quick, 0.25, 0.02)[1].min() == 1.0


def test_a_slowed_motion_is_as_smooth_and_ends_at_the_same_place() -> None:
    before = pacing()
    times = np.arange(0.0, 15.0, 0.25)
    after = before.slowed_for_loss(times, np.where(np.abs(times - 6.0) < 1.0, 0.5, 1.0))
    fast, slow = before.shaped, after.shaped
    assert slow.times[-1] > fast.times[-1]
    assert slow.at(np.inf)[0] == pytest.approx(fast.at(np.inf)[0])
    joints = slow.times[1:-1]
    for order in range(3):
        left, right = slow.at(joints - 1e-7)[order], slow.at(joints + 1e-7)[order]
        assert left == pytest.approx(right, abs=1e-4)
    assert np.linalg.norm(slow.at(slow.times)[1], axis=2).max() <= 2.0


@pytest.mark.slow
def test_the_usual_limit_of_the_swing_gives_way_to_the_endurance() -> None:
    """The plan is slowed as far as the endurance allows; a limit in metres is kept."""
    timed = timed_for_losses(make_plan(mission_for_knot("4_1", ["vehicles.max_acceleration=3.0"])))
    fast, slow = (one.plan.flight_duration for one in (timed, slowed_for_swing(timed)))
    assert slow > fast + 2.0

    def with_endurance(share: float, swing: float | str) -> float:
        mission = timed.plan.mission
        vehicles = mission.vehicles.model_copy(update={"endurance": fast + share * (slow - fast)})
        fold = mission.fold.model_copy(update={"swing": swing})
        mission = mission.model_copy(update={"vehicles": vehicles, "fold": fold})
        limited = PacedPlan(replace(timed.plan, mission=mission), timed.pacing)
        return (slowed_for_swing(limited).plan.flight_duration - fast) / (slow - fast)

    assert with_endurance(1.0, "auto") == pytest.approx(1.0)
    assert 0.5 < with_endurance(0.8, "auto") <= 0.8
    assert 0.2 < with_endurance(0.5, "auto") <= 0.5
    assert with_endurance(0.0, "auto") == 0.0
    assert with_endurance(0.5, 0.06) > 0.8
