"""The flight in its own process: slow callbacks, signals, a process that dies."""

import multiprocessing
import os
import pty
import signal
import socket
import subprocess
import sys
import termios
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack

import pytest

from swarm.errors import InputError, VehicleError
from swarm.ground.flight_process import (
    FlightRequest,
    _forward_signals,
    _Keys,
    _serve,
    fly_in_process,
)
from swarm.ground.fly import FlightCallbacks, FlyOptions
from swarm.ground.operator import read_screen_line
from swarm.ground.priority import helper_niceness
from swarm.mission.fleet import emulated_fleet
from tests.network import small_plan

FLIGHT_PLAN = small_plan()
SLOW = 8
"""Snapshots for which the caller of a flight is slow: over two seconds of it."""
pytestmark = pytest.mark.usefixtures("in_real_time")


def flown_by_a_slow_caller(folder):
    """What the caller of a flight got, its own niceness, and whether the events came in order."""
    shown, events, audits, nice = [], [], [], set()

    def slow(snapshot):
        shown.append(snapshot)
        nice.add(os.getpriority(os.PRIO_PROCESS, 0))
        end = time.monotonic() + 0.3
        while len(shown) <= SLOW and time.monotonic() < end:  # busy, like drawing
            pass

    flight = FlightRequest(
        FLIGHT_PLAN, emulated_fleet(3), folder, FlyOptions(speed=20.0), confirm=True
    )
    result = fly_in_process(
        flight,
        FlightCallbacks(
            confirm=lambda audit: audits.append(audit.systems) or True,
            on_snapshot=slow,
            on_event=events.append,
        ),
        low_priority=True,
    )
    in_order = [event.kind for event in events] == [event.kind for event in result.events]
    return result, len(shown), audits, (nice, helper_niceness()), in_order


@pytest.mark.slow
def test_a_slow_caller_does_not_delay_the_flight(tmp_path):
    """In a process of its own: not every user may raise a priority again."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        caller = pool.submit(flown_by_a_slow_caller, tmp_path / "record")
        result, shown, audits, (nice, helpers), in_order = caller.result()
    assert result.outcome.word == "done", result.events[-5:]
    assert audits == [(1, 2, 3)]
    assert result.statistics.lateness[0] < 0.01
    assert nice == {helpers}
    assert 0 < shown < len(result.trace.time)
    assert in_order


@pytest.mark.slow
def test_a_flight_that_is_not_confirmed_is_refused(tmp_path):
    flight = FlightRequest(
        FLIGHT_PLAN, emulated_fleet(3), tmp_path / "record", FlyOptions(speed=8.0), confirm=True
    )
    result = fly_in_process(flight, FlightCallbacks(confirm=lambda _: False))
    assert (result.outcome.word, result.outcome.explanation) == ("refused", "not confirmed")


def asking_caller(folder):
    """The result of a flight whose caller is asked, and answered by a screen."""
    answered = threading.Event()

    def confirm(_audit):
        answered.wait()

    control = folder / "control"

    def screen():
        while not control.exists():
            time.sleep(0.05)
        with socket.socket(socket.AF_UNIX) as client, client.makefile("rb") as lines:
            client.connect(str(control))
            client.sendall(b"name Anna\n")
            while True:
                client.sendall(b"snapshot\n")
                seen = read_screen_line(lines.readline())
                if seen.available["go"][0]:
                    client.sendall(f"go {seen.time}\n".encode())
                    if b"arms 3" in lines.readline():
                        return
                time.sleep(0.02)

    asking = threading.Thread(target=screen)
    asking.start()
    options = FlyOptions(speed=8.0, control=control, screens_answer=True)
    request = FlightRequest(FLIGHT_PLAN, emulated_fleet(3), folder, options, confirm=True)
    result = fly_in_process(request, FlightCallbacks(confirm, answered.set))
    asking.join()
    return result


@pytest.mark.slow
def test_a_screen_answers_in_the_place_of_the_caller(tmp_path):
    result = asking_caller(tmp_path / "record")
    assert result.outcome.word == "done", result.events[-5:]
    assert any(event.message.startswith("go by Anna: arms 3") for event in result.events)


@pytest.mark.slow
def test_errors_are_passed_on_unchanged(tmp_path):
    (tmp_path / "flight.tlog").write_text("")
    with pytest.raises(InputError, match="holds the record of a flight"):
        fly_in_process(FlightRequest(FLIGHT_PLAN, emulated_fleet(3), tmp_path))


def children(pid: int) -> list[int]:
    listed = subprocess.run(
        ["ps", "-ww", "-o", "pid=,args=", "--ppid", str(pid)],
        capture_output=True,
        text=True,
        check=False,
    ).stdout
    return [
        int(row.split()[0]) for row in listed.splitlines() if "swarm.ground.flight_process" in row
    ]


def test_a_process_that_dies_is_a_vehicle_error(tmp_path):
    def kill():
        while not (pids := children(os.getpid())):
            time.sleep(0.05)
        time.sleep(1.0)
        os.kill(pids[0], signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    with pytest.raises(VehicleError, match=r"the flight's process ended \(signal 9\)"):
        fly_in_process(
            FlightRequest(
                FLIGHT_PLAN, emulated_fleet(3), tmp_path / "record", FlyOptions(speed=4.0)
            )
        )
    killer.join()


def test_an_input_that_ends_at_the_question_refuses_before_it_is_an_error():
    """Ctrl-D: without an answer, the flight would wait for the go of another screen."""
    ours, theirs = multiprocessing.Pipe()
    theirs.send(("confirm", None))

    def confirm(_audit):
        raise EOFError

    with ExitStack() as context:
        keys = _Keys(context, ours, enabled=False)
        with pytest.raises(EOFError):
            _serve(ours, FlightCallbacks(confirm=confirm), keys, threading.Event())
    assert theirs.poll(5.0)
    assert theirs.recv() == ("answer", False)


class Ending(threading.Event):
    """Says that a question is asked; a signal arrives at the moment at which it ends."""

    signalled = False

    def clear(self):
        if not self.signalled:
            self.signalled = True
            signal.raise_signal(signal.SIGINT)
        super().clear()


@pytest.mark.parametrize("answer", [True, EOFError])
def test_a_signal_as_the_question_ends_is_one_answer(answer):
    ours, theirs = multiprocessing.Pipe()
    confirming = Ending()

    def confirm(_audit):
        if answer is EOFError:
            raise EOFError
        return answer

    theirs.send(("confirm", None))
    theirs.send(("result", "the result"))
    with ExitStack() as context:
        _forward_signals(context, ours, confirming)
        keys = _Keys(context, ours, enabled=False)
        callbacks = FlightCallbacks(confirm=confirm)
        assert _serve(ours, callbacks, keys, confirming) == ("result", "the result")
        signal.raise_signal(signal.SIGINT)  # after the question it is passed on alone
    sent = [theirs.recv() for _ in range(3)]
    assert sent == [("signal", signal.SIGINT), ("answer", False), ("signal", signal.SIGINT)]


def test_keys_are_read_from_the_confirmation_on(monkeypatch):
    """The question is answered on a terminal that echoes; after it, single keys are sent."""
    master, slave = pty.openpty()
    ours, theirs = multiprocessing.Pipe()
    seen = []

    def line_by_line():
        return bool(termios.tcgetattr(slave)[3] & termios.ICANON)

    def flight():
        theirs.send(("confirm", None))
        seen.append(theirs.recv())
        while line_by_line():
            time.sleep(0.01)
        os.write(master, b"h")
        seen.append(theirs.recv())
        theirs.send(("result", "the result"))

    def confirm(_audit):
        seen.append(line_by_line())
        return True

    process = threading.Thread(target=flight)
    process.start()
    with os.fdopen(slave, "rb", buffering=0) as terminal, ExitStack() as context:
        monkeypatch.setattr(sys, "stdin", terminal)
        keys = _Keys(context, ours, enabled=True)
        callbacks = FlightCallbacks(confirm=confirm)
        assert _serve(ours, callbacks, keys, threading.Event()) == ("result", "the result")
    process.join(5.0)
    os.close(master)
    assert seen == [True, ("answer", True), ("key", "h")]
