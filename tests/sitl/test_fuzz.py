"""Fuzzing: no crash, and no motion without a valid command."""

import random
import warnings

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as dialect

from sitl import Emulator
from tests.sitl.client import Ground, world
from tests.sitl.random_packets import COMMANDS, messages, random_frame, spoil

amounts = pytest.mark.parametrize(
    "trials", [6_000, pytest.param(1_000_000, marks=pytest.mark.full)]
)


@amounts
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_invalid_and_foreign_bytes_cause_no_motion(autopilot: str, trials: int) -> None:
    """Without a valid command to arm, the vehicle stays disarmed on the ground."""
    rng = random.Random(8)
    frames = [f for f in messages(rng) if f[7:10] not in COMMANDS]
    emulator = Emulator(world(1, autopilot=autopilot))
    ground = Ground(emulator)
    ground.run(1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for trial in range(trials):
            frame = rng.choice(frames)
            emulator.receive(1, frame if rng.random() < 0.3 else spoil(frame, rng), ground.now)
            if trial % 200 == 199:
                ground.now = round(ground.now + 0.02, 6)
                emulator.step(ground.now)
    truth = emulator.truth()
    assert not truth.armed.any()
    assert truth.position[0].tolist() == [0.0, 0.0, 0.0]
    assert {event["kind"] for event in emulator.events} <= {"mode"}


@amounts
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_random_commands_are_answered(autopilot: str, trials: int) -> None:
    rng = random.Random(9)
    numbers = [value for name, value in vars(dialect).items() if name.startswith("MAV_CMD_")]
    numbers = [n for n in numbers if isinstance(n, int) and 0 <= n < 65536]
    reals = [0.0, 1.0, 2.0, -1.0, 21196.0, 1e30, float("nan"), float("inf"), 3e38, 47.4, 8.5]
    emulator = Emulator(world(1, autopilot=autopilot))
    ground = Ground(emulator)
    ground.run(1.0)
    mav = dialect.MAVLink(None, 77, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for trial in range(trials // 2):
            number = rng.choice(numbers)
            p = [rng.choice(reals) for _ in range(7)]
            if rng.random() < 0.5:
                message = dialect.MAVLink_command_long_message(1, 1, number, 0, *p)
            else:
                x, y = rng.choice([0, 2**31 - 1, -(2**31), 473977420]), 85455940
                message = dialect.MAVLink_command_int_message(
                    1, 1, 3, number, 0, 0, *p[:4], x, y, p[6]
                )
            emulator.receive(1, message.pack(mav), ground.now)
            if trial % 20 == 19:
                ground.now = round(ground.now + 0.02, 6)
                emulator.step(ground.now)
    assert np.isfinite(emulator.bodies.position).all()
    assert np.abs(emulator.bodies.velocity).max() < 30.0


@amounts
def test_random_setpoints_are_ignored_or_flown_within_limits(trials: int) -> None:
    rng = random.Random(10)
    ground = Ground(Emulator(world(1)))
    ground.px4_offboard({1: (0.0, 0.0, 5.0)}, 10.0)
    before = ground.emulator.bodies.position.copy()
    mav = dialect.MAVLink(None, 77, 1)
    stay = ground.toward({1: (0.0, 0.0, 5.0)})
    bad = [float("nan"), float("inf"), -float("inf")]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(trials // 20):
            values = [rng.choice([*bad, 50.0]) for _ in range(9)]
            values[rng.randrange(2)] = rng.choice(bad)
            values[3] = values[6] = float("nan")
            message = dialect.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, rng.choice([0, 2, 5, 7, 8, 9, 77]), rng.randrange(65536), *values, 0.0, 0.0
            )
            ground.emulator.receive(1, message.pack(mav), ground.now)
            ground.run(0.05, stay)
    assert np.abs(ground.emulator.bodies.position - before).max() < 0.1


LIFE = 1_500
"""Packets after which a fresh emulator takes the place of a spoiled one."""


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
@pytest.mark.parametrize("trials", [2 * LIFE, pytest.param(500_000, marks=pytest.mark.full)])
def test_no_packet_to_one_vehicle_ends_the_emulator_of_all(autopilot: str, trials: int) -> None:
    """Any message from any component, with any parameter and value; every other vehicle flies."""
    rng = random.Random(12)
    for life in range(trials // LIFE):
        ground = Ground(Emulator(world(2, autopilot=autopilot)))
        ground.run(1.0)
        if life % 2:
            _take_off(ground, autopilot)
        first, second = ground.emulator.vehicles
        names = list(first.parameters.values)
        simulated = [name for name in names if name.startswith("SIM_")]
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for trial in range(LIFE):
                known = simulated if rng.random() < 0.3 else names
                frame = random_frame(rng, rng.choice([0, 1, 77, 255]), rng.randrange(256), known)
                data = frame if rng.random() < 0.9 else spoil(frame, rng)
                ground.emulator.receive(1, data, ground.now)
                if trial % 20 == 19:
                    first.links[0].receiver.set_key(None)  # else a random key ends the test
                    ground.now = round(ground.now + 0.05, 6)
                    ground.emulator.step(ground.now)
        assert np.isfinite(ground.emulator.bodies.position).all()
        ground.log.clear()
        ground.run(2.5)
        assert {system for _, system, m in ground.log if m.get_type() == "HEARTBEAT"} >= {2}
        assert second.armed == bool(life % 2)


def _take_off(ground: Ground, autopilot: str) -> None:
    if autopilot == "px4":
        ground.px4_offboard({1: (0.0, 0.0, 5.0), 2: (3.0, 0.0, 5.0)}, 3.0)
        return
    for number, *p in ((176, 1, 4), (400, 1), (22, 0, 0, 0, 0, 0, 0, 5.0)):
        for vehicle in (1, 2):
            ground.command(vehicle, number, *p)
        ground.run(0.5)
    ground.run(3.0)


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
@pytest.mark.parametrize("value", [2**48, 2**64 - 1])
def test_a_signing_time_of_more_than_six_bytes_is_cut_off(autopilot: str, value: int) -> None:
    ground = Ground(Emulator(world(2, autopilot=autopilot)))
    ground.send(1, dialect.MAVLink_setup_signing_message(1, 1, list(range(32)), value))
    ground.log.clear()
    ground.run(2.0)
    assert {system for _, system, _ in ground.log} == {1, 2}
    assert ground.emulator.vehicles[0].links[0].sender.signer is not None


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
@pytest.mark.parametrize(
    ("name", "value"),
    [("SIM_LINK_DELAY", 1e9), ("SIM_LINK_JITTER", 3e38), ("SIM_FREEZE", 1e9),
     ("SIM_ORIGIN_E", 1e30), ("SIM_GPS1_GLTCH_X", 3e38), ("SIM_WIND_SPD", 1e6),
     ("SIM_LINK_DELAY", 61.0), ("SIM_LINK_JITTER", -1.0), ("SIM_LINK_LOSS", 1.5),
     ("SIM_ENGINE_MUL", -0.5), ("SIM_BARO_DRIFT", 6.0), ("SIM_WIND_TURB", 21.0)],
)  # fmt: skip
def test_a_value_that_describes_no_fault_is_not_taken(
    autopilot: str, name: str, value: float
) -> None:
    ground = Ground(Emulator(world(2, autopilot=autopilot)))
    before = ground.emulator.vehicles[0].parameters[name]
    ground.send(1, dialect.MAVLink_param_set_message(1, 1, name.encode(), value, 9))
    ground.run(0.5)
    assert ground.last[1, "PARAM_VALUE"].param_value == before
    assert not ground.emulator.injector.active


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
@pytest.mark.parametrize("trials", [1_500, pytest.param(200_000, marks=pytest.mark.full)])
def test_a_vehicle_with_a_key_ignores_unsigned_packets(autopilot: str, trials: int) -> None:
    """Valid commands to arm and move, unsigned or signed with another key, are dropped."""
    rng = random.Random(11)
    emulator = Emulator(world(1, autopilot=autopilot))
    ground = Ground(emulator)
    ground.run(1.0)
    emulator.vehicles[0].links[0].receiver.set_key(bytes(range(32)))
    plain, foreign = dialect.MAVLink(None, 255, 190), dialect.MAVLink(None, 255, 190)
    foreign.signing.secret_key = bytes(range(1, 33))
    foreign.signing.sign_outgoing = True
    foreign.signing.timestamp = (1_800_000_000 - 1_420_070_400) * 100_000
    place = (0.0, 0.0, -5.0, *[0.0] * 8)
    for trial in range(trials):
        messages = (
            dialect.MAVLink_command_long_message(1, 1, 400, 0, 1, 21196, 0, 0, 0, 0, 0),
            dialect.MAVLink_command_long_message(
                1, 1, 176, 0, 1, rng.choice([4, 6]), 0, 0, 0, 0, 0
            ),
            dialect.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 3072, *place),
            dialect.MAVLink_set_mode_message(1, 1, 4),
        )
        frame = rng.choice(messages).pack(rng.choice([plain, foreign]))
        emulator.receive(1, frame if rng.random() < 0.8 else spoil(frame, rng), ground.now)
        if trial % 100 == 99:
            ground.now = round(ground.now + 0.02, 6)
            emulator.step(ground.now)
    truth = emulator.truth()
    assert not truth.armed.any()
    assert truth.position[0].tolist() == [0.0, 0.0, 0.0]
    assert not [event for event in emulator.events if event["time"] > 1.0]
