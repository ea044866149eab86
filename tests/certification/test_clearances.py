"""Certified clearances against brute force, and for plans that are broken on purpose."""

from itertools import pairwise

import numpy as np
import pytest

from swarm.certification.assessment import assess
from swarm.certification.cable_spans import all_pairs, exempt_length
from swarm.certification.clearances import certified, tightest_moments
from swarm.certification.motion_bounds import BoundedMotion, TeamStates
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.motion import Motion, concatenate, through_states
from tests.certification.oracle import catenary, closest, displaced
from tests.certification.synthetic import moving, plan_of, wandering

LENGTHS = [3.4, 3.1, 3.8, 3.3]


def tightest(plan, check, **options):
    return {moment.between: moment for moment in tightest_moments(plan, checks=(check,), **options)}


def numbers(between):
    return [int(name.split()[1]) - 1 for name in between]


def times_about(rng, moment, plan, count):
    """Half of the times near the tightest one, the others anywhere."""
    start, end = plan.motion.times[[0, -1]]
    near = moment.time + rng.uniform(-0.05, 0.05, count // 2)
    return np.clip(np.concatenate([near, rng.uniform(start, end, count - len(near))]), start, end)


def strand(plan, places, segment, count=60):
    start, end = places[..., segment, :], places[..., segment + 1, :]
    return catenary(start, end, plan.layout.lengths[segment], count)


@pytest.mark.parametrize("tracking", [0.0, 0.08])
@pytest.mark.parametrize("seed", range(4))
def test_brute_force_never_finds_strands_closer_than_certified(seed, tracking):
    rng = np.random.default_rng(seed)
    plan = plan_of(
        wandering(rng, 5, 4, size=0.25, spacing=2.3), LENGTHS, f"vehicles.tracking={tracking}"
    )
    found = tightest(plan, "cable clearance")
    assert found
    for between, moment in found.items():
        i, j = numbers(between)
        times = times_about(rng, moment, plan, 400)
        places = displaced(rng, plan.motion.at(times)[0], tracking)
        sampled = closest(strand(plan, places, i), strand(plan, places, j)) - 0.006
        assert sampled.min() >= moment.distance
        if tracking == 0.0:
            # Points of the polylines are up to a few centimetres off the closest points.
            assert sampled.min() <= moment.distance + max(0.05, 0.1 * moment.distance)


@pytest.mark.parametrize("seed", range(4))
def test_brute_force_never_finds_neighbours_closer_than_certified(seed):
    rng = np.random.default_rng(100 + seed)
    plan = plan_of(wandering(rng, 5, 4, size=0.3, spacing=2.3), LENGTHS, "vehicles.tracking=0.05")
    for between, moment in tightest(plan, "neighbouring segments").items():
        times = times_about(rng, moment, plan, 100)
        places = displaced(rng, plan.motion.at(times)[0], 0.05)
        assert neighbours_apart(plan, places, numbers(between)[0]).min() - 0.006 >= moment.distance


@pytest.mark.parametrize("steep", [0.6, 1.0, 1.17, 1.25])
def test_beside_a_steep_strand_the_certificate_is_near_brute_force(steep):
    """A steep chord is not treated as a vertical one."""
    rng = np.random.default_rng(7)
    hanging = [6.4 * np.cos(steep), 0.0, -6.4 * np.sin(steep)]
    line = np.array([[-4.0, 8.2, -0.6], [0.0, 0.0, 0.0], hanging]) + np.array([0.0, 0.0, 30.0])
    plan = plan_of(moving([0.0, 1.0], [line, line + np.array([0.3, 0.1, 0.0])]), [16.0, 7.7])
    (moment,) = tightest(plan, "neighbouring segments").values()
    places = displaced(rng, np.repeat(plan.motion.at(np.array([0.0, 1.0]))[0], 400, axis=0), 0.1)
    sampled = neighbours_apart(plan, places, 0)
    assert moment.distance <= sampled.min() - 0.006
    assert moment.distance >= sampled.min() - 0.16


def neighbours_apart(plan, places, segment):
    """Distances of a segment and the next one, without the exempt length at their vehicle."""
    beyond = exempt_length(plan)
    first, second = (strand(plan, places, k, 100) for k in (segment, segment + 1))
    from_grip = _arc(first)[..., -1:] - _arc(first)
    apart = np.linalg.norm(first[..., :, None, :] - second[..., None, :, :], axis=-1)
    counts = (from_grip[..., :, None] >= beyond) | (_arc(second)[..., None, :] >= beyond)
    return np.where(counts, apart, np.inf).min(axis=(-1, -2))


def _arc(points):
    steps = np.linalg.norm(np.diff(points, axis=-2), axis=-1)
    return np.concatenate([np.zeros_like(steps[..., :1]), np.cumsum(steps, axis=-1)], axis=-1)


@pytest.mark.parametrize("seed", range(3))
def test_brute_force_never_finds_vehicles_closer_than_certified(seed):
    rng = np.random.default_rng(200 + seed)
    plan = plan_of(wandering(rng, 5, 4, size=0.5, spacing=2.0), [9.0] * 4)
    for between, moment in tightest(plan, "vehicle clearance").items():
        i, j = numbers(between)
        times = times_about(rng, moment, plan, 20000)
        places = displaced(rng, plan.motion.at(times)[0], 0.1)
        apart = places[:, j] - places[:, i]
        margin = np.maximum(np.hypot(apart[:, 0], apart[:, 1]) - 1.0, np.abs(apart[:, 2]) - 1.5)
        assert margin.min() >= moment.margin


@pytest.mark.parametrize("seed", range(3))
def test_brute_force_never_finds_cable_closer_to_a_vehicle_than_certified(seed):
    rng = np.random.default_rng(300 + seed)
    plan = plan_of(wandering(rng, 5, 4, size=0.3, spacing=2.3), LENGTHS, "vehicles.tracking=0.05")
    rim = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    disc = [[0.0, 0.0, 0.6]] + [
        [0.25 * share * np.cos(angle), 0.25 * share * np.sin(angle), 0.6]
        for share in (0.5, 1.0)
        for angle in rim
    ]
    rod = [[0.0, 0.0, height] for height in np.linspace(0.0, 0.6, 7)]
    for check, body in (("vehicle-cable clearance", disc + rod), ("rotor disc", disc)):
        for between, moment in tightest(plan, check).items():
            vehicle, segment = numbers(between)
            times = times_about(rng, moment, plan, 100)
            places = displaced(rng, plan.motion.at(times)[0], 0.05)
            parts = places[:, vehicle, None, :] + np.array(body)
            sampled = closest(parts, strand(plan, places, segment)) - 0.003
            assert sampled.min() >= moment.distance


@pytest.mark.parametrize("seed", range(3))
def test_brute_force_never_finds_cable_lower_than_certified(seed):
    rng = np.random.default_rng(400 + seed)
    plan = plan_of(
        wandering(rng, 5, 4, size=0.3, spacing=2.3, height=3.0), LENGTHS, "vehicles.tracking=0.05"
    )
    for between, moment in tightest(plan, "floor").items():
        segment = numbers(between[:1])[0]
        times = times_about(rng, moment, plan, 1000)
        places = displaced(rng, plan.motion.at(times)[0], 0.05)
        lowest = strand(plan, places, segment)[..., 2].min() - 0.003
        assert lowest >= moment.distance


def crossing_plan(gap, *overrides):
    """One strand passes from side to side, ``gap`` above another that hangs still."""
    still = [[0, -1.5, 6.0], [0, 1.5, 6.0]]
    far, there = 30.0, [[-1.5, 0, 6.0 + gap], [1.5, 0, 6.0 + gap]]
    begin = [[x, y - 0.4, z] for x, y, z in there]
    end = [[x, y + 0.4, z] for x, y, z in there]
    join = [[0.0, far, 6.0]]
    places = [[*still, *join, *moving_pair] for moving_pair in (begin, end)]
    lengths = [3.5, 60.0, 60.0, 3.5]
    return plan_of(moving([0.0, 12.0], places), lengths, *overrides)


def passing(plan, **options):
    """The pair of the still strand and the moving one above it."""
    return tightest(plan, "cable clearance", **options)[("segment 1", "segment 4")]


def test_the_certified_distance_is_close_to_the_true_one():
    plan = crossing_plan(0.3, "vehicles.tracking=0")
    moment = passing(plan)
    places = plan.motion.at(np.linspace(0.0, 12.0, 60))[0]
    true = closest(strand(plan, places, 0, 400), strand(plan, places, 3, 400)).min() - 0.006
    assert true - 0.012 <= moment.distance <= true


def test_strands_that_pass_through_each_other_between_samples_are_caught():
    """Down through the other strand and up again within a tenth of a second."""
    plan = crossing_plan(1.0, "vehicles.tracking=0")
    over = plan.motion.at(np.array([5.9, 6.0, 6.1]))
    position, velocity, acceleration = (part.copy() for part in over)
    position[1, 3:, 2] -= 1.2
    velocity[1, 3:, 2] = 0.0
    dip = through_states(np.array([5.9, 6.0, 6.1]), position, velocity, acceleration)
    before = _cut(plan.motion, 0.0, 5.9)
    after = _cut(plan.motion, 6.1, 12.0)
    whipped = concatenate(concatenate(before, dip), after)
    broken = plan_of(whipped, plan.layout.lengths, "vehicles.tracking=0")
    coarse = broken.motion.at(np.arange(0.0, 12.0, 0.2) + 0.1)[0]
    assert closest(strand(broken, coarse, 0), strand(broken, coarse, 3)).min() > 0.5
    moment = passing(broken)
    assert moment.distance <= 0.0
    assert moment.time == pytest.approx(6.0, abs=0.1)


def _cut(motion, start, end):
    times = np.linspace(start, end, 60)
    return through_states(times, *motion.at(times))


def test_more_tracking_error_never_certifies_more():
    rng = np.random.default_rng(7)
    motion = wandering(rng, 5, 3, size=0.2, spacing=2.3)
    distances = []
    for tracking in (0.0, 0.03, 0.06, 0.1):
        plan = plan_of(motion, LENGTHS, f"vehicles.tracking={tracking}")
        distances.append(min(m.distance for m in tightest(plan, "cable clearance").values()))
    assert all(after < before for before, after in pairwise(distances))


def test_certified_agrees_with_the_measured_margins():
    rng = np.random.default_rng(11)
    answers = set()
    for size in (0.05, 0.1, 0.2, 0.4):
        plan = plan_of(
            wandering(rng, 4, 2, size=size, spacing=2.4), [2.9] * 3,
            "vehicles.tracking=0.01", "clearance.cable=0.05",
        )  # fmt: skip
        measured = min(moment.margin for moment in tightest_moments(plan))
        answer = certified(plan, tracking=0.01)
        assert answer == (measured >= 0.0) or abs(measured) < 0.01
        answers.add(answer)
    assert answers == {True, False}


def test_a_chord_beyond_the_allowed_ratio_is_found_at_its_moment():
    places = [[[0, 0, 5.0], [2.5, 0, 5.0]], [[0, 0, 5.0], [2.93, 0, 5.0]], [[0, 0, 5], [2.5, 0, 5]]]
    plan = plan_of(moving([0, 4, 8], places), [3.0], "vehicles.tracking=0.02")
    moment = tightest(plan, "taut")[("segment 1", "its length")]
    assert moment.margin == pytest.approx(0.985 * 3.0 - 2.93 - 0.04, abs=0.004)
    assert moment.time == pytest.approx(4.0, abs=0.1)


def test_cable_on_the_floor_can_lie_anywhere_within_reach():
    lying = [[[x, 0, 0.0] for x in (0, 2.7, 5.4, 8.1)]] * 2
    plan = plan_of(
        moving([0, 1], lying), [3.0] * 3, "vehicles.tracking=0.05", name="contract", cable="floor"
    )
    moment = tightest(plan, "reach on the floor")[("segment 1", "segment 3")]
    # Each can reach ½(3 + 0.1 − 2.7) beyond its ends.
    assert moment.distance == pytest.approx(2.7 - 0.4 - 0.006, abs=0.15)
    assert moment.distance <= 2.7 - 0.4 - 0.006 + 1e-9
    # And from vehicle 3, 2.7 m from one end and 5.4 m from the other, 0.25 m thick.
    vehicle = tightest(plan, "reach on the floor")[("vehicle 3", "segment 1")]
    assert vehicle.distance == pytest.approx(0.5 * (8.1 - 3.0) - 0.1 - 0.25 - 0.003, abs=0.2)
    assert vehicle.distance <= 0.5 * (8.1 - 3.0) - 0.1 - 0.25 - 0.003 + 1e-9


def test_cable_pulled_beyond_its_length_on_the_floor_is_found():
    places = [[[x, 0, 0.0] for x in (0, 2.7, 5.4)], [[x, 0, 0.0] for x in (0, 2.7, 5.8)]]
    plan = plan_of(moving([0, 4], places), [3.0] * 2, name="contract", cable="floor")
    moment = tightest(plan, "over-stretched on the floor")[("segment 2", "its length")]
    assert moment.margin == pytest.approx(-0.1, abs=0.015)


def test_fence_and_ceiling():
    places = [[[0, 0, 5.0], [2.0, 0, 5.0]], [[4.0, 0, 5.0], [6.0, 0, 6.0]]]
    plan = plan_of(
        moving([0, 6], places), [3.0], "vehicles.tracking=0.1", "workspace.ceiling=6.0",
        "workspace.fence=[[-5, -5], [5.5, -5], [5.5, 5], [-5, 5]]",
    )  # fmt: skip
    over = tightest(plan, "ceiling")[("vehicle 2", "the ceiling")]
    assert over.margin == pytest.approx(6.0 - 6.0 - 0.6 - 0.1, abs=0.08)
    out = tightest(plan, "fence")
    assert out[("vehicle 2", "the fence")].margin == pytest.approx(-0.5 - 0.25 - 0.1, abs=0.1)
    assert out[("segment 1", "the fence")].margin < 0.0
    assert out[("vehicle 1", "the fence")].margin == pytest.approx(1.5 - 0.25 - 0.1, abs=0.1)


@pytest.mark.parametrize(
    "every", [pytest.param(0.005, marks=pytest.mark.full), pytest.param(0.25, id="coarse")]
)
def test_a_whole_plan_sampled_finely_stays_within_its_certificate(overhand, every):
    """All pairs of strands that are not neighbours, every step with new errors of every vehicle."""
    rng = np.random.default_rng(3)
    tracking = overhand.mission.vehicles.tracking
    certified_least = min(m.distance for m in tightest(overhand, "cable clearance").values())
    start, end = overhand.phase("fold").start, overhand.phase("hold").end
    pairs = np.stack(np.triu_indices(overhand.vehicles - 1, 2), axis=1)
    least = np.inf
    for times in np.array_split(np.arange(start, end, every), max(1, int(0.5 / every))):
        places = displaced(rng, overhand.motion.at(times)[0], tracking)
        strands = catenary(places[:, :-1], places[:, 1:], overhand.layout.lengths, 40)
        middle = strands.mean(axis=2)
        reach = np.linalg.norm(strands - middle[:, :, None], axis=-1).max(axis=2)
        for i, j in pairs:
            near = np.linalg.norm(middle[:, i] - middle[:, j], axis=-1) < (
                reach[:, i] + reach[:, j] + certified_least + 0.1
            )
            if near.any():
                found = closest(strands[near, i], strands[near, j]).min() - 0.006
                least = min(least, found)
    assert certified_least <= least < certified_least + 0.5


def test_the_lowest_point_in_all_winds_is_found():
    """Sampled on tilted strands: their lowest points are not those along gravity."""
    places = [[0, 0, 5.0], [2.0, 0.5, 6.0]]
    plan = plan_of(moving([0, 1], [places, places]), [3.0], "vehicles.tracking=0")
    moment = tightest(plan, "floor", tilt=0.5)[("segment 1", "the floor")]
    share, heading = np.meshgrid(np.linspace(0.0, 0.5, 21), np.linspace(0.0, 2.0 * np.pi, 73))
    down = np.stack([share * np.cos(heading), share * np.sin(heading), 0.0 * share - 1.0], axis=-1)
    strands = solve_catenaries(places[0], places[1], 3.0, down=down).points(np.linspace(0, 1, 501))
    lowest = strands[..., 2].min() - 0.003
    assert 0.95 * lowest <= moment.distance <= lowest


@pytest.mark.parametrize("lengths", [[1.0, 4.0], [4.0, 1.0], [0.2, 0.2]])
def test_neighbours_shorter_than_the_exempt_length_are_compared(lengths):
    """One strand vertically above the other: apart only within the exempt length."""
    near, far = 0.9 * min(lengths), 0.9 * max(lengths)
    out, back = (near, far) if lengths[0] < lengths[1] else (far, near)
    places = np.array([[0.0, 0.02, 9.0], [out, 0, 9.0], [out - back, -0.02, 9.0]])
    plan = plan_of(
        moving([0, 2], [places] * 2), lengths, "clearance.vehicle=0.01", "clearance.downwash=0.01"
    )
    (moment,) = tightest(plan, "neighbouring segments").values()
    assert moment.margin < 0.0
    assert not certified(plan, tracking=0.0)


def test_the_exempt_length_is_at_most_half_of_the_shorter_segment():
    pairs, parts = all_pairs(np.array([1.0, 4.0, 10.0]), 1.02)
    beside = parts[pairs[:, 1] == pairs[:, 0] + 1]
    assert sorted(part.ravel().round(3).tolist() for part in beside) == [
        [0.0, 0.5, 0.0, 1.0],
        [0.0, 0.745, 0.0, 1.0],
        [0.0, 1.0, 0.102, 1.0],
        [0.0, 1.0, 0.125, 1.0],
    ]


def test_parts_that_are_compared_once_are_all_that_are_compared():
    lengths, rng = np.array([1.0, 4.0, 10.0]), np.random.default_rng(2)
    point = rng.uniform(0.0, 1.0, (500, 2))
    pairs, parts = all_pairs(lengths, 1.02)
    same, once = all_pairs(lengths, 1.02, once=True)
    assert (same == pairs).all()
    for pair in np.unique(pairs, axis=0):
        often, single = (
            sum(
                ((low <= point) & (point <= high)).all(axis=1)
                for low, high in each[(pairs == pair).all(axis=1)].swapaxes(1, 2)
            )
            for each in (parts, once)
        )
        assert ((often > 0) == (single > 0)).all()
        assert single.max() == 1


@pytest.mark.parametrize("seed", range(3))
def test_bounds_of_movement_include_the_jumps_between_pieces(seed):
    rng = np.random.default_rng(seed)
    smooth = wandering(rng, 3, 12, every=0.3)
    jumping = smooth.coefficients.copy()
    jumping[:, :2] += rng.normal(0.0, 0.05, jumping[:, :2].shape)
    motion = Motion(smooth.times, jumping)
    times, half = rng.uniform(*smooth.times[[0, -1]], 40), rng.uniform(0.0, 0.6, 40)
    team = TeamStates.at(BoundedMotion(motion), times, half)
    share = np.linspace(-1.0, 1.0, 301)
    for k in range(len(times)):
        inside = times[k] + half[k] * share
        inside = inside[(inside >= smooth.times[0]) & (inside < smooth.times[-1])]
        uniform = team.position[k] + (inside - times[k])[:, None, None] * team.velocity[k]
        away = np.linalg.norm(motion.at(inside)[0] - uniform, axis=-1).max(axis=0)
        assert (away <= team.deviation[k] + 1e-12).all()


@pytest.mark.parametrize(
    ("jump", "step", "wrong"),
    [(1e-3, 5e-4, {"smoothness", "acceleration"}), (0.9e-6, 1e-4, {"acceleration"})],
)
def test_acceleration_hidden_in_jumps_of_velocity_is_counted(jump, step, wrong):
    """Pieces of uniform motion whose speeds differ have no acceleration of their own."""
    count = 200
    speed = jump * np.minimum(np.arange(count), np.arange(count)[::-1])
    coefficients = np.zeros((count, 6, 2, 3))
    coefficients[:, 1, :, 0] = speed[:, None]
    coefficients[:, 0, :, 0] = ((np.cumsum(speed) - speed) * step)[:, None]
    coefficients[:, 0, :, 1] = [0.0, 2.5]
    coefficients[:, 0, :, 2] = 5.0
    motion = Motion(step * np.arange(count + 1.0), coefficients)
    most = 0.5 * jump / step
    limits = f"vehicles.max_acceleration={1.0 + most}", "vehicles.braking_acceleration=1.0"
    found = assess(plan_of(motion, [3.0], *limits)).findings
    assert {finding.check for finding in found if finding.severity == "error"} == wrong
