"""Thirty true metres stay thirty metres through each port, autopilot, and the ground station.

The oracles are the autopilots' own formulas for degrees and metres, as their sources have them.
"""

import json
import math

import numpy as np
import pymap3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl import Emulator
from sitl.firmware import sensors
from sitl.firmware.ardupilot import answer
from sitl.physics.geodesy import Geodesy
from sitl.server import MotionCapture
from sitl.world import Capture
from swarm.ground.mocap import estimate, parse_frame
from swarm.mavlink.frames import Origin, gps_frames, shared_frames
from tests.sitl.client import Ground, world

LENGTH, TOLERANCE = 30.0, 1e-3
PLACES = (np.zeros(3), *(sign * LENGTH * axis for axis in np.eye(3) for sign in (1.0, -1.0)))
LATITUDES = st.floats(-65.0, 65.0)


def from_ground(latitude, autopilot, local):
    """Return where the ground station sees NED positions (n, 3), relative to the first."""
    home = Origin(latitude, 8.5, 400.0)
    frames = gps_frames(home, 0.0, [home], [autopilot])
    seen = np.array([frames.points_to_mission(np.array([one]))[0] for one in local])
    return seen - seen[0]


SCALING = 0.011131884502145034
"""Metres of 1e-7 degrees: LATLON_TO_M (``AP_Math/definitions.h``)."""


def simulated(latitude, longitude, north, east):
    """Return the degrees of the JSON interface's metres: ``Location::offset``, without rounding."""
    there = latitude + north / SCALING * 1e-7
    shrink = math.cos(math.radians((latitude + there) / 2))
    return there, longitude + east / SCALING / shrink * 1e-7


def arducopter(home, latitude, longitude):
    """Return what ArduCopter reports at a place: (north, east), m; ``get_distance_NE``."""
    shrink = math.cos(math.radians((latitude + home[0]) / 2))
    north, east = (latitude - home[0]) * 1e7, (longitude - home[1]) * 1e7
    return north * SCALING, east * SCALING * shrink


def px4(home, latitude, longitude):
    """Return what PX4 reports at a place: (north, east), m (``MapProjection::project``)."""
    lat, ref = math.radians(latitude), math.radians(home[0])
    east = math.radians(longitude - home[1])
    cosine = math.sin(ref) * math.sin(lat) + math.cos(ref) * math.cos(lat) * math.cos(east)
    angle = math.acos(min(max(cosine, -1.0), 1.0))
    k = angle / math.sin(angle) if angle > 0.0 else 1.0
    north = math.cos(ref) * math.sin(lat) - math.sin(ref) * math.cos(lat) * math.cos(east)
    return k * north * 6371000.0, k * math.cos(lat) * math.sin(east) * 6371000.0


@settings(max_examples=40, deadline=None)
@given(LATITUDES)
def test_arducopter_through_its_json_interface(latitude):
    geodesy = Geodesy.at(latitude, 8.5, 400.0)
    local = []
    for place in PLACES:
        state = np.zeros(17)
        state[:3], state[6] = place, 1.0
        packet = answer(1.0, state, np.zeros(3), geodesy.scale("ardupilot"))
        north, east, down = json.loads(packet)["position"]
        fix = simulated(latitude, 8.5, north, east)
        true = pymap3d.enu2geodetic(*place[:2], 0.0, latitude, 8.5, 400.0)[:2]
        np.testing.assert_allclose(fix, true, rtol=0.0, atol=1e-8)  # degrees: 1 mm
        local.append((*arducopter((latitude, 8.5), *fix), down))
    np.testing.assert_allclose(from_ground(latitude, "ardupilot", local), PLACES, atol=TOLERANCE)


@settings(max_examples=40, deadline=None)
@given(LATITUDES)
def test_px4_through_its_receiver(latitude):
    geodesy = Geodesy.at(latitude, 8.5, 400.0)
    local = []
    for place in PLACES:
        fix = sensors.fix(sensors.RTK, geodesy, place, np.zeros(3), np.zeros(6))
        local.append((*px4((latitude, 8.5), fix.latitude, fix.longitude), 400.0 - fix.altitude))
    np.testing.assert_allclose(from_ground(latitude, "px4", local), PLACES, atol=TOLERANCE)


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_emulated_autopilots(autopilot):
    emulator = Emulator(world(1, autopilot=autopilot, projection="autopilot"))
    vehicle, origin = emulator.by_id[1], emulator.world.origin
    ground, local = Ground(emulator), []
    ground.run(0.5)
    for place in PLACES:
        vehicle.move_origin(emulator.bodies.position[0] - place)
        ground.command(1, 512, 32)
        ground.run(0.1)
        ned = ground.last[1, "LOCAL_POSITION_NED"]
        local.append((ned.x, ned.y, ned.z))
    seen = from_ground(origin.latitude, autopilot, local)
    np.testing.assert_allclose(seen, PLACES, atol=TOLERANCE)


def test_motion_capture():
    exact = world(1).model_copy(update={"capture": Capture(noise=0.0)})
    emulator = Emulator(exact)
    capture, local = MotionCapture(emulator, ("127.0.0.1", 9)), []
    for place in PLACES:
        emulator.bodies.position[0] = place
        (pose,) = parse_frame(capture.frame())
        sent = estimate(pose, 1.0)
        local.append((sent.x, sent.y, sent.z))
    capture.close()
    seen = [shared_frames(1).points_to_mission(np.array([one]))[0] for one in local]
    np.testing.assert_allclose(seen, PLACES, atol=TOLERANCE)
