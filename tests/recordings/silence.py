"""Record what a real autopilot does alone after its ground station has ended.

``python -m tests.recordings.silence px4=BUILD_FOLDER OUT.tlog.gz`` (or ``ardupilot=PATH``)

One vehicle with the parameters of the ground station's audit (T = `HOLD` seconds) boots in our world,
refuses to arm without a ground station, takes off, hovers; then nothing is sent to it any more. Times
are the world's. `tests/sitl/test_silence.py` plays the ground station's packets to an emulated one.
"""

import argparse
import gzip
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

from pymavlink.dialects.v20 import common as dialect

from sitl.autopilots import ardupilot, px4
from sitl.emulator import Emulator
from sitl.firmware.processes import assign, parse_firmware
from sitl.firmware.team import flying
from sitl.physics.dynamics import STEP
from sitl.world import Kind, default_world
from swarm.flight.parameters import fleet_requirements, required_values
from swarm.mission import Vehicles
from swarm.mission.fleet import emulated_fleet

HOLD = 20.0
"""T of the recordings, seconds: shorter than a fleet's 60 s, so that they are small."""
SILENT_FROM = {"px4": 30.0, "ardupilot": 90.0}
"""World time of the last packet: the ArduCopter boots for 40 to 60 s."""
TABLES = {"px4": px4.PARAMETERS, "ardupilot": ardupilot.PARAMETERS}
EPOCH = 1_800_000_000.0
HEIGHT = 2.0
_LONGEST = 40.0
_HEARTBEATS_FROM = 4.0
"""Seconds after the first packet: before it, PX4 refuses to arm without a ground station."""
_STREAMS = (30, 31, 83, 85, 105, 111, 74, 32, 33, 36, 24, 290, 291, 331, 141)
"""Frequent messages that do not matter here: they are stopped, as the ground station does."""


def parameters(kind: Kind) -> dict[str, float]:
    """Return what the ground station's audit asks of an autopilot, with T = `HOLD`."""
    fleet = emulated_fleet(1, (kind,))
    limits = fleet.limits.model_copy(update={"hold": HOLD})
    return required_values(
        kind, fleet_requirements(Vehicles(), fleet.model_copy(update={"limits": limits}))
    )


def settings(kind: Kind) -> Iterator[dialect.MAVLink_param_set_message]:
    """Yield PARAM_SET of the audit's values."""
    for name, value in parameters(kind).items():
        integer = isinstance(TABLES[kind][name], int)
        sent = float(value)
        if integer and kind == "px4":
            sent = struct.unpack("<f", struct.pack("<i", int(value)))[0]
        yield dialect.MAVLink_param_set_message(1, 1, name.encode(), sent, 6 if integer else 9)


class Pilot:
    """The ground station: what it sends at each step of the world."""

    def __init__(self, kind: Kind) -> None:
        self.kind = kind
        self.out = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
        self.end = SILENT_FROM[kind]

    def due(self, step: int, first: int) -> list[bytes]:
        """Return the packets of a step; none after the ground station has ended.

        ``first`` is the step at which the vehicle was heard first.
        """
        at = step * STEP
        if at >= self.end:
            return []
        sent = []
        if step % 50 == 0 and step >= first + round(_HEARTBEATS_FROM / STEP):
            sent.append(self.out.heartbeat_encode(6, 8, 0, 0, 4))
        start = self.end - 20.0
        if step == first + round((_HEARTBEATS_FROM - 1.0) / STEP):
            sent.append(self._command(400, 1))
        if step == round((start - 4.0) / STEP):
            sent += [self._command(511, number, -1) for number in _STREAMS]
        if at >= start and step % 2 == 0:
            axes = (0, 0, -HEIGHT, 0, 0, 0, 0, 0, 0, 0, 0)
            sent.append(self.out.set_position_target_local_ned_encode(0, 1, 1, 1, 2552, *axes))
        if step == round((start + 2.0) / STEP):
            sent.append(self._command(176, 1, 6))
        if step == round((start + 3.0) / STEP):
            sent.append(self._command(400, 1))
        return [one.pack(self.out) for one in sent]

    def _command(self, number: int, *values: float) -> dialect.MAVLink_command_long_message:
        padded = (*values, *[0.0] * (7 - len(values)))
        return self.out.command_long_encode(1, 1, number, 0, *padded)


def record(text: str, folder: Path) -> bytes:
    """Fly the vehicle of a ``--firmware`` until it has landed by itself; return the .tlog."""
    (part,) = parse_firmware(text)
    world = default_world(1, [part.kind])
    spec = world.vehicles[0].model_copy(update={"parameters": parameters(part.kind)})
    world = world.model_copy(update={"vehicles": [spec]})
    emulator = Emulator(world, outside=[1])
    pilot, log, peer, step, first = Pilot(part.kind), bytearray(), None, 0, 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.bind(("127.0.0.1", 0))
        ground.setblocking(False)
        target = f"127.0.0.1:{ground.getsockname()[1]}"
        with flying(emulator, assign([part], world), target, folder) as exchange:
            while emulator.time < pilot.end + _LONGEST:
                step += 1
                exchange.advance(step * STEP)
                try:
                    while True:
                        data, peer = ground.recvfrom(65535)
                        log += _entries(data, emulator.time)
                except BlockingIOError:
                    pass
                first = first or (step if peer is not None else 0)
                for packet in pilot.due(step, first) if first else []:
                    ground.sendto(packet, peer)
                    log += _entries(packet, emulator.time)
    return bytes(log)


def _entries(data: bytes, at: float) -> bytes:
    """Return the packets of one vehicle or of the ground station with their time."""
    stamp = round((EPOCH + at) * 1e6).to_bytes(8, "big")
    entries = bytearray()
    while data:
        length = 12 + data[1]
        entries += stamp + data[:length]
        data = data[length:]
    return bytes(entries)


def main() -> None:
    """Record, and write the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("firmware")
    parser.add_argument("out", type=Path)
    given = parser.parse_args()
    data = record(given.firmware, given.out.parent / "firmware")
    given.out.write_bytes(gzip.compress(data, mtime=0))


if __name__ == "__main__":
    main()
