import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from missions.gallery import shaping_figure
from swarm.certification.clearances import Moment
from swarm.errors import InputError, Refused
from swarm.reports import plots, study_plots
from tests.reports.synthetic import CROSSINGS, trefoil_plan

PLAN = trefoil_plan()


def drawn(figure: Figure) -> np.ndarray:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=figure.dpi)
    buffer.seek(0)
    return (255 * imread(buffer)[..., :3]).astype(np.uint8)


def ink_at(figure: Figure, axes: plots.Axes, x: float, y: float) -> bool:
    """Return whether a dark or coloured pixel is at a place in data coordinates."""
    image = drawn(figure)
    column, row = axes.transData.transform((x, y))
    pixel = image[image.shape[0] - 1 - round(row), round(column)].astype(int)
    return bool(pixel.min() < 160)


def test_plan_picture_is_written(tmp_path: Path) -> None:
    path = tmp_path / "plan.png"
    plots.save(plots.plan_figure(PLAN), path)
    picture = imread(path)
    assert picture.shape[1] > 1200
    assert picture[..., :3].std() > 0.05
    assert path.stat().st_size < 300_000


def test_under_strands_have_gaps_and_over_strands_none() -> None:
    figure = Figure(figsize=(6, 6), dpi=100)
    axes = figure.add_subplot()
    plots.draw_plan_view(axes, PLAN.layout)
    corners = PLAN.layout.corners[:, :2]
    for over, under in CROSSINGS:
        a, b = corners[over], corners[under]
        u, w = corners[over + 1] - a, corners[under + 1] - b
        share, _ = np.linalg.solve(np.column_stack([u, -w]), b - a)
        place = a + share * u
        assert ink_at(figure, axes, *place)
        aside = 0.1 * w / np.linalg.norm(w)
        assert not ink_at(figure, axes, *(place + aside))
        assert not ink_at(figure, axes, *(place - aside))
        along = 0.1 * u / np.linalg.norm(u)
        assert ink_at(figure, axes, *(place + along))


def test_grid_diagram_breaks_rows_below_columns_only() -> None:
    figure = Figure(figsize=(5, 5), dpi=100)
    axes = figure.add_subplot()
    plots.draw_grid(axes, PLAN.knot)
    for column, row in ((1, 2), (3, 1), (2, 3)):
        assert ink_at(figure, axes, column, row)
        assert not ink_at(figure, axes, column + 0.1, row)
        assert ink_at(figure, axes, column, row + 0.1)
    assert ink_at(figure, axes, 0, 1)
    assert not ink_at(figure, axes, 0, 3)


def test_the_grid_diagram_is_numbered_like_the_plan_view() -> None:
    places = plots.grid_places(PLAN.knot, PLAN.layout)
    assert places is not None
    assert np.allclose(places * 1.2 - 2.4, PLAN.layout.corners[:, :2])
    axes = Figure().add_subplot()
    plots.draw_grid(axes, PLAN.knot, PLAN.layout)
    shown = {text.get_text(): text.get_position() for text in axes.texts}
    assert shown == {str(k): tuple(place) for k, place in enumerate(places.tolist(), 1)}
    edges = [line for line in axes.collections if line.get_linestyle()[0][1] is not None]
    assert len(edges) == 2  # the dotted row and column without cable


def test_a_grid_diagram_of_another_layout_has_no_numbers() -> None:
    aside = PLAN.layout.corners.copy()
    aside[3, 0] += 0.4
    for corners in (aside, PLAN.layout.corners[:-1], PLAN.layout.corners[::-1] * [1, -1, 1]):
        axes = Figure().add_subplot()
        plots.draw_grid(axes, PLAN.knot, replace(PLAN.layout, corners=corners))
        assert not axes.texts


def test_labels_are_spread_and_keep_their_order() -> None:
    values = np.array([0.0, 0.1, 5.0, 0.05, 9.0])
    places = plots.spread_labels(values, 1.0)
    assert np.diff(np.sort(places)).min() >= 1.0 - 1e-12
    assert (np.argsort(places) == np.argsort(values)).all()
    assert places[0] == 0.0
    assert (places[2], places[4]) == (5.0, 9.0)


def test_a_label_of_a_curve_is_far_from_other_curves() -> None:
    times = np.linspace(0.0, 10.0, 101)
    curves = np.stack([np.sin(times), np.zeros(101), 1.2 * np.cos(times)], axis=1)
    labels = plots.places_of_labels(times, curves)
    for curve, k in enumerate(labels):
        assert np.abs(np.delete(curves[k], curve) - curves[k, curve]).min() > 0.5
    assert len(set(labels)) == 3


def moment(distance: float, time: float) -> Moment:
    between = ("segment 2", "segment 7")
    return Moment("cable clearance", between, distance, 0.15, time, (0.0, 0.0, 0.0))


@pytest.mark.parametrize("time", [10.0, 70.0])
def test_the_certified_distance_does_not_overprint_the_required_one(time: float) -> None:
    figure, axes = plots.new_axes((8.0, 2.8))
    times = np.linspace(0.0, 80.0, 9)
    plots.draw_clearance(axes, times, np.full(9, 1.0), 0.15, "title", moment(0.2, time))
    figure.draw_without_rendering()
    required, certified = (text.get_window_extent() for text in axes.texts)
    assert certified.width > 0
    assert not required.overlaps(certified)
    assert [text.get_text() for text in axes.texts] == [
        "required 0.15 m",
        "certified 0.20 m, segments 2 and 7",
    ]


def test_a_plan_without_a_grid_is_drawn_without_one() -> None:
    free = replace(PLAN, knot=replace(PLAN.knot, grid_columns=()))
    assert len(plots.plan_figure(free).axes) == 2
    assert len(plots.plan_figure(PLAN).axes) == 3


def test_remaining_ways_end_at_the_corners_and_begin_with_all_of_the_way() -> None:
    fold = PLAN.phase("fold")
    times = np.linspace(fold.start, fold.end, 400)
    remaining = plots.remaining_ways(PLAN, times)
    assert (remaining[-1] == 0.0).all()
    assert (np.diff(remaining, axis=0) <= 0.0).all()
    first, last = PLAN.motion.at(times[[0, -1]])[0]
    assert (remaining[0] >= np.linalg.norm(last - first, axis=1) - 1e-9).all()
    speed = np.linalg.norm(PLAN.motion.at(times)[1], axis=2)
    whole = np.trapezoid(speed, times, axis=0)
    assert remaining[0] == pytest.approx(whole, rel=1e-3)


def test_schedule_picture_is_written(tmp_path: Path) -> None:
    plots.save(plots.schedule_figure(PLAN), tmp_path / "schedule.png")
    assert imread(tmp_path / "schedule.png").shape[1] > 800


def test_the_swing_of_two_timings_is_drawn(tmp_path: Path) -> None:
    plots.save(shaping_figure(PLAN, PLAN), tmp_path / "swing.png")
    assert imread(tmp_path / "swing.png").shape[1] > 800
    grounded = tuple(phase for phase in PLAN.phases if phase.name != "fold")
    with pytest.raises(Refused, match="the plan folds no cable"):
        shaping_figure(PLAN, replace(PLAN, phases=grounded))


@pytest.mark.parametrize("vehicles", [1, 2, 3])
def test_a_line_and_a_point_are_drawn(vehicles: int) -> None:
    layout = replace(
        PLAN.layout,
        corners=np.array([[3.0 * k, 2.0, 5.0] for k in range(vehicles)]),
        lengths=np.full(vehicles - 1, 3.4),
        sags=np.full(vehicles - 1, 0.7),
        lanes=np.zeros(vehicles - 1),
        crossings=(),
        cell=0.0,
    )
    knot = replace(PLAN.knot, type="", grid_columns=())
    figure = plots.plan_figure(replace(PLAN, layout=layout, knot=knot))
    low, high = figure.axes[0].get_ylim()
    assert high - low > 0.25 * (vehicles - 1)
    assert ink_at(figure, figure.axes[0], 0.0, 2.0)


def test_the_pareto_figure_shows_every_plan_with_its_tracking_error() -> None:
    tracking = np.array([0.01, 0.12, 0.2])
    points = [
        {"variant": variant, "cable_length": cable, "fold_time": fold, "max_tracking_error": error,
         "dominated": dominated, "vehicles": 9, "payload": 0.2}
        for variant, cable, fold, error, dominated in zip(
            ("least", "the mission's", "roomy"), (60.0, 70.0, 90.0), (110.0, 130.0, 150.0),
            tracking, (True, False, False), strict=True,
        )
    ]  # fmt: skip
    figure = study_plots.pareto_figure(points)
    axes = figure.axes[0]
    assert [text.get_text() for text in axes.texts] == ["1", "2", "3"]
    legend = axes.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == [
        "least, e* 0.010 m",
        "the mission's, e* 0.120 m",
        "roomy, e* 0.200 m",
    ]
    marks = [line.get_markersize() for line in axes.lines if len(line.get_xdata())]
    assert marks == sorted(marks)
    assert marks[0] < marks[-1]
    assert len(figure.axes) == 1


def test_plans_with_several_numbers_of_vehicles_are_drawn_over_these() -> None:
    points = [
        {"variant": f"{vehicles} vehicles", "vehicles": vehicles, "cable_length": cable,
         "fold_time": fold, "max_tracking_error": 0.1, "payload": payload, "dominated": False}
        for vehicles, cable, fold, payload in ((5, 34.0, 46.0, 0.25), (9, 33.0, 52.0, 0.125))
    ]  # fmt: skip
    by_vehicles = study_plots.pareto_figure(points).axes[1:]
    assert [axes.get_ylabel() for axes in by_vehicles] == [
        "cable, m",
        "fold, s",
        "e*, m",
        "payload, g",
    ]
    drawn = [(line.get_xdata()[0], line.get_ydata()[0]) for line in by_vehicles[3].lines]
    assert drawn == [(5, 250.0), (9, 125.0)]


def test_a_picture_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        plots.save(plots.plan_figure(PLAN), tmp_path / "none" / "plan.png")
