"""The console's page in a real Chromium, of a real flight with emulated vehicles."""

import os
import re
import shutil
import socket
import subprocess
import sys
import threading
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import expect, sync_playwright

from tests.console.flight import PATIENCE, flying_with_console

SWARM = Path(sys.executable).with_name("swarm")
HOVER = Path(__file__).parents[2] / "missions" / "first-steps" / "hover.yaml"
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
ARGUMENTS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
pytestmark = [
    pytest.mark.skipif(
        CHROMIUM is None, reason="no chromium on this machine: apt install chromium"
    ),
    pytest.mark.usefixtures("in_real_time"),
]


@contextmanager
def flying(folder):
    """A flight in real time; yields the address of its console, and the folder of its record."""
    command = [SWARM, "fly", HOVER, "--record", "flight", "--console", "127.0.0.1:0"]
    command += ["--set", "hold_time=30"]
    flight = subprocess.Popen(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    printed = []
    try:
        for line in flight.stdout:
            printed.append(line)
            if found := re.match(r"Console: (http://\S+)", line):
                reading = threading.Thread(target=lambda: printed.extend(flight.stdout))
                reading.start()
                yield found[1], folder / "flight"
                flight.wait(PATIENCE)
                reading.join()
                return
        raise AssertionError("".join(printed))
    finally:
        if flight.poll() is None:
            flight.kill()
            flight.wait()
        flight.stdout.close()


class Relay:
    """A way to the console that can be cut: bytes of both directions, connection by connection."""

    def __init__(self, target):
        self._target, self._ends, self._is_cut = target, [], False
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    def _accept(self):
        with suppress(OSError):
            while True:
                near, _ = self._listening.accept()
                self._ends.append(near)
                if self._is_cut:
                    near.shutdown(socket.SHUT_RDWR)
                    continue
                far = socket.create_connection(self._target)
                self._ends.append(far)
                for pair in ((near, far), (far, near)):
                    self._threads.append(threading.Thread(target=self._copy, args=pair))
                    self._threads[-1].start()

    def _copy(self, source, sink):
        with suppress(OSError):
            while data := source.recv(1 << 16):
                sink.sendall(data)
        for end in (source, sink):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def cut(self):
        self._is_cut = True
        for end in self._ends:
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def mend(self):
        self._is_cut = False

    def close(self):
        self._ends.append(self._listening)
        self.cut()
        for thread in self._threads:
            thread.join()
        for end in self._ends:
            end.close()


@pytest.fixture
def browser():
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, headless=True, args=ARGUMENTS)
        yield opened
        opened.close()


def page_of(browser, url, width, scheme):
    context = browser.new_context(
        viewport={"width": width, "height": 900}, color_scheme=scheme, service_workers="block"
    )
    page = context.new_page()
    page.set_default_timeout(1000.0 * PATIENCE)
    problems = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.goto(url)
    return page, problems


def shows(page, selector, text):
    expect(page.locator(selector)).to_contain_text(text, timeout=1000.0 * PATIENCE)


@pytest.mark.slow
def test_two_browsers_command_a_flight(tmp_path, browser):
    """Hand-over, a page that is loaded again, a connection that is lost, kill cancelled, landing."""
    with ExitStack() as stack:
        url, record = stack.enter_context(flying(tmp_path))
        parts = urlsplit(url)
        relay = Relay((parts.hostname, parts.port))
        stack.callback(relay.close)
        anna, errors = page_of(browser, url, 1280, "light")
        ben, other_errors = page_of(
            browser, f"http://127.0.0.1:{relay.port}/#{parts.fragment}", 390, "dark"
        )
        assert parts.fragment not in anna.evaluate("location.href")
        shows(anna, "#team tbody", "offboard")
        anna.fill("#name", "Anna")
        anna.press("#name", "Enter")
        anna.click("#take")
        shows(anna, "#holder", "You have command.")
        shows(ben, "#holder", "Anna (console 1) has command.")
        shows(ben, ".buttons .hold", "all stop along the path")
        expect(ben.locator(".buttons .hold")).to_be_disabled()
        for page, width in ((anna, 1280), (ben, 390), (ben, 768)):
            page.set_viewport_size({"width": width, "height": 900})
            assert page.evaluate("document.documentElement.scrollWidth") == width
            assert page.evaluate("document.getElementById('above').width") > 300

        shows(anna, "#phases .current", "fold")
        shows(anna, "#team tbody", re.compile(r"\d\.\d\d of 0\.\d\d m"))
        anna.keyboard.press("h")
        shows(anna, "#answer", "hold: all stop along the path")
        for page in (anna, ben):
            shows(page, "#wait", "hold: operator command; then all land together in")

        anna.keyboard.press("k")
        shows(anna, "#killing", "type")
        shows(anna, "#number", re.compile(r"^\d{4}$"))
        anna.fill("#digits", "0000")
        anna.keyboard.press("Enter")
        shows(anna, "#again", "That was not the number; nothing was stopped.")
        anna.click("#cancel")
        shows(anna, "#answer", "kill: cancelled; nothing was stopped")
        expect(anna.locator("#killing")).to_be_hidden()

        ben.click("#take")
        shows(anna, "#asks", "console 2 asks for command")
        anna.click("#give")
        shows(ben, "#holder", "You have command.")
        expect(anna.locator(".buttons .resume")).to_be_disabled()

        ben.reload()
        shows(ben, "#holder", "You have command.")
        relay.cut()
        shows(ben, "#link", "connection lost, trying again")
        shows(anna, "#holder", "console 2 has command, and lost the connection.")
        relay.mend()
        shows(ben, "#holder", "You have command.")
        shows(ben, "#link", "live")
        ben.click(".buttons .resume")
        shows(ben, "#answer", "resume: continues the plan")
        ben.click("[data-view=space]")
        expect(ben.locator("#scene")).to_be_visible()
        ben.click(".buttons .land")
        shows(ben, "#answer", "land: ")
        for page in (anna, ben):
            shows(page, "#wait", "The flight has ended. ")
        assert (errors, other_errors) == ([], [])
    events = (record / "events.jsonl").read_text()
    for words in (
        "Anna (console 1) takes command",
        "hold by Anna (console 1): all stop along the path",
        "kill: cancelled; nothing was stopped",
        "console 2 takes command from Anna (console 1)",
        "console 2 has command and lost the connection",
        "resume by console 2: continues the plan",
        "land by console 2: ",
    ):
        assert words in events, words


ASKED = """
import sys, threading
from pathlib import Path
from swarm.console.launch import Address, open_console
from swarm.ground.flight_process import FlightRequest, fly_in_process
from swarm.ground.fly import FlightCallbacks, FlyOptions
from swarm.mission.fleet import emulated_fleet
from tests.network import small_plan

folder = Path("flight").absolute()
options = FlyOptions(control=folder / "control", screens_answer=True)
request = FlightRequest(small_plan(), emulated_fleet(3), folder, options, confirm=True)
folder.mkdir()
with open_console(folder, Address("127.0.0.1", 0), None) as console:
    print(console.message, flush=True)
    answered = threading.Event()
    asked = FlightCallbacks(lambda _: answered.wait() and None, answered.set)
    print(fly_in_process(request, asked).outcome.explanation, flush=True)
"""


@pytest.mark.slow
def test_the_go_before_arming_comes_from_who_has_command(tmp_path, browser):
    """Findings are on the page; who reads cannot give the go, a page that stands still neither."""
    root = str(Path(__file__).parents[2])
    environment = {**os.environ, "PYTHONPATH": root}
    with ExitStack() as stack:
        flight = stack.enter_context(
            subprocess.Popen(
                [sys.executable, "-c", ASKED], cwd=tmp_path, env=environment, text=True,
                stdout=subprocess.PIPE,
            )
        )  # fmt: skip
        stack.callback(flight.kill)
        url = flight.stdout.readline().split()[-1]
        anna, errors = page_of(browser, url, 1280, "light")
        ben, other_errors = page_of(browser, url, 390, "dark")
        for page, width in ((anna, 1280), (anna, 768), (ben, 390)):
            page.set_viewport_size({"width": width, "height": 900})
            shows(page, "#checked tbody", "placement")
            shows(page, ".buttons .go", "arms 3 vehicles and flies, after 3 s")
            expect(page.locator(".buttons .go")).to_be_disabled()
            assert page.evaluate("document.documentElement.scrollWidth") == width
        anna.click("#take")
        shows(ben, "#holder", "console 1 has command.")
        expect(ben.locator(".buttons .go")).to_be_disabled()
        ben.evaluate("say({ do: 'command', command: 'go', seen: state.time })")
        shows(ben, "#answer", "console 1 has command: this console only reads")
        anna.evaluate("say({ do: 'command', command: 'go', seen: state.time - 2.5 })")
        shows(anna, "#answer", "this screen does not show the present state; nothing was armed")
        anna.reload()
        shows(anna, "#holder", "You have command.")
        shows(anna, "#phases + *, #wait", "waiting for the ground check and the go")
        anna.click(".buttons .go")
        shows(anna, "#answer", "go: arms 3 vehicles and flies")
        shows(anna, "#events", "take-off in 1 s")
        shows(ben, "#clock", re.compile("0:0[1-9]"))
        for page in (anna, ben):
            expect(page.locator(".checked")).to_be_hidden()
            expect(page.locator(".buttons .go")).to_be_hidden()
        anna.click(".buttons .land")
        shows(ben, "#wait", "The flight has ended. ")
        assert "landed" in flight.stdout.read()
        assert (errors, other_errors) == ([], [])
    events = (tmp_path / "flight" / "events.jsonl").read_text()
    assert "go by console 1: arms 3 vehicles and flies" in events
    assert "nothing was armed (console 1)" in events


@pytest.mark.slow
def test_the_page_of_a_check_asks_before_parameters_are_set(tmp_path, browser):
    command = [SWARM, "check", "--fix", "--record", "check", "--console", "127.0.0.1:0"]
    (tmp_path / "fleet.yaml").write_text(
        "{schema: 1, name: two, emulated: {}, links: {net: 'udpin://127.0.0.1:0'}, vehicles: ["
        "{sysid: 1, links: [net], autopilot: px4}, {sysid: 7, links: [net], autopilot: px4}]}"
    )
    with subprocess.Popen(
        [*command, "--fleet", "fleet.yaml"], cwd=tmp_path, text=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    ) as check:  # fmt: skip
        for line in check.stdout:
            if found := re.match(r"Console: (http://\S+)", line):
                break
        try:
            page, errors = page_of(browser, found[1], 390, "light")
            shows(page, ".buttons .go", "sets these ")
            shows(page, "#team tbody", "7not ready: COM_OBL_RC_ACT is 0")
            shows(page, "#checked tbody", "systems 1, 7: COM_OBL_RC_ACT is 0")
            shows(page, "#phases .current", "parameters")
            shows(page, ".buttons .interrupt", "end the check")
            for hidden in (".maps", ".buttons .hold", ".buttons .kill", "#margins"):
                expect(page.locator(hidden)).to_be_hidden()
            assert page.evaluate("document.documentElement.scrollWidth") == 390
            page.click("#take")
            page.click(".buttons .go")
            shows(page, "#answer", "go: sets these ")
            shows(page, "#wait", "The check has ended. GO for flight")
        except BaseException:
            check.kill()  # it waits for an answer
            raise
        assert "set systems 1, 7: COM_OBL_RC_ACT 0" in check.stdout.read()
        assert (check.wait(), errors) == (0, [])


@pytest.mark.slow
def test_without_the_token_the_page_asks_for_it(tmp_path, browser):
    with flying_with_console(tmp_path) as (_flight, console):
        address, _, token = console.url.partition("#")
        page, errors = page_of(browser, address, 390, "light")
        expect(page.locator("#login")).to_be_visible(timeout=1000.0 * PATIENCE)
        page.fill("#token", "not the token")
        page.keyboard.press("Enter")
        shows(page, "#refused", "wrong token")
        page.fill("#token", token.upper())
        page.keyboard.press("Enter")
        shows(page, "#team tbody", "flying")
        assert errors == []
