"""Faults: start, size, end and sources."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as dialect

from sitl import Emulator, WorldError
from sitl.faults import KINDS, Channel, Fault, UniformNumbers, parse_scenario
from tests.sitl.client import Ground, world

INJECT = 420
OFFBOARD = 6 << 16


def scenario(*lines: str) -> list[Fault]:
    body = ", ".join(f"{{{line}}}" for line in lines)
    return parse_scenario(f"{{schema: 1, faults: [{body}]}}")


def flying(*lines: str, count: int = 1, seconds: float = 7.5, **keys) -> Ground:
    ground = Ground(Emulator(world(count, **keys), scenario(*lines)))
    ground.px4_offboard({i + 1: (3.0 * i, 0.0, 5.0) for i in range(count)}, seconds)
    return ground


def stay(ground: Ground, seconds: float) -> None:
    places = {i: (3.0 * (i - 1), 0.0, 5.0) for i in ground.ids}
    ground.run(seconds, ground.toward(places))


def test_bad_scenarios_are_refused_with_every_error() -> None:
    with pytest.raises(WorldError) as error:
        scenario("at: -1, kind: motor_loss", "at: 1, kind: explode", "at: 1, kind: freeze, loss: 1")
    assert str(error.value).splitlines() == [
        "scenario: faults.0.at: expected greater than or equal to 0, got -1",
        "scenario: faults.1.kind: expected "
        + ", ".join(f"'{kind}'" for kind in list(KINDS)[:-1])
        + f" or '{list(KINDS)[-1]}', got 'explode'",
        "scenario: faults.2: freeze: expected no further keys, got loss",
    ]
    with pytest.raises(WorldError, match=r"expected vehicles of the world, got \[7\]"):
        Emulator(world(1), scenario("at: 1, kind: freeze, vehicle: 7"))


@pytest.mark.parametrize(
    ("burst", "runs"), [(0.0, pytest.approx(1.25, abs=0.15)), (0.5, pytest.approx(10, rel=0.3))]
)
def test_losses_have_the_given_share_and_bursts(burst: float, runs: object) -> None:
    channel = Channel(
        UniformNumbers(np.random.default_rng(3)), Fault(at=0.0, kind="link", loss=0.2, burst=burst)
    )
    arrived = []
    for k in range(40_000):
        channel.push(k, 50, 0.05 * k)
        arrived += channel.pop(0.05 * k)
    assert len(arrived) / 40_000 == pytest.approx(0.8, abs=0.03)
    gaps = np.diff(arrived)
    assert (gaps[gaps > 1] - 1).mean() == runs


def test_numbers_drawn_in_blocks_equal_single_draws() -> None:
    numbers, singly = UniformNumbers(np.random.default_rng(8)), np.random.default_rng(8)
    assert [numbers.draw() for _ in range(1000)] == [singly.random() for _ in range(1000)]


def test_latency_jitter_duplicates_and_reordering() -> None:
    def through(**values: float) -> list[tuple[float, int]]:
        channel = Channel(
            UniformNumbers(np.random.default_rng(5)), Fault(at=0.0, kind="link", **values)
        )
        got = []
        for step in range(20_000):
            if step % 5 == 0 and step < 15_000:
                channel.push(step // 5, 50, 0.01 * step)
            got += [(0.01 * step, item) for item in channel.pop(0.01 * step)]
        return got

    late = through(latency=0.3, jitter=0.1)
    delays = np.array([time - 0.05 * item for time, item in late])
    assert delays.min() >= 0.3
    assert delays.max() <= 0.41
    assert delays.std() == pytest.approx(0.1 / np.sqrt(12), rel=0.1)
    assert len(through(duplicate=0.25)) == pytest.approx(3000 * 1.25, rel=0.03)
    order = [item for _, item in through(reorder=0.3, jitter=0.2)]
    assert sorted(order) == list(range(3000))
    assert order != sorted(order)
    slow = through(bandwidth=500.0)
    assert len(slow) * 50 / 150.0 == pytest.approx(500.0, rel=0.05), "bytes per second"


def test_an_uplink_outage_is_a_stream_loss() -> None:
    ground = flying("at: 10.0, kind: link, loss: 1.0, direction: up, duration: 3.0")
    stay(ground, 3.5)
    assert ground.mode(1) != OFFBOARD
    stay(ground, 3.0)
    assert ground.mode(1) == OFFBOARD, "it comes back by itself"


def test_a_downlink_outage_only_stops_telemetry() -> None:
    ground = flying("at: 9.0, kind: link, loss: 1.0, direction: down")
    ground.log.clear()
    stay(ground, 4.0)
    assert not [t for t, _, _ in ground.log if t > 9.1]
    assert ground.emulator.truth().position[0, 2] == pytest.approx(4.4, abs=0.1)


def test_latency_delays_telemetry() -> None:
    ground = flying("at: 9.0, kind: link, latency: 0.5, direction: up")
    stay(ground, 2.0)
    ground.command(1, dialect.MAV_CMD_DO_SET_MODE, 1, 4, 3)
    stay(ground, 0.4)
    assert len(ground.acks(1, dialect.MAV_CMD_DO_SET_MODE)) == 2, "the old ones"
    stay(ground, 0.3)
    assert len(ground.acks(1, dialect.MAV_CMD_DO_SET_MODE)) == 4


def test_a_lost_motor_falls_and_a_weak_one_sags() -> None:
    ground = flying("at: 9.0, kind: motor_loss, vehicle: 1",
                    "at: 9.0, kind: weak_thrust, vehicle: 2, fraction: 0.8", count=2)  # fmt: skip
    stay(ground, 0.8)
    assert ground.emulator.truth().position[1, 2] < 4.35
    assert ground.emulator.truth().tilt[0] > 1.0, "it tumbles, and reports it"
    assert abs(ground.last[1, "ATTITUDE"].roll) > 1.0
    stay(ground, 3.0)
    position = ground.emulator.truth().position
    assert position[0, 2] < 0.01
    assert position[1, 2] == pytest.approx(4.4, abs=0.2), "the integrator compensates"
    assert ground.emulator.truth().contacts[0]["kind"] == "crash"


def test_position_faults_and_the_reaction_of_the_autopilot() -> None:
    ground = flying("at: 9.0, kind: gps_jump, offset: [2.0, 0, 0], duration: 6.0")
    stay(ground, 6.0)
    assert ground.emulator.truth().position[0, 0] == pytest.approx(-2.0, abs=0.3), "it believes it"
    stay(ground, 6.0)
    assert ground.emulator.truth().position[0, 0] == pytest.approx(0.0, abs=0.3)

    ground = flying("at: 9.0, kind: position_loss")
    stay(ground, 2.0)
    assert [e["mode"] for e in ground.emulator.events if e["kind"] == "mode"][-1] == "DESCEND"

    ground = flying("at: 9.0, kind: origin_reset, offset: [0, 3.0, 0]")
    before = ground.last[1, "LOCAL_POSITION_NED"].x
    ground.run(0.4)
    assert ground.last[1, "LOCAL_POSITION_NED"].x - before == pytest.approx(-3.0, abs=0.2)

    ground = flying("at: 9.0, kind: barometer_drift, rate: 0.1")
    stay(ground, 10.0)
    assert ground.emulator.truth().position[0, 2] == pytest.approx(4.4 - 1.0, abs=0.25)
    assert ground.last[1, "LOCAL_POSITION_NED"].z == pytest.approx(
        -(5.0 - ground.origin(1)[2]), abs=0.2
    )


def test_a_wrong_heading_jumps_turns_back_and_pushes_aside() -> None:
    ground = flying()
    held = ground.last[1, "ATTITUDE"].yaw
    (fault,) = scenario("at: 0, kind: heading, turn: 0.7")
    ground.emulator.inject(fault)
    stay(ground, 0.15)
    assert ground.last[1, "ATTITUDE"].yaw - held == pytest.approx(0.7, abs=0.15), "it believes it"
    stay(ground, 4.0)
    assert ground.last[1, "ATTITUDE"].yaw == pytest.approx(held, abs=0.05)
    here = ground.emulator.truth().position[0].copy()
    ground.run(0.8, ground.toward({1: (here[0] + 2.0, here[1], here[2])}))
    east, north, _ = ground.emulator.truth().position[0] - here
    assert np.arctan2(north, east) == pytest.approx(0.7, abs=0.2), "to the left of where it wants"
    ground.run(5.0, ground.toward({1: (here[0] + 2.0, here[1], here[2])}))
    assert ground.emulator.truth().position[0, 0] == pytest.approx(here[0] + 2.0, abs=0.3)
    assert ground.emulator.truth().position[0, 1] == pytest.approx(here[1], abs=0.3)


def test_battery_pilot_and_leaving_offboard() -> None:
    ground = flying("at: 9.0, kind: battery, charge: 0.06")
    stay(ground, 2.0)
    assert "Critical battery\t" in ground.texts(1)
    assert ground.last[1, "BATTERY_STATUS"].battery_remaining <= 6

    ground = flying("at: 9.0, kind: pilot")
    stay(ground, 2.0)
    assert ground.mode(1) == 3 << 16, "Position mode, setpoints or not"

    ground = flying("at: 9.0, kind: leave_offboard")
    stay(ground, 2.0)
    assert ground.mode(1) == 4 << 16 | 3 << 24


def test_freezing_rebooting_and_slow_clocks() -> None:
    ground = flying("at: 9.0, kind: freeze, duration: 2.0")
    stay(ground, 1.0)
    ground.log.clear()
    stay(ground, 1.0)
    assert not ground.log
    stay(ground, 2.0)
    assert ground.log

    ground = flying("at: 9.0, kind: reboot")
    before = ground.last[1, "ATTITUDE"].time_boot_ms
    ground.log.clear()
    stay(ground, 3.0)
    assert not [t for t, _, _ in ground.log if t > 9.1], "silent while it boots"
    stay(ground, 2.0)
    assert ground.last[1, "ATTITUDE"].time_boot_ms < before
    assert not ground.armed(1)

    ground = flying("at: 9.0, kind: slow_clock, fraction: 0.9")
    stay(ground, 1.0)
    before = ground.last[1, "ATTITUDE"].time_boot_ms
    stay(ground, 10.0)
    assert ground.last[1, "ATTITUDE"].time_boot_ms - before == pytest.approx(9000, abs=60)


def test_refused_arming_and_a_false_landing() -> None:
    ground = Ground(Emulator(world(1), scenario("at: 0.5, kind: refuse_arming, text: Compass bad")))
    ground.run(1.0)
    ground.command(1, 400, 1)
    ground.run(0.2)
    assert ground.acks(1, 400) == [1]
    assert ground.texts(1) == ["Arming denied: Compass bad\t"]

    ground = flying("at: 9.0, kind: believes_landed")
    stay(ground, 4.0)
    assert not ground.armed(1)
    assert ground.emulator.truth().position[0, 2] < 0.01


GRIP = dialect.MAV_CMD_DO_GRIPPER


def test_gripper_faults() -> None:
    cable = "{points: [[-1, 0, 0], [7, 0, 0]]}"
    ground = Ground(
        Emulator(
            world(3, cable),
            scenario("at: 0, kind: gripper_stuck_open, vehicle: 1",
                     "at: 3, kind: gripper_stuck_shut, vehicle: 2",
                     "at: 3, kind: gripper_slip, vehicle: 3"),
        )
    )  # fmt: skip
    for vehicle in ground.ids:
        ground.command(vehicle, GRIP, 1, 0)
    ground.run(1.0)
    for vehicle in ground.ids:
        ground.command(vehicle, GRIP, 1, 1)
    ground.run(1.5)
    assert [ground.acks(vehicle, GRIP)[-1] for vehicle in ground.ids] == [4, 0, 0]
    ground.run(1.0)
    assert ground.emulator.truth().gripped.tolist() == [False, True, False]
    ground.command(2, GRIP, 1, 0)
    ground.run(1.0)
    assert ground.acks(2, GRIP)[-1] == 4
    assert ground.emulator.truth().gripped.tolist() == [False, True, False]


def test_a_snag_holds_the_cable() -> None:
    cable = "{mass_per_length: 0.05, points: [[0, 0, 0], [5.0, 0, 0]], attached: [0, 3.0]}"
    ground = flying("at: 0, kind: snag, arc: 5.0", count=2, cable=cable, gripper="attached")
    truth = ground.emulator.truth()
    assert truth.cable[-1] == pytest.approx([5.0, 0.0, 0.0], abs=0.02)
    assert truth.position[1, 2] < 2.1, "two metres of cable between it and the snag"
    assert truth.tension[1] > 1.0
    ground = flying(
        "at: 0, kind: snag, arc: 5.0, duration: 4.0", count=2, cable=cable, gripper="attached"
    )
    assert ground.emulator.truth().position[1, 2] > 3.5


def test_failures_injected_over_mavlink() -> None:
    ground = flying()
    ground.command(1, INJECT, 4, 1)
    stay(ground, 1.0)
    assert not ground.last[1, "SYS_STATUS"].onboard_control_sensors_health & 32
    ground.command(1, INJECT, 4, 0)
    stay(ground, 1.0)
    assert ground.last[1, "SYS_STATUS"].onboard_control_sensors_health & 32
    ground.command(1, INJECT, 5, 1)
    stay(ground, 0.2)
    assert ground.acks(1, INJECT) == [0, 0, 3]


def test_simulation_parameters_of_ardupilot() -> None:
    ground = Ground(Emulator(world(1, autopilot="ardupilot")))
    ground.run(0.5)
    ground.send(1, dialect.MAVLink_param_set_message(1, 1, b"SIM_ENGINE_MUL", 0.5, 9))
    ground.run(0.1)
    assert ground.emulator.bodies.health[0] == 0.5


@pytest.mark.slow
def test_every_kind_of_fault_starts_and_ends_in_flight() -> None:
    cable = "{points: [[0, 0, 0], [3.6, 0, 0]]}"
    for k, kind in enumerate(KINDS):
        ground = Ground(
            Emulator(world(2, cable, seed=k), scenario(f"at: 3.0, kind: {kind}, duration: 1.0"))
        )
        ground.px4_offboard({1: (0.0, 0.0, 3.0), 2: (3.0, 0.0, 3.0)}, 4.0)
        kinds = [event["kind"] for event in ground.emulator.events]
        assert "fault" in kinds
        assert "fault ended" in kinds
        assert np.isfinite(ground.emulator.bodies.position).all()
