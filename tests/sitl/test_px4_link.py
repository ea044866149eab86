"""PX4's simulator link: messages in NED and FRD, a stream in pieces, sensors, start parameters."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as dialect
from scipy.spatial.transform import Rotation

from sitl.firmware import sensors
from sitl.firmware.processes import Start
from sitl.firmware.px4 import Stream, launch_px4, receiver, sensor
from sitl.physics.geodesy import GRAVITY, Geodesy
from sitl.physics.rigid_bodies import in_body
from sitl.protocol import wire

ANGLE = st.floats(-3.0, 3.0)
GEODESY = Geodesy.at(47.4, 8.5, 488.0)


def decoded(data):
    """Return the only message in ``data``, read by pymavlink."""
    (message,) = dialect.MAVLink(None).parse_buffer(data)
    return message


def test_sensor_values_are_in_frd():
    inertial = np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])
    slow = (0.2, -0.1, -0.4, 950.0, 540.0, 11.5)
    sent = decoded(sensor(wire.Sender(1), 5000, inertial, slow))
    assert (sent.xacc, sent.yacc, sent.zacc) == (1.0, -2.0, -3.0)
    np.testing.assert_allclose((sent.xgyro, sent.ygyro, sent.zgyro), (0.1, -0.2, -0.3), rtol=1e-6)
    np.testing.assert_allclose((sent.xmag, sent.ymag, sent.zmag), (0.2, 0.1, 0.4), rtol=1e-6)
    assert (sent.time_usec, sent.abs_pressure, sent.pressure_alt) == (5000, 950.0, 540.0)
    assert sent.fields_updated == 0x1BFF  # all but the differential pressure


def test_without_slow_sensors_only_inertial_values_are_updated():
    sent = decoded(sensor(wire.Sender(1), 1, np.ones(6), None))
    assert sent.fields_updated == 0x3F


def test_a_fix_is_in_ned_with_its_stated_errors():
    place = sensors.fix(
        sensors.RTK, GEODESY, np.array([10.0, 20.0, 5.0]), np.array([1.0, 2.0, -0.5]), np.zeros(6)
    )
    sent = decoded(receiver(wire.Sender(1), 7, place))
    assert (sent.vn, sent.ve, sent.vd, sent.vel) == (200, 100, 50, 224)
    assert sent.cog == round(100 * math.degrees(math.atan2(1.0, 2.0)))
    assert (sent.alt, sent.eph, sent.epv, sent.fix_type) == (493000, 1, 1, 6)
    # 1e-7 degrees are 11 mm
    assert GEODESY.metres(sent.lat * 1e-7, sent.lon * 1e-7) == pytest.approx((10.0, 20.0), abs=0.01)


def controls(time, values, armed):
    mode = 128 | 1 if armed else 1
    message = dialect.MAVLink_hil_actuator_controls_message(time, values, mode, 1)
    return message.pack(dialect.MAVLink(None, 1, 1))


FRAMES = b"".join(
    [
        dialect.MAVLink_heartbeat_message(2, 12, 0, 0, 0, 3).pack(dialect.MAVLink(None, 1, 1)),
        controls(100, [0.0] * 16, armed=False),
        controls(200, [0.5, 0.25, 0.125, 1.0, *[0.0] * 12], armed=True),
    ]
)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, len(FRAMES)), max_size=6), st.binary(max_size=8))
def test_outputs_are_read_from_any_pieces_after_any_garbage(cuts, garbage):
    data = garbage.replace(b"\xfd", b"") + FRAMES
    edges = [0, *sorted(cuts), len(data)]
    stream = Stream()
    found = [stream.feed(data[a:b]) for a, b in itertools.pairwise(edges)]
    latest = [one for one in found if one is not None][-1]
    assert latest == (200, (0.5, 0.25, 0.125, 1.0, *(0.0,) * 12), True)


def test_a_frame_with_a_wrong_checksum_is_dropped():
    frame = bytearray(controls(300, [1.0] * 16, armed=True))
    frame[20] ^= 1
    stream = Stream()
    assert stream.feed(bytes(frame)) is None
    assert stream.feed(controls(400, [0.0] * 16, armed=True)).time == 400


@pytest.mark.parametrize(
    ("place", "declination", "inclination", "strength"),
    # PX4 1.16's table, made by NOAA's calculator for 2024.4; it changes by up to 0.2° a year
    [
        ((0.0, 0.0), -3.95, -30.30, 0.3194),
        ((50.0, 10.0), 3.92, 65.86, 0.4915),
        ((-30.0, 150.0), 10.99, -60.82, 0.5511),
    ],
)
def test_the_field_is_the_one_that_px4_expects(place, declination, inclination, strength):
    east, north, up = sensors.magnetic_field(*place, 0.0)
    level = math.hypot(east, north)
    assert math.degrees(math.atan2(east, north)) == pytest.approx(declination, abs=0.6)
    assert math.degrees(math.atan2(-up, level)) == pytest.approx(inclination, abs=0.6)
    assert math.hypot(level, up) == pytest.approx(strength, rel=0.01)


@settings(max_examples=50, deadline=None)
@given(st.tuples(ANGLE, ANGLE, ANGLE))
def test_world_vectors_turn_into_body_axes(angles):
    turn = Rotation.from_euler("zyx", angles)
    x, y, z, w = turn.as_quat()
    vector = np.array([0.2, -0.5, 0.4])
    np.testing.assert_allclose(
        in_body(np.array([w, x, y, z]), vector), turn.inv().apply(vector), atol=1e-12
    )


@given(st.floats(-400.0, 9000.0))
def test_pressure_falls_as_the_weight_of_the_air_above(altitude):
    pressure, celsius = sensors.air(altitude)
    assert sensors.pressure_altitude(pressure) == pytest.approx(altitude, abs=1e-6)
    higher, _ = sensors.air(altitude + 1.0)
    density = 100.0 * pressure / (287.053 * (celsius + 273.15))
    assert 100.0 * (pressure - higher) == pytest.approx(density * GRAVITY, rel=1e-3)


def test_each_process_has_its_own_instance_link_and_parameters(tmp_path):
    start = Start(Path("/px4"), tmp_path, 4, 5, 0.0, True, {"COM_OF_LOSS_T": 0.5}, "127.0.0.1:9")
    one = launch_px4(start, 0.25)
    assert one.command == ["/px4/bin/px4", "-d", "-i", "4", "/px4/etc"]
    assert one.files["px4-rc.mavlink"].splitlines() == [
        "param set COM_OF_LOSS_T 0.5",
        "mavlink start -x -u 14584 -r 4000000 -f -m onboard -o 9 -t 127.0.0.1",
    ]
    assert one.environment["PX4_PARAM_PWM_MAIN_FUNC5"] == "430"
    assert one.environment["PATH"].startswith(f"{tmp_path}:")


def test_px4_finds_its_links_in_a_folder_that_was_given_relative_to_ours(tmp_path, monkeypatch):
    # PX4 has its own folder: with a relative one in its path it took the links of its simulator
    monkeypatch.chdir(tmp_path)
    start = Start(Path("/px4"), Path("logs/vehicle1"), 0, 1, 0.0, True, {}, "127.0.0.1:9")
    path = launch_px4(start, 0.25).environment["PATH"]
    assert path.startswith(f"{tmp_path}/logs/vehicle1:")


def test_without_a_target_the_links_are_those_of_px4s_own_simulators(tmp_path):
    start = Start(Path("/px4"), tmp_path, 0, 1, 0.0, False, {}, None)
    one = launch_px4(start, 0.25)
    assert one.files["px4-rc.mavlink"] == ". etc/init.d-posix/px4-rc.mavlink\n"
    assert "PX4_PARAM_PWM_MAIN_FUNC5" not in one.environment
