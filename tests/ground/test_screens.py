"""A flight outlives its screens: the terminal that began it, and those that attach later."""

import grp
import os
import pty
import pwd
import queue
import re
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace

import pytest

from swarm.ground.fly import Caller, Preflight, TickTasks
from swarm.ground.record import Record
from tests.command import run
from tests.console.test_server import Client
from tests.network import Network, small_plan

SWARM = Path(sys.executable).with_name("swarm")
ROOT = Path(__file__).parents[2]
OTHER = 65534
"""An account that every machine has, and its group."""


@pytest.fixture
def alone(tmp_path):
    """A flight in virtual time whose caller goes, and the work of its process after each tick."""

    def begun(policy):
        flight = Network(small_plan())
        record = Record(tmp_path / policy, 0.0)
        preflight = Preflight(flight.conductor, tmp_path)
        caller = Caller()
        tasks = TickTasks(
            flight.conductor, record, preflight, lambda _: None, caller, unattended=policy
        )
        return flight, tasks, caller

    return begun


def words(flight, tasks):
    return [event.message for event in (*flight.events, *tasks.events)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("policy", "end"),
    [("hold", "interrupted"), ("land", "interrupted"), ("fly-on", "done")],
)
def test_a_team_without_a_screen_does_what_was_chosen(alone, policy, end):
    flight, tasks, caller = alone(policy)
    flight.until_phase("fold", after=1.0)
    caller.gone.set()
    tasks.run(flight.now)
    tasks.run(flight.now)
    flight.run(lambda: tasks.run(flight.now) is not None)
    assert flight.conductor.finished.word == end, words(flight, tasks)
    assert sum("the last screen is gone" in text for text in words(flight, tasks)) == 1
    landing = [text for text in words(flight, tasks) if text.startswith("landing together")]
    assert len(landing) == (policy != "fly-on"), words(flight, tasks)


@pytest.mark.slow
def test_who_attaches_again_may_resume(alone):
    flight, tasks, caller = alone("hold")
    flight.until_phase("fold", after=1.0)
    caller.gone.set()
    tasks.run(flight.now)
    flight.until_time(9.5)
    assert flight.conductor.clock.stopped
    caller.gone.clear()
    tasks.run(flight.now)
    assert tasks.events[-1].message == "a screen is attached again"
    flight.conductor.request("resume")
    flight.run(lambda: tasks.run(flight.now) is not None)
    assert flight.conductor.finished.word == "done", words(flight, tasks)


@pytest.mark.parametrize("policy", ["hold", "land"])
def test_on_the_ground_a_flight_without_a_screen_ends(alone, policy):
    flight, tasks, caller = alone(policy)
    flight.once()
    caller.gone.set()
    tasks.run(flight.now)
    assert flight.conductor.finished.word == "interrupted"
    assert flight.conductor.finished.explanation == "interrupted before anything was armed"


@pytest.fixture
def asked(tmp_path):
    """A flight in virtual time that is ready, its caller asked; ``ended`` counts ends of that."""
    flight = Network(small_plan(), starts=False)
    answers, ended = queue.SimpleQueue(), []
    preflight = Preflight(flight.conductor, tmp_path, lambda _: answers.get(), screens_answer=True)
    caller = Caller()
    tasks = TickTasks(
        flight.conductor, Record(tmp_path / "record", 0.0), preflight, lambda _: None, caller,
        on_answered=lambda: ended.append(flight.now),
    )  # fmt: skip
    while flight.conductor.asked_at is None:
        flight.once()
        tasks.run(flight.now)
    yield flight, tasks, answers, ended
    answers.put(False)


def run_on(flight, tasks, condition):
    while not condition():
        flight.once()
        tasks.run(flight.now)


def test_the_go_of_a_screen_arms_after_a_countdown(asked):
    flight, tasks, _answers, ended = asked
    began = flight.now
    words_of_go = "arms 3 vehicles and flies, after 3 s in which it can be refused"
    assert flight.conductor.request("go", "Anna (console 1)") == words_of_go
    run_on(flight, tasks, lambda: flight.conductor.stage == "execute")
    assert 3.0 <= flight.now - began < 3.2
    assert [text for text in words(flight, tasks) if "take-off in" in text] == [
        "take-off in 3 s", "take-off in 2 s", "take-off in 1 s",
    ]  # fmt: skip
    assert f"go by Anna (console 1): {words_of_go}" in words(flight, tasks)
    assert len(ended) == 1
    assert not flight.conductor.available()["refuse"].open


@pytest.mark.parametrize("after_go", [False, True])
def test_a_screen_refuses_also_in_the_countdown(asked, after_go):
    flight, tasks, _answers, ended = asked
    if after_go:
        flight.conductor.request("go", "Ben (console 2)")
        run_on(flight, tasks, lambda: "take-off in 2 s" in words(flight, tasks))
    flight.conductor.request("refuse", "Anna (console 1)")
    tasks.run(flight.now)
    ending = flight.conductor.finished
    assert (ending.word, ending.explanation) == ("refused", "refused by the operator")
    assert len(ended) == 1
    assert not any(vehicle.armed for vehicle in flight.conductor.flyers)


def test_the_caller_answers_as_before(asked):
    flight, tasks, answers, ended = asked
    answers.put(True)
    run_on(flight, tasks, lambda: flight.conductor.stage == "execute")
    assert len(ended) == 1


def test_the_refusal_of_the_caller_wins_over_the_go_of_a_screen(asked):
    flight, tasks, answers, _ended = asked
    flight.conductor.request("go", "Ben (console 2)")
    answers.put(False)
    run_on(flight, tasks, lambda: flight.conductor.finished is not None)
    ending = flight.conductor.finished
    assert (ending.word, ending.explanation) == ("refused", "not confirmed")
    assert not any(vehicle.armed for vehicle in flight.conductor.flyers)


def test_a_question_whose_caller_has_gone_waits_for_a_screen_and_ends_with_the_last(asked):
    flight, tasks, answers, _ended = asked
    answers.put(None)
    tasks.control = SimpleNamespace(watched=True, poll=lambda: None, publish=lambda _: None)
    tasks.caller.gone.set()
    run_on(flight, tasks, lambda: tasks.preflight.abandoned)
    for _ in range(50):
        flight.once()
        tasks.run(flight.now)
    assert flight.conductor.stage == "ready"
    tasks.unattended = "fly-on"
    tasks.control.watched = False
    flight.once()
    tasks.run(flight.now)
    assert flight.conductor.finished.explanation == "not confirmed"


def test_nothing_is_asked_before_the_audit():
    flight = Network(small_plan())
    for _ in range(5):
        flight.once()
    for request in ("go", "refuse"):
        assert not flight.conductor.available()[request].open
        assert flight.conductor.request(request) == "nothing is asked now"
    assert flight.conductor.go_given is None


PROGRAM = "import sys; from swarm.cli.main import main; sys.argv[0] = 'swarm'; sys.exit(main())"


def become_other(groups):
    os.setgroups(groups)
    os.setgid(OTHER)
    os.setuid(OTHER)


def other_runs_python():
    """Whether this is root, and another account may run this interpreter and this program."""
    process = os.fork()
    if process == 0:
        with ExitStack() as stack:
            stack.callback(os._exit, 1)
            become_other([])
            os.execv(sys.executable, [sys.executable, "-c", "import swarm.cli.main"])  # noqa: S606
    return os.waitpid(process, 0)[1] == 0


class Terminal:
    """A pseudo-terminal with a program in it, which loses it at :meth:`close`."""

    def __init__(self, folder, *arguments, umask=0o022, groups=None):
        self.process, self.master = pty.fork()
        if self.process == 0:
            os.umask(umask)
            os.chdir(folder)
            if groups is not None:
                become_other(groups)
                os.environ["HOME"] = str(folder)
            os.execv(sys.executable, [sys.executable, "-c", PROGRAM, *arguments])  # noqa: S606
        os.set_blocking(self.master, False)
        self.text = ""

    def until(self, words, seconds=120.0):
        """Read until the program has printed these words."""
        deadline = time.monotonic() + seconds
        while words not in self.text:
            assert time.monotonic() < deadline, self.text[-2000:]
            try:
                self.text += os.read(self.master, 1 << 16).decode("utf-8", "replace")
            except BlockingIOError:
                time.sleep(0.02)
            except OSError:  # the program has ended
                raise AssertionError(self.text[-2000:]) from None

    def close(self):
        os.close(self.master)
        os.waitpid(self.process, 0)


@pytest.mark.slow
@pytest.mark.usefixtures("in_real_time")
def test_a_closed_terminal_and_another_that_attaches(tmp_path):
    """The window is closed in mid-air; the team holds; the next terminal resumes, and sees it land."""
    hover = str(ROOT / "missions" / "first-steps" / "hover.yaml")
    # T is 15 s of real time: a busy machine starts the next terminal within it
    first = Terminal(tmp_path, "fly", hover, "--speed", "4", "--record", "flight")
    events = tmp_path / "flight" / "events.jsonl"
    deadline = time.monotonic() + 240.0
    while not (events.exists() and "all are airborne" in events.read_text()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    first.close()
    while "the last screen is gone" not in events.read_text():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    listed = subprocess.run(
        [SWARM, "flights"], capture_output=True, text=True, check=True, cwd=tmp_path
    ).stdout
    (row,) = [row for row in listed.splitlines() if row.startswith(str(tmp_path))]
    assert re.fullmatch(
        rf"{tmp_path}/flight: fold, 0:\d\d\.\d of the plan, held: operator command", row
    )
    second = Terminal(tmp_path, "attach", "flight", "--view", "foxglove")
    second.until("live view: open connection ws://127.0.0.1:")
    second.until("a screen is attached again")
    os.write(second.master, b"r")
    second.until("Record: flight")
    second.close()
    assert "done: " in second.text, second.text[-2000:]
    # the page that the first terminal would have written, and the same from the record later
    page = (tmp_path / "flight" / "report.html").read_text()
    assert run("verify", str(tmp_path / "flight"), "--report", str(tmp_path / "again.html"))[0] == 0
    assert (tmp_path / "again.html").read_text() == page
    assert "all vehicles have landed and disarmed" in page


@pytest.mark.usefixtures("in_real_time")
def test_another_account_attaches_to_a_shared_flight():
    """It holds, resumes and hands over command; the record says which account it was."""
    if not other_runs_python():
        pytest.skip("only root becomes another account, which must be able to run this interpreter")
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        own, others = Path(folder) / "own", Path(folder) / "others"
        for each, mode in ((Path(folder), 0o755), (own, 0o711), (others, 0o777)):
            each.mkdir(exist_ok=True)
            each.chmod(mode)
        hover = str(ROOT / "missions" / "first-steps" / "hover.yaml")
        share = ("--share", grp.getgrgid(OTHER).gr_name)
        first = Terminal(own, "fly", hover, "--record", "flights/one", *share, umask=0o077)
        first.until("all are airborne")
        os.write(first.master, b"h")
        first.until("hold by terminal")
        record = str(own / "flights" / "one")
        second = Terminal(others, "attach", record, "--console", "127.0.0.1:0", groups=[OTHER])
        second.until("holding: operator command")
        os.write(second.master, b"r")
        account = f"(account {pwd.getpwuid(OTHER).pw_name})"
        first.until(f"at an attached terminal {account}")
        url = re.search(r"Console: (http://\S+)", second.text)[1]
        people = []
        for name in ("Anna", "Ben"):
            people.append(Client(stack, url))
            people[-1].join()
            people[-1].say(do="name", name=name)
        anna, ben = people
        anna.say(do="take")
        ben.next("people", lambda message: message["holder"] == 1)
        ben.say(do="take")
        anna.next("people", lambda message: message["asking"] == 2)
        anna.say(do="hand over")
        ben.next("people", lambda message: message["holder"] == 2)
        ben.say(do="command", command="land")
        ben.next("answer")
        second.until("Record: ")
        first.until("Record: ")
        for terminal in (first, second):
            terminal.close()
        assert "Report: not written" not in second.text
        events = (own / "flights" / "one" / "events.jsonl").read_text()
        for words in (
            f"Ben (console 2) takes command from Anna (console 1) {account}",
            f"land by Ben (console 2) {account}",
        ):
            assert words in events, words


@pytest.mark.slow
@pytest.mark.usefixtures("in_real_time")
def test_a_closed_pipe_ends_the_screen_and_not_the_flight(tmp_path):
    hover = str(ROOT / "missions" / "first-steps" / "hover.yaml")
    command = [SWARM, "fly", hover, "--speed", "8", "--record", "flight", "--unattended", "land"]
    flight = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path
    )
    for line in flight.stdout:
        if "phase takeoff" in line:
            break
    flight.stdout.close()
    flight.stdout = None
    _, errors = flight.communicate(timeout=120)
    assert flight.returncode == 130
    assert errors.strip().endswith("the flight goes on: swarm attach flight")
    assert "Traceback" not in errors
    summary = tmp_path / "flight" / "summary.json"
    deadline = time.monotonic() + 120.0
    while not summary.exists():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert "landing together" in (tmp_path / "flight" / "events.jsonl").read_text()


@pytest.mark.parametrize(
    ("record", "why"), [("nowhere", "no such file or directory"), ("ended", "it has ended")]
)
def test_a_flight_that_does_not_run_has_no_screen(tmp_path, record, why):
    (tmp_path / "ended").mkdir()
    (tmp_path / "ended" / "summary.json").write_text("{}")
    done = subprocess.run(
        [SWARM, "attach", record], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"{record}: expected the record of a flight that runs: {why}\n"


def test_a_record_that_cannot_be_written_is_refused_before_arming(tmp_path):
    hover = str(ROOT / "missions" / "first-steps" / "hover.yaml")
    (tmp_path / "file").write_text("")
    ended = subprocess.run(
        [SWARM, "fly", hover, "--record", "file/flight"],
        capture_output=True, text=True, check=False, cwd=tmp_path,
    )  # fmt: skip
    assert ended.returncode == 2
    assert ended.stderr.splitlines()[-1] == "file/flight: not a directory"


def test_a_record_is_not_overwritten_by_another_flight(tmp_path):
    for name in ("flight.tlog", "flight.rrd"):
        (tmp_path / name).write_text("kept")
    hover = str(ROOT / "missions" / "first-steps" / "hover.yaml")
    done = run("fly", hover, "--record", str(tmp_path))
    assert (done.returncode, done.stderr.splitlines()[-1]) == (
        2, f"{tmp_path}: holds the record of a flight"
    )  # fmt: skip
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        "flight.tlog": "kept", "flight.rrd": "kept",
    }  # fmt: skip
