"""Typed requests, keys and the control socket."""

import grp
import os
import pty
import pwd
import socket
import stat
import subprocess
import sys
import tempfile
from contextlib import suppress
from dataclasses import fields
from pathlib import Path

import click
import numpy as np
import pytest

from swarm.certification.findings import Finding
from swarm.certification.monitor import Clearances
from swarm.cli.inputs import confirmed
from swarm.errors import VehicleError
from swarm.flight.snapshot import Checked, Event, Snapshot
from swarm.ground.operator import (
    KEYS,
    KILL_KEY,
    ControlSocket,
    OperatorConsole,
    parse_group,
    read_screen_line,
    terminal_keys,
)
from swarm.ground.record import Record, shared_folder

SNAPSHOT = Snapshot(
    time=12.5, mission_time=11.0, rate=0.5, phase="fold", waiting_for=None,
    position=np.array([[1.0, 2.0, np.nan], [4.0, 5.0, 6.0]]),
    velocity=np.zeros((2, 3)), setpoint=np.full((2, 3), np.nan), modes=("offboard", "guided"),
    states=("armed", "armed"), armed=(True, False), gripped=(True, True),
    battery=np.array([0.5, np.nan]), link_age=np.array([0.1, np.inf]),
    clearances=Clearances(*range(len(fields(Clearances)))), available={"hold": (True, "all stop")},
    held="wind", time_left=3.0, stray=np.array([0.02]), cable=np.zeros((1, 4, 3)),
)  # fmt: skip


def assert_same(read, wanted):
    """Two snapshots have the same values, NaN at the same places."""
    for field in fields(wanted):
        expected, value = getattr(wanted, field.name), getattr(read, field.name)
        assert type(value) is type(expected), field.name
        np.testing.assert_equal(value, expected, err_msg=field.name)


class Flight:
    def __init__(self):
        self.requests = []
        self.authors = []
        self.reports = []
        self.now, self.asked_at = 20.0, None

    def report(self, kind, message):
        self.reports.append((kind, message))

    def request(self, request, author):
        self.requests.append(request)
        self.authors.append(author)
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


@pytest.mark.parametrize("seen", ["17.9", "20.5", "nan", "", "now", "-inf"])
def test_a_go_by_a_screen_that_shows_no_present_state_arms_nothing(flight, console, seen):
    words = "go: this screen does not show the present state; nothing was armed"
    assert console.line(f"go {seen}") == words
    assert flight.requests == []
    assert flight.reports == [("operator", f"{words} (terminal)")]


def test_a_go_names_the_state_that_was_seen(flight, console):
    assert console.line("go 18.1") == "go it is"
    assert (flight.requests, flight.authors) == (["go"], ["terminal"])


def test_a_go_answers_no_question_that_its_screen_had_not_seen(flight, console):
    flight.asked_at = 19.0
    assert console.line("go 18.9").startswith("go: this screen does not show the present state")
    assert console.line("go 19.0") == "go it is"
    assert flight.requests == ["go"]


def test_findings_reach_a_screen_that_comes_later(flight, tmp_path):
    path = tmp_path / "control"
    control = ControlSocket(path, lambda: OperatorConsole(flight, dict))
    checked = Checked((Finding("warning", "battery", "system 1: 40 %"),), ("links", "health"))
    control.publish(Checked(()))
    control.publish(checked)
    with connected(control, path) as screen:
        screen.send(b"watch\n")
        assert lines_for(control, screen, 1) == [checked]
    control.close()


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
    assert flight.reports[-1] == ("operator", "kill: cancelled; nothing was stopped")
    for digit in number:
        console.key(digit)
    assert flight.requests == ["hold"]


def test_the_socket_is_private_and_answers(flight, console, tmp_path):
    path = tmp_path / "control"
    control = ControlSocket(path, lambda: console)
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


OTHER, GROUP = 65534, 65533
"""An account and a group that no test runs as."""
CLIENT_OF_OTHERS = """
import os, socket, sys
os.setgroups([int(group) for group in sys.argv[2:]])
os.setgid(65534)
os.setuid(65534)
with socket.socket(socket.AF_UNIX) as client:
    try:
        client.connect(sys.argv[1])
    except PermissionError:
        sys.exit("refused")
    client.sendall(b"name operator\\nhold\\n")
    print(client.recv(100).decode())
"""


@pytest.fixture
def reachable():
    """A folder that other accounts reach; those of tests are private."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root becomes another account")
@pytest.mark.parametrize(
    ("group", "member", "requests"),
    [(None, [GROUP], []), (GROUP, [], []), (GROUP, [GROUP], ["hold"])],
)
def test_only_members_of_the_group_reach_a_shared_flight(
    flight, reachable, group, member, requests
):
    path = reachable / "control"
    control = ControlSocket(path, lambda: OperatorConsole(flight, dict), group)
    assert stat.S_IMODE(path.stat().st_mode) == (0o600 if group is None else 0o660)
    with subprocess.Popen(
        [sys.executable, "-c", CLIENT_OF_OTHERS, path, *map(str, member)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as client:  # fmt: skip
        while client.poll() is None:
            control.poll()
        out, errors = client.communicate()
    control.close()
    assert flight.requests == requests
    assert (out.strip(), errors.strip()) == (("hold it is", "") if requests else ("", "refused"))
    name = pwd.getpwuid(OTHER).pw_name
    assert flight.authors == [f"operator (account {name})"] * len(requests)


def test_a_flight_is_shared_with_a_group_that_is_ours():
    own = grp.getgrgid(os.getegid())
    assert parse_group(own.gr_name) == own.gr_gid
    with pytest.raises(ValueError, match="expected a group of this machine, got 'nobodys'"):
        parse_group("nobodys")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files to another group")
def test_the_record_of_a_shared_flight_is_read_by_the_group(tmp_path):
    before = os.umask(0o077)
    try:
        (tmp_path / "old").mkdir()
        folder = tmp_path / "old" / "flights" / "record"
        with shared_folder(folder, GROUP):
            Record(folder, 0.0).close()
            (folder / "parameters").mkdir()
        (folder / "after").touch()
    finally:
        os.umask(before)
    modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in (tmp_path / "old").rglob("*")}
    assert modes == {
        "flights": 0o710, "record": 0o2750, "events.jsonl": 0o640, "flight.tlog": 0o640,
        "parameters": 0o2750, "after": 0o600,
    }  # fmt: skip
    assert {path.stat().st_gid for path in (tmp_path / "old").rglob("*")} == {GROUP}
    assert (tmp_path / "old").stat().st_gid != GROUP


def test_noise_on_the_socket_is_no_request_and_does_not_end_it(flight, tmp_path):
    """Random bytes, lines without end, kills with guessed numbers, clients that come and go.

    Each client has a console of its own, as in a flight: none guesses the number of another.
    """
    rng = np.random.default_rng(4)
    control = ControlSocket(tmp_path / "control", lambda: OperatorConsole(flight, dict))
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


def connected(control, path):
    """A client of the socket that waits for its answers at most five seconds."""
    client = socket.socket(socket.AF_UNIX)
    client.settimeout(5)
    client.connect(str(path))
    control.poll()
    return client


def lines_for(control, client, count):
    """The next lines that the client gets."""
    received = b""
    while received.count(b"\n") < count:
        control.poll()
        with suppress(BlockingIOError):
            received += client.recv(1 << 20, socket.MSG_DONTWAIT)
    return [read_screen_line(line) for line in received.splitlines()]


def test_a_screen_gets_what_was_and_what_comes(flight, tmp_path):
    path = tmp_path / "control"
    control = ControlSocket(path, lambda: OperatorConsole(flight, dict))
    first, second = Event(1.0, "gate", "all are armed"), Event(2.0, "phase", "fold", 3)
    control.publish(first)
    control.publish(SNAPSHOT)
    with connected(control, path) as asking, connected(control, path) as screen:
        asking.send(b"snapshot\n")
        assert_same(lines_for(control, asking, 1)[0], SNAPSHOT)
        assert not control.watched
        screen.send(b"watch\n")
        event, snapshot = lines_for(control, screen, 2)
        assert control.watched
        assert event == first
        assert_same(snapshot, SNAPSHOT)
        control.publish(second)
        screen.send(b"key h\nkey  \n")
        assert lines_for(control, screen, 3) == [second, "hold it is", "hold it is"]
        asking.setblocking(False)
        control.poll()
        with pytest.raises(BlockingIOError):
            asking.recv(10)
    control.poll()
    assert not control.watched
    control.close()


def test_the_number_that_confirms_kill_belongs_to_its_client(flight, tmp_path):
    path = tmp_path / "control"
    control = ControlSocket(path, lambda: OperatorConsole(flight, dict))
    with connected(control, path) as asking, connected(control, path) as other:
        asking.send(b"kill\n")
        (answer,) = lines_for(control, asking, 1)
        number = answer.split()[-1].encode()
        other.send(b"kill " + number + b"\n")
        assert lines_for(control, other, 1)[0].startswith("to stop all motors")
        assert flight.requests == []
        asking.send(b"kill " + number + b"\n")
        assert lines_for(control, asking, 1) == ["kill it is"]
    control.close()
    assert flight.requests == ["kill"]


def test_the_record_names_who_made_a_request(flight, tmp_path):
    path = tmp_path / "control"
    control = ControlSocket(path, lambda: OperatorConsole(flight, dict))
    with connected(control, path) as client:
        client.send(b"hold\nname Anna\x1b (console 1)\nhold\nkey r\nnote she looks away\n")
        assert lines_for(control, client, 3) == ["hold it is", "hold it is", "resume it is"]
        for _ in range(3):
            control.poll()
    control.close()
    assert flight.authors == ["terminal", "Anna\ufffd (console 1)", "Anna\ufffd (console 1)"]
    assert flight.reports == [("operator", "she looks away")]


def test_the_number_that_confirms_kill_can_be_cancelled(flight, console):
    number = console.line("kill").split()[-1]
    assert console.line("kill cancel") == "kill: cancelled; nothing was stopped"
    assert flight.reports == [("operator", "kill: cancelled; nothing was stopped")]
    assert console.line(f"kill {number}").startswith("to stop all motors")
    assert flight.requests == []


def test_a_screen_that_comes_before_the_first_snapshot_gets_that(flight, tmp_path):
    path = tmp_path / "control"
    control = ControlSocket(path, lambda: OperatorConsole(flight, dict))
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(str(path))
        client.settimeout(5.0)
        client.sendall(b"snapshot\n")
        control.poll()
        for _ in range(2):
            control.publish(SNAPSHOT)
            control.poll()
        control.close()
        with client.makefile("rb") as lines:
            (line,) = lines.readlines()  # once for one request
        assert_same(read_screen_line(line), SNAPSHOT)


def test_the_console_is_a_screen_while_somebody_looks_at_it(flight, tmp_path):
    path = tmp_path / "control"
    control = ControlSocket(path, lambda: OperatorConsole(flight, dict))
    event = Event(1.0, "gate", "all are armed")
    control.publish(event)
    with connected(control, path) as client:
        for line, watched in (("screens 0", False), ("screens 2", True), ("screens 0", False)):
            client.send(f"{line}\nnothing\n".encode())
            lines_for(control, client, 1)
            assert control.watched == watched
        control.publish(SNAPSHOT)
        assert_same(lines_for(control, client, 1)[0], SNAPSHOT)
    control.close()


def test_a_screen_that_does_not_read_misses_snapshots_but_no_event(flight, tmp_path):
    path = tmp_path / "control"
    control = ControlSocket(path, lambda: OperatorConsole(flight, dict))
    with connected(control, path) as screen:
        screen.send(b"watch\n")
        control.poll()
        for k in range(2000):
            control.publish(SNAPSHOT)
            if k % 100 == 0:
                control.publish(Event(float(k), "gate", "text"))
            control.poll()
        seen = []
        while sum(isinstance(item, Event) for item in seen) < 20:
            seen += lines_for(control, screen, 1)
        snapshots = sum(isinstance(item, Snapshot) for item in seen)
        assert 0 < snapshots < 1900
    control.close()


@pytest.mark.parametrize("line", [b'{"snapshot": 3}', b'{"event": {}}', b"{}", b"{"])
def test_a_line_of_another_version_is_named(line):
    with pytest.raises(ValueError, match="expected a snapshot or an event"):
        read_screen_line(line)


def test_a_socket_that_cannot_be_created_is_named(console, tmp_path):
    with pytest.raises(VehicleError, match=r"control socket .*nowhere"):
        ControlSocket(tmp_path / "nowhere" / "control", lambda: console)


@pytest.mark.parametrize(
    ("typed", "answer"), [(b"y\n", True), (b"\n", False), (b"what\nyes\n", True)]
)
def test_what_was_typed_before_a_question_is_no_answer(monkeypatch, capfd, typed, answer):
    """Lines of before the question, and of before the one after it, are dropped."""
    master, slave = pty.openpty()
    polls = []

    def elsewhere():
        polls.append(None)
        if len(polls) == 4:
            os.write(master, typed)
        return False

    with os.fdopen(slave, "r") as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        for _ in range(2):
            polls.clear()
            os.write(master, b"y\nn\n" if answer else b"y\n")
            assert confirmed("Arm and fly?", elsewhere) is answer
            assert len(polls) >= 4
        assert confirmed("Arm and fly?", lambda: True) is None
        polls.clear()
        typed = b"\4"
        with pytest.raises(click.Abort):
            confirmed("Arm and fly?", elsewhere)
        os.close(master)
    assert capfd.readouterr().err.startswith("Arm and fly? [y/N]: ")


def test_keys_are_read_from_a_terminal_only(flight, console):
    master, slave = pty.openpty()
    with os.fdopen(slave, "rb", buffering=0) as terminal:
        with terminal_keys(console.key, terminal) as poll:
            os.write(master, b" rq")
            while len(flight.requests) < 2:
                poll()
        os.close(master)
    assert flight.requests == ["hold", "resume"]
    with (
        terminal_keys(console.key, None) as poll,
        open(os.devnull, "rb") as file,
        terminal_keys(console.key, file) as silent,
    ):
        poll()
        silent()
