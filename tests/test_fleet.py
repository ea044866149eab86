"""Fleet files: valid, invalid and ready-made ones."""

from pathlib import Path

import pytest

from swarm.errors import InputError
from swarm.mission import mission_for_knot
from swarm.mission.fleet import (
    emulated_fleet,
    fleet_schema,
    mission_for,
    parse_fleet,
    with_tracking,
)

READY_MADE = sorted((Path(__file__).parent.parent / "missions" / "fleets").glob("*.yaml"))

GOOD = """
schema: 1
name: two
links: {a: "udpin://127.0.0.1:14540", b: "udpout://10.0.0.2:14550"}
vehicles:
  - {sysid: 1, links: [a], pad: 1}
  - {sysid: 2, links: [b, a], autopilot: px4}
"""


@pytest.mark.parametrize("path", READY_MADE, ids=lambda path: path.stem)
def test_ready_made_fleets_are_good_and_fit_the_overhand(path):
    fleet = parse_fleet(path.read_text(), path.name)
    assert len(fleet.vehicles) == 9
    assert fleet.systems == tuple(range(1, 10))


def test_ready_made_fleets_are_all_there():
    assert {path.stem for path in READY_MADE} >= {
        "emulator",
        "px4_sitl",
        "ardupilot_sitl",
        "mixed_sitl",
        "motion_capture",
    }


def test_the_emulators_fleet_is_its_file():
    path = next(path for path in READY_MADE if path.stem == "emulator")
    assert parse_fleet(path.read_text(), "x") == emulated_fleet(9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("sysid: 2", "sysid: 1"), "fleet.yaml: sysid 1 given more than once"),
        (("[b, a]", "[c]"), "fleet.yaml: links c not among the links"),
        (("px4}", "px4, pad: 1}"), "fleet.yaml: pad 1 given more than once"),
        (("sysid: 2", "sysid: 251"), ": vehicles.1.sysid: expected a number <= 250, got 251"),
        (
            ("udpout://10.0.0.2:14550", "udp:14550"),
            "links: expected udpin://host:port, udpout://host:port, tcp://host:port or "
            "serial://device:baud, got b = 'udp:14550'",
        ),
        (("udpout://10.0.0.2:14550", "udpin://h:99999"), "got b = 'udpin://h:99999'"),
        (
            ("name: two", "name: two\ngrippers: 3"),
            "fleet.yaml:4: grippers: unknown key, got 3: did you mean gripper?",
        ),
        (("schema: 1", "schema: 2"), "fleet.yaml:2: schema: expected 1, got 2"),
        (
            ("name: two", "name: two\nrates: {setpoint: 1}"),
            "fleet.yaml:4: rates.setpoint: expected a number >= 4 in Hz, got 1",
        ),
    ],
)
def test_errors_are_reported_with_their_place(change, message):
    parse_fleet(GOOD, "fleet.yaml")
    with pytest.raises(InputError) as caught:
        parse_fleet(GOOD.replace(*change), "fleet.yaml")
    assert message in str(caught.value)


def test_overrides_reach_every_key():
    fleet = parse_fleet(GOOD, "fleet.yaml", ["rates.setpoint=50", "limits.hold=20"])
    assert (fleet.rates.setpoint, fleet.limits.hold) == (50, 20)


def test_a_larger_measured_tracking_error_replaces_the_missions():
    mission = mission_for_knot("3_1", ())
    for measured, planned in ((None, 0.1), (0.06, 0.1), (0.1, 0.1), (0.13, 0.13)):
        fleet = emulated_fleet(9).model_copy(update={"tracking": measured})
        assert mission_for(mission, fleet).vehicles.tracking == planned
    other = mission_for(mission, fleet)
    assert other == mission_for_knot("3_1", ("vehicles.tracking=0.13",))


@pytest.mark.parametrize("path", READY_MADE, ids=lambda path: path.stem)
def test_a_measured_tracking_error_is_written_into_a_copy(path):
    text = path.read_text()
    written = with_tracking(text, 0.12)
    assert written == f"{text}tracking: 0.12\n"
    measured = parse_fleet(written, path.name)
    assert measured.tracking == 0.12
    assert measured.model_copy(update={"tracking": None}) == parse_fleet(text, path.name)
    assert parse_fleet(with_tracking(written, 0.2), path.name).tracking == 0.2


def test_the_signing_key_of_a_copy_has_the_path_that_is_given():
    text = GOOD + "signing_key: keys/two.key\n"
    copy = parse_fleet(with_tracking(text, 0.1, "/home/lab/keys/two.key"), "copy.yaml")
    assert copy.signing_key == "/home/lab/keys/two.key"


def test_every_key_has_a_sentence_in_the_schema():
    def sentences(node):
        for section in (node, *node.get("$defs", {}).values()):
            for key, value in section.get("properties", {}).items():
                yield key, value.get("description")

    assert [key for key, sentence in sentences(fleet_schema()) if not sentence] == []
