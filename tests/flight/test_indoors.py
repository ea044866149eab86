"""A team indoors, in the shared frame of motion capture: there is no global position."""

import pytest

from swarm.certification.findings import Finding, in_common, of_systems
from swarm.mission.fleet import emulated_fleet
from tests.network import Network, small_plan


@pytest.mark.slow
@pytest.mark.parametrize(
    "autopilots", [("px4",), ("ardupilot",), ("px4", "ardupilot")], ids="-".join
)
def test_a_team_flies_where_there_is_no_global_position(autopilots):
    fleet = emulated_fleet(3, autopilots).model_copy(update={"frame": "shared"})
    flight = Network(small_plan(), fleet)
    outcome = flight.run()
    assert outcome is not None
    assert outcome.word == "done"
    told = in_common(f for f in flight.conductor.audit.findings if f.check == "ready")
    # what PX4 says of itself in Hold says nothing of offboard mode: in one line for all
    words = (
        "it decides whether to arm in offboard mode only; on the ground it lacks a global position"
    )
    systems = [v.system for v in flight.conductor.flyers if v.autopilot.name == "px4"]
    assert told == [Finding("info", "ready", of_systems(systems) + words)][: len(systems)]


def test_outdoors_a_vehicle_that_is_not_ready_is_waited_for_and_refused():
    fleet = emulated_fleet(3, ("px4",))
    fleet = fleet.model_copy(update={"limits": fleet.limits.model_copy(update={"ready": 5.0})})
    flight = Network(small_plan(), fleet)
    flight.emulator.vehicles[1].refuse_arming = "Compass needs calibration"
    outcome = flight.run()
    assert outcome is not None
    assert outcome.word == "refused"
    assert "vehicle 2: not ready to arm" in outcome.explanation


def test_in_a_mixed_team_no_vehicle_stays_armed_on_the_ground_beyond_its_timer():
    flight = Network(small_plan(vehicles=4), emulated_fleet(4, ("px4", "ardupilot")))
    flight.until_phase("takeoff", 3.0)
    at = {kind: {e.vehicle: e.time for e in flight.events if e.kind == kind}
          for kind in ("armed", "airborne")}  # fmt: skip
    px4 = {v for v in at["armed"] if flight.conductor.flyers[v - 1].autopilot.name == "px4"}
    assert len(px4) == 2
    first = max(time for vehicle, time in at["armed"].items() if vehicle not in px4)
    assert all(at["armed"][vehicle] > first for vehicle in px4)
    waited = {vehicle: at["airborne"][vehicle] - time for vehicle, time in at["armed"].items()}
    # 6.1 s: 2.0 s until the ArduPilots' motors turn fast, 1.8 s until they are at 0.8 m, from where
    # the plan moves all, and 2.1 s until the plan is so high that the PX4s lift off
    assert max(waited.values()) < 7.0, "COM_DISARM_PRFLT and DISARM_DELAY are 10 s"
    # and nobody leaves the ground before all are armed
    assert min(at["airborne"].values()) > max(at["armed"].values())
