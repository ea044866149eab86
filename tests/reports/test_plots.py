import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from swarm.errors import InputError
from swarm.reports import plots
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
    plots.plot_plan(PLAN, path)
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


def test_a_plan_without_a_grid_is_drawn_without_one() -> None:
    free = replace(PLAN, knot=replace(PLAN.knot, grid_columns=()))
    assert len(plots.plan_figure(free).axes) == 2
    assert len(plots.plan_figure(PLAN).axes) == 3


def test_places_along_the_path_end_at_the_corners() -> None:
    fold = PLAN.phase("fold")
    times = np.linspace(fold.start, fold.end, 50)
    places = plots.places_along_path(PLAN, times)
    arc = np.append(0.0, np.linalg.norm(np.diff(PLAN.path, axis=0), axis=1).cumsum())
    assert places[-1, 0] == pytest.approx(0.0, abs=1e-9)
    assert places[-1, -1] == pytest.approx(arc[-1], abs=1e-9)
    assert (np.diff(places, axis=0) >= 0).all()
    assert (np.diff(places[-1]) > 0).all()


def test_schedule_picture_is_written(tmp_path: Path) -> None:
    plots.plot_schedule(PLAN, tmp_path / "schedule.png")
    assert imread(tmp_path / "schedule.png").shape[1] > 800


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
         "dominated": dominated}
        for variant, cable, fold, error, dominated in zip(
            ("least", "the mission's", "roomy"), (60.0, 70.0, 90.0), (110.0, 130.0, 150.0),
            tracking, (True, False, False), strict=True,
        )
    ]  # fmt: skip
    figure = plots.pareto_figure(points)
    axes = figure.axes[0]
    assert [text.get_text().split("\n")[0] for text in axes.texts] == [
        f"e* {value:.3f} m" for value in tracking
    ]
    assert axes.lines[0].get_markersize() < axes.lines[2].get_markersize()


def test_a_picture_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        plots.plot_plan(PLAN, tmp_path / "none" / "plan.png")
