"""A real PX4 in our world; skipped where SWARM_PX4 names no build folder."""

import math
import os
import socket
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as dialect

from sitl.emulator import Emulator
from sitl.firmware.processes import assign, parse_firmware
from sitl.firmware.team import flying
from sitl.physics.dynamics import STEP
from sitl.world import default_world

BUILD = os.environ.get("SWARM_PX4")
OFFBOARD = 6
HEIGHT = 2.0
LONGEST = 60.0
"""Seconds of the vehicle's time until it must be armed: it is ready after 3 to 10 s."""
PARAMETERS = {"COM_OF_LOSS_T": 0.5, "NAV_RCL_ACT": 3.0, "COM_RCL_EXCEPT": 4.0}

pytestmark = pytest.mark.skipif(BUILD is None, reason="SWARM_PX4 names no folder of a PX4 build")


def test_a_px4_is_ready_without_a_complaint_takes_off_and_hovers_in_our_world(tmp_path):
    world = default_world(1, ["px4"])
    spec = world.vehicles[0].model_copy(update={"parameters": PARAMETERS})
    world = world.model_copy(update={"vehicles": [spec]})
    firmware = assign(parse_firmware(f"px4={BUILD}"), world)
    emulator = Emulator(world, outside=list(firmware))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.bind(("127.0.0.1", 0))
        ground.setblocking(False)
        target = f"127.0.0.1:{ground.getsockname()[1]}"
        with flying(emulator, firmware, target, Path(tmp_path)) as exchange:
            assert exchange is not None
            pilot = Pilot(ground)
            while emulator.time < LONGEST and emulator.time < pilot.armed_at + 30.0:
                exchange.advance(emulator.time + STEP)
                pilot.tick(emulator)
    assert not math.isinf(pilot.armed_at), f"it did not arm: {pilot.texts}"
    hover = np.array(pilot.places[-500:])
    assert np.linalg.norm(hover - [*pilot.start[:2], HEIGHT], axis=1).max() < 0.1
    # while it boots, it may miss its estimator and the ground station
    assert not [text for text in pilot.since_ready if "fail" in text.lower()]


class Pilot:
    """A ground station: setpoints above the start, offboard and arming when PX4 is ready."""

    def __init__(self, ground):
        self.ground = ground
        self.out = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
        self.parser = dialect.MAVLink(None)
        self.parser.robust_parsing = True
        self.peer = self.local = self.goal = None
        self.ready = False
        self.armed_at = math.inf
        self.texts, self.since_ready, self.places, self.start = [], [], [], None

    def tick(self, emulator):
        """Take what has come, send what is due: called once per step of the world."""
        try:
            while True:
                data, self.peer = self.ground.recvfrom(65535)
                for message in self.parser.parse_buffer(data) or []:
                    self.take(message, emulator.time)
        except BlockingIOError:
            pass
        if self.peer is None:
            return
        step = round(emulator.time / STEP)
        if step % 50 == 0:
            self.send(self.out.heartbeat_encode(6, 8, 0, 0, 4))
        if self.ready and self.local is not None:
            x, y, z = self.goal
            axes = (x, y, z, 0, 0, 0, 0, 0, 0, 0, 0)
            self.send(self.out.set_position_target_local_ned_encode(0, 1, 1, 1, 2048, *axes))
            if step % 50 == 25 and math.isinf(self.armed_at):
                self.command(dialect.MAV_CMD_DO_SET_MODE, 1, OFFBOARD)
                self.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        place = emulator.bodies.position[0] - [0.0, 0.0, emulator.bodies.grip_offset[0]]
        self.places.append(place.tolist())
        self.start = self.start or self.places[0]

    def take(self, message, now):
        kind = message.get_type()
        if kind == "STATUSTEXT":
            self.texts.append(message.text)
            if self.ready:
                self.since_ready.append(message.text)
        elif kind == "SYS_STATUS":
            # PX4 says in `health` alone that it may be armed
            health = message.onboard_control_sensors_health & dialect.MAV_SYS_STATUS_PREARM_CHECK
            if health and not self.ready and self.local is not None:
                self.goal = (self.local.x, self.local.y, self.local.z - HEIGHT)
                self.ready = True
        elif kind == "LOCAL_POSITION_NED":
            self.local = message
        elif kind == "HEARTBEAT" and message.base_mode & 128 and math.isinf(self.armed_at):
            self.armed_at = now

    def command(self, number, *values):
        padded = (*values, *[0.0] * (7 - len(values)))
        self.send(self.out.command_long_encode(1, 1, number, 0, *padded))

    def send(self, message):
        self.ground.sendto(message.pack(self.out), self.peer)
