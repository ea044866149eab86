from dataclasses import replace

import numpy as np
import pytest

from swarm.reports import study_plots
from tests.reports.test_plots import ink_at


def run(label: str, cable: list[float], failing: list[bool]) -> study_plots.TrialDistances:
    values = np.array(cable)
    return study_plots.TrialDistances(
        label=label,
        by_kind={
            "cable": values,
            "vehicle": values + 1.0,
            "vehicle_cable": values,
            "emulated_cable": values,
        },
        tracking_error=np.linspace(0.05, 0.15, len(values)),
        with_failure=np.array(failing),
        tracking_radius=np.array([0.0, 0.1, 0.2]),
        certified={
            name: np.array([0.5, 0.3, -np.inf]) for name in ("cable", "vehicle", "vehicle_cable")
        },
    )


def test_distributions_of_both_trajectories_have_no_trials_with_a_failure() -> None:
    ours = run("this plan", [0.6, 0.7, np.nan, 0.1], [False, False, False, True])
    paper = run("the paper's trajectory", [0.01, 0.02, 0.03, 0.04], [False] * 4)
    required = {"cable": 0.15, "vehicle": 1.0, "vehicle_cable": 0.3}
    figure = study_plots.trials_figure([ours, paper], required)
    above = figure.axes[0]
    steps = [
        line for line in above.lines if len(line.get_xdata()) > 1 and line.get_linestyle() == "-"
    ]
    assert [list(line.get_xdata()) for line in steps] == [
        [0.6, 0.6, 0.7], [0.01, 0.01, 0.02, 0.03, 0.04],
    ]  # fmt: skip
    assert list(steps[0].get_ydata()) == [0.0, 0.5, 1.0]
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"this plan (2 trials)", "the paper's trajectory (4 trials)"} < set(words)
    below = figure.axes[3]
    assert [len(line.get_xdata()) for line in below.lines[:3]] == [2, 2, 1]
    assert below.get_title() == "Flown and certified, this plan"
    assert "trials with a failure (1 of 1 beyond the right edge)" in words


def test_a_distance_that_no_trial_has_has_no_picture() -> None:
    two = run("this plan", [np.nan, np.nan], [False, False])
    two = replace(two, by_kind={**two.by_kind, "vehicle": np.array([2.7, 2.8])})
    required = {"cable": 0.15, "vehicle": 1.0, "vehicle_cable": 0.3}
    figure = study_plots.trials_figure([two], required)
    assert [axes.get_title() for axes in figure.axes] == [
        "Vehicle to vehicle",
        "Flown and certified",
    ]


@pytest.mark.slow
def test_the_upper_strand_of_a_rope_covers_the_lower() -> None:
    along = np.linspace(-1.0, 1.0, 41)
    first = np.column_stack([along, 0 * along, 0 * along])
    back = np.array([[1.5, 1.5, 0.5]])
    second = np.column_stack([0 * along, -along, 0 * along + 1.0])
    shape = np.concatenate([first, back, second])
    moved = study_plots.RopeCurves(
        "this plan", "0_1", np.arange(3.0), np.array([0.0, 0.1, 0.2]), np.full(3, 0.1), np.ones(3),
        np.ones(3), shape,
    )  # fmt: skip
    figure = study_plots.rope_figure([moved], 0.15)
    above = figure.axes[2]
    assert ink_at(figure, above, 0.0, 0.3)
    assert ink_at(figure, above, 0.5, 0.0)
    assert not ink_at(figure, above, 0.02, 0.0)
