"""Random packets: valid frames of every message, and spoiled ones."""

import itertools
import math
import random
from collections.abc import Sequence
from typing import Any

from pymavlink.dialects.v20 import common as dialect

COMMANDS = {number.to_bytes(3, "little") for number in (75, 76, 11)}
"""Message ids, as in a frame, of COMMAND_INT, COMMAND_LONG and SET_MODE."""


WILD = [0, 1, -1, 5, 127, 255, 65535, 2**31 - 1, 2**48, 2**64 - 1]
REALS = [0.0, 1.0, -1.0, 0.3, 1e9, -1e9, 1e30, math.nan, math.inf, -math.inf, 3e38]
NUMBERS = sorted(
    {
        value
        for name, value in vars(dialect).items()
        if name.startswith("MAV_CMD_") and isinstance(value, int) and value < 65536
    }
)
KINDS = list(dialect.mavlink_map.values())
TARGETED = [kind for kind in KINDS if "target_system" in kind.fieldnames]


def random_message(rng: random.Random, kind: Any, names: Sequence[str] = ()) -> Any:
    """Return a message of a kind with random values, many of them extreme.

    Most are for vehicle 1, of commands that exist, and of parameters with these names.
    """
    values: list[Any] = []
    lengths = [kind.lengths[k] for k in kind.orders]  # fields are in the order of the wire
    for name, field, length in zip(kind.fieldnames, kind.fieldtypes, lengths, strict=True):
        if field == "char":
            known = name == "param_id" and names and rng.random() < 0.9
            text = rng.choice(names).encode() if known else rng.randbytes(max(length, 1))
            values.append(text)
            continue
        real = field in {"float", "double"}
        picked = [rng.choice(REALS if real else WILD) for _ in range(max(length, 1))]
        if not real:
            low, high = _range(field)
            picked = [min(max(value, low), high) for value in picked]
        values.append(picked if length > 1 else picked[0])
    fields = list(kind.fieldnames)
    for name, usual in (
        ("target_system", 1),
        ("target_component", 1),
        ("command", rng.choice(NUMBERS)),
        ("mission_type", rng.randrange(3)),
        ("seq", rng.randrange(3)),
        ("count", rng.randrange(4)),
    ):
        if name in fields and lengths[fields.index(name)] <= 1 and rng.random() < 0.7:
            low, high = _range(kind.fieldtypes[fields.index(name)])
            values[fields.index(name)] = min(max(usual, low), high)
    return kind(*values)


def messages(rng: random.Random) -> list[bytes]:
    """Return valid frames of every message with random values, from another ground station."""
    mav = dialect.MAVLink(None, 77, 1)
    return [random_message(rng, kind).pack(mav) for kind in KINDS for _ in range(3)]


def random_frame(rng: random.Random, system: int, component: int, names: Sequence[str]) -> bytes:
    """Return a valid frame of any message from this sender, of either version of MAVLink.

    Half of them are messages with a target.
    """
    kind = rng.choice(TARGETED if rng.random() < 0.5 else KINDS)
    mav = dialect.MAVLink(None, system, component)
    mav.seq = rng.randrange(256)
    first = kind.id < 256 and rng.random() < 0.2
    return bytes(random_message(rng, kind, names).pack(mav, force_mavlink1=first))


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
