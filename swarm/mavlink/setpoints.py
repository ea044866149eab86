"""Setpoints for the whole team at once: SET_POSITION_TARGET_LOCAL_NED, as pymavlink encodes it.

A compiled loop writes the variable fields and the checksums into packets that are laid out once.
"""

from typing import Any

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import common

from swarm.jit import allocates, compiled
from swarm.mavlink.packets import GROUND_COMPONENT, GROUND_SYSTEM
from swarm.mavlink.telemetry_table import crc_accumulate
from swarm.signatures import Bytes2, Floats1, Floats3, Ints1

Floats = npt.NDArray[np.float64]
Bytes = npt.NDArray[np.uint8]

POSITION_VELOCITY_ACCELERATION_YAW = int(common.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE)
"""Type mask of the setpoints: only the yaw rate is ignored."""

_MAGIC, _SIGNED = 0xFD, 0x01
_SEQUENCE, _TIME, _STATE, _YAW, _CHECKSUM = 4, 10, 14, 50, 63
"""Offsets of the variable fields and of the checksum in a packet."""
_MESSAGE = common.MAVLink_set_position_target_local_ned_message
_EXTRA = int(_MESSAGE.crc_extra)
_PACKET = np.dtype(
    [
        ("magic", "u1"),
        ("length", "u1"),
        ("incompatible", "u1"),
        ("compatible", "u1"),
        ("sequence", "u1"),
        ("system", "u1"),
        ("component", "u1"),
        ("message", "u1", 3),
        ("time", "<u4"),
        ("state", "<f4", 9),
        ("yaw", "<f4"),
        ("yaw_rate", "<f4"),
        ("type_mask", "<u2"),
        ("target_system", "u1"),
        ("target_component", "u1"),
        ("frame", "u1"),
        ("checksum", "<u2"),
    ]
)


class SetpointPacker:
    """Packs setpoints for a fixed list of vehicles.

    ``frame`` is never zero, so the last byte of the payload is never truncated, and all packets
    have the same length.
    """

    def __init__(
        self,
        systems: npt.ArrayLike,
        components: npt.ArrayLike,
        source: tuple[int, int] = (GROUND_SYSTEM, GROUND_COMPONENT),
        *,
        signed: bool = False,
    ) -> None:
        """``signed`` sets the flag for signing; the caller appends the signatures."""
        targets = np.asarray(systems, dtype=np.uint8)
        frames: Any = np.zeros(len(targets), _PACKET)
        frames["magic"] = _MAGIC
        frames["length"] = _PACKET.itemsize - 12
        frames["incompatible"] = _SIGNED if signed else 0
        frames["system"], frames["component"] = source
        frames["message"][:, 0] = _MESSAGE.id
        frames["type_mask"] = POSITION_VELOCITY_ACCELERATION_YAW
        frames["target_system"] = targets
        frames["target_component"] = np.asarray(components, dtype=np.uint8)
        frames["frame"] = common.MAV_FRAME_LOCAL_NED
        self._bytes: Bytes = frames.view(np.uint8).reshape(len(frames), _PACKET.itemsize)

    def pack(
        self,
        sequences: npt.ArrayLike,
        time_boot_ms: int,
        states: Floats,
        yaw: Floats,
    ) -> Bytes:
        """Return the packets (n, 65) of setpoints in each vehicle's own NED, SI units.

        ``sequences`` (n,) are sequence numbers; ``states`` (n, 3, 3) position, velocity and
        acceleration of each vehicle; ``yaw`` (n,) in radians. The next call overwrites the array.
        """
        numbers = np.asarray(sequences, dtype=np.int64)
        _write(self._bytes, numbers, time_boot_ms & 0xFFFFFFFF, states, yaw)
        return self._bytes


@compiled
@allocates
def _write(packets: Bytes2, sequences: Ints1, time: int, states: Floats3, yaw: Floats1) -> None:
    single = np.empty(10, np.float32)
    raw = single.view(np.uint8)
    for i in range(len(packets)):
        packet = packets[i]
        packet[_SEQUENCE] = sequences[i] & 0xFF
        for k in range(4):
            packet[_TIME + k] = time >> (8 * k) & 0xFF
        for k in range(9):
            single[k] = states[i, k // 3, k % 3]
        single[9] = yaw[i]
        for k in range(40):
            packet[_STATE + k] = raw[k]
        checksum = 0xFFFF
        for k in range(1, _CHECKSUM):
            checksum = crc_accumulate(checksum, packet[k])
        checksum = crc_accumulate(checksum, _EXTRA)
        packet[_CHECKSUM], packet[_CHECKSUM + 1] = checksum & 0xFF, checksum >> 8
