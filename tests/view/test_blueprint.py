"""The views of the knot in Rerun: the camera frames it, and nothing hides it."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import rerun.blueprint as rrb
from scipy.spatial.transform import Rotation

from swarm.planning import Plan
from swarm.view.blueprint import comparison_blueprint, flight_blueprint, plan_blueprint
from tests.reports.synthetic import trefoil_plan

PLAN = trefoil_plan()
KNOT_VIEWS = {"Knot", "Planned", "Flown"}
FIELD_VIEWS = {"Field", "Planned and flown"}


def spatial_views(plan: Plan) -> list[Any]:
    def found(part: Any) -> Iterator[Any]:
        if isinstance(part, rrb.Spatial3DView):
            yield part
        for inner in getattr(part, "contents", ()):
            if not isinstance(inner, str):
                yield from found(inner)

    arranged = (partial(flight_blueprint, live=False), plan_blueprint, comparison_blueprint)
    return [view for arrange in arranged for view in found(arrange(plan).root_container)]


VIEWS = {f"{number} {view.name}": view for number, view in enumerate(spatial_views(PLAN))}


def trails(view: Any) -> list[float]:
    """Return the seconds of trail of a view's entities."""
    shown = view.visualizer_overrides.values()
    ranges = [np.atleast_1d(one)[0].ranges.as_arrow_array().to_pylist()[0] for one in shown]
    return [-one["range"]["start"] / 1e9 for one in ranges]


@pytest.mark.parametrize("view", VIEWS.values(), ids=VIEWS.keys())
def test_trails_are_short_and_no_path_is_drawn_where_the_knot_is_seen(view: Any) -> None:
    knot = view.name in KNOT_VIEWS
    assert knot or view.name in FIELD_VIEWS
    assert trails(view) == [1.5 if knot else 8.0] * 2
    assert not knot or "- /plan/path" in view.contents


@pytest.mark.parametrize("scale", [0.5, 1.0, 4.0])
def test_the_folded_knot_and_its_vehicles_fill_the_view(scale: float) -> None:
    layout = PLAN.layout
    corners = layout.corners * [scale, scale, 1.0]
    lengths = layout.lengths * max(scale, 1.0)
    plan = replace(PLAN, layout=replace(layout, corners=corners, lengths=lengths))
    view = next(view for view in spatial_views(plan) if view.name == "Knot")
    camera = view.properties["EyeControls3D"]
    eye, target = (
        np.array(part.as_arrow_array().to_pylist()[0])
        for part in (camera.position, camera.look_target)
    )
    # The camera's frame: x to the right, y ahead, z up in the picture.
    ahead = target - eye
    turned = Rotation.from_euler(
        "ZX",
        [
            np.arctan2(-ahead[0], ahead[1]),
            np.arctan2(ahead[2], np.hypot(*ahead[:2])),
        ],
    )
    vehicles = plan.mission.vehicles
    tops = corners + np.array([0.0, 0.0, vehicles.grip_offset + vehicles.radius])
    seen = turned.inv().apply(np.concatenate([corners, tops]) - eye)
    tangent = np.tan(np.radians(27.5))
    share = np.abs(seen[:, [0, 2]] / seen[:, [1]]) / (tangent * np.array([1.5, 1.0]))
    assert seen[:, 1].min() > 0.0
    assert 0.6 < share.max() <= 0.9
