"""The emulator as a process: sockets, signals, exit codes, ground truth on file."""

import contextlib
import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as dialect

from sitl import Emulator, default_world, server
from sitl.__main__ import main


@contextmanager
def running(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], dict]]:
    process = subprocess.Popen(
        [sys.executable, "-m", "sitl", "--json", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        yield process, json.loads(line) if line else {}
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def ground_socket() -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", 0))
    sock.settimeout(5.0)
    return sock


@pytest.mark.parametrize("kinds", [["px4"], ["ardupilot"], ["px4", "ardupilot"]])
def test_connection_instructions_name_the_used_address(kinds: list) -> None:
    """With one target address, the instructions name neither 14540 nor 14550 nor TCP."""
    emulator = Emulator(default_world(2, kinds))
    running = server.to_target(emulator, ("127.0.0.1", 14777), "127.0.0.1", 1.0)
    words = server.connect_help(running)
    running.close()
    assert "MAVSDK          udpin://127.0.0.1:14777 (all vehicles)\n" in words
    assert "mavproxy.py --master=udpin:127.0.0.1:14777\n" in words
    assert "QGroundControl  needs a UDP link on port 14777" in words
    assert not {"14540", "14550", "5760"} & set(re.findall(r"\d+", words))


def test_every_vehicle_sends_from_its_own_port_to_the_target() -> None:
    with ground_socket() as sock:
        target = f"127.0.0.1:{sock.getsockname()[1]}"
        with running("-n", "3", "--target", target, "--speed", "5") as (process, ready):
            assert ready["ready"]
            assert [one["id"] for one in ready["vehicles"]] == [1, 2, 3]
            parser = dialect.MAVLink(None)
            seen: dict[int, int] = {}
            deadline = time.monotonic() + 10
            while len(seen) < 3 and time.monotonic() < deadline:
                data, address = sock.recvfrom(65535)
                for message in parser.parse_buffer(data) or []:
                    if message.get_type() == "HEARTBEAT":
                        seen[message.get_srcSystem()] = address[1]
            assert seen == {one["id"]: one["udp_local"] for one in ready["vehicles"]}
            request = dialect.MAVLink_param_request_read_message(2, 1, b"MAV_SYS_ID", -1)
            sock.sendto(request.pack(dialect.MAVLink(None, 255, 190)), ("127.0.0.1", seen[2]))
            answers = []
            while not answers and time.monotonic() < deadline:
                answers += [
                    (message.get_srcSystem(), message.param_id)
                    for message in parser.parse_buffer(sock.recv(65535)) or []
                    if message.get_type() == "PARAM_VALUE"
                ]
            assert answers == [(2, "MAV_SYS_ID")]
            process.send_signal(signal.SIGINT)
            assert process.wait(5) == 0
            assert process.communicate()[1] == ""


def test_packets_that_arrive_before_a_pause_of_the_process_are_read_in_their_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A vehicle must not state a time that its world has not reached."""
    emulator = Emulator(default_world(1, ["px4"]))
    with ground_socket() as sock:
        running = server.to_target(emulator, sock.getsockname(), "127.0.0.1", 1.0)
        pause = [0.0]
        real, advance = time.monotonic, running.advance

        class PausedAfterPacket:
            """Poll, and the process is held up for 0.2 s where a packet waits."""

            def poll(self, timeout: float) -> list[tuple[int, int]]:
                ready = inner.poll(timeout)
                pause[0] += 0.2 if ready and timeout > 0 else 0.0
                return ready

        inner, running.poll = running.poll, PausedAfterPacket()  # type: ignore[assignment]
        monkeypatch.setattr(server.time, "monotonic", lambda: real() + pause[0])
        ahead = []

        def advanced(now: float) -> None:
            ahead.append(emulator.vehicles[0].now - now)
            advance(now)
            sock.sendto(b"\xfd", ("127.0.0.1", running.description[0]["udp_local"]))
            running.stopped = now > 1.0

        running.advance = advanced
        running.run(None, None)
        running.close()
    assert pause[0] >= 0.2
    assert max(ahead) <= 1e-9


def test_a_termination_signal_ends_the_process_and_truth_is_on_file(tmp_path: Path) -> None:
    file = tmp_path / "truth.jsonl"
    with running("--truth", str(file), "--target", "127.0.0.1:9", "--speed", "20") as (process, _):
        deadline = time.monotonic() + 10
        while file.read_text().count("\n") < 20 and time.monotonic() < deadline:
            select.select([], [], [], 0.05)
        process.send_signal(signal.SIGTERM)
        assert process.wait(5) == 0
        assert process.communicate() == ("", "")
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    states = [line for line in lines if "record" not in line]
    assert states[-1]["time"] > 1.0
    assert states[-1]["ids"] == [1]
    assert len(states[-1]["position"][0]) == 3


def test_invalid_files_and_usage_give_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "w.yaml"
    bad.write_text("schema: 1\nvehicles: []\nwinds: 3\n")
    for arguments, error in (
        (["--world", str(bad)], f"{bad}: winds: expected a known key, got an unknown one"),
        (["--scenario", str(bad)], f"{bad}: winds: expected a known key, got an unknown one"),
        (["-n", "0"], "'-n' / '--count': 0 is not in the range 1<=x<=250."),
        (["--target", "nowhere"], "'--target': expected HOST:PORT, got nowhere"),
        (["--speed", "nan"], "'--speed': expected 0.01 to 1000, got nan"),
        (["--autopilot", "betaflight"], "'--autopilot': expected px4 or ardupilot, got betaflight"),
    ):
        try:
            code = main(arguments)
        except SystemExit as exit_:
            code = int(exit_.code or 0)
        assert code == 2
        assert error in capsys.readouterr().err


@pytest.mark.slow
def test_the_ports_of_the_real_simulators() -> None:
    with running("-n", "12", "--autopilot", "px4") as (_, ready):
        ports = [int(one["udp_to"].split(":")[1]) for one in ready["vehicles"]]
        assert ports == [*range(14540, 14550), 14549, 14549]
        assert {one["udp_ground"] for one in ready["vehicles"]} == {"127.0.0.1:14550"}
    with running("-n", "12", "--port-step", "2") as (_, ready):
        ports = [int(one["udp_to"].split(":")[1]) for one in ready["vehicles"]]
        assert ports == [14540 + 2 * i for i in range(12)]


def test_ardupilot_listens_on_the_tcp_port_of_its_simulator() -> None:
    with running("-n", "2", "--autopilot", "ardupilot", "--speed", "5") as (_, ready):
        for i, one in enumerate(ready["vehicles"]):
            assert one.get("tcp") in {f"127.0.0.1:{5760 + 10 * i}", None}
            if one.get("tcp") is None:
                continue
            with socket.create_connection(("127.0.0.1", 5760 + 10 * i), timeout=5) as sock:
                parser = dialect.MAVLink(None)
                messages = parser.parse_buffer(sock.recv(65535)) or []
                assert {message.get_srcSystem() for message in messages} == {i + 1}


def test_the_process_ends_with_its_parent() -> None:
    script = (
        "import subprocess, sys\n"
        "child = subprocess.Popen([sys.executable, '-m', 'sitl', '--follow-parent', '--json',"
        " '--target', '127.0.0.1:9'], stdout=subprocess.PIPE)\n"
        "child.stdout.readline(); print(child.pid, flush=True)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    child = int(done.stdout)
    deadline = time.monotonic() + 5
    while time.monotonic() < deadline and Path(f"/proc/{child}").exists():
        with Path(f"/proc/{child}/stat").open() as file:
            if file.read().rsplit(")", 1)[1].split()[0] == "Z":
                break
        select.select([], [], [], 0.05)
    else:
        assert not Path(f"/proc/{child}").exists()
    assert os.path.isdir("/proc")


@pytest.mark.parametrize("kind", ["px4", "ardupilot"])
def test_occupied_ports_end_the_command_with_exit_code_3(
    kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    taken = socket.socket(
        socket.AF_INET, socket.SOCK_STREAM if kind == "ardupilot" else socket.SOCK_DGRAM
    )
    port = server.TCP if kind == "ardupilot" else server.OFFBOARD_LOCAL
    with taken:
        with contextlib.suppress(OSError):  # another program that has the port is as good
            taken.bind(("127.0.0.1", port))
            if kind == "ardupilot":
                taken.listen()
        assert main(["-n", "1", "--autopilot", kind]) == 3
        assert f"cannot open sockets on 127.0.0.1: port {port}: " in capsys.readouterr().err
