"""Distances of vehicles and cable from obstacles, against brute force that shares no code."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm.certification.air import wind_tilt
from swarm.certification.assessment import assess
from swarm.certification.clearances import (
    PlanChecks,
    certified,
    failure_in_wind,
    tightest_moments,
)
from swarm.certification.contingency_windows import contingency_windows
from swarm.certification.kinds import KINDS
from swarm.certification.monitor import Monitor
from swarm.certification.motion_bounds import BoundedMotion
from swarm.certification.strand_pieces import LEAVES, HeldCable, TubeRadii
from swarm.certification.stream_loss import certify_stream_loss
from swarm.flight.separation import UP, separation_motion
from swarm.planning import digest
from tests.certification.oracle import catenary, displaced
from tests.certification.synthetic import moving, plan_of, wandering
from tests.certification.test_wind import leaning

LENGTHS = np.array([3.4, 3.6])
CLEARANCE, TRACKING = 0.2, 0.08
TABLE = {"name": "table", "shape": "box", "centre": [1.4, 0.4], "size": [2.0, 1.0], "top": 4.8,
         "bottom": 4.0, "turn": 25.0}  # fmt: skip
POST = {"name": "post", "shape": "cylinder", "centre": [3.6, 2.4], "radius": 0.4, "top": 9.0}
NET = {"name": "net", "shape": "half-space", "point": [0.0, -3.0, 0.0], "normal": [0.1, 1.0, -0.3]}


def beside(motion, lengths=LENGTHS, *overrides, obstacles=(TABLE, POST, NET), **options):
    return plan_of(
        motion, lengths, "workspace.obstacles=" + json.dumps(obstacles),
        f"vehicles.tracking={TRACKING}", *overrides, **options,
    )  # fmt: skip


def from_obstacle(obstacle, points):
    """Distances of points (…, 3) from an obstacle; of inner ones, from its surface, negative."""
    if obstacle["shape"] == "half-space":
        normal = np.array(obstacle["normal"])
        return (points - obstacle["point"]) @ normal / np.linalg.norm(normal)
    aside, height = points[..., :2] - obstacle["centre"], points[..., 2]
    above = np.maximum(height - obstacle["top"], obstacle.get("bottom", 0.0) - height)
    if obstacle["shape"] == "cylinder":
        beyond = np.stack([np.hypot(*np.moveaxis(aside, -1, 0)) - obstacle["radius"], above])
    else:
        turn = np.radians(obstacle.get("turn", 0.0))
        east = aside @ [np.cos(turn), np.sin(turn)]
        north = aside @ [-np.sin(turn), np.cos(turn)]
        width, depth = np.array(obstacle["size"]) / 2.0
        beyond = np.stack([np.abs(east) - width, np.abs(north) - depth, above])
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=0)
    return np.where((beyond > 0.0).any(axis=0), outside, beyond.max(axis=0))


def body(mission, count=400):
    """Points on the upright cylinder that stands for a vehicle, around its grip point."""
    rng = np.random.default_rng(0)
    angle, radius = rng.uniform(0.0, 2.0 * np.pi, count), mission.vehicles.radius
    rim = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    height = mission.vehicles.grip_offset * np.array([0.0, 0.5, 1.0])[np.arange(count) % 3]
    return np.column_stack([rim, height])


def nearest(plan, obstacle, place, down=None):
    """The smallest distances of vehicles and of cable, at grip points (k, n, 3)."""
    vehicles = from_obstacle(obstacle, place[:, :, None] + body(plan.mission)).min(axis=(0, 2))
    cable = []
    for k, length in enumerate(plan.layout.lengths):
        ends = place[:, k], place[:, k + 1]
        points = catenary(*ends, length) if down is None else leaning(*ends, length, down)
        cable.append(from_obstacle(obstacle, points).min() - 0.5 * plan.mission.cable.diameter)
    return vehicles.min(), min(cable)


def certified_distances(plan, obstacle, **options):
    found = tightest_moments(plan, checks=("obstacle",), **options)
    chosen = [one for one in found if one.between[1] == f"obstacle {obstacle['name']}"]
    return tuple(
        min((one.distance for one in chosen if one.between[0].startswith(kind)), default=np.inf)
        for kind in ("vehicle", "segment")
    )


@pytest.mark.slow
@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000))
def test_an_adversary_never_finds_less_than_is_certified(seed):
    """Random motions, sampled finely, with random errors on the sphere of tracking errors."""
    rng = np.random.default_rng(seed)
    motion = wandering(rng, 3, 3, spacing=2.6, size=0.5, height=6.0)
    for obstacle in (TABLE, POST, NET):
        plan = beside(motion, obstacles=[obstacle])
        vehicles, cable = certified_distances(plan, obstacle)
        place = motion.at(np.linspace(0.0, 6.0, 400))[0]
        place = np.concatenate([displaced(rng, place, TRACKING) for _ in range(3)])
        chords = np.linalg.norm(np.diff(place, axis=1), axis=2)
        place = place[(chords < 0.97 * LENGTHS).all(axis=1)]
        found = nearest(plan, obstacle, place)
        assert found[0] >= vehicles - 1e-9
        assert found[1] >= cable - 1e-9


def test_the_certified_distance_is_close_to_the_true_one():
    """A team that passes a post at constant height: exact but for the tracking error."""
    places = [[[x, 0.0, 6.0], [x, 2.6, 6.0]] for x in (0.0, 4.0)]
    post = POST | {"centre": [2.0, -1.0]}
    plan = beside(moving([0.0, 6.0], places), [3.0], obstacles=[post])
    vehicle, segment = certified_distances(plan, post)
    radius, thin = plan.mission.vehicles.radius, 0.5 * plan.mission.cable.diameter
    assert vehicle == pytest.approx(1.0 - 0.4 - radius - TRACKING, abs=0.004)
    assert vehicle <= 1.0 - 0.4 - radius - TRACKING + 1e-9
    assert segment <= 1.0 - 0.4 - thin - TRACKING + 1e-9
    assert segment == pytest.approx(1.0 - 0.4 - thin - TRACKING, abs=0.03)


def test_in_no_wind_an_adversary_finds_less_than_is_certified():
    rng, speed = np.random.default_rng(2), 3.0
    motion = wandering(rng, 3, 2, spacing=2.6, size=0.3, height=6.0)
    plan = beside(motion)
    tilt = wind_tilt(plan, speed)
    angle, share = rng.uniform(0.0, 2.0 * np.pi, 3000), np.sqrt(rng.uniform(size=3000))
    share[::3] = 1.0
    lean = tilt * share * np.stack([np.cos(angle), np.sin(angle)])
    down = np.column_stack([*lean, np.full(3000, -1.0)])
    place = displaced(rng, motion.at(rng.uniform(0.0, 4.0, 3000))[0], TRACKING)
    for obstacle in (TABLE, POST, NET):
        _, cable = certified_distances(plan, obstacle, tilt=tilt)
        _, still = certified_distances(plan, obstacle)
        assert cable <= still + 0.004
        assert nearest(plan, obstacle, place, down)[1] >= cable - 1e-9


def test_a_wind_that_blows_cable_against_a_net_is_found():
    places = [[0.0, 0.0, 6.0], [2.6, 0.0, 6.0]]
    net = {"name": "net", "shape": "half-space", "point": [0, 0.7, 0], "normal": [0, -1, 0]}
    plan = beside(moving([0.0, 2.0], [places, places]), [3.4], obstacles=[net])
    assert certified(plan, tracking=TRACKING)
    assert failure_in_wind(plan, 0.2) is None
    failed = failure_in_wind(plan, 6.0)
    assert failed is not None
    assert failed[:2] == ("obstacle", ("segment 1", "obstacle net"))


def test_the_tube_of_the_swing_counts():
    motion = wandering(np.random.default_rng(3), 3, 2, spacing=2.6, size=0.3, height=6.0)
    plan = beside(motion)
    tube = TubeRadii.of_leaves(0.0, np.full((1, 2, LEAVES), 0.07))
    kind = next(one for one in KINDS if one.check == "obstacle" and one.swing)
    bounds = []
    for radii in (None, tube):
        cable = HeldCable(BoundedMotion(motion), LENGTHS, TRACKING, 0.0, radii)
        family = kind.family(plan, PlanChecks.of(plan).spans, cable)
        bounds.append(family.evaluate(family.roots()))
    assert bounds[0].low - bounds[1].low == pytest.approx(0.07)
    assert bounds[0].high - bounds[1].high == pytest.approx(0.07)


def test_cable_on_the_floor_can_lie_anywhere_within_reach():
    """Cable of 3.4 m between grips 2.6 m apart reaches 1.10 m to the side."""
    places = [[0.0, 0.0, 0.0], [2.6, 0.0, 0.0]]
    rest = moving([0.0, 2.0], [places, places])
    table = {"name": "table", "shape": "box", "centre": [1.3, 2.0], "size": [1.0, 1.0], "top": 0.7}
    plan = beside(rest, [3.4], obstacles=[table], name="lift", cable="lifting")
    _, reach = certified_distances(plan, table)
    rng = np.random.default_rng(5)
    ends = np.array(places) + displaced(rng, np.zeros((2000, 2, 3)), TRACKING)
    points = rng.uniform([-0.6, -1.5, -1.5], [3.2, 1.6, 1.5], (2000, 60, 3))
    total = sum(np.linalg.norm(points - ends[:, None, k], axis=2) for k in (0, 1))
    found = from_obstacle(table, points[total <= 3.4]).min()
    thin = 0.5 * plan.mission.cable.diameter
    assert found - thin >= reach - 1e-9
    assert found - thin == pytest.approx(reach, abs=0.12)


def passing(gap, speed=1.2, **options):
    """A team that flies along a wall, turns before another one, and comes back."""
    places = [[[x, 0.0, 5.0], [x, 2.4, 5.0]] for x in (0.0, 4.0, 0.0)]
    wall = {"name": "wall", "shape": "box", "centre": [4.0 + 1.0 + gap, 1.0], "size": [2.0, 9.0],
            "top": 8.0}  # fmt: skip
    time = 4.0 / speed * 1.9
    return beside(moving([0.0, time, 2.0 * time], places), [3.0], obstacles=[wall], **options)


def test_lost_setpoints_slow_the_clock_before_an_obstacle():
    """The vehicles turn before the wall; without setpoints they would fly on."""
    near = passing(0.25 + CLEARANCE + TRACKING + 0.02)
    assert certified(near, tracking=TRACKING)
    found = certify_stream_loss(near)
    assert found.rates.min() < 1.0
    assert not len(found.infeasible)
    far = certify_stream_loss(passing(4.0))
    assert far.rates.min() > found.rates.min()
    for time in np.linspace(0.0, near.motion.times[-1], 60):
        position, velocity, _ = near.motion.at(time)
        coast = (0.85 + 0.12 * 1.3) * found.rate_limit(time)
        flown_on = position[None] + coast * np.linspace(0.0, 1.0, 9)[:, None, None] * velocity
        wall = near.mission.model_dump()["workspace"]["obstacles"][0]
        assert min(nearest(near, wall, flown_on)) >= CLEARANCE - 1e-3


def test_the_monitor_stops_the_clock_before_an_obstacle():
    plan = passing(1.0)
    monitor = Monitor(plan)
    there = plan.motion.at(0.5 * plan.motion.times[-1])[0]
    free = there - [1.0, 0.0, 0.0]
    nearer = there - [0.25 + CLEARANCE + 0.03 - 1.0, 0.0, 0.0]
    assert monitor.clock_rate(free[None], "aloft") == 1.0
    assert monitor.clock_rate(nearer[None], "aloft") == pytest.approx(0.3, abs=0.01)
    found = monitor.clearances(np.stack([free, nearer]), "aloft")
    assert found[1].kind == "obstacle"
    assert found[1].margin == pytest.approx(0.03, abs=1e-9)


def test_nobody_lands_on_a_table():
    """The team flies over a table: there it can neither land together nor release."""
    places = [[[x, 0.0, 5.0], [x, 2.4, 5.0]] for x in (0.0, 8.0)]
    table = {"name": "table", "shape": "box", "centre": [4.0, 1.2], "size": [1.0, 0.6], "top": 0.75}
    plan = beside(moving([0.0, 8.0], places), [3.0], obstacles=[table])
    free = beside(moving([0.0, 8.0], places), [3.0], obstacles=[])
    found, without = contingency_windows(plan), contingency_windows(free)
    assert without.land.all()
    over = np.abs(plan.motion.at(found.time)[0][:, 0, 0] - 4.0)
    # cable hangs above the table, no vehicle does
    assert found.release.all()
    assert not found.land[over < 0.5 + CLEARANCE + TRACKING].any()
    assert found.land[over > 0.5 + CLEARANCE + TRACKING + 0.1].all()
    under = table | {"centre": [4.0, 2.4]}
    found = contingency_windows(beside(moving([0.0, 8.0], places), [3.0], obstacles=[under]))
    assert not found.release[over < 0.5 + 0.25 + CLEARANCE + TRACKING].any()
    assert found.release[over > 0.5 + 0.25 + CLEARANCE + TRACKING + 1e-6].all()
    assert not (found.land & ~found.release).any()
    assert found.falls.all()
    assert found.may_fall(4.0)
    above = table | {"centre": [4.0, 2.4], "bottom": 6.4, "top": 6.6}
    found = contingency_windows(beside(moving([0.0, 8.0], places), [3.0], obstacles=[above]))
    # the team does not climb before it lands, but where it moves apart
    assert found.land.all()
    assert not found.release[over < 0.5 + 0.25].any()


FOLLOW = np.array([False, True, True])
"""The first of three vehicles has fallen."""


@pytest.mark.parametrize("height", [0.75, 7.0])
def test_a_team_separates_as_far_as_obstacles_allow(height):
    """A table, or a wall, 2.5 m beside a team of three."""
    start = np.array([[0.0, 0.0, 5.0], [1.5, 0.0, 5.0], [0.0, 1.5, 5.0]])
    table = {"name": "table", "shape": "box", "centre": [3.5, 0.0], "size": [1.6, 9.0],
             "top": height}  # fmt: skip
    still = moving([0.0, 1.0], [start, start])
    free = beside(still, obstacles=[]).mission
    mission = beside(still, obstacles=[table]).mission
    apart, near = (
        separation_motion(start, start[0], 0.0, 3.0, one, FOLLOW) for one in (free, mission)
    )
    assert apart.at(apart.times[-1])[0][1] == pytest.approx([4.5, 0.0, 5.0 + UP])
    end = near.at(near.times[-1])[0]
    needed = mission.vehicles.radius + mission.clearance.obstacle + TRACKING
    assert 1.5 < end[1, 0] <= 3.5 - 0.8 - needed
    assert end[1, 0] >= 3.5 - 0.8 - needed - 3.0 / 12
    ways = near.at(np.linspace(near.times[0], near.times[-1], 50))[0]
    falls = end * np.array([1.0, 1.0, 0.0]) + np.linspace(0.0, 6.0, 40)[:, None, None] * [0, 0, 1.0]
    vehicles = [from_obstacle(table, each[:, :, None] + body(mission)) for each in (ways, falls)]
    assert min(each.min() for each in vehicles) >= CLEARANCE + TRACKING - 1e-9


def test_a_team_that_need_not_move_apart_does_to_come_down_beside_a_table():
    start = np.array([[-4.0, 0.0, 4.0], [0.0, 0.0, 4.0], [-0.1, 2.9, 7.0]])
    table = {"name": "table", "shape": "box", "centre": [0.2, 3.0], "size": [1.6, 0.8],
             "top": 0.75}  # fmt: skip
    mission = beside(moving([0.0, 1.0], [start, start]), obstacles=[table]).mission
    motion = separation_motion(start, start.mean(axis=0), 0.0, 1.0, mission, np.ones(3, dtype=bool))
    end = motion.at(motion.times[-1])[0]
    assert end[2, 1] > 3.4 + mission.vehicles.radius + CLEARANCE + TRACKING
    free = beside(moving([0.0, 1.0], [start, start]), obstacles=[]).mission
    motion = separation_motion(start, start.mean(axis=0), 0.0, 1.0, free, np.ones(3, dtype=bool))
    assert motion.at(motion.times[-1])[0][:, :2] == pytest.approx(start[:, :2])


def separated(start, obstacle, spread):
    """The mission, and where three vehicles are while they separate, from the first to the last."""
    still = moving([0.0, 1.0], [start, start])
    mission = beside(still, obstacles=[obstacle]).mission
    motion = separation_motion(start, start[0], 0.0, spread, mission, FOLLOW)
    return mission, motion.at(np.linspace(motion.times[0], motion.times[-1], 50))[0]


@pytest.mark.parametrize("size", [3.0, 40.0])
def test_a_team_below_an_obstacle_does_not_climb_into_it(size):
    """0.3 m above the rotors; the vehicles move apart at their height."""
    start = np.array([[0.0, 0.0, 5.0], [1.5, 0.0, 5.0], [0.0, 1.5, 5.0]])
    roof = {"name": "roof", "shape": "box", "centre": [0.0, 0.0], "size": [size, size],
            "bottom": 5.9, "top": 6.9}  # fmt: skip
    for spread in (1.0, 3.0):
        mission, ways = separated(start, roof, spread)
        bodies = from_obstacle(roof, ways[:, FOLLOW, None] + body(mission))
        assert bodies.min() >= CLEARANCE + TRACKING - 1e-9
        assert ways[-1, 1] == pytest.approx([1.5 * spread, 0.0, 5.0])


def test_a_team_that_has_no_clear_way_stays_where_it_is():
    """A net is nearer above a team than it must be, as where a team has left its plan."""
    start = np.array([[0.0, 0.0, 5.0], [1.5, 0.0, 5.0], [0.0, 1.5, 5.0]])
    roof = {"name": "net", "shape": "half-space", "point": [0.0, 0.0, 5.8], "normal": [0, 0, -1.0]}
    _, ways = separated(start, roof, 3.0)
    assert ways == pytest.approx(np.broadcast_to(start, ways.shape))


@pytest.mark.parametrize(
    ("centre", "size", "apart"),
    [
        ([0.0, 0.0], [0.5, 0.5], 1.6),
        ([2.0, 0.0], [9.0, 9.0], 1.6),
        ([4.0, 0.0], [2.5, 9.0], 0.8),
        ([4.0, 0.0], [3.6, 9.0], 1.6),
    ],
)
def test_vehicles_that_are_near_each_other_move_apart_above_a_table(centre, size, apart):
    """Two vehicles 0.4 m apart, which need 0.66 m to descend.

    The table is below the fallen one; below all; farther away, with room to descend before it; so
    near that there is none.
    """
    start = np.array([[0.0, 0.0, 5.0], [1.0, 0.0, 5.0], [1.0, 0.4, 7.0]])
    table = {"name": "table", "shape": "box", "centre": centre, "size": size, "top": 0.75}
    _, ways = separated(start, table, 4.0)
    assert np.linalg.norm(ways[-1, 1, :2] - ways[-1, 2, :2]) == pytest.approx(apart)
    assert ways[-1, 1:, 2] == pytest.approx(start[1:, 2] + UP)


def test_a_plan_is_refused_with_the_obstacle_its_place_and_time():
    plan = passing(0.5)
    moment = min(tightest_moments(plan, checks=("obstacle",)), key=lambda one: one.margin)
    (finding, *_) = [one for one in assess(plan).findings if one.check == "obstacle"]
    assert finding.severity == "error"
    assert finding.message.startswith(
        f"{-moment.margin:.3f} m too near obstacle wall: {moment.between[0]} for tracking errors up "
        "to 0.08 m; move it, or the mission's origin away from it (at "
    )
    assert -moment.margin == pytest.approx(0.25 + CLEARANCE + TRACKING - 0.5, abs=0.01)
    assert finding.at_time == pytest.approx(0.5 * plan.motion.times[-1], abs=0.5)
    assert finding.where[0] == pytest.approx(4.0, abs=0.1)


def test_obstacles_are_part_of_the_digest_and_their_absence_is_not():
    plan = passing(1.0)
    none = replace(plan, mission=passing(1.0).mission.model_copy(
        update={"workspace": plan.mission.workspace.model_copy(update={"obstacles": ()})}
    ))  # fmt: skip
    farther = replace(plan, mission=passing(1.1).mission)
    assert len({digest(plan), digest(none), digest(farther)}) == 3
    assert "obstacle" not in json.dumps(none.mission.model_dump(mode="json"))
    document = plan.mission.model_dump(mode="json", by_alias=True)
    assert plan.mission.model_validate(document) == plan.mission
