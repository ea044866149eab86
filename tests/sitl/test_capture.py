"""Motion capture that errs, and a person who lifts, leans and turns a standing vehicle."""

import json
import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sitl import Emulator
from sitl.faults import parse_scenario
from sitl.server import MotionCapture
from sitl.world import Capture, WorldError, default_world
from tests.sitl.client import Ground


def laboratory(*faults):
    """Return a world of three vehicles with faults, and its motion capture without noise."""
    described = default_world(3, ["px4"]).model_copy(
        update={"capture": Capture(delay=0.0, noise=0.0), "indoor": True}
    )
    text = "{schema: 1, faults: [" + ", ".join("{" + fault + "}" for fault in faults) + "]}"
    world = Emulator(described, parse_scenario(text))
    return world, MotionCapture(world, ("127.0.0.1", 9))


def seen(world, source, until):
    """Return the frames of a world until a time, by the system ids of the bodies."""
    frames = []
    while world.time < until - 1e-9:
        world.advance(world.time + 0.02)
        frames.append(json.loads(source.frame())["bodies"])
    source.close()
    return frames


def turned(row):
    w, x, y, z = row[3:]
    return Rotation.from_quat([x, y, z, w])


def test_a_person_lifts_leans_and_turns_a_vehicle_and_puts_it_back():
    world, source = laboratory(
        "at: 1, kind: handled, vehicle: 2, duration: 8, height: 0.4, lean: 0.5, turn: 0.9"
    )
    ground = Ground(world)
    before = world.bodies.position[1].copy()
    angles = []
    while world.time < 10.0:
        ground.run(0.02)
        angles.append(
            (
                *(getattr(ground.last[2, "ATTITUDE"], k) for k in ("roll", "pitch", "yaw")),
                world.bodies.position[1, 2],
            )
            if (2, "ATTITUDE") in ground.last
            else (0,) * 4
        )
    roll, pitch, yaw, height = np.array(angles).T
    assert roll.max() == pytest.approx(0.5, abs=0.02), "to its right"
    assert pitch.max() == pytest.approx(0.5, abs=0.02), "nose up"
    assert np.ptp(np.unwrap(yaw[100:])) == pytest.approx(0.9, abs=0.02)
    assert height.max() - before[2] == pytest.approx(0.4, abs=0.01)
    assert world.bodies.position[1] == pytest.approx(before)
    assert world.bodies.landed.all()
    # its pose has the attitude that it reports: NED and FRD there, ENU and FLU here
    row = json.loads(source.frame())["bodies"]["2"]
    source.close()
    assert turned(row).as_euler("ZYX")[1:] == pytest.approx([0.0, 0.0], abs=1e-6)


def test_a_pose_leans_as_its_vehicle_reports():
    world, source = laboratory("at: 0, kind: handled, vehicle: 1, duration: 10")
    world.advance(2.5)
    row = json.loads(source.frame())["bodies"]["1"]
    source.close()
    yaw, pitch, roll = turned(row).as_euler("ZYX")
    assert roll == pytest.approx(0.6, abs=0.02), "to its right, about x forwards"
    assert pitch == pytest.approx(0.0, abs=1e-3)
    assert yaw == pytest.approx(float(world.bodies.yaw[0]), abs=1e-3)


def test_bodies_are_swapped_lost_and_frozen():
    world, source = laboratory(
        "at: 0, kind: capture, vehicle: 2, error: swapped, body: 3",
        "at: 0.5, kind: capture, vehicle: 1, error: frozen",
        "at: 1, kind: capture, vehicle: 3, error: lost, duration: 1",
        "at: 0.5, kind: handled, vehicle: 1, duration: 1",
        "at: 0.5, kind: handled, vehicle: 2, duration: 1",
    )
    frames = seen(world, source, 2.5)
    places = world.bodies.position
    assert frames[5]["2"][:3] == pytest.approx(places[2])
    assert frames[5]["3"][:3] == pytest.approx(places[1])
    heights = np.array([frame["1"][2] for frame in frames])
    assert np.ptp(heights) == 0.0
    assert {frozenset(frame) for frame in frames[55:95]} == {frozenset({"1", "2"})}
    assert set(frames[-1]) == {"1", "2", "3"}
    lifted = max(frame["3"][2] for frame in frames if "3" in frame)
    assert lifted > places[1, 2] + 0.2, "body 3 is on vehicle 2"


@pytest.mark.parametrize(
    ("error", "change"),
    [
        ("mirrored", lambda r: Rotation.from_matrix(
            np.diag([-1, 1, 1]) @ r.as_matrix() @ np.diag([-1, 1, 1]))),
        ("turned", lambda r: r * Rotation.from_euler("Z", math.pi / 2)),
    ],
)  # fmt: skip
def test_axes_are_mirrored_and_turned(error, change):
    hands = "at: 0, kind: handled, vehicle: 2, duration: 4"
    good = seen(*laboratory(hands), 3.0)
    bad = seen(*laboratory(hands, f"at: 0, kind: capture, vehicle: 2, error: {error}"), 3.0)
    for right, wrong in zip(good, bad, strict=True):
        apart = change(turned(right["2"])).inv() * turned(wrong["2"])
        assert apart.magnitude() < 1e-4
        assert right["1"] == wrong["1"]


def test_a_body_that_flips_turns_by_half_a_turn():
    frames = seen(*laboratory("at: 0, kind: capture, vehicle: 1, error: flipping"), 2.9)
    steps = [
        (turned(one["1"]).inv() * turned(two["1"])).magnitude() for one, two in pairwise(frames)
    ]
    jumps = [step for step in steps if step > 1e-6]
    assert jumps == pytest.approx([math.pi] * len(jumps))
    assert len(jumps) == 5


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("at: 0, kind: handled, vehicle: 1", "handled: expected a duration above 0"),
        ("at: 0, kind: capture, vehicle: 1, error: swapped", "expected a body with swapped"),
        ("at: 0, kind: capture, vehicle: 1, error: lost, body: 2", "expected a body with swapped"),
        ("at: 0, kind: capture, vehicle: 1, error: swapped, body: 9", "expected vehicles of the world"),
    ],
)  # fmt: skip
def test_faults_that_cannot_be_are_refused(fault, words):
    with pytest.raises(WorldError, match=words):
        laboratory(fault)
