"""The process of the console on loopback, with WebSocket clients that are no browsers."""

import json
import os
import signal
import socket
import ssl
import time
from contextlib import ExitStack, contextmanager
from http.client import HTTPConnection
from urllib.parse import urlsplit

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from swarm.console.certificate import fingerprint, read_certificate, self_signed
from swarm.console.launch import Address, open_console, parse_address
from swarm.errors import InputError
from tests.command import run
from tests.console.flight import LOOPBACK, PATIENCE, flying_with_console


class Client:
    """A client that reads everything; ``messages`` are those of each kind so far."""

    def __init__(self, stack, url, **options):
        parts = urlsplit(url)
        scheme = {"http": "ws", "https": "wss"}[parts.scheme]
        options.setdefault("origin", f"{parts.scheme}://{parts.netloc}")
        self.token = parts.fragment
        self.connection = stack.enter_context(
            connect(f"{scheme}://{parts.netloc}/socket", open_timeout=PATIENCE, **options)
        )
        self.messages = []

    def say(self, **message):
        self.connection.send(json.dumps(message))

    def join(self, **more):
        self.say(do="join", token=self.token, key="", name="", **more)
        return self.next("joined")

    def next(self, kind, condition=lambda _: True):
        """The next message of a kind for which a condition holds."""
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            message = json.loads(self.connection.recv(timeout=PATIENCE))
            self.messages.append(message)
            if message["kind"] == "state":
                self.connection.send("drawn")
            if message["kind"] == kind and condition(message):
                return message
        raise AssertionError(f"no {kind}: {self.messages[-5:]}")

    def closed(self):
        """The code with which the connection was closed."""
        try:
            while True:
                self.connection.recv(timeout=PATIENCE)
        except ConnectionClosed as error:
            return error.rcvd.code


EVERYWHERE = Address("0.0.0.0", 0)  # noqa: S104 - what is tested


@contextmanager
def opened(tmp_path, address=LOOPBACK):
    with ExitStack() as stack, flying_with_console(tmp_path, address) as (flight, console):
        yield stack, flight, console


def until(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.slow
def test_two_clients_command_and_the_end_of_the_flight(tmp_path):
    with opened(tmp_path) as (stack, flight, console):
        anna = Client(stack, console.url)
        anna.join()
        plan = anna.next("plan")
        assert (plan["vehicles"], len(plan["paths"])) == (3, 3)
        state = anna.next("state")
        assert [row["number"] for row in state["rows"]] == [1, 2, 3]
        assert state["rows"][0]["fix"] == "RTK fixed, 18 sat."
        until(lambda: flight.watched)
        ben = Client(stack, console.url)
        ben.join()
        assert ben.next("event")["words"] == "all vehicles are ready"
        anna.say(do="name", name="Anna")
        anna.say(do="take")
        ben.next("people", lambda m: m["holder"] == 1)
        ben.say(do="command", command="hold")
        assert (
            ben.next("answer")["words"] == "Anna (console 1) has command: this console only reads"
        )
        anna.say(do="command", command="hold")
        assert anna.next("answer")["words"] == "hold it is"
        anna.say(do="kill")
        number = anna.next("kill")["number"]
        anna.say(do="cancel kill")
        assert anna.next("answer")["words"] == "kill: cancelled; nothing was stopped"
        anna.say(do="kill", number=number)  # it is not valid any more
        assert anna.next("kill")["number"] != number
        assert flight.requests == [("hold", "Anna (console 1)")]
        assert "Anna (console 1) takes command" in flight.notes
        flight.end()
        for client in (anna, ben):
            assert client.next("ended")["words"] == "done: landed"


@pytest.mark.slow
def test_hostile_clients_do_not_disturb_the_others(tmp_path):
    """Wrong tokens, garbage, frames that are too large, and a client that never reads."""
    with opened(tmp_path) as (stack, _flight, console):
        anna = Client(stack, console.url)
        anna.join()
        anna.next("state")
        codes = []
        for k in range(12):
            with ExitStack() as own:
                guess = Client(own, console.url)
                guess.say(do="join", token=f"guess {k}", key="")
                codes.append(guess.closed())
        assert set(codes) <= {4001, 4002}
        for frame in ("garbage", b"\x00" * 100, "x" * 2000):
            with ExitStack() as own:
                client = Client(own, console.url)
                client.connection.send(frame)
                assert client.closed() == 4004
        with ExitStack() as own:
            client = Client(own, console.url)
            client.connection.send("x" * 100_000)
            assert client.closed() == 1009
        parts = urlsplit(console.url)
        deaf = stack.enter_context(socket.create_connection((parts.hostname, parts.port)))
        deaf.sendall(
            b"GET /socket HTTP/1.1\r\nHost: %b\r\nOrigin: http://%b\r\nUpgrade: websocket\r\n"
            b"Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
            % (parts.netloc.encode(), parts.netloc.encode())
        )
        before = anna.next("state")["time"]
        assert anna.next("state")["time"] > before


@pytest.mark.slow
def test_a_console_that_hangs_delays_no_flight_and_then_shows_the_present(tmp_path):
    """Its process stands still for five seconds of a flight that goes on; no backlog is drawn."""
    with opened(tmp_path) as (stack, flight, console):
        anna = Client(stack, console.url)
        anna.join()
        anna.next("state")
        os.kill(console.process.pid, signal.SIGSTOP)
        try:
            stopped = flight.now
            until(lambda: flight.now > stopped + 5.0)  # its loop counts its own ticks
            assert flight.watched
        finally:
            os.kill(console.process.pid, signal.SIGCONT)
        present = anna.next("state", lambda message: message["time"] > stopped + 5.0)["time"]
        times = [one["time"] for one in anna.messages if one["kind"] == "state"]
        late = [time for time in times if stopped < time < present]
        assert len(late) < 0.5 * 20.0 * (present - stopped), late
        anna.say(do="take")
        anna.say(do="command", command="hold")
        assert anna.next("answer")["words"] == "hold it is"


@pytest.mark.slow
def test_the_page_of_another_site_is_refused(tmp_path):
    with opened(tmp_path) as (stack, _flight, console):
        for origin in ("https://elsewhere.example", "null", None):
            with pytest.raises(InvalidStatus, match="403"):
                Client(stack, console.url, origin=origin)


def got(url, path="/", **headers):
    """What the console answers to a request for a file: status, headers and text."""
    connection = HTTPConnection(urlsplit(url).netloc, timeout=PATIENCE)
    try:
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read().decode()
    finally:
        connection.close()


@pytest.mark.slow
def test_the_page_comes_from_the_console_alone(tmp_path):
    with opened(tmp_path) as (_stack, _flight, console):
        status, headers, page = got(console.url)
        assert status == 200
        assert "http:" not in page
        assert "https:" not in page
        assert "default-src 'none'; script-src 'self'" in headers["Content-Security-Policy"]
        assert urlsplit(console.url).fragment not in page
        for name in ("console.js", "console.css", "map.js", "motion_scene.js", "motion_camera.js"):
            assert name in page
            status, _, text = got(console.url, f"/{name}")
            assert status == 200
            assert len(text) > 1000
        assert got(console.url, "/../server.py")[0] == 404
        assert got(console.url, Host="elsewhere.example:80")[0] == 421


@pytest.mark.slow
def test_on_other_addresses_there_is_tls(tmp_path):
    with opened(tmp_path, EVERYWHERE) as (stack, _flight, console):
        assert console.url.startswith("https://")
        port = urlsplit(console.url).port
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        token = console.url.partition("#")[2]
        client = Client(stack, f"https://127.0.0.1:{port}/#{token}", ssl=context)
        client.join()
        client.next("state")
        shown = client.connection.socket.getpeercert(binary_form=True)
        pem = ssl.DER_cert_to_PEM_cert(shown)
        assert console.message.endswith(f"compare SHA-256 {fingerprint(pem.encode())}")


@pytest.mark.slow
def test_a_console_whose_flight_never_begins_ends_with_its_terminal(tmp_path):
    with open_console(tmp_path, LOOPBACK, None) as console:
        assert got(console.url)[0] == 200
    assert console.process.wait(PATIENCE) == 0


def test_an_address_in_use_is_refused(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        words = f"--console: 127.0.0.1:{port}: address already in use"
        with (
            pytest.raises(InputError, match=words),
            open_console(tmp_path, Address("127.0.0.1", port), None),
        ):
            pass


def test_an_address_in_use_is_refused_before_planning():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        done = run("fly", "overhand", "--console", address)
    assert done == (2, "", f"--console: {address}: address already in use\n")


@pytest.mark.parametrize(
    ("text", "host", "port", "loopback"),
    [
        ("127.0.0.1:8765", "127.0.0.1", 8765, True),
        ("localhost:1", "127.0.0.1", 1, True),
        ("[::1]:0", "::1", 0, True),
        ("192.168.1.5:8443", "192.168.1.5", 8443, False),
        ("[::]:8443", "::", 8443, False),
    ],
)
def test_an_address_is_read(text, host, port, loopback):
    address = parse_address(text)
    assert (address.host, address.port, address.loopback) == (host, port, loopback)


@pytest.mark.parametrize(
    "text",
    ["", "8443", "127.0.0.1", "nowhere:1", "127.0.0.1:x", "127.0.0.1:65536", "missions/x.yaml"],
)
def test_another_text_is_no_address(text):
    with pytest.raises(ValueError, match="expected"):
        parse_address(text)


def test_a_given_certificate_is_tried_before_the_flight(tmp_path):
    good, bad = tmp_path / "good.pem", tmp_path / "bad.pem"
    pem = self_signed(["localhost", "10.0.0.1", "::1"])
    good.write_bytes(pem)
    assert read_certificate(good) == pem
    bad.write_text("nothing")
    with pytest.raises(InputError, match="expected a certificate and its private key in PEM"):
        read_certificate(bad)
