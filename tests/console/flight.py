"""A flight that only answers: its control socket, beside a record with a plan, for the console."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from swarm.console.launch import Address, Console, open_console
from swarm.flight.conductor import Conductor
from swarm.flight.requests import REQUESTS
from swarm.flight.snapshot import Event, Snapshot
from swarm.ground.operator import ControlSocket, OperatorConsole
from swarm.ground.record import Record
from swarm.mission.fleet import emulated_fleet
from tests.network import small_plan

PATIENCE = 300.0
"""Seconds for a process to start and to compile on a busy machine."""
LOOPBACK = Address("127.0.0.1", 0)


def snapshot(time_: float, **changed: Any) -> Snapshot:
    """Return a team of three that holds its cable aloft in the fold of the small plan."""
    plan = small_plan().plan
    at = plan.phase("fold").start + 1.0
    position = plan.motion.at(at)[0]
    values: dict[str, Any] = {
        "time": time_, "mission_time": at, "rate": 1.0, "phase": "fold", "waiting_for": None,
        "position": position, "velocity": np.zeros((3, 3)), "setpoint": position + 0.01,
        "modes": ("offboard",) * 3, "states": ("flying",) * 3, "armed": (True,) * 3,
        "gripped": (True,) * 3, "battery": np.full(3, 0.9), "link_age": np.full(3, 0.05),
        "available": {name: (name != "resume", f"what {name} does") for name in REQUESTS},
        "received": np.full(3, 50.0 * time_), "lost": np.zeros(3), "problems": ("",) * 3,
        "voltage": np.full(3, 16.0), "fix": np.full(3, 6.0), "satellites": np.full(3, 18.0),
        "position_age": np.full(3, 0.1), "landing": 30.0,
        "windows": {"land": 0.0, "release": 4.2},
    }  # fmt: skip
    return Snapshot(**(values | changed))


class FlightStub:
    """Takes requests and notes, and shows a snapshot twenty times a second."""

    def __init__(self, folder: Path) -> None:
        flight_plan = small_plan()
        fleet = emulated_fleet(3)
        self.folder = folder
        self.requests: list[tuple[str, str]] = []
        self.notes: list[str] = []
        record = Record(folder, 0.0)
        record.before(flight_plan, Conductor(flight_plan, fleet).basis, fleet, {})
        record.close()
        self._control: ControlSocket | None = None
        self._over = threading.Event()
        self._watched = False
        self._now = 0.0

    @property
    def watched(self) -> bool:
        """Whether a screen is attached to the flight."""
        return self._watched

    @property
    def now(self) -> float:
        """The time of the newest snapshot."""
        return self._now

    def request(self, request: str, author: str) -> str:
        """Take a request."""
        self.requests.append((request, author))
        return f"{request} it is"

    def report(self, _kind: str, message: str) -> None:
        """Take an event for the record, and show it."""
        self.notes.append(message)
        if self._control is not None:
            self._control.publish(Event(1.0, "operator", message))

    def run(self) -> None:
        """Fly until it is over."""
        control = ControlSocket(self.folder / "control", lambda: OperatorConsole(self, dict))
        self._control = control
        control.publish(Event(0.5, "flight", "all vehicles are ready"))
        tick = 0
        while not self._over.is_set():
            tick += 1
            control.poll()
            self._watched = control.watched
            if tick % 5 == 0:
                self._now = 0.01 * tick
                control.publish(snapshot(self._now))
            time.sleep(0.01)
        (self.folder / "summary.json").write_text('{"outcome": "done", "explanation": "landed"}')
        with suppress(OSError):
            control.close()

    def end(self) -> None:
        """Let it be over."""
        self._over.set()


@contextmanager
def flying(folder: Path) -> Iterator[FlightStub]:
    """Fly beside the block."""
    flight = FlightStub(folder)
    thread = threading.Thread(target=flight.run)
    thread.start()
    try:
        yield flight
    finally:
        flight.end()
        thread.join()


@contextmanager
def flying_with_console(
    folder: Path, address: Address = LOOPBACK
) -> Iterator[tuple[FlightStub, Console]]:
    """Fly with a console beside the block; the console ends by itself after its flight."""
    with flying(folder) as flight, open_console(folder, address, None) as console:
        try:
            yield flight, console
        finally:
            flight.end()
            code = console.process.wait(PATIENCE)
    assert code == 0
