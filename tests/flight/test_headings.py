"""Wrong headings: against what is held, and in what both firmwares report."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from swarm.flight.detect import HEADING_OFF, HeadingDetector, HealthDetector, ReportDetector
from swarm.flight.failures import Failure, FailureKind, Latch
from swarm.flight.preparation import problems_of
from swarm.mavlink.autopilots import AUTOPILOTS
from swarm.mavlink.packets import Decoder
from swarm.mavlink.vehicle import Vehicle, VehicleEvent
from swarm.mission.fleet import emulated_fleet
from tests.flight.test_detect import expected, kinds, seen
from tests.recordings import ARDUCOPTER, ARDUCOPTER_CABLE, ARDUCOPTER_ENDS, PX4, recorded


class Flight:
    """A team whose attitudes are reported every 50 ms."""

    def __init__(self) -> None:
        self._headings, self._ms = HeadingDetector(3, Latch()), 0

    def see(self, *headings: float, samples: int = 1, roll: float = 0.0, **commanded):
        """Return what is found in some samples of the same headings; 0: the last one again."""
        found: list[Failure] = []
        for number in range(max(samples, 1)):
            self._ms += 50 * (number < samples)
            attitude = np.array([[roll, 0.0, heading] for heading in headings])
            reports = seen(attitude=attitude, attitude_ms=float(self._ms))
            found += self._headings.detect(reports, expected(**commanded))
        return found


def test_a_heading_that_leaves_the_one_it_is_to_hold_is_reported_once():
    flight = Flight()
    # across north, where angles begin anew
    assert flight.see(3.1, -3.1, 0.0) == []
    small = 0.9 * HEADING_OFF
    assert flight.see(3.1 + small, -3.1 - small, 0.0, samples=50) == []
    (failure,) = flight.see(3.1 + 0.7 - 2.0 * math.pi, -3.1, 0.0, samples=2)
    assert (failure.kind, failure.vehicle) == (FailureKind.HEADING_DISAGREES, 0)
    assert failure.message == "vehicle 1's heading is +40° off what it is to hold"
    assert flight.see(3.1 + 0.7 - 2.0 * math.pi, -3.1, 0.0, samples=50) == []


def test_one_attitude_that_is_off_lands_no_team():
    flight = Flight()
    assert flight.see(0.0, 0.0, 0.0) == []
    for _ in range(10):
        assert flight.see(0.0, 0.7, 0.0) == []
        for _ in range(10):
            assert flight.see(0.0, 0.7, 0.0, samples=0) == [], "the same sample, seen again"
        assert flight.see(0.0, 0.1, 0.0) == []
    assert kinds(flight.see(0.0, 0.7, 0.0, samples=2)) == [FailureKind.HEADING_DISAGREES]


def test_a_vehicle_that_a_pilot_turned_returns_to_the_team():
    flight, turned = Flight(), math.radians(25.0)
    flight.see(0.0, 0.0, 0.0)
    outside = np.array([True, False, True])
    assert flight.see(0.0, turned, 0.0, samples=20, streaming=outside) == []
    # setpoints for a second before offboard mode, then it turns back
    assert flight.see(0.0, turned, 0.0, samples=20, rejoining=frozenset({1})) == []
    for heading in np.linspace(turned, 0.0, 20):
        assert flight.see(0.0, heading, 0.0) == []
    assert kinds(flight.see(0.0, turned, 0.0, samples=2)) == [FailureKind.HEADING_DISAGREES]


@pytest.mark.parametrize(
    "commanded",
    [
        {"armed": np.full(3, False)},
        {"streaming": np.full(3, False)},
        {"may_land": np.full(3, True)},
        {"rejoining": frozenset({0})},
        {"fallen": frozenset({0})},
        {"roll": 0.5},
    ],
)
def test_a_vehicle_that_holds_no_heading_or_turns_over_is_not_judged_by_it(commanded):
    flight = Flight()
    flight.see(0.0, 0.0, 0.0)
    assert flight.see(1.0, 0.0, 0.0, samples=10, **commanded) == []
    assert flight.see(0.0, 0.0, 0.0) == []
    assert kinds(flight.see(1.0, 0.0, 0.0, samples=2)) == [FailureKind.HEADING_DISAGREES]


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
    headings = HeadingDetector(3, Latch())
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
                reports_of = seen(now, attitude=one, attitude_ms=vehicle.attitude_ms)
                assert headings.detect(reports_of, expected()) == []
                assert vehicle.compass_healthy
        for event in vehicle.take_events():
            if event.kind in {"text warning", "text error"}:
                assert reports.detect(seen(), expected(), 1, vehicle, event, now) == []
    assert compared > 400


@pytest.mark.parametrize("name", AUTOPILOTS)
def test_an_unhealthy_compass_prevents_arming_where_it_gives_the_heading(name):
    vehicle = Vehicle(1, autopilot=AUTOPILOTS[name])
    compass = int(common.MAV_SYS_STATUS_SENSOR_3D_MAG)
    outdoors = emulated_fleet(3)
    indoors = outdoors.model_copy(update={"frame": "shared"})

    def status(sequence: int, enabled: int, health: int) -> None:
        message = common.MAVLink_sys_status_message(
            enabled, enabled, health, 0, 12000, 0, 90, 0, 0, 0, 0, 0, 0
        )
        vehicle.receive((message.get_msgId(), 0, 1, sequence, message), 0.1 * sequence)
        vehicle.heartbeat_at = vehicle.received_at

    def told(fleet) -> bool:
        return ("compass", "its compass is unhealthy") in problems_of(vehicle, fleet, 0.5)

    # unhealthy from the first report on, then healthy, then not in use
    for sequence, (enabled, health, healthy) in enumerate(
        [(compass, 0, False), (compass, compass, True), (compass, 0, False), (0, 0, True)]
    ):
        status(sequence, enabled, health)
        assert vehicle.compass_healthy == healthy
        assert told(outdoors) == (not healthy)
        assert not told(indoors)


@pytest.mark.parametrize("compass", [True, False])
def test_an_unhealthy_compass_counts_in_flight_where_it_gives_the_heading(compass):
    health = HealthDetector(Latch(), gps=True, compass=compass)
    reports = seen(compass_healthy=np.array([True, False, True]))
    for commanded in (
        expected(armed=np.full(3, False)), expected(may_land=np.full(3, True)),
        expected(fallen=frozenset({1})),
    ):  # fmt: skip
        assert health.detect(reports, commanded) == []
    # whenever it began: also before the motors ran
    found = health.detect(reports, expected())
    told = [(FailureKind.HEADING_DISAGREES, 1, "vehicle 2's compass is unhealthy")] * compass
    assert [(failure.kind, failure.vehicle, failure.message) for failure in found] == told
    assert health.detect(reports, expected()) == []


def test_texts_on_a_compass_do_not_count_where_poses_give_the_heading():
    event, vehicle = VehicleEvent("text warning", "Compass needs calibration"), Vehicle(1)
    for compass in (True, False):
        reports = ReportDetector(compass=compass)
        found = reports.detect(seen(), expected(), 0, vehicle, event, 10.0)
        assert kinds(found) == [FailureKind.HEADING_DISAGREES] * compass
