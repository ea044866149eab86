"""Typed requests, keys and the control socket."""

import os
import pty
import socket
import stat
from contextlib import suppress

import numpy as np
import pytest

from swarm.errors import VehicleError
from swarm.ground.operator import KEYS, KILL_KEY, ControlSocket, OperatorConsole, terminal_keys


class Flight:
    def __init__(self):
        self.requests = []
        self.reports = []

    def report(self, kind, message):
        self.reports.append((kind, message))

    def request(self, request):
        self.requests.append(request)
        return f"{request} it is"


@pytest.fixture
def flight():
    return Flight()


@pytest.fixture
def console(flight):
    return OperatorConsole(flight, lambda: {"land": (True, "here"), "rewind": (False, "too far")})


def test_a_line_is_a_request(flight, console):
    assert console.line(" Hold \n") == "hold it is"
    assert flight.requests == ["hold"]


def test_status_lists_the_open_requests(console):
    assert console.line("status") == "land open (here); rewind closed (too far)"


def test_an_unknown_line_is_refused(flight, console):
    assert console.line("return to launch").startswith("expected one of status, hold, resume")
    assert flight.requests == []


def test_kill_is_confirmed_with_the_number_in_the_answer(flight, console):
    answer = console.line("kill")
    number = answer.split()[-1]
    assert answer == f"to stop all motors in the air, type: kill {number}"
    again = console.line("kill 1")
    assert flight.requests == []
    assert console.line(f"kill {again.split()[-1]}") == "kill it is"
    assert flight.requests == ["kill"]
    console.line(f"kill {number}")
    assert flight.requests == ["kill"]


def test_no_single_key_kills():
    assert "kill" not in KEYS.values()
    assert KILL_KEY not in KEYS


def test_kill_is_confirmed_by_typing_the_number(flight, console):
    words = console.key("k")
    number = words.removeprefix("to stop all motors in the air, type ")[:4]
    assert words == f"to stop all motors in the air, type {number}; other keys cancel"
    assert flight.reports == [("operator", words)]
    assert [console.key(digit) for digit in number] == [None, None, None, "kill it is"]
    assert flight.requests == ["kill"]


def test_a_wrong_number_and_another_key_cancel_kill(flight, console):
    number = console.key("k").removeprefix("to stop all motors in the air, type ")[:4]
    wrong = f"{(int(number) + 1) % 10_000:04d}"
    assert [console.key(digit) for digit in wrong][-1] == (
        f"kill: {wrong} is not the number; nothing was stopped"
    )
    for digit in number:
        console.key(digit)
    number = console.key("k").removeprefix("to stop all motors in the air, type ")[:4]
    console.key("h")
    for digit in number:
        console.key(digit)
    assert flight.requests == ["hold"]


def test_the_socket_is_private_and_answers(flight, console, tmp_path):
    path = tmp_path / "control"
    control = ControlSocket(path, console)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(5)
        client.connect(str(path))
        client.send(b"ho")
        control.poll()
        client.send(b"ld\nla")
        control.poll()
        assert client.recv(100) == b"hold it is\n"
        client.send(b"x" * 1000)
        for _ in range(10):
            control.poll()
        with suppress(ConnectionResetError):
            assert client.recv(100) == b""
    control.poll()
    control.close()
    assert not path.exists()
    assert flight.requests == ["hold"]


def test_noise_on_the_socket_is_no_request_and_does_not_end_it(flight, console, tmp_path):
    """Random bytes, lines without end, kills with guessed numbers, clients that come and go."""
    rng = np.random.default_rng(4)
    control = ControlSocket(tmp_path / "control", console)
    for k in range(200):
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(tmp_path / "control"))
            guess = b"kill %d\n" % rng.integers(10_000)
            client.send((rng.bytes(300), b"a" * 5_000, guess, b"\n" * 50, b"\0kill\xff")[k % 5])
            control.poll()
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(5)
        client.connect(str(tmp_path / "control"))
        client.send(b"hold\n")
        for _ in range(20):
            control.poll()
        assert client.recv(100) == b"hold it is\n"
    control.close()
    assert flight.requests == ["hold"]


def test_a_socket_that_cannot_be_created_is_named(console, tmp_path):
    with pytest.raises(VehicleError, match=r"control socket .*nowhere"):
        ControlSocket(tmp_path / "nowhere" / "control", console)


def test_keys_are_read_from_a_terminal_only(flight, console):
    master, slave = pty.openpty()
    with os.fdopen(slave, "rb", buffering=0) as terminal:
        with terminal_keys(console, terminal) as poll:
            os.write(master, b" rq")
            while len(flight.requests) < 2:
                poll()
        os.close(master)
    assert flight.requests == ["hold", "resume"]
    with (
        terminal_keys(console, None) as poll,
        open(os.devnull, "rb") as file,
        terminal_keys(console, file) as silent,
    ):
        poll()
        silent()
