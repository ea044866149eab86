"""Layouts of the mission: fitted to a cable, or given by corners and sags."""

from pathlib import Path

import numpy as np
import pytest

from swarm import planner
from swarm.errors import InputError, Refused
from swarm.knots.catalog import lookup_knot
from swarm.knots.grid import openings
from swarm.mission import Mission, mission_for_knot, parse_mission
from swarm.planning.candidates import make_plan
from swarm.planning.foldings import (
    fit_to_cable,
    grid_margins,
    lay_out_apart,
    layout_sizes,
    planning_margins,
)


def refusal(*overrides: str) -> str:
    with pytest.raises(InputError) as caught:
        mission_for_knot("overhand", overrides)
    return str(caught.value)


@pytest.mark.parametrize("length", [60.0])
def test_a_layout_is_rescaled_to_use_the_whole_cable(length: float) -> None:
    mission = mission_for_knot("overhand", [f"cable.length={length}"])
    margins = planning_margins(mission)
    diagram = openings(lookup_knot("overhand").grid)[0]
    shape = next(layout_sizes(mission, margins))
    scaled = fit_to_cable(diagram, shape, margins)
    factor = scaled.cell / shape.cell
    assert scaled.lane_over == pytest.approx(factor * shape.lane_over)
    assert scaled.slope == pytest.approx(factor * shape.slope)
    used = lay_out_apart(diagram, scaled, margins).lengths.sum()
    assert length - 1e-3 < used <= length


def test_a_cable_that_is_too_short_is_refused_with_the_resulting_distance() -> None:
    with pytest.raises(Refused) as caught:
        make_plan(mission_for_knot("overhand", ["cable.length=12.0"]))
    assert "cable.length 12 m, a cell of 0.129 m: vehicles would rest 0.18 m apart" in str(
        caught.value
    )


def test_a_given_cable_requires_a_layout_that_can_be_scaled() -> None:
    words = "overhand: expected cable.length only with a layout that the planner chooses and scales"
    assert refusal("cable.length=50", "layout.cell=2.0").startswith(words)
    assert refusal("cable.length=50", "fold.method=paper").endswith("got fold.method: paper too")


def star(*keys: str) -> Mission:
    turns = 2 * np.pi * np.array([0, 2, 4, 1, 3]) / 5
    corners = [[float(7 * np.cos(a)), float(7 * np.sin(a))] for a in turns]
    text = f"""{{schema: 1, name: star, knot: {{name: 3_1, chirality: either}},
        layout: {{corners: {corners}, sags: [2.8, 0.6, 3.9, 1.7]}}}}"""
    return parse_mission(text, "star.yaml", keys)


def test_segments_that_cross_and_sag_alike_are_refused() -> None:
    with pytest.raises(Refused, match="segments 1 and 3 cross and both sag 2 m"):
        make_plan(star("layout.sags=[2, 1, 2, 3]"))


@pytest.mark.slow
def test_a_given_layout_that_exceeds_the_endurance_is_refused_with_that_error() -> None:
    path = Path(__file__).parents[1] / "missions" / "overhand_five.yaml"
    mission = parse_mission(path.read_text(), str(path), ["vehicles.endurance=60"])
    result = planner.plan(mission, robustness=False)
    assert not result.certificate.cleared
    errors = [found.check for found in result.certificate.findings if found.severity == "error"]
    assert "endurance" in errors
    assert result.plan.flight_duration > 60.0


@pytest.mark.parametrize(
    ("keys", "margin"),
    [([], 0.22), (["layout.chord_margin=0.47"], 0.47), (["layout.chord_margin=0"], 0.0)],
)
def test_ends_can_be_farther_apart_than_their_corners_by_the_chord_margin(
    keys: list[str], margin: float
) -> None:
    mission = mission_for_knot("overhand", [*keys, "layout.cell=3"])
    margins = planning_margins(mission)
    diagram = openings(lookup_knot("overhand").grid)[0]
    layout = lay_out_apart(diagram, next(layout_sizes(mission, margins)), margins)
    spans = np.linalg.norm(np.diff(layout.corners, axis=0), axis=1)
    # as little as needed: the slack of each segment and the distances at crossings may give more
    farther = 0.98 * 0.985 * layout.lengths - spans
    assert farther.min() >= margin - 1e-9
    if margin > 0.22:
        assert farther.min() == pytest.approx(margin, abs=1e-6)


def test_strands_have_room_only_where_the_planner_chooses_and_the_budget_has_to_close() -> None:
    def room(*keys: str) -> float:
        mission = mission_for_knot("overhand", keys)
        return grid_margins(mission).cable - planning_margins(mission).cable

    assert room() == pytest.approx(0.1)
    assert room("fold.swing=0.06") == 0.0
    assert room("limits.accept_negative_budget=true") == 0.0
    assert room("cable.length=50") == 0.0
    wide = mission_for_knot("overhand")
    as_wide = next(layout_sizes(wide, planning_margins(wide))).cell
    assert next(layout_sizes(wide, grid_margins(wide))).cell == as_wide
