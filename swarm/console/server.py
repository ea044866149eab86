"""The process of a console: ``python -m swarm.console.server DESCRIPTOR RECORD``.

It is a client of the flight's control socket, and passes on to browsers what it reads there. The
flight never waits for it; and it waits for no browser: each has a queue of its own, in which the
newest state replaces the one before.
"""

import asyncio
import json
import os
import secrets
import signal
import socket
import sys
import time
import traceback
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import uvicorn
from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from swarm.console.certificate import tls_context
from swarm.console.facts import (
    Rates,
    checked_facts,
    event_facts,
    fleet_facts,
    plan_facts,
    state_facts,
)
from swarm.console.session import LARGEST_MESSAGE, Close, Output, Send, Session
from swarm.errors import SwarmError
from swarm.flight.snapshot import Checked, Event, Snapshot
from swarm.ground.operator import read_screen_line
from swarm.ground.record_reader import recorded_fleet, recorded_plan
from swarm.planning import Plan

INTERVAL: Final = 0.1
"""Seconds between two states that are shown: a flight in slow or fast time has more of them."""
TICK: Final = 0.5
_MOST_WAITING: Final = 1000
"""Messages besides states that wait for a slow browser before it is given up: those of minutes."""
_MOST_EVENTS: Final = 400
"""Events that a page gets when it is loaded."""
_RETRY: Final = 0.1
_SUMMARY_TIME: Final = 10.0
"""Seconds within which a flight that has ended writes its summary."""
_LINGER: Final = 1.0
"""Seconds in which browsers get the last messages."""
_NICENESS: Final = 3
"""Behind the flight, and before the programs that only draw: commands come through this process."""
_LARGEST_LINE: Final = 1 << 24
DRAWN: Final = "drawn"
"""What a page sends when it has drawn a state."""
SLOW_CODE: Final = 4007
"""Code with which the WebSocket of a browser is closed that does not read."""

_PAGES: Final = {
    "/": ("console", "console.html", "text/html"),
    "/console.css": ("console", "console.css", "text/css"),
    "/console.js": ("console", "console.js", "text/javascript"),
    "/map.js": ("console", "map.js", "text/javascript"),
    "/motion_scene.js": ("reports", "motion_scene.js", "text/javascript"),
    "/motion_camera.js": ("reports", "motion_camera.js", "text/javascript"),
}
"""Path → package, file and type of what is served."""


@dataclass(eq=False)
class _Browser:
    """The messages that wait for one browser: events and answers in order, and the newest state.

    A page says when it has drawn a state, and gets the next one then: one that is slow gets fewer,
    and nothing piles up on the way to it.
    """

    websocket: WebSocket
    waiting: deque[str] = field(default_factory=deque)
    state: str | None = None
    drawn: bool = True
    closing: tuple[int, str] | None = None
    changed: asyncio.Event = field(default_factory=asyncio.Event)

    def send(self, text: str) -> None:
        """Queue a message."""
        if len(self.waiting) < _MOST_WAITING:
            self.waiting.append(text)
        else:
            self.close(SLOW_CODE, "this browser does not read")
        self.changed.set()

    def show(self, state: str) -> None:
        """Queue a state; it replaces one that waits."""
        self.state = state
        self.changed.set()

    def next_state(self) -> None:
        """Take note that the page has drawn the state before."""
        self.drawn = True
        self.changed.set()

    def close(self, code: int, reason: str) -> None:
        """End the connection after what waits."""
        self.closing = self.closing or (code, reason)
        self.changed.set()

    async def run(self) -> None:
        """Send what waits until the connection ends."""
        with suppress(WebSocketDisconnect, RuntimeError, OSError):
            while True:
                await self.changed.wait()
                self.changed.clear()
                while self.waiting:
                    await self.websocket.send_text(self.waiting.popleft())
                if self.state is not None and self.drawn:
                    state, self.state, self.drawn = self.state, None, False
                    await self.websocket.send_text(state)
                if self.closing is not None and not self.waiting:
                    await self.websocket.close(*self.closing)
                    return


class ConsoleServer:
    """The console of one flight: browsers on one side, the control socket on the other."""

    def __init__(self, folder: Path, token: str) -> None:
        self._folder = folder
        self._session = Session(token, lambda: secrets.token_urlsafe(12))
        self._browsers: dict[int, _Browser] = {}
        self._numbers = 0
        self._flight: asyncio.StreamWriter | None = None
        self._plan: Plan | None = None
        self._plan_text: str | None = None
        self._events: deque[str] = deque(maxlen=_MOST_EVENTS)
        self._checked: str | None = None
        self._snapshot: bytes | None = None
        self._state: str | None = None
        self._rates: Rates | None = None
        self._ended: str | None = None
        self.app = Starlette(
            routes=[
                *(Route(path, self._page) for path in _PAGES),
                WebSocketRoute("/socket", self._socket),
            ]
        )

    @property
    def connected(self) -> bool:
        """Whether the flight was reached."""
        return self._flight is not None

    # Browsers

    async def _page(self, request: Request) -> Response:
        if not _known_host(request):
            return PlainTextResponse("unknown host", 421)
        package, name, kind = _PAGES[request.url.path]
        text = files(f"swarm.{package}").joinpath("static", name).read_text(encoding="utf-8")
        host = request.headers.get("host", "")
        policy = (
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
            f"connect-src 'self' ws://{host} wss://{host}; base-uri 'none'; form-action 'none'; "
            "frame-ancestors 'none'"
        )
        headers = {
            "Content-Security-Policy": policy,
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cache-Control": "no-store",
        }
        return Response(text, media_type=kind, headers=headers)

    async def _socket(self, websocket: WebSocket) -> None:
        origin = websocket.headers.get("origin", "")
        host = websocket.headers.get("host", "")
        if not _known_host(websocket) or origin.partition("://")[2] != host:
            await websocket.close(1008)  # the page of another site
            return
        await websocket.accept()
        self._numbers += 1
        number, browser = self._numbers, _Browser(websocket)
        self._browsers[number] = browser
        address = websocket.client.host if websocket.client else ""
        sending = asyncio.create_task(browser.run())
        try:
            self._carry_out(self._session.connect(number, address, time.monotonic()))
            while browser.closing is None:
                message = await websocket.receive()
                if message["type"] == "websocket.disconnect":
                    break
                content = message.get("text")
                if content == DRAWN:
                    browser.next_state()
                    continue
                content = message.get("bytes") or b"" if content is None else content
                self._carry_out(self._session.receive(number, content, time.monotonic()))
            if browser.closing is not None:
                with suppress(TimeoutError):
                    await asyncio.wait_for(sending, _LINGER)
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            sending.cancel()
            del self._browsers[number]
            self._carry_out(self._session.disconnect(number, time.monotonic()))

    def _carry_out(self, outputs: Sequence[Output]) -> None:
        for output in outputs:
            if isinstance(output, Send):
                self._send(output.connection, output.message)
            elif isinstance(output, Close):
                if output.connection in self._browsers:
                    self._browsers[output.connection].close(output.code, output.reason)
            elif self._flight is not None:
                self._flight.write(output.line.encode() + b"\n")

    def _send(self, connection: int, message: Any) -> None:
        browser = self._browsers.get(connection)
        if browser is None:
            return
        browser.send(json.dumps(message))
        if message["kind"] == "joined":
            for text in (self._plan_text, self._checked, *self._events, self._ended):
                if text is not None:
                    browser.send(text)
            if self._state is not None:
                browser.show(self._state)

    def _show_all(self, text: str) -> None:
        for connection in self._session.joined:
            self._browsers[connection].send(text)

    # The flight

    async def follow(self) -> None:
        """Follow the flight from its beginning to its end."""
        reader, self._flight = await self._connect()
        self._session.closed = ""
        self._flight.write(f"screens {self._session.screens}\n".encode())
        fleet = None
        with suppress(SwarmError):
            fleet = recorded_fleet(self._folder, flown=False)
        facts = fleet_facts(fleet)
        if (self._folder / "plan.json").exists():  # not in a check without a mission
            self._plan = await asyncio.to_thread(recorded_plan, self._folder)
            facts = plan_facts(self._plan, fleet)
        self._plan_text = json.dumps(facts)
        self._show_all(self._plan_text)
        async with asyncio.TaskGroup() as tasks:
            showing = tasks.create_task(self._show_states())
            with suppress(OSError, asyncio.IncompleteReadError):
                while True:
                    self._take(await reader.readuntil(b"\n"))
            self._session.closed = "the flight has ended"
            showing.cancel()
        await self._show_state()
        words, level = await self._outcome()
        self._ended = json.dumps({"kind": "ended", "words": words, "level": level})
        self._show_all(self._ended)
        await asyncio.sleep(_LINGER)

    async def _connect(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        while True:
            with suppress(OSError):
                return await asyncio.open_unix_connection(
                    self._folder / "control", limit=_LARGEST_LINE
                )
            await asyncio.sleep(_RETRY)

    def _take(self, line: bytes) -> None:
        if line.startswith(b'{"snapshot"'):
            self._snapshot = line
            return
        item = read_screen_line(line)
        if isinstance(item, Event):
            facts = event_facts(item)
            if facts is not None:
                self._events.append(json.dumps(facts))
                self._show_all(self._events[-1])
        elif isinstance(item, Checked):
            self._checked = json.dumps(checked_facts(item))
            self._show_all(self._checked)
        elif isinstance(item, str):
            self._carry_out(self._session.answer(item))

    async def _show_states(self) -> None:
        while True:
            await self._show_state()
            await asyncio.sleep(INTERVAL)

    async def _show_state(self) -> None:
        """Show the newest snapshot, if there is one that was not shown."""
        line, self._snapshot = self._snapshot, None
        if line is None or self._plan_text is None:
            return
        snapshot = read_screen_line(line)
        if not isinstance(snapshot, Snapshot):
            return
        self._rates = (self._rates or Rates.first(snapshot)).counted(snapshot)
        facts = await asyncio.to_thread(state_facts, self._plan, snapshot, self._rates)
        self._state = json.dumps(facts)
        for connection in self._session.joined:
            self._browsers[connection].show(self._state)

    async def keep_time(self) -> None:
        """Let the session's time pass."""
        while True:
            await asyncio.sleep(TICK)
            self._carry_out(self._session.tick(time.monotonic()))

    async def _outcome(self) -> tuple[str, str]:
        """Return how the flight ended, by its record, and the level of that."""
        latest = time.monotonic() + _SUMMARY_TIME
        while time.monotonic() < latest:
            with suppress(OSError, ValueError, KeyError, TypeError):
                ended = json.loads((self._folder / "summary.json").read_text())
                word, explanation = ended["outcome"], ended["explanation"]
                level = "good" if ended.get("exit_code", 1) == 0 else "bad"
                return f"{word}: {explanation}" if explanation else str(word), level
            await asyncio.sleep(_RETRY)
        return "the flight ended without a summary", "bad"


def _known_host(connection: HTTPConnection) -> bool:
    """Return whether the page was asked for by an address of its own.

    A page of another site, whose name leads to this machine (DNS rebinding), is refused.
    """
    server = connection.scope.get("server") or ("", 0)
    name, _, _ = connection.headers.get("host", "").rpartition(":")
    local = {"127.0.0.1", "localhost", "[::1]"}
    return server[0] not in {"127.0.0.1", "::1"} or name in local


async def _serve(listening: socket.socket, folder: Path) -> None:
    lines = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(lines), sys.stdin
    )
    secret = json.loads(await lines.readline())
    console = ConsoleServer(folder, secret["token"])
    config = uvicorn.Config(
        console.app,
        http="h11",
        ws="websockets-sansio",
        ws_max_size=4 * LARGEST_MESSAGE,
        ws_ping_interval=5.0,
        ws_ping_timeout=15.0,
        ws_per_message_deflate=False,
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        timeout_keep_alive=5,
        timeout_graceful_shutdown=1,
        limit_concurrency=128,
    )
    config.load()
    if secret["pem"] is not None:
        config.ssl = tls_context(secret["pem"].encode())
    server = uvicorn.Server(config)
    serving = asyncio.create_task(server.serve(sockets=[listening]))
    time_keeping = asyncio.create_task(console.keep_time())
    following = asyncio.create_task(console.follow())
    caller = asyncio.create_task(lines.read())
    await asyncio.wait({serving, following, caller}, return_when=asyncio.FIRST_COMPLETED)
    if console.connected and not serving.done():
        await asyncio.wait({serving, following}, return_when=asyncio.FIRST_COMPLETED)
    time_keeping.cancel()
    server.should_exit = True
    await serving
    if following.done():
        await following
    following.cancel()


def main() -> None:
    """Serve the console of the flight with a record on a socket that listens already.

    An error of this program goes into the record: there is no terminal to print it on.
    """
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    os.nice(_NICENESS)
    listening, folder = socket.socket(fileno=int(sys.argv[1])), Path(sys.argv[2])
    try:
        asyncio.run(_serve(listening, folder))
    except Exception:
        with suppress(OSError):
            (folder / "console-error.txt").write_text(traceback.format_exc(), encoding="utf-8")
        raise


if __name__ == "__main__":
    main()
