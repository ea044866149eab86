"""Every kind of clearance in a flown trace: found where it is missed, no less than certified."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm.certification.cable_spans import CableSpans
from swarm.certification.certificate import certify
from swarm.certification.clearances import PlanChecks
from swarm.certification.kinds import (
    KINDS,
    MEASURED,
    SWINGING,
    Flown,
    measured_distances,
    swinging_distances,
    unmeasured,
)
from swarm.certification.strand_pieces import HeldCable
from swarm.flight.trace import Trace
from swarm.planning import Plan
from swarm.reports.flight import clearance_table, verification_object
from swarm.verification import verify_trace
from tests.network import sideways
from tests.shared import shared

FENCE = "workspace.fence=[[-20,-20],[40,-20],[40,20],[-20,20]]"
WALL = "workspace.obstacles=[{name: wall, shape: box, centre: [10, -16], size: [60, 1], turn: 2, top: 9}]"
STEP = 0.1


@shared
def put_down() -> Plan:
    """Five vehicles inside a fence, beside a wall, that lift a line, move it, and put it down."""
    return sideways("finish=hold", FENCE, WALL, vehicles=5)


def flown(plan: Plan) -> Flown:
    """The exactly tracked plan, ten times a second."""
    time = np.arange(plan.motion.times[0], plan.duration, STEP)
    place = plan.motion.at(time)[0]
    return Flown(time, place, place.copy())


def middle(plan: Plan, track: Flown, state: str) -> np.ndarray:
    """Five samples in the middle of the spans with the held cable in a state."""
    spans = getattr(PlanChecks.of(plan).spans, state)
    rows = np.flatnonzero([any(a <= t <= b for a, b in spans) for t in track.time])
    return rows[len(rows) // 2 - 2 :][:5]


def moved(state: str, vehicle: int, *step: float):
    """Displace a vehicle for half a second."""

    def change(plan: Plan, track: Flown, place: np.ndarray) -> tuple[np.ndarray, int]:
        rows = middle(plan, track, state)
        place[rows, vehicle] += step
        return rows, vehicle

    return change


def put(state: str, vehicle: int, beside: int, *step: float):
    """Put a vehicle beside another for half a second."""

    def change(plan: Plan, track: Flown, place: np.ndarray) -> tuple[np.ndarray, int]:
        rows = middle(plan, track, state)
        place[rows, vehicle] = place[rows, beside] + step
        return rows, vehicle

    return change


VIOLATIONS = {
    "chord": moved("aloft", 0, -1.5, 0.0, 0.0),
    "cable": put("aloft", 4, 1, 0.0, 0.2, 0.0),
    "neighbours": put("aloft", 2, 0, 0.0, 0.2, 0.0),
    "floor": moved("aloft", 2, 0.0, 0.0, -5.0),
    "cable_reach": put("dragged", 4, 1, 0.5, 0.5, 0.0),
    "vehicle_reach": put("dragged", 4, 1, 0.5, 0.5, 0.0),
    "stretch": moved("dragged", 0, -3.0, 0.0, 0.0),
    "lying": moved("dragged", 2, 0.0, 0.0, 0.5),
    "drawn_out": put("dragged", 4, 2, 0.0, 1.0, 0.0),
    "beside_rotors": put("lifting", 4, 3, 0.1, 0.0, 2.5),
    "straight_down": moved("landing", 1, 0.02, 0.0, 0.0),
    "vehicle": put("aloft", 4, 3, 0.3, 0.0, 0.1),
    "ceiling": moved("aloft", 0, 0.0, 0.0, 60.0),
    "vehicle_cable": put("aloft", 4, 1, 1.5, 0.0, -0.6),
    "rotor_disc": put("aloft", 4, 3, 0.05, 0.0, 2.0),
    "vehicle_fence": moved("aloft", 4, 0.0, 40.0, 0.0),
    "vehicle_obstacle": moved("aloft", 4, 0.0, -17.8, 0.0),
    "cable_obstacle": moved("aloft", 0, 0.0, -18.5, 0.0),
    "obstacle_reach": moved("dragged", 4, 0.0, -15.5, 0.0),
    "cable_fence": moved("aloft", 0, -20.0, 0.0, 0.0),
}


@pytest.mark.parametrize("key", MEASURED)
def test_a_violation_of_each_kind_is_found_with_its_time_and_names(key: str) -> None:
    plan, kind = put_down(), MEASURED[key]
    track = flown(plan)
    exact = measured_distances(plan, track)[key]
    assert exact is not None
    assert exact.distance >= exact.required
    changed = getattr(track, kind.flown_by)
    rows, vehicle = VIOLATIONS[key](plan, track, changed)
    found = measured_distances(plan, track)[key]
    assert found is not None
    assert found.distance < found.required == kind.required(plan.mission)
    assert found.time in track.time[rows]
    assert {f"vehicle {vehicle + 1}", f"segment {vehicle}", f"segment {vehicle + 1}"} & {
        *found.between
    }


@pytest.mark.parametrize("key", MEASURED)
def test_a_kind_is_compared_only_while_its_certificate_applies(key: str) -> None:
    plan, kind = put_down(), MEASURED[key]
    track, exact = flown(plan), measured_distances(plan, flown(plan))[key]
    spans = kind.family(plan, *_held(plan)).spans
    outside = np.array([not any(a <= t <= b for a, b in spans) for t in track.time])
    for place in (track.positions, track.setpoints):
        place[outside] += np.linspace(0.0, 100.0, 15).reshape(5, 3)
    assert measured_distances(plan, track)[key] == exact


def _held(plan: Plan) -> tuple[CableSpans, HeldCable]:
    checks = PlanChecks.of(plan)
    return checks.spans, HeldCable(checks.motion, plan.layout.lengths, 0.0)


def test_what_is_not_measured_says_why() -> None:
    assert list(unmeasured().values()) == [["ground"], ["speed", "acceleration"]]
    for kind in KINDS:
        assert bool(kind.flown) != bool(kind.unmeasured), kind.check


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0))
def test_no_kind_is_flown_closer_than_certified(seed: int, share: float) -> None:
    """For tracking errors within the certified radius; its setpoints exactly."""
    plan, track = put_down(), flown(put_down())
    rng = np.random.default_rng(seed)
    error = rng.normal(size=track.positions.shape)
    error *= share * plan.mission.vehicles.tracking / np.linalg.norm(error, axis=-1, keepdims=True)
    found = measured_distances(plan, track._replace(positions=track.positions + error))
    certificate = certify(plan).assessment
    for key, tightest in found.items():
        held = certificate.certified(key)
        assert tightest is not None
        # setpoints are compared to a tenth of a millimetre, which packets keep
        assert tightest.distance >= held.distance - 1e-4, key


def test_the_swing_of_known_shapes_counts() -> None:
    plan = put_down()
    track = flown(plan)
    straight = np.linspace(track.positions[:, :-1], track.positions[:, 1:], 25, axis=2)
    modelled = measured_distances(plan, track)
    taut = swinging_distances(plan, track._replace(shapes=straight))
    assert taut.keys() == SWINGING.keys()
    sagging = straight.copy()
    sagging[..., 2] -= 6.0 * np.sin(np.linspace(0.0, np.pi, 25))
    deep = swinging_distances(plan, track._replace(shapes=sagging))
    for distances, nearer in ((taut, False), (deep, True)):
        floor, in_model = distances["emulated_floor"], modelled["floor"]
        assert floor is not None
        assert in_model is not None
        assert (floor.distance < in_model.distance) == nearer
    assert deep["emulated_floor"].distance < 0.0


def test_a_violation_of_a_limit_is_told_in_the_verdict_of_a_flight() -> None:
    plan, track = put_down(), flown(put_down())
    VIOLATIONS["vehicle_fence"](plan, track, track.positions)
    phase = tuple(plan.phase_at(float(t)).name for t in track.time)
    trace = Trace(track.time, track.time, track.positions, track.setpoints, phase)
    document = verification_object(verify_trace(plan, trace), certify(plan).assessment)
    rows = {str(row[0]): row for row in clearance_table(document["clearance"]).rows}
    flown_cell = rows["vehicle to fence"][1]
    assert flown_cell.level == "bad"
    assert document["clearance"]["vehicle_fence"]["flown"]["distance"] < 0.0
