"""Fuzzing: no crash, and no motion without a valid command."""

import itertools
import random
import struct
import warnings

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as dialect

from sitl import Emulator
from tests.sitl.client import Ground, world

amounts = pytest.mark.parametrize(
    "trials", [6_000, pytest.param(1_000_000, marks=pytest.mark.full)]
)


def messages(rng: random.Random) -> list[bytes]:
    """Return one valid frame of every message with random values, from another ground station."""
    mav = dialect.MAVLink(None, 77, 1)
    frames = []
    wild = [0, 1, -1, 127, 255, 65535, 2**31 - 1]
    reals = [0.0, -1.0, 1e30, float("nan"), float("inf"), -float("inf"), 3e38]
    for number, kind in dialect.mavlink_map.items():
        for _ in range(3):
            values = []
            for field, length in zip(kind.fieldtypes, kind.lengths, strict=True):
                if field == "char":
                    values.append(bytes(rng.choices(range(256), k=max(length, 1))))
                    continue
                pool = reals if field in {"float", "double"} else wild
                picked = [rng.choice(pool) for _ in range(max(length, 1))]
                if field not in {"float", "double"}:
                    low, high = _range(field)
                    picked = [min(max(value, low), high) for value in picked]
                values.append(picked if length > 1 else picked[0])
            names = list(kind.fieldnames)
            for name, value in (("target_system", 1), ("target_component", 1)):
                if name in names and rng.random() < 0.7:
                    values[names.index(name)] = value
            try:
                frames.append(kind(*values).pack(mav))
            except (struct.error, TypeError, OverflowError):
                frames.append(b"\xfd" + bytes([0, 0, 0, 0, 77, 1]) + number.to_bytes(3, "little"))
    return frames


def _range(kind: str) -> tuple[int, int]:
    bits = (
        int("".join(itertools.takewhile(str.isdigit, kind.lstrip("uint")))) if kind != "char" else 8
    )
    return (0, 2**bits - 1) if kind.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


def spoil(frame: bytes, rng: random.Random) -> bytes:
    """Return a frame that is truncated, joined, replaced by noise, or has flipped bits."""
    way = rng.randrange(5)
    data = bytearray(frame)
    if way == 0:
        return bytes(data[: rng.randrange(len(data))])
    if way == 1:
        for _ in range(rng.randrange(1, 4)):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        return bytes(data)
    if way == 2:
        data[-1] ^= 0xFF
        return bytes(data)
    if way == 3:
        return bytes(data[3:]) + frame
    return rng.randbytes(rng.randrange(300))


@amounts
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_invalid_and_foreign_bytes_cause_no_motion(autopilot: str, trials: int) -> None:
    """Without a valid command to arm, the vehicle stays disarmed on the ground."""
    rng = random.Random(8)
    frames = [f for f in messages(rng) if f[7:10] not in _COMMANDS]
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


_COMMANDS = {number.to_bytes(3, "little") for number in (75, 76, 11)}


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
