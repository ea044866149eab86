"""Repairs on the motion as it is flown: paced and shaped, so nowhere on its path."""

from functools import cache

import numpy as np
import numpy.typing as npt
import pytest

from swarm import planner
from swarm.folding.penalty import missed_margins
from swarm.folding.schedule import Flown, Schedule, improve
from swarm.mission import mission_for_knot
from swarm.planner.pacing import Pacing, timed_for_losses
from swarm.planning.candidates import candidates
from swarm.planning.flown import flown_stages

Floats = npt.NDArray[np.float64]


@cache
def first_candidate() -> tuple[Schedule, Pacing, Flown]:
    """The first folding of a figure-eight, not yet repaired, how it is paced, and its stages."""
    with planner.one_thread():
        first = next(candidates(mission_for_knot("4_1")))
        pacing = timed_for_losses(first.plan).pacing
    assert first.folding is not None
    assert pacing is not None
    schedule = first.folding.schedule
    return schedule, pacing, flown_stages(schedule, pacing.paced, pacing.shaper)


def as_flown(schedule: Schedule, flown: Flown) -> Floats:
    """Positions (m, n, 3) of the team, one stage after the other of each moment."""
    each = [schedule.at(stages)[0] for stages in flown.stages.T]
    found: Floats = np.einsum("k,kmni->mni", flown.shares, np.stack(each))
    return found


def test_the_mean_over_the_stages_is_the_shaped_motion() -> None:
    schedule, pacing, flown = first_candidate()
    times = np.linspace(0.0, pacing.shaped.times[-1], len(flown.stages))
    expected = pacing.shaped.at(times)[0]
    found = as_flown(schedule, flown)
    height = (expected - found)[0, 0]
    assert height[:2] == pytest.approx(0.0, abs=1e-6)
    assert np.abs(found + height - expected).max() < 0.01
    on_path = schedule.at(flown.stages @ flown.shares)[0]
    assert np.abs(on_path + height - expected).max() > 0.1, "it is far from its path"


def test_stages_with_a_given_mean_are_found_between_those_of_moments() -> None:
    flown = Flown(np.array([[0.0, 0.0], [4.0, 0.0], [8.0, 8.0]]), np.array([0.25, 0.75]))
    assert flown.at(np.array([0.0, 0.5, 1.0, 4.5, 8.0])) == pytest.approx(
        np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.0], [6.0, 4.0], [8.0, 8.0]])
    )


def test_a_schedule_is_improved_on_its_path_and_as_it_is_flown() -> None:
    schedule, _, flown = first_candidate()
    with planner.one_thread():
        on_path, on_both = improve(schedule), improve(schedule, flown)
    misses = [
        float(missed_margins(schedule.team, as_flown(one, flown)).max())
        for one in (schedule, on_path, on_both)
    ]
    assert min(misses[:2]) > 0.1, "on its path alone it misses margins where it is flown"
    assert misses[2] < 0.5 * min(misses[:2])
    stages = np.linspace(0.0, on_both.last_stage, 1000)
    before, after = (
        float(missed_margins(schedule.team, one.at(stages)[0]).max()) for one in (schedule, on_both)
    )
    assert after < before + 0.05
