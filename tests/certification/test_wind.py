"""Clearances in every steady wind up to a speed, against catenaries that share no code."""

import numpy as np
import pytest

from swarm.certification import strand_pieces as pieces
from swarm.certification.air import wind_tilt
from swarm.certification.cable_spans import all_pairs, exempt_length
from swarm.certification.clearances import (
    failure_in_wind,
    families,
    largest_wind,
    tightest_moments,
    violations_in_wind,
)
from swarm.geometry.catenary import Catenary, solve_catenaries
from tests.certification.oracle import catenary, closest, displaced
from tests.certification.synthetic import moving, plan_of

UNEVEN = [
    [-2.407, 0.0, 14.0], [2.407, 0.0, 14.0], [3.994, 0.611, 12.082], [-3.664, 0.553, 11.643],
]  # fmt: skip
"""A long strand that hangs deep beside a short one that hangs flat, in other planes."""
UNEVEN_LENGTHS = [9.118, 3.159, 8.250]


def uneven():
    return plan_of(moving([0.0, 1.0], [UNEVEN, UNEVEN]), UNEVEN_LENGTHS)


def leaning(start, end, length, down):
    """Strands (k, 60, 3) between ends (k, 3) in gravities (k, 3), in a frame that is turned."""
    up = -down / np.linalg.norm(down, axis=-1, keepdims=True)
    east = np.cross([0.0, 1.0, 0.0], up)
    east /= np.linalg.norm(east, axis=-1, keepdims=True)
    turn = np.stack([east, np.cross(up, east), up], axis=1)
    found = catenary(*(np.einsum("kij,kj->ki", turn, p) for p in (start, end)), length)
    return np.einsum("kji,kfj->kfi", turn, found)


def nearest_in_winds(plan, speed, pair, count=4000):
    """The smallest distance of two strands found in random winds, times and tracking errors."""
    rng = np.random.default_rng(3)
    share, heading = np.sqrt(rng.uniform(size=count)), rng.uniform(0.0, 2.0 * np.pi, count)
    share[::4] = 1.0
    tilt = share * wind_tilt(plan, speed)
    down = np.stack([tilt * np.cos(heading), tilt * np.sin(heading), np.full(count, -1.0)], axis=1)
    time = rng.uniform(plan.motion.times[0], plan.motion.times[-1], count)
    place = displaced(rng, plan.motion.at(time)[0], plan.mission.vehicles.tracking)
    one, other = (leaning(place[:, k], place[:, k + 1], plan.layout.lengths[k], down) for k in pair)
    return closest(one, other).min() - plan.mission.cable.diameter


def test_a_wind_is_refused_where_a_weaker_one_blows_strands_together():
    """At 4.63 m/s both hang to one side, far apart; at 2.81 m/s they touch."""
    plan = uneven()
    assert failure_in_wind(plan, 0.0) is None
    assert failure_in_wind(plan, 2.8093) is not None
    assert failure_in_wind(plan, 4.6318) is not None
    most = largest_wind(plan, tightest_moments(plan))
    assert 0.5 < most < 2.8093
    assert nearest_in_winds(plan, most, (0, 2)) >= plan.mission.clearance.cable
    assert nearest_in_winds(plan, 2.8093, (0, 2)) < plan.mission.clearance.cable


@pytest.mark.slow
def test_in_no_wind_up_to_the_certified_one_strands_come_nearer_than_required():
    """Strands that pass each other, so that time, tilt and errors count together."""
    far = [[-30, 30, 60], [-30, -30, 60]]
    before = [[0.0, -1.5, 60.0], [0.0, 1.5, 60.0], *far, [-1.6, -0.3, 61.3], [1.4, 0.4, 61.0]]
    after = [[0.4, -1.5, 60.2], [0.3, 1.4, 60.0], *far, [-1.2, 0.4, 61.0], [1.7, -0.3, 61.4]]
    plan = plan_of(moving([0.0, 3.0], [before, after]), [3.8, 50.0, 66.0, 50.0, 3.6])
    pair, most = (0, 4), largest_wind(plan, tightest_moments(plan))
    assert most is not None
    assert most > 1.0
    assert nearest_in_winds(plan, most, pair) >= plan.mission.clearance.cable
    assert failure_in_wind(plan, most) is None
    assert failure_in_wind(plan, 0.3 * most) is None
    assert violations_in_wind(plan, most) == violations_in_wind(plan, 0.0) == ()
    short = violations_in_wind(plan, most + 0.5)
    failed = failure_in_wind(plan, most + 0.5)
    assert failed is not None
    assert failed[1] in {moment.between for moment in short}
    assert all(moment.margin < 0.0 for moment in short)


MOVED = [
    [-2.0, 0.5, 13.6], [2.9, 0.4, 14.3], [3.6, 0.2, 12.3], [-3.3, -0.2, 11.9],
]  # fmt: skip


def body_points(vehicles):
    """Points (k, 3) of a vehicle's cone: its tip, its rim, and between them."""
    angle, share = np.linspace(0.0, 2.0 * np.pi, 24), np.linspace(0.0, 1.0, 6)[:, None]
    rim = vehicles.radius * np.stack([np.cos(angle), np.sin(angle)])
    disc, side = share * rim[:, None], vehicles.grip_offset * (share + 0.0 * angle)
    top = np.stack([*disc, np.full(side.shape, vehicles.grip_offset)], axis=-1)
    return np.concatenate([top, np.stack([*disc, side], axis=-1)]).reshape(-1, 3)


@pytest.mark.parametrize(("speed", "error"), [(1.5, 0.0), (4.0, 0.1)])
@pytest.mark.parametrize(
    "check", ["cable clearance", "neighbouring segments", "vehicle-cable clearance", "floor"]
)
def test_in_no_case_within_a_box_is_a_margin_below_its_bound(check, speed, error):
    """Boxes of times, tilts and pieces, of a team that moves by up to 1 m/s."""
    plan, rng = (
        plan_of(moving([0.0, 2.0], [UNEVEN, MOVED]), UNEVEN_LENGTHS),
        np.random.default_rng(7),
    )
    tilt, clearance, radius = (
        wind_tilt(plan, speed),
        plan.mission.clearance,
        0.5 * plan.mission.cable.diameter,
    )
    family = next(each for each in families(plan, error, tilt) if each.check == check)
    boxes = family.roots()
    boxes = boxes.taken(rng.integers(0, len(boxes), 100))
    size, half = (100, boxes.middle.shape[1] - 3), boxes.half.copy()
    boxes.half[:, 0] *= 0.5 ** rng.integers(0, 6, 100)
    boxes.middle[:, 0] += rng.uniform(-1.0, 1.0, 100) * (half[:, 0] - boxes.half[:, 0])
    boxes.half[:, 1:3] = tilt * 0.5 ** rng.integers(1, 10, (100, 1))
    boxes.middle[:, 1:3] = tilt * rng.uniform(-0.7, 0.7, (100, 2))
    pieces = 2 ** rng.integers(3, 7, size)
    boxes.half[:, 3:] = 0.5 / pieces
    boxes.middle[:, 3:] = (rng.integers(0, pieces) + 0.5) / pieces
    every, parts = all_pairs(plan.layout.lengths, exempt_length(plan), once=bool(tilt))
    neighbours = check == "neighbouring segments"
    parts = parts[(every[:, 1] == every[:, 0] + 1) == neighbours]
    compared = parts if neighbours or check == "cable clearance" else None
    low = family.evaluate(boxes).low
    for k in np.flatnonzero(np.isfinite(low)):
        side = np.clip(rng.uniform(-2.0, 2.0, (60, len(half[k]))), -1.0, 1.0)
        case = boxes.middle[k] + side * boxes.half[k]
        case = case[np.hypot(*case[:, 1:3].T) <= tilt]
        place = plan.motion.at(case[:, 0])[0]
        place = displaced(rng, place, error)
        down = np.column_stack([case[:, 1:3], np.full(len(case), -1.0)])
        names = [name for name in family.names[boxes.group[k]] if name != "the floor"]
        pair = [int(name.split()[1]) - 1 for name in names]
        near = []
        for column, segment in enumerate(pair[-size[1] :]):
            f = boxes.middle[k, 3 + column] + np.linspace(-1, 1, 9) * boxes.half[k, 3 + column]
            if compared is not None:
                f = np.clip(f, *compared[boxes.group[k], column])
            ends = place[:, segment], place[:, segment + 1]
            near.append(solve_catenaries(*ends, UNEVEN_LENGTHS[segment], down=down).points(f))
        if check == "floor":
            margin = near[0][..., 2] - radius - clearance.floor
        elif check == "vehicle-cable clearance":
            body = place[:, pair[0], None] + body_points(plan.mission.vehicles)
            margin = closest(near[0], body) - radius - clearance.vehicle_cable
        else:
            margin = closest(*near) - 2.0 * radius - clearance.cable
        assert margin.min(initial=np.inf) >= low[k] - 1e-9


def test_strands_lean_by_no_more_than_the_measured_laws_say():
    """Points, their second order and responses to ends, for random shapes and turns."""
    rng, count, step = np.random.default_rng(11), 300, 3e-4
    ratio = np.concatenate([rng.uniform(0.05, 0.985, count - 100), rng.uniform(0.9, 0.985, 100)])
    steep = np.radians(rng.uniform(-80.0, 80.0, count))
    end = ratio[:, None] * np.stack([np.cos(steep), 0.0 * steep, np.sin(steep)], axis=1)
    axis = rng.uniform(0.0, np.pi, count)
    fractions = np.linspace(0.0, 1.0, 801)

    def points(turn, moved=0.0):
        down = np.stack([-np.sin(axis) * np.sin(turn), np.cos(axis) * np.sin(turn),
                         np.full(count, -np.cos(turn))], axis=1)  # fmt: skip
        return solve_catenaries(np.zeros(3), end + moved, np.ones(count), down=down).points(
            fractions
        )

    def response(turn):
        along = 1e-5 * np.eye(3)
        columns = [(points(turn, d) - points(turn, -d)) / 2e-5 for d in along]
        return np.stack(columns, axis=-1)

    back, still, ahead = points(-step), points(0.0), points(step)
    first = (ahead - back) / (2.0 * step)
    second = np.linalg.norm((ahead - 2.0 * still + back) / step**2, axis=-1).max(axis=1)
    change = np.linalg.norm(response(step) - response(-step), ord=2, axis=(-2, -1)).max(axis=1)
    first = np.linalg.norm(first, axis=-1).max(axis=1)
    strands = solve_catenaries(np.zeros(3), end, np.ones(count))
    bounds = []
    for k in range(count):
        figures = (strands.length, strands.parameter, strands.slope, strands.span, strands.rise)
        shape = Catenary(*(float(figure[k]) for figure in figures))
        strand = pieces.Strand((0.0,) * 3, (0.0, 0.0, -1.0), (1.0, 0.0, 0.0), shape, (0.0,) * 3)
        motion = pieces._EndMotion(0, ((0.0,) * 3, (0.0,) * 3), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        radii = pieces.Radii(0.0, 0.0, 0.0)
        piece = pieces.Piece(strand, 0.0, 1.0, 1, (0.0,) * 3, (0.0,) * 3, 0.0, motion, radii)
        bounds.append([
            pieces._per_angle(piece), pieces._per_square(piece), pieces._response_per_angle(piece),
        ])  # fmt: skip
    measured = np.stack([first, second, change / (2.0 * step)], axis=1)
    share = (measured / np.array(bounds)).max(axis=0)
    assert (share <= 1.0).all(), share
    assert (share >= 0.7).all(), "the laws are not sharp"
