"""What is refused before a mission is folded."""

import numpy as np
import pytest

from swarm.errors import Refused
from swarm.mission import mission_for_knot, parse_mission
from swarm.mission.fleet import emulated_fleet
from swarm.planning.candidates import make_plan
from swarm.planning.estimates import refuse_overload, require_fleet, vehicles_needed

FORMATION = "{schema: 1, name: two, formation: {places: [[[0, 0, 2], [3, 0, 2]]]}}"
CORNERS = "{corners: [[0, 0], [2, 0], [2, 2], [1, -1]], sags: [0.5, 0.5, 0.6]}"


def test_a_cable_that_is_too_heavy_is_refused_with_the_heaviest_that_can_be_carried():
    with pytest.raises(Refused) as caught:
        make_plan(mission_for_knot("overhand", ["vehicles.payload=0.015"]))
    assert str(caught.value) == (
        "payload: 9 vehicles of 15 g payload carry at most 3.3 g/m in this layout, where one "
        "vehicle holds at least 4.5 m of cable; cable.mass_per_length is 12 g/m. For example: "
        "--set cable.mass_per_length=0.0011, or vehicles that carry more: "
        "--set vehicles.payload=0.16"
    )


@pytest.mark.parametrize(
    ("payload", "refused"), [(0.0359, True), (0.0361, False)], ids=["less", "more"]
)
def test_the_limit_is_half_of_the_two_longest_neighbouring_segments(payload, refused):
    """Corners 2 and 4 m apart: 3 m hang on the vehicle between them, 36 g of the default cable."""
    corners = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 4.0], [2.0, 3.0]])
    mission = mission_for_knot("overhand", [f"vehicles.payload={payload}"])
    if refused:
        with pytest.raises(Refused, match="4 vehicles of 36 g payload"):
            refuse_overload(mission, [corners])
    else:
        refuse_overload(mission, [corners])


@pytest.mark.parametrize(
    ("mission", "count"),
    [
        (mission_for_knot("overhand"), 9),
        (mission_for_knot("figure-eight"), 11),
        (mission_for_knot("figure-eight", ["vehicles.count=7"]), 7),
        (mission_for_knot("figure-eight", ["vehicles.count=fewest"]), 6),
        (mission_for_knot("overhand", [f"layout={CORNERS}"]), 4),
        (parse_mission(FORMATION, "m.yaml"), 2),
    ],
)
def test_the_number_of_vehicles_is_known_before_planning(mission, count):
    assert vehicles_needed(mission) == count


def test_a_fleet_of_another_number_is_refused_before_planning():
    mission = mission_for_knot("overhand")
    require_fleet(mission, emulated_fleet(9))
    with pytest.raises(Refused, match=r"^the plan needs 9 vehicles, the fleet emulator has 3$"):
        require_fleet(mission, emulated_fleet(3))
