"""Random packets: valid frames of every message, and spoiled ones."""

import itertools
import random

from pymavlink.dialects.v20 import common as dialect

COMMANDS = {number.to_bytes(3, "little") for number in (75, 76, 11)}
"""Message ids, as in a frame, of COMMAND_INT, COMMAND_LONG and SET_MODE."""


def messages(rng: random.Random) -> list[bytes]:
    """Return one valid frame of every message with random values, from another ground station."""
    mav = dialect.MAVLink(None, 77, 1)
    frames = []
    wild = [0, 1, -1, 127, 255, 65535, 2**31 - 1]
    reals = [0.0, -1.0, 1e30, float("nan"), float("inf"), -float("inf"), 3e38]
    for kind in dialect.mavlink_map.values():
        for _ in range(3):
            values = []
            lengths = [kind.lengths[k] for k in kind.orders]  # fields are in the order of the wire
            for field, length in zip(kind.fieldtypes, lengths, strict=True):
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
            frames.append(kind(*values).pack(mav))
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
