"""Which body each vehicle moves: by noise, gaps and delays, all exchanges, and every fault."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from swarm.flight.bodies import Body, Pose
from swarm.flight.identification import (
    Identification,
    attitude_matrix,
    pose_matrix,
    rotation_vector,
)

RATE, MOVING, PAUSE = 20.0, 6.0, 3.0
NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD = np.diag([1.0, -1.0, -1.0])
ANGLE = st.floats(-3.0, 3.0)


def bump(share, start, end):
    return math.sin(math.pi * (share - start) / (end - start)) ** 2 if start < share < end else 0.0


class Hall:
    """Vehicles that are moved one after the other, and a system that sees them as it likes.

    ``seen`` maps a vehicle's true rotation (FRD to NED), its position and the time to what the
    system sees of it: rotation and position, None for nothing. ``bodies`` has the vehicle on which
    each body is. A vehicle's attitude arrives late by ``late`` seconds.
    """

    def __init__(self, vehicles, bodies=None, seen=None, late=0.0, noise=0.0, gaps=0.0, seed=1,
                 order=None, height=0.4):  # fmt: skip
        self.systems = tuple(range(1, vehicles + 1))
        self.bodies = bodies or {k: k for k in self.systems}
        self.seen = seen or {}
        self.late, self.noise, self.gaps, self.height = late, noise, gaps, height
        self.rng = np.random.default_rng(seed)
        self.order = order or self.systems
        self.headings = {k: self.rng.uniform(-3.0, 3.0) for k in self.systems}
        self.newest, self.last, self.changed = {}, {}, {}

    def angles(self, system, now):
        """Return roll, pitch, yaw and height of a vehicle, by its turn in the order."""
        begun = PAUSE + self.order.index(system) * (MOVING + PAUSE)
        share = (now - begun) / MOVING
        roll, pitch = 0.6 * bump(share, 0.1, 0.4), 0.6 * bump(share, 0.35, 0.65)
        yaw = self.headings[system] - 1.2 * bump(share, 0.6, 0.9)
        return roll, pitch, yaw, self.height * bump(share, 0.0, 1.0)

    def moment(self, now):
        attitudes = {}
        for system in self.systems:
            roll, pitch, yaw, _ = self.angles(system, now - self.late)
            errors = self.noise * self.rng.standard_normal(3)
            attitudes[system] = tuple(np.array([roll, pitch, yaw]) + errors)
        return attitudes, {k: self.body(k, now) for k in self.bodies if self.sees(k, now)}

    def sees(self, body, now):
        """Take a new pose of a body, if there is one; return whether there was any."""
        on = self.bodies[body]
        *angles, height = self.angles(on, now)
        place = np.array([3.0 * on, 1.0, height])
        true = attitude_matrix(*angles)
        look = self.seen.get(body, lambda rotation, position, _: (rotation, position))
        found = look(true, place, now)
        if found is not None and self.rng.random() >= self.gaps:
            rotation, position = found
            shaken = (
                rotation
                @ Rotation.from_rotvec(self.noise * self.rng.standard_normal(3)).as_matrix()
            )
            x, y, z, w = Rotation.from_matrix(NED @ shaken @ FRD).as_quat()
            pose = Pose(body, now, tuple(position), (w, x, y, z))
            if body not in self.last or pose[2:] != self.last[body][2:]:
                self.changed[body] = now
            self.newest[body], self.last[body] = now, pose
        return body in self.last

    def body(self, body, now):
        newest = self.newest[body]
        return Body(self.last[body], RATE, now - newest, newest - self.changed[body])

    def identified(self, until=None):
        """Return the identification at the end, and what it said."""
        identification, said = Identification(self.systems), []
        end = until or PAUSE + len(self.systems) * (MOVING + PAUSE) + 1.0
        for k in range(int(end * RATE)):
            now = k / RATE
            said += identification.step(now, *self.moment(now))
        return identification, said


def messages(identification):
    return [finding.message for finding in identification.findings()]


GOOD = "vehicle {0} moves body {0}: attitude, heading and height agree"
ASK = "vehicle {}: lift it, lean it to its right, lift its nose, turn it by a quarter, and put it back"


def test_a_transcript_of_three_vehicles():
    identification, said = Hall(3).identified()
    assert said == [text.format(k) for k in (1, 2, 3) for text in (ASK, GOOD)]
    assert identification.done
    assert messages(identification) == [GOOD.format(k) for k in (1, 2, 3)]
    assert all(result.own for result in identification.results.values())


def test_swapped_bodies_are_named_once():
    identification, said = Hall(4, {1: 1, 2: 3, 3: 2, 4: 4}).identified()
    assert said[3] == "vehicle 2 moves body 3, not body 2"
    assert messages(identification) == [
        GOOD.format(1), "vehicle 2 moves body 3: bodies 2 and 3 are swapped", GOOD.format(4)
    ]  # fmt: skip


def test_three_bodies_in_a_ring():
    identification, _ = Hall(3, {2: 1, 3: 2, 1: 3}).identified()
    assert messages(identification) == [
        "vehicle 1 moves body 2, vehicle 2 moves body 3, vehicle 3 moves body 1: bodies 1, 2, 3 "
        "are exchanged"
    ]


EACH_KIND = {(1, 2, 3, 4), (1, 2, 4, 3), (2, 1, 4, 3), (1, 3, 4, 2), (2, 3, 4, 1)}
"""No exchange, of two bodies, of two and two, in a ring of three and of four."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "bodies",
    [
        pytest.param(bodies, marks=() if bodies in EACH_KIND else pytest.mark.full)
        for bodies in itertools.permutations(range(1, 5))
    ],
)
def test_every_exchange_is_found(bodies):
    on = dict(zip(range(1, 5), bodies, strict=True))
    identification, _ = Hall(4, on, noise=0.005, gaps=0.1, seed=3).identified()
    moved = {result.body: system for system, result in identification.results.items()}
    assert moved == on
    errors = [f for f in identification.findings() if f.severity == "error"]
    assert (errors == []) == (bodies == (1, 2, 3, 4))


@pytest.mark.slow
@settings(max_examples=12, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(
    st.permutations([1, 2, 3]), st.floats(0.0, 0.005), st.floats(0.0, 0.4), st.floats(-0.3, 0.3),
    st.integers(0, 1000),
)  # fmt: skip
def test_noise_gaps_and_delays_do_not_change_what_is_found(bodies, noise, gaps, late, seed):
    on = dict(zip((1, 2, 3), bodies, strict=True))
    hall = Hall(3, on, late=late, noise=noise, gaps=gaps, seed=seed)
    identification, _ = hall.identified()
    assert {r.body: k for k, r in identification.results.items()} == on
    exchanged = any(body != on[body] for body in on)
    problems = [p for r in identification.results.values() for p in r.problems]
    assert problems == []
    assert any(f.severity == "error" for f in identification.findings()) == exchanged


def mirror(normal):
    """Return what a system sees whose axis (of NED) is mirrored."""
    reflection = np.eye(3)
    reflection[normal, normal] = -1.0
    body = np.diag([1.0, -1.0, 1.0])  # a mirrored vehicle has its right on its left
    enu = NED @ reflection @ NED.T

    def look(rotation, position, _now):
        return reflection @ rotation @ body, enu @ position

    return look


def about(axis, degrees):
    turn = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return lambda rotation, position, _: (rotation @ turn, position)


def world_about(degrees):
    turn = Rotation.from_euler("Z", degrees, degrees=True).as_matrix()
    return lambda rotation, position, _: (turn @ rotation, position)


HALF = Rotation.from_euler("X", 180, degrees=True).as_matrix()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("look", "words"),
    [
        (mirror(0), "body 2 on vehicle 2 is mirrored: roll and heading go the other way"),
        (mirror(1), "body 2 on vehicle 2 is mirrored: roll and heading go the other way"),
        (lambda r, p, _: (np.diag([1, -1, 1]) @ r @ np.diag([1, -1, 1]), p),
         "body 2 on vehicle 2 is mirrored: roll and heading go the other way"),
        (about("Z", 90), "body 2 on vehicle 2 is turned by 90 degrees about the vertical: define its "
         "axes anew in the motion capture system, x forwards, y to the left"),
        (about("Z", 180), "body 2 on vehicle 2 is turned by 180 degrees about the vertical: define "
         "its axes anew in the motion capture system, x forwards, y to the left"),
        (about("Y", 90), "the axes of body 2 on vehicle 2 do not fit the vehicle's"),
        (about("X", 20), "body 2 on vehicle 2 leans by 20 degrees against it at rest"),
        (world_about(50), "body 2 on vehicle 2: headings differ by 50 degrees at rest: turn the axes "
         "of the laboratory, or the vehicle's north"),
        (lambda r, p, _: (r, p * (1, 1, -1)),
         "body 2 on vehicle 2 sinks when it is lifted: up is mirrored"),
        (lambda r, p, now: (r, p) if now < 12.0 else None, "body 2 is lost while vehicle 2 moves"),
        (lambda *_: (np.eye(3), np.zeros(3)),
         "body 2 is frozen: no digit of its pose changes while vehicle 2 moves"),
        (lambda _r, _p, now: (np.eye(3), np.array([0.0, 0.0, 1e-3 * math.sin(99 * now)])),
         "no body moves with vehicle 2"),
        (lambda r, p, now: (r @ HALF if now % 3.0 < 1.0 else r, p),
         "body 2 flips: its attitude jumps while vehicle 2 turns smoothly"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_body_is_named(look, words):
    identification, _ = Hall(3, seen={2: look}, noise=0.0).identified()
    assert messages(identification) == [GOOD.format(1), words, GOOD.format(3)]
    assert not identification.results[2].own


def test_a_vehicle_that_was_only_leaned_is_told_so():
    identification, _ = Hall(1, height=0.05).identified()
    assert messages(identification) == [
        "vehicle 1 was lifted by less than 0.1 m: heights not compared"
    ]


def test_another_vehicle_than_the_one_that_was_asked_for():
    hall = Hall(2, order=(2, 1))
    identification, said = hall.identified()
    assert said[:2] == [
        ASK.format(1),
        "vehicle 2 moves, and vehicle 1 was asked for: put it back; if it is labelled 1, its "
        "system id is wrong",
    ]
    assert said[2:] == [GOOD.format(1), ASK.format(2)]
    assert identification.asked == 2
    assert identification.remaining == ("lean it to its right", "lift its nose", "turn it")


def test_what_remains_to_be_done_is_known():
    hall = Hall(1)
    identification = Identification((1,))
    remaining = []
    for k in range(int((PAUSE + MOVING + PAUSE) * RATE)):
        identification.step(k / RATE, *hall.moment(k / RATE))
        if identification.asked and identification.remaining not in remaining:
            remaining.append(identification.remaining)
    assert remaining == [
        ("lean it to its right", "lift its nose", "turn it"),
        ("lift its nose", "turn it"),
        ("turn it",),
        ("put it back",),
    ]


def test_nothing_is_asked_while_a_vehicle_is_not_heard_or_moves():
    identification = Identification((1, 2))
    hall = Hall(2)
    for k in range(40):
        attitudes, bodies = hall.moment(0.0)
        attitudes[1] = (0.1 * k, 0.0, 0.0)
        assert identification.step(k / RATE, attitudes, bodies) == []
        attitudes.pop(2)
        assert identification.step(k / RATE + 0.01, attitudes, bodies) == []


@given(ANGLE, st.floats(-1.5, 1.5), ANGLE)
def test_rotations_are_those_of_another_library(yaw, pitch, roll):
    rotation = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    matrix = attitude_matrix(roll, pitch, yaw)
    assert matrix == pytest.approx(rotation.as_matrix(), abs=1e-12)
    assert Rotation.from_rotvec(rotation_vector(matrix)).as_matrix() == pytest.approx(
        matrix, abs=1e-6
    )
    x, y, z, w = Rotation.from_matrix(NED @ matrix @ FRD).as_quat()
    assert pose_matrix((w, x, y, z)) == pytest.approx(matrix, abs=1e-9)


@pytest.mark.parametrize("axis", np.vstack([np.eye(3), [[0.6, 0.8, 0.0], [0.0, -0.6, 0.8]]]))
def test_half_a_turn_has_its_axis(axis):
    vector = rotation_vector(Rotation.from_rotvec(math.pi * axis).as_matrix())
    assert np.linalg.norm(vector) == pytest.approx(math.pi)
    assert abs(vector @ axis) == pytest.approx(math.pi)
