"""Two vehicles with one system id: emulated ones in memory, and two emulators on one UDP port."""

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from pymavlink.dialects.v20 import common

from sitl import Emulator
from sitl.world import default_world
from swarm.flight.fleet_listener import FleetListener
from swarm.mission.fleet import Fleet, emulated_fleet
from tests.command import run
from tests.network import Network, small_plan
from tests.ports import free_port

LINKS = {"radio": "udpin://127.0.0.1:1", "spare": "udpin://127.0.0.1:2"}
Places = Callable[[int], list[tuple[str, object]]]


def emulated(kind: str, seed: int = 1) -> Emulator:
    return Emulator(default_world(2, (kind,), seed))


def fleet_of(links: tuple[str, ...] = ("radio",), autopilot: str = "detect") -> Fleet:
    fleet = emulated_fleet(2)
    listed = tuple(
        one.model_copy(update={"links": links, "autopilot": autopilot}) for one in fleet.vehicles
    )
    return fleet.model_copy(update={"links": LINKS, "vehicles": listed, "emulated": None})


def at_home(number: int) -> Places:
    return lambda system: [("radio", ("10.0.0.9", 1000 * number + system))]


def both_links(system: int) -> list[tuple[str, object]]:
    return [("radio", ("10.0.0.9", system)), ("spare", ("10.0.0.9", 50 + system))]


def heard(fleet: Fleet, *speaking: tuple[Emulator, Places], seconds: float = 6.0) -> list[str]:
    """What is said against vehicles after so long; each speaks from all of its places."""
    listener = FleetListener(fleet)
    for tick in range(int(20 * seconds)):
        now = 0.05 * tick
        for emulator, places in speaking:
            for system, data in emulator.step(now):
                for link, address in places(system):
                    listener.receive(link, address, data, now)
        for one in listener.tick(now):
            for emulator, places in speaking:
                for system in (1, 2):
                    if (one.link, one.address) in places(system):
                        emulator.receive(system, one.data, now)
    assert not listener.missing
    return [finding.message for finding in listener.team.conflicts()]


def test_two_autopilots_are_reported_with_both_addresses():
    said = heard(fleet_of(), (emulated("px4"), at_home(1)), (emulated("ardupilot"), at_home(2)))
    assert said == [
        f"system {k} is two vehicles: PX4 at 10.0.0.9:100{k} on link radio and ArduPilot at "
        f"10.0.0.9:200{k} on link radio: give each vehicle a system id of its own"
        for k in (1, 2)
    ]


def test_two_clocks_are_reported():
    said = heard(fleet_of(), (emulated("px4"), at_home(1)), (emulated("px4", 3), at_home(2)))
    assert [words.split(" s apart")[0].rsplit(" ", 1)[0] for words in said] == [
        f"system {k} is two vehicles: PX4 at 10.0.0.9:100{k} on link radio and PX4 at "
        f"10.0.0.9:200{k} on link radio, started"
        for k in (1, 2)
    ]


def test_two_addresses_on_one_link_are_reported_for_identical_vehicles():
    def places(system: int) -> list[tuple[str, object]]:
        return [*at_home(1)(system), *at_home(2)(system)]

    said = heard(fleet_of(), (emulated("px4"), places))
    assert len(said) == 2
    assert said[0].startswith(
        "system 1 is received from two addresses: PX4 at 10.0.0.9:1001 on link radio and PX4 at "
        "10.0.0.9:2001 on link radio: two vehicles have this system id, or one is connected twice"
    )


@pytest.mark.parametrize("links", [("radio", "spare"), ("radio",)])
def test_a_vehicle_on_two_links_is_one_vehicle_whether_both_are_listed_or_not(links):
    assert heard(fleet_of(links), (emulated("px4"), both_links)) == []


@pytest.mark.parametrize("links", [("radio", "spare"), ("radio",)])
def test_another_vehicle_on_another_link_is_reported(links):
    other: Places = lambda system: [("spare", ("10.0.0.9", 50 + system))]  # noqa: E731
    both = (emulated("px4"), at_home(1)), (emulated("ardupilot"), other)
    said = heard(fleet_of(links), *both)
    assert (
        "PX4 at 10.0.0.9:1001 on link radio and ArduPilot at 10.0.0.9:51 on link spare" in said[0]
    )


def test_a_router_that_forwards_many_vehicles_is_fine():
    router: Places = lambda _: [("radio", ("10.0.0.9", 14550))]  # noqa: E731
    assert heard(fleet_of(), (emulated("ardupilot"), router)) == []


@pytest.mark.parametrize(
    ("other", "words"),
    [
        ("px4", "two vehicles have this system id behind one address"),
        ("ardupilot", "ArduPilot and PX4 at 10.0.0.9:14550 on link radio"),
    ],
)
def test_two_vehicles_behind_one_router_are_reported(other, words):
    router: Places = lambda _: [("radio", ("10.0.0.9", 14550))]  # noqa: E731
    said = heard(fleet_of(), (emulated("px4"), router), (emulated(other, 3), router))
    assert {one.split(" ")[1].rstrip(":") for one in said} == {"1", "2"}
    assert words in said[0]


def said_by(component: int, kind: int, autopilot: int, clones: bool = False) -> list[str]:
    """What is said against system 1, of whose heartbeats this sender has a share as well."""
    listener, vehicle = FleetListener(fleet_of()), emulated("px4")
    other = common.MAVLink(None, srcSystem=1, srcComponent=component)
    beat = common.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 3, 3).pack(other)
    for tick in range(100):
        now = 0.05 * tick
        if tick % 20 == 0:
            listener.receive("radio", ("10.0.0.9", 77 if clones else 1), beat, now)
        if tick > 30:
            for system, data in vehicle.step(now):
                listener.receive("radio", ("10.0.0.9", system), data, now)
        listener.tick(now)
    assert listener.missing == []
    assert listener.team.vehicles[1].component == 1
    return [finding.message for finding in listener.team.conflicts()]


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize(
    ("component", "kind", "autopilot"),
    [(100, 30, 0), (154, 26, 3), (191, 18, 12), (1, 30, 8), (0, 2, 12)],
)
def test_a_device_that_is_received_first_is_no_vehicle(component, kind, autopilot, apart):
    assert said_by(component, kind, autopilot, clones=apart) == []


def test_a_second_autopilot_with_another_component_is_reported():
    (said,) = said_by(2, 2, 12)
    assert said.startswith("system 1 is two autopilots, components 1 and 2: PX4 at 10.0.0.9:1 on ")
    (said,) = said_by(2, 2, 3)
    assert said.startswith(
        "system 1 is two vehicles: ArduPilot and PX4 at 10.0.0.9:1 on link radio"
    )


@pytest.mark.parametrize("copied", [(1.0, 3.0, 5.0, 20.0), (0.0, 4.0)])
def test_late_copies_from_another_vehicles_address_are_no_second_vehicle(copied):
    """A network sends copies of packets by other ways; also before all other packets."""
    listener, emulator, late = FleetListener(fleet_of()), emulated("px4"), []
    for tick in range(600):
        now = 0.05 * tick
        for system, data in emulator.step(now):
            if any(at <= now < at + 1.0 for at in copied):
                late.append((now + 3.2 if tick > 20 else now, system, data))
            if tick > 20 or copied[0] > 0.0:
                listener.receive("radio", ("10.0.0.9", system), data, now)
        while late and late[0][0] <= now:
            _, system, data = late.pop(0)
            listener.receive("radio", ("10.0.0.9", 3 - system), data, now)
        for one in listener.tick(now):
            emulator.receive(one.address[1], one.data, now)
    assert listener.missing == []
    assert listener.team.conflicts() == []
    assert [listener.team.way_to(k).address for k in (1, 2)] == [("10.0.0.9", 1), ("10.0.0.9", 2)]
    assert all(now - one.position_at < 0.5 for one in listener.team.vehicles.values())


def test_an_autopilot_other_than_the_listed_one_is_reported():
    said = heard(fleet_of(autopilot="px4"), (emulated("ardupilot"), at_home(1)))
    assert said[0] == (
        "system 1 is ArduPilot at 10.0.0.9:1001 on link radio, and PX4 in the fleet file"
    )


def test_a_vehicle_that_is_restarted_once_is_still_one_vehicle():
    emulator = emulated("px4")
    emulator.vehicles[0].timers.append((3.0, emulator.vehicles[0].reboot))
    assert heard(fleet_of(), (emulator, both_links), seconds=20.0) == []


def test_clocks_that_drift_as_simulators_do_are_one_clock_on_both_ways():
    emulator = emulated("px4")
    for vehicle in emulator.vehicles:
        vehicle.clock_rate = 0.8
    assert heard(fleet_of(), (emulator, both_links), seconds=30.0) == []


def test_a_second_vehicle_without_requests_is_reported_by_its_clock_requests():
    """An ArduCopter sends heartbeats and TIMESYNC only, until it is asked for more."""
    listener, vehicle = FleetListener(fleet_of(("radio",))), emulated("ardupilot")
    silent = common.MAVLink(None, srcSystem=1, srcComponent=1)
    beat = common.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3).pack(silent)
    for tick in range(160):
        now = 0.05 * tick
        for system, data in vehicle.step(now):
            listener.receive("radio", ("10.0.0.9", system), data, now)
        if tick % 20 == 0:
            clock = common.MAVLink_timesync_message(0, int((now + 7.0) * 1e9)).pack(silent)
            listener.receive("spare", ("10.0.0.9", 99), beat + clock, now)
        for one in listener.tick(now):
            if one.address:
                vehicle.receive(one.address[1], one.data, now)
    (said,) = listener.team.conflicts()
    assert said.message.startswith(
        "system 1 is two vehicles: ArduPilot at 10.0.0.9:1 on link radio"
    )
    assert "ArduPilot at 10.0.0.9:99 on link spare, started " in said.message


@pytest.mark.parametrize(
    ("kind", "within", "words"),
    [
        ("ardupilot", 5.0, "system 2 is two vehicles: PX4 at 2 on link loopback and ArduPilot at "),
        ("px4", 10.0, "system 1 is "),
    ],
)
def test_a_flight_with_a_second_vehicle_of_a_system_is_refused_on_the_ground(kind, within, words):
    """Of another kind, or of one kind and with one clock."""
    flight, other = Network(small_plan(), emulated_fleet(3)), Emulator(default_world(3, (kind,)))

    def double() -> bool:
        for system, data in other.step(flight.now):
            flight.conductor.receive("loopback", ("10.0.0.9", system), data, flight.now)
        return False

    outcome = flight.run(double, most=10.0)
    assert outcome is not None
    assert outcome.word == "refused"
    assert words in outcome.explanation
    assert flight.now < within


@contextmanager
def processes(port: int, *kinds: str) -> Iterator[None]:
    started = [
        subprocess.Popen(
            [sys.executable, "-m", "sitl", "-n", "2", "--autopilot", kind, "--json", "--target",
             f"127.0.0.1:{port}", "--follow-parent"],
            stdout=subprocess.PIPE,
        )
        for kind in kinds
    ]  # fmt: skip
    try:
        for one in started:
            assert one.stdout is not None
            assert one.stdout.readline()
        yield
    finally:
        for one in started:
            one.terminate()
            one.communicate()


@pytest.mark.slow
def test_two_emulators_on_one_port_are_refused_by_the_check_in_seconds(tmp_path):
    port = free_port()
    vehicles = [{"sysid": k, "links": ["ground"], "autopilot": "px4"} for k in (1, 2)]
    links = {"ground": f"udpin://127.0.0.1:{port}"}
    file = tmp_path / "fleet.json"
    file.write_text(json.dumps({"schema": 1, "name": "two", "links": links, "vehicles": vehicles}))
    with processes(port, "px4", "ardupilot"):
        began = time.monotonic()
        said = run("check", "--fleet", str(file), "--record", str(tmp_path / "record"))
        took = time.monotonic() - began
    assert said.returncode == 1
    assert "listening" not in said.stderr
    for k in (1, 2):
        (line,) = (one for one in said.stderr.splitlines() if f"system {k} is two vehicles" in one)
        assert line.count("127.0.0.1:") == 2
        assert "PX4 at" in line
        assert "ArduPilot at" in line
    assert took < 15.0
