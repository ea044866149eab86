"""Who stands where: frames from origins, pads and fits; assignment; spares."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from sitl.faults import Fault
from swarm.errors import Refused
from swarm.flight.fleet_listener import FleetListener
from swarm.flight.preparation import STANDING_TIME, assigned, levelled, rough_frames
from swarm.flight.setup import FlightOptions
from swarm.mavlink.autopilots import PX4
from swarm.mavlink.frames import Origin, from_mission, to_local
from swarm.mavlink.vehicle import Vehicle
from swarm.mission.fleet import emulated_fleet, parse_fleet
from tests.network import Network, small_plan

PADS = np.array([[0.0, 0.0, 0.6], [3.0, 0.5, 0.6], [6.0, -1.0, 0.6], [9.0, 0.0, 0.6]])


def corrected():
    """Return a flight whose receivers get corrections, before its first step."""
    flight_plan, team = small_plan(), emulated_fleet(3)
    flight = Network(flight_plan, team, no_cable=True)
    options = FlightOptions(no_cable=True, corrected=True)
    flight.conductor = type(flight.conductor)(flight_plan, team, options)
    return flight


def test_a_team_with_corrections_waits_until_all_receivers_use_them():
    flight, fixed = corrected(), 6.0
    while flight.now < fixed:
        flight.once()
        assert flight.conductor.stage == "prepare"
        flight.conductor.team.vehicles[2].fix_type = common.GPS_FIX_TYPE_RTK_FLOAT
    flight.run(lambda: flight.conductor.stage != "prepare")
    assert flight.conductor.stage == "execute"
    assert fixed + STANDING_TIME < flight.now < fixed + STANDING_TIME + 2.0


@pytest.mark.slow
def test_a_receiver_that_never_uses_the_corrections_is_named():
    flight = corrected()
    while flight.conductor.finished is None:
        flight.conductor.team.vehicles[3].fix_type = common.GPS_FIX_TYPE_3D_FIX
        flight.once()
        flight.conductor.team.vehicles[3].fix_type = common.GPS_FIX_TYPE_3D_FIX
        assert flight.now < 2.0 * flight.fleet.limits.ready
    assert flight.conductor.finished.explanation == (
        "system 3: a 3D fix without corrections, with errors of 1.5 m, though corrections are sent: "
        "RTK fixed is needed"
    )


def test_a_place_that_follows_the_first_corrections_is_waited_for():
    # wrong by less than the 0.5 m by which a vehicle may stand beside its pad, and right after 2.3 s
    flight = corrected()
    wrong = [Fault(at=0.0, kind="gps_jump", vehicle=2, offset=(0.4, 0.0, 0.0))]
    for k in range(20):
        at = 0.4 + 0.1 * k
        wrong.append(Fault(at=at, kind="gps_jump", vehicle=2, offset=(-0.02, 0.0, 0.0)))
    for fault in wrong:
        flight.emulator.inject(fault)
    flight.run(lambda: flight.conductor.stage != "prepare")
    assert 2.3 < flight.now < 2.3 + STANDING_TIME + 1.0
    assert flight.conductor.stage == "execute"


def test_a_check_waits_for_corrections_as_a_flight_does():
    flight_plan, team, fixed, now = small_plan(), emulated_fleet(3), 6.0, 0.0
    emulator = Network(flight_plan, team, no_cable=True).emulator
    listener = FleetListener(team, flight_plan.plan.mission.vehicles.tracking)
    while now < 3.0 or not listener.at_rest():
        now += 0.05
        for system, data in emulator.step(now):
            listener.receive("loopback", system, data, now)
        for outgoing in listener.tick(now):
            emulator.receive(outgoing.address, outgoing.data, now)
        if now < fixed:
            listener.team.vehicles[2].fix_type = common.GPS_FIX_TYPE_RTK_FLOAT
        if 3.0 < now < fixed:
            (found,) = listener.waits_for()
            assert found.message.startswith("system 2: RTK float, with errors of 0.4 m, though ")
    assert fixed + STANDING_TIME <= now < fixed + STANDING_TIME + 2.0


def fleet(*lines: str):
    vehicles = "\n".join(f"  - {{sysid: {k}, links: [a]}}" for k in range(1, 5))
    text = f'schema: 1\nname: f\nlinks: {{a: "udpin://127.0.0.1:0"}}\nvehicles:\n{vehicles}\n'
    return parse_fleet(text + "\n".join(lines), "f")


def standing(mission: Origin, heading: float, origins: list[Origin], height: float = 0.0):
    """Vehicles that stand on their pads, each with its own origin."""
    vehicles, measured = [], []
    for k, (pad, origin) in enumerate(zip(PADS, origins, strict=True), 1):
        place = from_mission(mission, heading, pad)
        vehicle = Vehicle(k, autopilot=PX4)
        vehicle.origin, vehicle.global_position = origin, place
        vehicles.append(vehicle)
        north, east, down = to_local("px4", origin, place)
        measured.append((north, east, down + height * k))
    return vehicles, np.array(measured)


@given(st.floats(-60, 60), st.floats(-179, 179), st.floats(-3.1, 3.1))
@settings(max_examples=40, deadline=None)
def test_without_an_origin_the_mission_is_fitted_to_the_pads(latitude, longitude, heading):
    mission = Origin(latitude, longitude, 300.0)
    origins = [from_mission(mission, 0.0, np.array([2.0 * k, -k, k])) for k in range(4)]
    vehicles, measured = standing(mission, heading, origins, height=0.7)
    rough = rough_frames(vehicles, fleet(), PADS)
    frames = levelled(rough, fleet(), PADS, measured)
    assert frames.points_to_mission(measured) == pytest.approx(PADS, abs=5e-3)
    north = frames.rotation[0] @ np.array([1.0, 0.0, 0.0])
    assert math.atan2(north[0], north[1]) == pytest.approx(heading, abs=0.01)


def test_an_origin_without_a_place_for_the_mission_is_refused():
    vehicles, _ = standing(Origin(47, 8, 0), 0.0, [Origin(47, 8, 0)] * 4)
    with pytest.raises(Refused, match="neither an origin nor two vehicles with their pads"):
        rough_frames(vehicles, fleet(), np.full((4, 3), np.nan))


def test_vehicles_whose_origin_is_not_known_are_named():
    vehicles, _ = standing(Origin(47, 8, 0), 0.0, [Origin(47, 8, 0)] * 4)
    vehicles[1].origin = vehicles[3].origin = None
    gps = fleet("origin: {latitude: 47, longitude: 8, altitude: 400}")
    with pytest.raises(Refused, match="not known of systems 2, 4"):
        rough_frames(vehicles, gps, PADS)


def test_heights_are_levelled_and_places_are_not():
    vehicles, measured = standing(Origin(47, 8, 400), 0.0, [Origin(47, 8, 390)] * 4, height=2.0)
    measured[1, 0] += 0.3
    gps = fleet("origin: {latitude: 47, longitude: 8, altitude: 400}")
    frames = levelled(rough_frames(vehicles, gps, PADS), gps, PADS, measured)
    off = frames.points_to_mission(measured) - PADS
    assert off[:, 2] == pytest.approx(0.0, abs=1e-9)
    assert off[1] == pytest.approx([0.0, 0.3, 0.0], abs=2e-3)


@given(st.permutations(range(4)))
def test_each_vehicle_gets_the_pad_on_which_it_stands(order):
    positions = PADS[list(order)] + 0.2
    assert [order[k] for k in assigned(positions, PADS, {})] == [0, 1, 2, 3]


def test_pads_from_the_file_are_kept_and_spares_are_left_over():
    positions = np.array([PADS[2], PADS[0], [50.0, 50.0, 0.6], PADS[1], PADS[3]])
    assert assigned(positions, PADS, {}) == [1, 3, 0, 4]
    assert assigned(positions, PADS, {0: 2}) == [2, 3, 0, 4]


def test_a_spare_takes_the_place_of_a_vehicle_that_is_not_there():
    flight_plan = small_plan()
    whole = emulated_fleet(3)
    listed = [vehicle.model_copy(update={"pad": None}) for vehicle in whole.vehicles]
    absent = listed[0].model_copy(update={"sysid": 9})
    team = whole.model_copy(update={"vehicles": (*listed, absent)})
    flight = Network(flight_plan, team, no_cable=True)
    flight.run(lambda: flight.conductor.stage == "execute")
    assert flight.conductor.state.roster.systems == (1, 2, 3)


def test_a_vehicle_far_from_its_pad_is_refused_by_name():
    flight_plan = small_plan()
    whole = emulated_fleet(3)
    first, second, third = whole.vehicles
    swapped = whole.model_copy(
        update={
            "vehicles": (
                first.model_copy(update={"pad": 2}),
                second.model_copy(update={"pad": 1}),
                third,
            )
        }
    )
    flight = Network(flight_plan, whole, no_cable=True)
    flight.conductor = type(flight.conductor)(flight_plan, swapped)
    with pytest.raises(Refused, match=r"vehicle 1 \(system 2\) stands 3\.\d+ m from its pad"):
        flight.run()


def test_a_place_that_an_estimator_has_just_found_is_not_averaged_with_the_one_before():
    found = 0.6
    wrong = Fault(at=0.0, kind="gps_jump", vehicle=2, offset=(3.0, 0.0, 0.0), duration=found)
    flight = Network(small_plan(), emulated_fleet(3), no_cable=True)
    flight.emulator.inject(wrong)
    flight.run(lambda: flight.conductor.stage != "prepare")
    assert flight.conductor.stage == "execute"
    assert found + STANDING_TIME < flight.now < found + STANDING_TIME + 1.0
