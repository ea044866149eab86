"""Strangers on the links, and files from strangers: no wrong motion, no crash, words instead."""

import json
import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from swarm.errors import InputError
from swarm.flight.tlog import replay
from swarm.ground.record_reader import recorded_flight, recorded_plan
from swarm.mavlink.packets import Decoder
from swarm.mission import parse_mission
from swarm.mission.fleet import emulated_fleet, parse_fleet
from swarm.planning.archive import plan_document, plan_motion, read_plan
from swarm.simulation.loop import faults_from
from tests.network import Network, small_plan
from tests.sitl.random_packets import random_frame

PLAN = small_plan()
SECONDS = 4.0


def flown(attack=None):
    """The setpoints and commands of a short stretch of the fold, with an attack on every tick."""
    flight = Network(PLAN, emulated_fleet(3, ("px4", "ardupilot")), no_cable=True).in_fold(1.0)
    flight.sent.clear()
    end = flight.now + SECONDS
    while flight.now < end:
        flight.once()
        if attack is not None:
            attack(flight)
    return flight


@pytest.fixture(scope="module")
def quiet():
    return flown().sent


def lies(flight):
    """What somebody says who pretends to be a vehicle: disarmed, landed, far away, low battery."""
    return (
        common.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3),
        common.MAVLink_local_position_ned_message(int(flight.now * 1e3), 9e3, 9e3, -9e3, 5, 5, 5),
        common.MAVLink_extended_sys_state_message(0, 1),
        common.MAVLink_command_ack_message(211, 4, 0, 0, 255, 190),
    )


def forged(system, flight):
    liar = common.MAVLink(None, srcSystem=system, srcComponent=1)
    return b"".join(lie.pack(liar) for lie in lies(flight))


def test_a_spoofed_vehicle_from_another_address_changes_no_packet(quiet):
    def attack(flight):
        for system in (1, 2, 3):
            flight.conductor.receive(
                "loopback", f"liar {system}", forged(system, flight), flight.now
            )

    flight = flown(attack)
    assert flight.sent == quiet
    assert flight.conductor.team.rejected > 100
    assert any("another address" in words for words in flight.words("security"))


def test_replayed_traffic_from_another_address_changes_no_packet(quiet):
    kept = []

    def attack(flight):
        kept.append(b"".join(data for _, _, data in flight.sent[-3:]))
        for data in kept[-40:]:
            flight.conductor.receive("loopback", "replayer", data, flight.now)

    assert flown(attack).sent == quiet


def test_a_second_ground_station_is_reported_and_changes_no_packet(quiet):
    other = common.MAVLink(None, srcSystem=250, srcComponent=190)
    heartbeat = common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(other)
    order = common.MAVLink_command_long_message(1, 1, 400, 0, 0, 21196, 0, 0, 0, 0, 0).pack(other)

    def attack(flight):
        flight.conductor.receive("loopback", "other", heartbeat + order, flight.now)

    flight = flown(attack)
    assert flight.sent == quiet
    assert any("another ground station (system 250)" in words for words in flight.words("security"))


def test_a_flood_changes_no_packet_and_takes_no_memory(quiet):
    """A thousand addresses, each tick another; what they say is counted and forgotten."""
    rng = np.random.default_rng(3)

    def attack(flight):
        for k in range(100):
            data = forged(k % 5, flight) if k % 2 else rng.bytes(60)
            address = f"flood {int(rng.integers(1000))}"
            flight.conductor.receive("loopback", address, data, flight.now)

    flight = flown(attack)
    assert flight.sent == quiet
    team = flight.conductor.team
    assert len(team._routes) <= team._most_routes
    assert len(flight.words("security")) < 100


ABOARD = [
    common.MAVLink_heartbeat_message(30, common.MAV_AUTOPILOT_GENERIC, 0, 0, 4, 3),
    common.MAVLink_heartbeat_message(26, common.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3),
    common.MAVLink_heartbeat_message(18, common.MAV_AUTOPILOT_PX4, 0, 0, 4, 3),
    common.MAVLink_heartbeat_message(27, common.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3),
]
"""Heartbeats of a camera, a gimbal, a companion computer and a transponder."""


@pytest.mark.parametrize("apart", [False, True], ids=["one address", "an address of their own"])
def test_nothing_that_other_components_say_changes_a_packet(quiet, apart):
    rng = random.Random(5)

    def attack(flight):
        for system in (1, 2, 3):
            component = rng.choice([0, 2, 25, 100, 154, 191, 255])
            device = common.MAVLink(None, system, component)
            said = [*ABOARD, *lies(flight)[1:], common.MAVLink_sys_status_message(
                0, 0xFFFFFFF, 0, 900, 4900, -1, 3, 0, 0, 0, 0, 0, 0)]  # fmt: skip
            data = b"".join(one.pack(device) for one in said)
            data += random_frame(rng, system, rng.choice([0, *range(2, 256)]), ["MPC_XY_VEL_MAX"])
            address = f"devices of {system}" if apart else system
            flight.conductor.receive("loopback", address, data, flight.now)

    flight = flown(attack)
    assert flight.sent == quiet
    assert flight.words("failure") == []
    assert flight.conductor.team.conflicts() == []


def fuzzed(count, seed):
    """Any message of any component, damaged copies of what vehicles say, and noise, from the
    vehicles' own addresses."""
    flight = Network(PLAN, emulated_fleet(3), no_cable=True).in_fold(1.0)
    rng, chance = np.random.default_rng(seed), random.Random(seed)
    heard = []
    flight.downlink = lambda _now, _system, data: heard.append(data) or True
    flight.until_time(1.0)
    for k in range(count):
        data = bytearray(heard[int(rng.integers(len(heard)))])
        for _ in range(int(rng.integers(1, 6))):
            data[int(rng.integers(len(data)))] = int(rng.integers(256))
        sent = bytes(data[: int(rng.integers(1, len(data) + 1))]) if k % 3 else rng.bytes(80)
        system = int(rng.integers(1, 4))
        if k % 2:
            component = 1 if rng.random() < 0.5 else int(rng.integers(256))
            sent = random_frame(chance, system, component, ["MPC_XY_VEL_MAX"])
        if k % 5:
            flight.conductor.receive("loopback", system, sent, flight.now)
        else:
            flight.conductor.receive_all("loopback", [(system, sent)], flight.now)
        if k % 500 == 0:
            flight.conductor.events()
            for one in flight.conductor.tick(flight.now):
                for packet in Decoder().feed(one.data):
                    setpoint = packet.message
                    if packet.number == 84:
                        assert np.isfinite([setpoint.x, setpoint.y, setpoint.z]).all()
    return flight


def test_fuzzed_packets_do_not_stop_the_ground_station():
    assert fuzzed(5_000, 1).conductor.stage in {"execute", "contingency"}


@pytest.mark.full
def test_a_million_fuzzed_packets_do_not_stop_the_ground_station():
    assert fuzzed(1_000_000, 2).conductor.stage in {"execute", "contingency", "finished"}


NESTED = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=12),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4)
    ),
    max_leaves=12,
)
DOCUMENT = plan_document(PLAN.plan)
MOTION = plan_motion(PLAN.plan)


@settings(max_examples=60, deadline=None)
@given(text=st.one_of(st.text(max_size=200), NESTED.map(lambda one: json.dumps(one, default=str))))
def test_files_from_strangers_are_read_or_refused_in_words(text):
    for parse in (parse_mission, parse_fleet, faults_from):
        try:
            parse(text, "file")
        except InputError:
            continue


@settings(max_examples=60, deadline=None)
@given(key=st.sampled_from(sorted(DOCUMENT)), value=NESTED)
def test_a_strangers_plan_is_read_or_refused_in_words(key, value):
    try:
        read_plan({**DOCUMENT, key: value}, MOTION)
    except InputError:
        return


@settings(max_examples=40, deadline=None)
@given(cut=st.integers(0, len(MOTION)), noise=st.binary(max_size=40))
def test_a_damaged_motion_is_refused_in_words(cut, noise):
    try:
        read_plan(DOCUMENT, MOTION[:cut] + noise)
    except InputError:
        return


@settings(max_examples=40, deadline=None)
@given(data=st.binary(max_size=400))
def test_a_strangers_log_is_refused_in_words(data):
    with pytest.raises(InputError):
        replay(data, PLAN.plan, emulated_fleet(3))


def test_control_characters_in_names_of_files_and_keys_are_not_printed():
    with pytest.raises(InputError) as refused:
        parse_fleet('schema: 1\nname: "a\\e[2J"\n"k\\e]0;t\\a": 3', "fleet\x1b[2J.yaml")
    assert "fleet\ufffd[2J.yaml:3: k\ufffd]0;t\ufffd: unknown key, got 3" in str(refused.value)
    assert str(refused.value).replace("\n", "").isprintable()


@pytest.mark.parametrize(
    "text", ["!!python/object/apply:os.system ['true']", "a: &a [*a, *a]", "[" * 5000]
)
def test_code_loops_and_towers_in_files_are_refused(text):
    for parse in (parse_mission, parse_fleet, faults_from):
        with pytest.raises(InputError):
            parse(text, "file")


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("plan.json", b"[" * 200_000),
        ("plan.json", b"{}"),
        ("plan.json", b"3"),
        ("plan.json", b"\xff\xfe"),
        ("motion.npz", b"PK\x03\x04" + bytes(100)),
        ("motion.npz", b""),
        ("fleet.json", b"[" * 200_000),
        ("fleet.json", b'{"links": 3}'),
        ("fleet.json", b" " * 2_000_000),
        ("flight.tlog", bytes(5_000)),
    ],
)
def test_a_strangers_record_is_refused_in_words(name, data, tmp_path):
    good = {
        "plan.json": json.dumps(DOCUMENT).encode(),
        "motion.npz": MOTION,
        "fleet.json": emulated_fleet(3).model_dump_json(by_alias=True).encode(),
        "flight.tlog": b"",
    }
    for file, content in {**good, name: data}.items():
        (tmp_path / file).write_bytes(content)
    with pytest.raises(InputError) as refused:
        recorded_flight(tmp_path, recorded_plan(tmp_path))
    assert len(str(refused.value)) < 2_000


def test_a_file_that_is_too_large_is_not_read(tmp_path):
    (tmp_path / "motion.npz").write_bytes(MOTION)
    with (tmp_path / "plan.json").open("wb") as file:
        file.truncate(1 << 40)  # a hole: it takes no room, and would take all memory
    with pytest.raises(InputError, match="expected at most 67,108,864 bytes"):
        recorded_plan(tmp_path)
