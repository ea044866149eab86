"""Every kind of clearance counts for the live monitor and after a loss of setpoints.

Against brute force on densely sampled strands, without code of the certificate.
"""

from collections.abc import Collection
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from swarm.certification.cable_spans import cable_spans, exempt_length
from swarm.certification.clearances import families, limits
from swarm.certification.kinds import KINDS, Kind, coverage_table, kind_of
from swarm.certification.monitor import Monitor
from swarm.certification.motion_bounds import BoundedMotion
from swarm.certification.strand_pieces import LEAVES, HeldCable, TubeRadii
from swarm.certification.stream_loss import certify_stream_loss
from swarm.certification.team_margins import PLACES
from swarm.folding.penalty import no_extra_margins
from swarm.geometry.chain import polyline
from swarm.geometry.motion import Motion
from swarm.mission.mission import CylinderObstacle
from swarm.planning import Plan
from tests.certification.synthetic import moving, plan_of
from tests.overhand import planned_overhand

LIVE = {kind.place: kind.check for kind in KINDS if kind.place is not None}
NAMES = [LIVE[place] for place in sorted(LIVE)]
SAMPLES = 160
POST = (
    "workspace.obstacles=[{name: post, shape: cylinder, centre: [-2.2, 3], radius: 0.3, top: 20}]"
)
FENCE = "workspace.fence=[[-4,-4],[8,-4],[8,8],[2,8],[2,5],[-4,5]]"


def brute(plan: Plan, grips: np.ndarray, kinds: Collection[str] = NAMES) -> dict[str, float]:
    """The smallest margins at grip points (n, 3): of all kinds of clearance, or of some at least."""
    mission, n = plan.mission, len(grips)
    clearance, vehicles, thin = mission.clearance, mission.vehicles, 0.5 * mission.cable.diameter
    lengths = plan.layout.lengths
    drawn = polyline(grips, lengths, SAMPLES)
    strands = [drawn[k * SAMPLES : (k + 1) * SAMPLES + 1] for k in range(n - 1)]
    found = dict.fromkeys(NAMES, np.inf)

    def count(kind: str, margin: float) -> None:
        found[kind] = min(found[kind], float(margin))

    for i in range(n):
        count("ceiling", mission.workspace.ceiling - vehicles.grip_offset - grips[i, 2])
        count("fence", inside(grips[i, :2], mission.workspace.fence) - vehicles.radius)
        count("obstacle", from_post(grips[i]) - vehicles.radius - clearance.obstacle)
        for j in range(i):
            x, y, z = np.abs(grips[i] - grips[j])
            count(
                "vehicle clearance", max(np.hypot(x, y) - clearance.vehicle, z - clearance.downwash)
            )
        for k, strand in enumerate(strands):
            own = k in (i - 1, i)
            if ("rotor disc" if own else "vehicle-cable clearance") not in kinds:
                continue
            tip = vehicles.grip_offset if own else 0.0
            apart = from_cone(strand - grips[i], vehicles.radius, vehicles.grip_offset, tip)
            needed = 0.0 if own else clearance.vehicle_cable
            count("rotor disc" if own else "vehicle-cable clearance", apart - thin - needed)
    beyond = exempt_length(plan)
    for i, strand in enumerate(strands):
        count("taut", 0.985 * lengths[i] - np.linalg.norm(grips[i + 1] - grips[i]))
        count("floor", strand[:, 2].min() - thin - clearance.floor)
        count("obstacle", from_post(strand).min() - thin - clearance.obstacle)
        for point in strand[::8] if "fence" in kinds else ():
            count("fence", inside(point[:2], mission.workspace.fence) - thin)
        for j in range(i + 1, n - 1):
            kind = "neighbouring segments" if j == i + 1 else "cable clearance"
            if kind not in kinds:
                continue
            apart = np.linalg.norm(strand[:, None] - strands[j][None], axis=2)
            if j == i + 1:
                near = min(beyond, 0.5 * lengths[i], 0.5 * lengths[j])
                arc = np.linspace(0.0, lengths[i], SAMPLES + 1)
                other = np.linspace(0.0, lengths[j], SAMPLES + 1)
                exempt = (lengths[i] - arc < near)[:, None] & (other < near)[None]
                apart[exempt] = np.inf
            count(kind, apart.min() - 2.0 * thin - clearance.cable)
    return found


def inside(point: np.ndarray, fence: list[list[float]] | None) -> float:
    """Distance of a point from a fence, negative outside; infinite without one."""
    if fence is None:
        return np.inf
    corners = np.array(fence, dtype=float)
    apart, within = np.inf, False
    for one, other in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        step = other - one
        share = np.clip((point - one) @ step / (step @ step), 0.0, 1.0)
        apart = min(apart, float(np.linalg.norm(one + share * step - point)))
        if (one[1] > point[1]) != (other[1] > point[1]):
            within ^= point[0] < one[0] + (point[1] - one[1]) / step[1] * step[0]
    return apart if within else -apart


def from_post(points: np.ndarray) -> np.ndarray:
    """Distance of points (…, 3) from the post, which is higher than all of them."""
    return np.hypot(points[..., 0] + 2.2, points[..., 1] - 3.0) - 0.3


def from_cone(points: np.ndarray, radius: float, height: float, tip: float) -> float:
    """Distance of points (k, 3) from a disc and the hull of it and a point below, by its outline."""
    share = np.linspace(0.0, 1.0, 150)
    outline = np.concatenate(
        [
            np.column_stack([share * radius, np.full(150, height)]),
            np.column_stack([share * radius, tip + share * (height - tip)]),
        ]
    )
    at = np.column_stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]])
    apart = np.linalg.norm(at[:, None] - outline[None], axis=2).min(axis=1)
    hull = (
        (at[:, 1] <= height)
        & (at[:, 1] >= tip)
        & (at[:, 0] * (height - tip) <= radius * (at[:, 1] - tip))
    )
    return float(np.where(hull & (height > tip), 0.0, apart).min())


SQUARE = np.array([[0.0, 0.0, 6.0], [3.0, 0.0, 6.0], [3.0, 3.0, 6.0], [0.0, 3.0, 6.0]])
LENGTHS = [3.6, 3.6, 5.0]
RING = np.array(
    [[0.0, 0.0, 6.0], [3.0, 0.0, 6.0], [4.5, 2.6, 6.0], [1.8, 3.2, 5.2], [1.4, -1.6, 3.6]]
)
BESIDE = np.concatenate([RING[:4], [[1.5, 1.0, 4.6]]])
FOLDED = np.array([[0.0, 0.0, 6.0], [6.0, 0.0, 6.0], [0.562, 2.536, 6.0]])
STEEP = np.array([[0.0, 0.0, 5.0], [1.6, 0.0, 6.2], [3.2, 0.0, 7.0]])
MOVES = {
    "vehicle clearance": (SQUARE, LENGTHS, 3, (0.0, -2.5, 0.0)),
    "ceiling": (SQUARE, LENGTHS, 3, (0.0, 0.0, 2.6)),
    "fence": (SQUARE, LENGTHS, 3, (0.0, 2.0, 0.0)),
    "taut": (SQUARE, [3.6, 3.6, 3.6], 3, (-0.6, 0.0, 0.0)),
    "cable clearance": (RING, [3.6, 3.4, 3.3, 5.6], 4, (0.0, 0.0, 3.2)),
    "neighbouring segments": (FOLDED, [6.5, 6.5], 2, (-0.51, -1.72, 0.0)),
    "vehicle-cable clearance": (BESIDE, [3.6, 3.4, 3.3, 3.3], 4, (0.0, -0.9, 0.0)),
    "rotor disc": (STEEP, [3.0, 4.0], 1, (-1.35, 0.0, 1.0)),
    "floor": (SQUARE - [0.0, 0.0, 2.6], LENGTHS, 3, (0.0, 0.0, -2.3)),
    "obstacle": (SQUARE, LENGTHS, 3, (-1.7, 0.0, 0.0)),
}  # fmt: skip
"""Grip points with lengths, and the step of a vehicle by which a kind falls short first."""


@cache
def place_with(kind: str, margin: float) -> np.ndarray:
    """The grip points on the way of a kind's vehicle at which it has a margin."""
    start, lengths, vehicle, step = MOVES[kind]
    still, near, far, there = _plan(moving([0.0, 1.0], [start, start]), lengths), 0.0, 1.0, start
    for _ in range(14):
        share, there = 0.5 * (near + far), start.copy()
        there[vehicle] += share * np.array(step)
        near, far = (share, far) if brute(still, there, {kind})[kind] > margin else (near, share)
    return there


def plan_for(kind: str) -> Plan:
    """A plan in which a vehicle nearly falls short of what a kind requires, fast, and goes back."""
    start, lengths, _, _ = MOVES[kind]
    near = place_with(kind, 0.06)
    time = max(1.6, float(np.linalg.norm(near - start)) / 0.6)
    return _plan(moving([0.0, time, 2.0 * time], [start, near, start]), lengths)


def _plan(motion: Motion, lengths: list[float]) -> Plan:
    return plan_of(motion, lengths, FENCE, POST, "workspace.ceiling=9", "vehicles.tracking=0.05")


@pytest.mark.slow
@pytest.mark.parametrize("kind", NAMES)
def test_the_monitor_sees_every_kind(kind: str) -> None:
    places = np.stack([place_with(kind, 0.03), place_with(kind, -0.002)])
    monitor = Monitor(plan_for(kind))
    before, after = monitor.clearances(places, "aloft")
    assert before.margin > 0.0, before
    assert after.margin < 0.0
    assert after.kind == kind, after
    assert monitor.clock_rate(places, "aloft") == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", NAMES)
def test_a_loss_that_breaks_any_kind_limits_the_rate(kind: str) -> None:
    # the vehicle turns just before; without setpoints it would fly on
    plan, vehicle = plan_for(kind), MOVES[kind][2]
    times = np.linspace(0.0, plan.motion.times[-1], 9)
    assert min(min(brute(plan, place).values()) for place in plan.motion.at(times)[0]) > 0.0
    found = certify_stream_loss(plan)
    assert found.rates.min() < 1.0
    assert not len(found.infeasible)
    fastest = np.linalg.norm(plan.motion.at(np.linspace(0.0, times[-1], 500))[1], axis=2).max()
    for time in times:
        position, velocity, _ = plan.motion.at(time)
        for share in (0.5, 1.0):
            flown_on = position.copy()
            coast = (0.85 + 0.12 * fastest) * share * found.rate_limit(time)
            flown_on[vehicle] += coast * velocity[vehicle]
            assert min(brute(plan, flown_on).values()) > -0.001


@pytest.mark.slow
def test_margins_are_those_of_dense_samples() -> None:
    plan = plan_for("floor")
    rng, seen = np.random.default_rng(4), dict.fromkeys(NAMES, 0)
    for _ in range(60):
        grips = SQUARE - [0.0, 0.0, rng.uniform(0.0, 5.0)] + rng.normal(0.0, 0.4, (4, 3))
        chords = np.linalg.norm(np.diff(grips, axis=0), axis=1)
        if (chords > 0.98 * np.array(LENGTHS)).any():
            continue
        expected = brute(plan, grips)
        low, here = (each[0] for each in Monitor(plan)._margins(grips[None], "aloft", np.inf))
        for number, kind in enumerate(NAMES):
            tolerance = 1e-9 if kind in {"vehicle clearance", "ceiling", "taut"} else 0.03
            assert low[number] <= expected[kind] + 1e-9, kind
            assert low[number] == pytest.approx(expected[kind], abs=tolerance), kind
            assert here[number] == pytest.approx(expected[kind], abs=tolerance), kind
            seen[kind] += 1
    assert min(seen.values()) > 10


def fenced(mission) -> Plan:
    plan = planned_overhand().plan
    fence = ((-50.0, -50.0), (50.0, -50.0), (50.0, 50.0), (-50.0, 50.0))
    post = CylinderObstacle(name="post", shape="cylinder", centre=(0.0, 40.0), radius=1.0, top=9.0)
    update = {"fence": fence, "obstacles": (post,)}
    workspace = plan.mission.workspace.model_copy(update=update)
    return replace(
        plan, mission=plan.mission.model_copy(update={"workspace": workspace, **mission})
    )


def test_the_table_says_who_compares_what() -> None:
    """Each row against the families that it makes: times, tracking errors, wind and swing."""
    plan = fenced({})
    made = {family.kind for family in (*families(plan, 0.1), *limits(plan))}
    assert {kind.check for kind in set(KINDS) - made} <= {"straight down"}
    assert len(NAMES) == len(set(NAMES)) == PLACES
    spans = cable_spans(plan)
    motion = BoundedMotion(plan.motion)
    tube = TubeRadii.of_leaves(0.0, np.full((1, plan.vehicles - 1, LEAVES), 0.2))

    def margins(kind: Kind, tracking: float, tube: TubeRadii | None = None) -> np.ndarray:
        cable = HeldCable(motion, plan.layout.lengths, tracking, 0.0, tube)
        family = kind.family(plan, spans, cable)
        boxes = family.roots()
        return family.evaluate(replace(boxes, half=0.02 * boxes.half)).low

    for kind in made:
        still = margins(kind, 0.0)
        assert (still > margins(kind, 0.05)).any() == kind.tracking, kind.check
        assert (still > margins(kind, 0.0, tube)).any() == kind.swing, kind.check
        leaning = HeldCable(motion, plan.layout.lengths, 0.0, 0.1, None)
        family = kind.family(plan, spans, leaning)
        upright = kind.family(plan, spans, HeldCable(motion, plan.layout.lengths, 0.0))
        changed = len(family.others) > len(upright.others)
        assert changed == kind.wind or kind.objects == "a vehicle and the fence", kind.check


def test_rows_of_one_check_agree_on_its_messages_and_repairs() -> None:
    for kind in KINDS:
        first = kind_of(kind.check)
        for name in ("failure", "listed", "figure", "margin", "budget", "unit"):
            assert getattr(kind, name) == getattr(first, name), kind.check
        if kind.margin:
            assert hasattr(no_extra_margins(2), kind.margin)


def test_the_method_has_the_table() -> None:
    page = (Path(__file__).parents[2] / "docs" / "method.md").read_text(encoding="utf-8")
    assert coverage_table() in page
