"""A real ArduCopter in our world; skipped where SWARM_ARDUCOPTER names no program."""

import math
import os
import socket
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from sitl.emulator import Emulator
from sitl.firmware.processes import assign, parse_firmware
from sitl.firmware.team import flying
from sitl.physics.dynamics import STEP
from sitl.world import default_world

PROGRAM = os.environ.get("SWARM_ARDUCOPTER")
GUIDED = 4
HEIGHT = 2.0
LONGEST = 120.0
"""Seconds of the vehicle's time until it must hover: its estimator takes 40 to 60 s."""
BOOT = 5.0
"""Without a radio it waits 2 s for one as it starts; a command to arm before its receiver has
started ends it (`AP_GPS::pre_arm_checks`)."""

pytestmark = pytest.mark.skipif(
    PROGRAM is None, reason="SWARM_ARDUCOPTER names no ArduCopter built for SITL"
)


def test_an_arducopter_takes_off_and_hovers_in_our_world(tmp_path):
    world = default_world(1, ["ardupilot"])
    firmware = assign(parse_firmware(f"ardupilot={PROGRAM}"), world)
    emulator = Emulator(world, outside=list(firmware))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.bind(("127.0.0.1", 0))
        ground.setblocking(False)
        target = f"127.0.0.1:{ground.getsockname()[1]}"
        with flying(emulator, firmware, target, Path(tmp_path)) as exchange:
            assert exchange is not None
            heights = _fly(emulator, exchange, ground)
    assert np.abs(heights[-50:] - HEIGHT).max() < 0.1


def _fly(emulator, exchange, ground):
    """Arm as soon as the vehicle accepts it, climb, hover for 15 s; return heights by step."""
    pilot = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
    parser, peer, heights = dialect.MAVLink(None), None, []
    parser.robust_parsing = True
    armed_at = math.inf
    while emulator.time < LONGEST and emulator.time < armed_at + 25.0:
        exchange.advance(emulator.time + STEP)
        heights.append(float(emulator.bodies.position[0, 2]) - emulator.bodies.grip_offset[0])
        try:
            while True:
                data, peer = ground.recvfrom(65535)
                for message in parser.parse_buffer(data) or []:
                    armed = message.get_type() == "HEARTBEAT" and message.base_mode & 128
                    if armed and math.isinf(armed_at):
                        armed_at = emulator.time
                        _command(ground, peer, pilot, 22, HEIGHT)
        except BlockingIOError:
            pass
        due = emulator.time > BOOT and round(emulator.time / STEP) % 100 == 0
        if due and peer is not None and math.isinf(armed_at):
            ground.sendto(pilot.set_mode_encode(1, 1, GUIDED).pack(pilot), peer)
            _command(ground, peer, pilot, 400, 0.0, first=1.0)
    assert not math.isinf(armed_at), "it did not arm"
    return np.array(heights)


def _command(ground, peer, pilot, number, last, first=0.0):
    values = (first, 0.0, 0.0, 0.0, 0.0, 0.0, last)
    ground.sendto(pilot.command_long_encode(1, 1, number, 0, *values).pack(pilot), peer)
