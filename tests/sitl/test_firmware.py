"""Which vehicles fly with real firmware, and what one does in our world, where one is given."""

import contextlib
import socket
import stat

import pytest

from sitl.__main__ import main
from sitl.emulator import Emulator
from sitl.firmware.ardupilot import launch
from sitl.firmware.processes import (
    Firmware,
    FirmwareError,
    Start,
    assign,
    check_positioning,
    parse_firmware,
    position_parameters,
)  # fmt: skip
from sitl.firmware.team import flying
from sitl.world import CableSpec, Capture, Origin, default_world


@pytest.fixture
def program(tmp_path):
    """Return an executable file."""
    path = tmp_path / "arducopter"
    path.write_text("#!/bin/sh\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def test_parts_have_a_kind_a_program_and_perhaps_a_count(program):
    assert parse_firmware(f"ardupilot={program}") == [Firmware("ardupilot", program, None)]
    assert parse_firmware(f"2*ardupilot={program}, ardupilot={program}") == [
        Firmware("ardupilot", program, 2),
        Firmware("ardupilot", program, None),
    ]


@pytest.mark.parametrize("text", ["", "ardupilot", "ardupilot=", "betaflight=x", "x*ardupilot=y"])
def test_other_texts_are_refused(text):
    with pytest.raises(FirmwareError) as caught:
        parse_firmware(text)
    assert str(caught.value) == (
        f"--firmware: expected px4=BUILD_FOLDER or ardupilot=PATH, got {text}"
    )


def test_a_missing_program_is_named(tmp_path, capsys):
    missing = tmp_path / "arducopter"
    assert main(["-n", "2", "--firmware", f"ardupilot={missing}"]) == 2
    assert capsys.readouterr().err == (
        "--firmware: expected the program of ardupilot, built as its own pages say, got "
        f"{missing}: no executable file\n"
    )


def test_a_folder_without_a_px4_is_named(tmp_path, capsys):
    assert main(["-n", "2", "--firmware", f"px4={tmp_path}"]) == 2
    assert capsys.readouterr().err == (
        "--firmware: expected the folder of a build of px4, built as its own pages say, got "
        f"{tmp_path}: no executable bin/px4 in it\n"
    )


def test_a_px4_that_ends_at_once_is_named(tmp_path, capsys):
    program = tmp_path / "bin" / "px4"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\necho no airframe\n")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    folder = tmp_path / "logs"
    given = ["-n", "1", "--firmware", f"px4={tmp_path}", "--firmware-folder", str(folder)]
    assert main(given) == 3
    log = folder / "vehicle1" / "log.txt"
    assert capsys.readouterr().err == (
        f"PX4 of vehicle 1 did not connect to its simulator; its output is in {log}\n"
    )
    assert log.read_text() == "no airframe\n"


@pytest.mark.parametrize(
    ("kind", "occupied", "radio", "named"),
    [
        ("ardupilot", [("udp", 11012)], False, "UDP 11012 (vehicle 202)"),
        ("ardupilot", [("udp", 7501), ("udp", 7511)], False, None),
        ("ardupilot", [("udp", 7511)], True, "UDP 7511 (vehicle 202)"),
        (
            "px4",
            [("udp", 14780), ("tcp", 4760), ("tcp", 4761)],
            False,
            "TCP 4760 (vehicle 201), UDP 14780 (vehicle 201), TCP 4761 (vehicle 202)",
        ),
    ],
)
def test_ports_of_other_programs_are_named_before_anything_starts(
    kind, occupied, radio, named, tmp_path
):
    program = tmp_path / "bin" / "px4"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\n")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    world = default_world(2, [kind])
    vehicles = [
        one.model_copy(update={"id": 200 + one.id, "radio": radio}) for one in world.vehicles
    ]
    world = world.model_copy(update={"vehicles": vehicles})
    firmware = assign(parse_firmware(f"{kind}={tmp_path if kind == 'px4' else program}"), world)
    with contextlib.ExitStack() as stack:
        for protocol, port in occupied:
            if protocol == "tcp":
                stack.enter_context(socket.create_server(("127.0.0.1", port)))
            else:
                one = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
                one.bind(("127.0.0.1", port))
        started = flying(
            Emulator(world, outside=[201, 202]), firmware, "127.0.0.1:9", tmp_path / "logs"
        )
        if named is None:
            with started:
                return
        with pytest.raises(FirmwareError) as caught, started:
            pass
    assert str(caught.value) == f"--firmware: other programs have the ports {named}"
    assert not (tmp_path / "logs").exists()


def test_an_arducopter_listens_on_loopback_alone(program, tmp_path):
    def start(*, radio):
        return Start(program, tmp_path, 3, 4, 0.0, False, {"FS_THR_ENABLE": 3}, None, radio)

    alone = launch(start(radio=False), Origin())
    line = " ".join(alone.command)
    assert "--serial1 none: --serial2 none: --rc-in-port 9032" in line
    assert alone.needs == [("UDP", 9032, "127.0.0.1")]
    assert "FS_THR_ENABLE 0\n" in alone.files["defaults.parm"]
    piloted = launch(start(radio=True), Origin())
    assert "--rc-in-port 5531" in " ".join(piloted.command)
    assert piloted.needs[1:] == [("UDP", 5531, "")]
    assert "FS_THR_ENABLE 3\n" in piloted.files["defaults.parm"]


def test_teams_of_both_autopilots_are_in_the_order_of_the_parts(program, tmp_path):
    build = tmp_path / "bin" / "px4"
    build.parent.mkdir()
    build.write_text("#!/bin/sh\n")
    build.chmod(build.stat().st_mode | stat.S_IXUSR)
    parts = parse_firmware(f"2*px4={tmp_path},1*ardupilot={program}")
    world = default_world(3, ["px4", "px4", "ardupilot"])
    assert [one.kind for one in assign(parts, world).values()] == ["px4", "px4", "ardupilot"]


def test_vehicles_of_the_kind_get_the_firmware_in_order(program):
    world = default_world(4, ["px4", "ardupilot", "ardupilot", "ardupilot"])
    assert list(assign(parse_firmware(f"2*ardupilot={program}"), world)) == [2, 3]
    assert list(assign(parse_firmware(f"ardupilot={program}"), world)) == [2, 3, 4]
    with pytest.raises(FirmwareError) as caught:
        assign(parse_firmware(f"4*ardupilot={program}"), world)
    assert str(caught.value) == "--firmware: expected at least 4 vehicles with ardupilot, got 3"


def test_a_cable_without_inertia_is_refused(program):
    cable = CableSpec(points=[(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], model="static")
    world = default_world(1, ["ardupilot"]).model_copy(update={"cable": cable})
    with pytest.raises(FirmwareError) as caught:
        assign(parse_firmware(f"ardupilot={program}"), world)
    assert str(caught.value) == (
        "--firmware: expected a world with cable.model: swinging, got static"
    )


def test_estimators_are_told_the_delay_and_the_noise_of_the_motion_capture():
    laboratory = Capture(delay=0.045, noise=0.02)
    px4 = position_parameters("px4", "mocap", laboratory)
    assert (px4["EKF2_EV_DELAY"], px4["EKF2_EVP_NOISE"]) == (45, 0.02)
    ardupilot = position_parameters("ardupilot", "mocap", laboratory)
    assert (ardupilot["VISO_DELAY_MS"], ardupilot["VISO_POS_M_NSE"]) == (45, 0.05)
    assert "VISO_DELAY_MS" not in position_parameters("ardupilot", "rtk", laboratory)


def test_px4_has_no_plain_receiver(program):
    parts = [Firmware("ardupilot", program, None), Firmware("px4", program.parent, None)]
    check_positioning(parts, "rtk")
    check_positioning(parts, "mocap")
    check_positioning(parts[:1], "gps")
    with pytest.raises(FirmwareError) as caught:
        check_positioning(parts, "gps")
    assert str(caught.value) == "--positioning: expected rtk or mocap with px4, got gps"
