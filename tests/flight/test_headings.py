"""Wrong headings: against what is held, against motion, and in the messages of both firmwares."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from swarm.flight.detect import HEADING_OFF, HeadingDetector, ReportDetector
from swarm.flight.failures import FailureKind, Latch
from swarm.flight.grip_slip import INTERVAL, GripSlipDetector
from swarm.geometry.catenary import STANDARD_GRAVITY
from swarm.mavlink.autopilots import AUTOPILOTS
from swarm.mavlink.packets import Decoder
from swarm.mavlink.vehicle import Vehicle, VehicleEvent
from tests.flight.test_detect import expected, kinds, seen
from tests.network import small_plan
from tests.recordings import ARDUCOPTER, ARDUCOPTER_CABLE, ARDUCOPTER_ENDS, PX4, recorded

PLAN = small_plan().plan
MASS = PLAN.mission.vehicles.mass


def detector() -> tuple[GripSlipDetector, HeadingDetector]:
    leaning = GripSlipDetector(PLAN, Latch(), enabled=True)
    return leaning, HeadingDetector(3, Latch(), leaning)


def attitudes(*headings: float, roll: float = 0.0) -> np.ndarray:
    return np.array([[roll, 0.0, heading] for heading in headings])


def test_a_heading_that_leaves_the_one_it_is_to_hold_is_reported_once():
    _, headings = detector()
    # across north, where angles begin anew
    assert headings.detect(seen(attitude=attitudes(3.1, -3.1, 0.0)), expected()) == []
    small = 0.9 * HEADING_OFF
    assert (
        headings.detect(seen(attitude=attitudes(3.1 + small, -3.1 - small, 0.0)), expected()) == []
    )
    off = seen(attitude=attitudes(3.1 + 0.7 - 2.0 * math.pi, -3.1, 0.0))
    (failure,) = headings.detect(off, expected())
    assert (failure.kind, failure.vehicle) == (FailureKind.HEADING_DISAGREES, 0)
    assert failure.message == "vehicle 1's heading is +40° off what it is to hold"
    assert headings.detect(off, expected()) == []


@pytest.mark.parametrize(
    "commanded",
    [
        expected(armed=np.full(3, False)),
        expected(streaming=np.full(3, False)),
        expected(may_land=np.full(3, True)),
        expected(fallen=frozenset({0})),
    ],
)
def test_a_vehicle_that_holds_no_heading_or_turns_over_is_not_judged_by_it(commanded):
    _, headings = detector()
    headings.detect(seen(attitude=attitudes(0.0, 0.0, 0.0)), expected())
    turned = attitudes(1.0, 0.0, 0.0)
    assert headings.detect(seen(attitude=turned), commanded) == []
    tilted = attitudes(1.0, 0.0, 0.0, roll=0.5)
    assert headings.detect(seen(attitude=tilted), expected()) == []
    assert kinds(headings.detect(seen(attitude=turned), expected())) == [
        FailureKind.HEADING_DISAGREES
    ]


def swayed(error: float, who: int, *, wind: float = 0.0, seconds: float = 12.0) -> list[str]:
    """Let a team sway east and north; after four seconds one heading is off clockwise.

    Only its attitude tells: its autopilot holds the heading that it takes for its own.
    """
    leaning, headings = detector()
    line = PLAN.layout.corners.astype(np.float64)
    messages = []
    for number in range(int(seconds / INTERVAL)):
        now = number * INTERVAL
        rates = 2.0 * np.array([0.9, 1.3])
        velocity = np.zeros((3, 3))
        velocity[:, :2] = 0.6 * np.sin(rates * now)
        accelerations = [
            0.6 * rates * np.cos(rates * (now - lag)) for lag in np.linspace(0, 0.25, 5)
        ]
        pull = leaning._held(line).pull
        lift = MASS * STANDARD_GRAVITY - pull[:, 2]
        lean = (MASS * np.mean(accelerations, axis=0) + [wind, 0.0] - pull[:, :2]) / lift[:, None]
        truly = np.full(3, 0.4)
        ahead = lean[:, 0] * np.sin(truly) + lean[:, 1] * np.cos(truly)
        right = lean[:, 0] * np.cos(truly) - lean[:, 1] * np.sin(truly)
        pitch = -np.arctan(ahead)
        attitude = np.stack([np.arctan(right * np.cos(pitch)), pitch, truly], axis=1)
        if now > 4.0:
            attitude[who, 2] += error
        leaning.evaluate(now, attitude, velocity, line)
        held = attitude.copy()
        held[:, 2] = 0.4  # what is held is looked at elsewhere
        found = headings.detect(seen(now, attitude=held), expected())
        assert all(one.kind is FailureKind.HEADING_DISAGREES for one in found)
        messages += [one.message for one in found]
    return messages


@settings(max_examples=25, deadline=None)
@given(st.floats(0.5, 2.5), st.sampled_from([-1.0, 1.0]), st.integers(0, 2), st.floats(-1.0, 1.0))
def test_a_heading_that_contradicts_the_motion_is_found_in_any_steady_wind(size, sign, who, wind):
    (message,) = swayed(sign * size, who, wind=wind)
    assert message.startswith(f"vehicle {who + 1}'s heading is {'+' if sign > 0 else '-'}")
    assert message.endswith("° off its motion")


@settings(max_examples=15, deadline=None)
@given(st.floats(-0.2, 0.2), st.integers(0, 2), st.floats(-1.0, 1.0))
def test_a_heading_as_recorded_firmware_holds_it_is_no_failure(error, who, wind):
    assert swayed(error, who, wind=wind) == []


@pytest.mark.parametrize(
    ("kind", "text", "told"),
    [
        ("text warning", "EKF3 IMU0 emergency yaw reset", True),
        ("text error", "Compass needs calibration - Land now!", True),
        ("text", "EKF3 IMU0 MAG0 in-flight yaw alignment complete", False),
        ("text warning", "Low battery", False),
    ],
)
def test_the_texts_of_both_firmwares_tell_of_wrong_headings_in_flight(kind, text, told):
    reports, event = ReportDetector(compass=True), VehicleEvent(kind, text)
    vehicle = SimpleNamespace()
    found = reports.detect(seen(), expected(), 1, vehicle, event, 10.0)
    assert kinds(found) == [FailureKind.HEADING_DISAGREES] * told
    standing = expected(armed=np.full(3, False))
    assert reports.detect(seen(), standing, 1, vehicle, event, 10.0) == []


@pytest.mark.parametrize(
    ("name", "system"),
    [(PX4, 1), (PX4, 2), (ARDUCOPTER, 1), (ARDUCOPTER_CABLE, 1), (ARDUCOPTER_ENDS, 4)],
)
def test_real_autopilots_in_sound_flights_have_no_wrong_heading(name, system):
    _, headings = detector()
    vehicle, decoder, reports = Vehicle(system), Decoder(), ReportDetector(compass=True)
    compared = 0
    for now, data in recorded(name):
        if data[5] != system:
            continue
        for packet in decoder.feed(data):
            vehicle.receive(packet, now)
            if packet.number == common.MAVLINK_MSG_ID_ATTITUDE and vehicle.armed:
                compared += 1
                one = np.tile(vehicle.attitude, (3, 1))
                assert headings.detect(seen(now, attitude=one), expected()) == []
        for event in vehicle.take_events():
            if event.kind in {"heading", "text warning", "text error"}:
                assert reports.detect(seen(), expected(), 1, vehicle, event, now) == []
    assert compared > 400


@pytest.mark.parametrize("name", AUTOPILOTS)
def test_an_unhealthy_compass_is_an_event_and_in_flight_a_failure(name):
    vehicle = Vehicle(1, autopilot=AUTOPILOTS[name])
    compass = int(common.MAV_SYS_STATUS_SENSOR_3D_MAG)

    def status(sequence: int, enabled: int, health: int) -> list[VehicleEvent]:
        message = common.MAVLink_sys_status_message(
            enabled, enabled, health, 0, 12000, 0, 90, 0, 0, 0, 0, 0, 0
        )
        vehicle.receive((message.get_msgId(), 0, 1, sequence, message), 0.1 * sequence)
        return [event for event in vehicle.take_events() if event.kind == "heading"]

    assert status(0, compass, compass) == []
    (event,) = status(1, compass, 0)
    assert event.message == "its compass is unhealthy"
    assert status(2, compass, 0) == []
    assert status(3, compass, compass) == status(4, 0, 0) == []
    found = ReportDetector(compass=True).detect(seen(), expected(), 1, vehicle, event, 10.0)
    assert kinds(found) == [FailureKind.HEADING_DISAGREES]


@pytest.mark.parametrize("kind", ["heading", "text warning"])
def test_a_compass_does_not_count_where_poses_give_the_heading(kind):
    event, vehicle = VehicleEvent(kind, "Compass needs calibration"), Vehicle(1)
    for compass in (True, False):
        reports = ReportDetector(compass=compass)
        found = reports.detect(seen(), expected(), 0, vehicle, event, 10.0)
        assert [failure.kind for failure in found] == [FailureKind.HEADING_DISAGREES] * compass
