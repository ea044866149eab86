"""Typed wishes, keys and the control socket."""

import os
import pty
import socket
import stat
from contextlib import suppress

import numpy as np
import pytest

from swarm.errors import VehicleError
from swarm.ground.operator import KEYS, ControlSocket, Desk, keys


class Flight:
    def __init__(self):
        self.wishes = []

    def request(self, wish):
        self.wishes.append(wish)
        return f"{wish} it is"


@pytest.fixture
def flight():
    return Flight()


@pytest.fixture
def desk(flight):
    return Desk(flight, lambda: {"land": (True, "here"), "rewind": (False, "too far")})


def test_a_line_is_a_wish(flight, desk):
    assert desk.line(" Hold \n") == "hold it is"
    assert flight.wishes == ["hold"]


def test_status_says_what_is_open(desk):
    assert desk.line("status") == "land open (here); rewind closed (too far)"


def test_what_is_not_a_wish_is_refused(flight, desk):
    assert desk.line("return to launch").startswith("expected one of status, hold, resume")
    assert flight.wishes == []


def test_killing_is_confirmed_with_the_number_that_was_given(flight, desk):
    asked = desk.line("kill")
    number = asked.split()[-1]
    assert asked == f"to stop all motors in the air, type: kill {number}"
    again = desk.line("kill 1")
    assert flight.wishes == []
    assert desk.line(f"kill {again.split()[-1]}") == "kill it is"
    assert flight.wishes == ["kill"]
    desk.line(f"kill {number}")
    assert flight.wishes == ["kill"]


def test_no_key_kills():
    assert "kill" not in KEYS.values()


def test_the_socket_is_private_and_answers(flight, desk, tmp_path):
    path = tmp_path / "control"
    control = ControlSocket(path, desk)
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
    assert flight.wishes == ["hold"]


def test_no_noise_on_the_socket_is_a_wish_or_ends_it(flight, desk, tmp_path):
    """Random bytes, lines without end, kills with guessed numbers, clients that come and go."""
    rng = np.random.default_rng(4)
    control = ControlSocket(tmp_path / "control", desk)
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
    assert flight.wishes == ["hold"]


def test_a_socket_that_cannot_be_made_is_named(desk, tmp_path):
    with pytest.raises(VehicleError, match=r"control socket .*nowhere"):
        ControlSocket(tmp_path / "nowhere" / "control", desk)


def test_keys_are_taken_from_a_terminal_and_from_nothing_else(flight, desk):
    master, slave = pty.openpty()
    with os.fdopen(slave, "rb", buffering=0) as terminal:
        with keys(desk, terminal) as poll:
            os.write(master, b" rq")
            while len(flight.wishes) < 2:
                poll()
        os.close(master)
    assert flight.wishes == ["hold", "resume"]
    with keys(desk, None) as poll, open(os.devnull, "rb") as nothing, keys(desk, nothing) as silent:
        poll()
        silent()
