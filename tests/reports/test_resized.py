"""The screen of a flight in a terminal that is resized: nothing of an earlier drawing is left."""

import fcntl
import os
import pty
import struct
import termios
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from swarm.flight.requests import REQUESTS
from swarm.reports.terminal import FlightScreen
from tests.reports.synthetic import snapshot_at, trefoil_plan

pyte = pytest.importorskip("pyte", reason="no emulator of terminals: pip install pyte")
PLAN = trefoil_plan()
KEYS = "h hold  r resume  b rewind  l land  x release  j rejoin  a abort  k kill  ^C end"


def team(number, second):
    """So many vehicles; what is shown differs in every second."""
    nine = snapshot_at(PLAN, 40.0 + second)
    chosen = [k % 9 for k in range(number)]
    values = {
        name: getattr(nine, name)[chosen]
        for name in ("position", "velocity", "setpoint", "battery", "link_age")
    } | {
        name: tuple(getattr(nine, name)[k] for k in chosen)
        for name in ("modes", "states", "armed", "gripped")
    }
    values["link_age"] = np.full(number, 0.05)
    return replace(
        nine, time=40.0 + second, available=dict.fromkeys(REQUESTS, (True, "")), **values
    )


class Terminal:
    """A pseudo-terminal whose lines fold, or leave it at the top, when it becomes smaller."""

    def __init__(self, stack, columns, lines):
        self._master, self._slave = pty.openpty()
        stack.callback(os.close, self._master)
        file = stack.enter_context(os.fdopen(self._slave, "w", encoding="utf-8"))
        os.set_blocking(self._master, False)
        self.screen = pyte.Screen(columns, lines)
        self._stream = pyte.ByteStream(self.screen)
        self.console = Console(file=file, force_terminal=True, color_system=None)
        self.console._environ = {"TERM": "xterm"}
        self._set_size(columns, lines)

    def _set_size(self, columns, lines):
        fcntl.ioctl(self._slave, termios.TIOCSWINSZ, struct.pack("4H", lines, columns, 0, 0))
        self.console.size = os.get_terminal_size(self._slave)  # Rich asks for that of its process

    def read(self):
        """The lines that it shows now."""
        try:
            while data := os.read(self._master, 1 << 16):
                self._stream.feed(data)
        except BlockingIOError:
            pass
        return [line.rstrip() for line in self.screen.display]

    def resize(self, columns, lines):
        """Resize it as terminals do: long lines are folded, the last line stays at the bottom."""
        shown = self.read()
        while shown and not shown[-1]:
            shown.pop()
        at = self.screen.cursor.y
        folded, row = [], 0
        for k, line in enumerate(shown):
            if k == at:
                row = len(folded)
            folded += [line[i : i + columns] for i in range(0, max(len(line), 1), columns)]
        row = row if at < len(shown) else len(folded) + at - len(shown)
        over = max(0, max(len(folded), row + 1) - lines)
        self.screen.resize(lines, columns)
        self.screen.reset()
        for k, line in enumerate(folded[over:]):
            self.screen.cursor.y, self.screen.cursor.x = k, 0
            self.screen.draw(line)
        self.screen.cursor.y, self.screen.cursor.x = row - over, 0
        self._set_size(columns, lines)


def assert_one_drawing(lines, number, second):
    """Every vehicle is shown once, and one line of each other kind, none of an earlier second."""
    text = "\n".join(lines)
    assert sum(line.startswith(PLAN.mission.name) for line in lines) == 1, text
    assert sum(line.startswith(KEYS[:14]) for line in lines) == 1, text
    keys = next(line for line in lines if line.startswith(KEYS[:14]))
    assert keys == KEYS, text
    assert f"record 0:{40 + second:02}.0" in text
    heads = sum(line.split()[:1] in (["vehicle"], ["state"]) for line in lines)
    assert heads == 1, text
    rows = [
        line.split()
        for line in lines[
            lines.index(
                next(line for line in lines if line.split()[:1] in (["vehicle"], ["state"]))
            )
            + 1 :
        ]
    ]
    shown = [word for row in rows for word in row if word.isdigit()]
    assert sorted(map(int, shown)) == list(range(1, number + 1)), text


@pytest.mark.parametrize("number", [9, 13, 19])
def test_nothing_of_an_earlier_drawing_is_left_after_resizing(number):
    """80 by 24, larger, smaller again, narrower and wider in mid-flight."""
    with ExitStack() as stack:
        terminal = Terminal(stack, 80, 24)
        screen = FlightScreen(PLAN, terminal.console, keys=True)
        screen._live.auto_refresh = False
        stack.enter_context(screen)
        sizes = [(80, 24), (132, 40), (80, 24), (100, 50), (80, 30), (120, 24), (80, 24)]
        for second, (columns, lines) in enumerate(sizes):
            terminal.resize(columns, lines)
            for _ in range(2):
                screen.show(team(number, second))
                screen._live.refresh()
                terminal.read()
            assert_one_drawing(terminal.read(), number, second)
