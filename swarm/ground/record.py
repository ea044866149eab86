"""A flight's record: a folder that fills while it flies, and never holds the flight up.

Packets and events are handed to a thread that writes them a few times a second; a disk that is
full or gone costs the record, not the flight.
"""

import json
import math
import os
import platform
import struct
import threading
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from swarm.errors import InputError, Problem
from swarm.flight.adherence import adherence_object
from swarm.flight.archive import certificate_document, frames_document
from swarm.flight.flight_plan import Basis, FlightPlan
from swarm.flight.result import FlightResult
from swarm.flight.snapshot import Event
from swarm.flight.tlog import KnownFrames
from swarm.ground.priority import run_behind_main_thread
from swarm.mavlink.packets import split_packets
from swarm.mission.fleet import Fleet
from swarm.planning.archive import plan_document, plan_motion
from swarm.version import __version__

WRITE_INTERVAL = 0.25
_AT_ONCE, _BREATH = 40, 0.001
"""Packets that are made ready to be written in one go, and seconds of rest after that."""
_MOST_WAITING = 200_000
_STAMP = struct.Struct(">Q")


class Record:
    """The record of one flight.

    ``began`` is the wall-clock time in seconds since 1970 at which flight time was zero.
    """

    def __init__(self, folder: Path, began: float) -> None:
        """Raise :class:`InputError` where the folder cannot be made or holds a flight's record."""
        self.folder = folder
        self.began = began
        self.problem: str | None = None
        self.dropped = 0
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._packets = (folder / "flight.tlog").open("xb", buffering=0)
            self._events = (folder / "events.jsonl").open("wb", buffering=0)
        except FileExistsError:
            raise InputError([Problem(str(folder), "holds the record of a flight")]) from None
        except OSError as error:
            reason = (error.strerror or "cannot be written").lower()
            raise InputError([Problem(str(folder), reason)]) from None
        self._waiting: deque[Event | tuple[str, float, bytes]] = deque()
        self._cut: dict[str, bytes] = {}
        self._closing = threading.Event()
        self._writer = threading.Thread(target=self._write, name="record", daemon=True)
        self._writer.start()

    def packet(self, data: bytes, now: float, stream: str = "") -> None:
        """Keep what was sent or received at once; on a ``stream`` packets may be cut anywhere."""
        self._keep((stream, now, data))

    def event(self, event: Event) -> None:
        """Keep an event."""
        self._keep(event)

    def _keep(self, what: Event | tuple[str, float, bytes]) -> None:
        if len(self._waiting) < _MOST_WAITING:
            self._waiting.append(what)
        else:
            self.dropped += 1

    def _write(self) -> None:
        run_behind_main_thread()
        while not self._closing.wait(WRITE_INTERVAL):
            self._write_waiting()
        self._write_waiting()

    def _write_waiting(self) -> None:
        packets: list[bytes] = []
        events: list[bytes] = []
        for done in range(len(self._waiting)):
            if done % _AT_ONCE == _AT_ONCE - 1:
                # while this holds the interpreter, the flight's loop waits for it
                self._closing.wait(_BREATH)
            what = self._waiting.popleft()
            if isinstance(what, Event):
                events.append(json.dumps(asdict(what), ensure_ascii=False).encode() + b"\n")
            else:
                packets.extend(self._stamped(*what))
        self._append(self._packets, packets)
        self._append(self._events, events)

    def _stamped(self, stream: str, now: float, data: bytes) -> Iterator[bytes]:
        """Yield the packets with their times: eight bytes, microseconds since 1970, big-endian."""
        stamp = _STAMP.pack(int((self.began + now) * 1e6))
        whole, cut = split_packets(self._cut.get(stream, b"") + data)
        if stream:
            self._cut[stream] = cut
        for packet in whole:
            yield stamp + packet

    def _append(self, file: Any, chunks: list[bytes]) -> None:
        data = b"".join(chunks)
        try:
            while data:
                data = data[file.write(data) :]
        except OSError as error:
            self.dropped += len(chunks)
            self.problem = (error.strerror or "cannot be written").lower()

    def before(
        self, flight_plan: FlightPlan, basis: Basis, fleet: Fleet, facts: Mapping[str, Any]
    ) -> None:
        """Write down what is about to be flown, with what."""
        plan = flight_plan.plan
        self._file("mission.json", json.dumps(plan.mission.document(), indent=1).encode())
        self._file("fleet.json", fleet.model_dump_json(by_alias=True, indent=1).encode())
        self._file("plan.json", json.dumps(plan_document(plan), indent=1).encode())
        self._file("motion.npz", plan_motion(plan))
        certificate = certificate_document(basis, flight_plan.assessment)
        self._file("certificate.json", json.dumps(certificate, indent=1).encode())
        self._file("versions.json", json.dumps({**_versions(), **facts}, indent=1).encode())

    def frames(self, known: KnownFrames) -> None:
        """Keep the frames of vehicles that fly already: this record cannot tell them."""
        self._file("frames.json", json.dumps(frames_document(known), indent=1).encode())

    def after(self, result: FlightResult) -> None:
        """Write the summary and the trace, and close the record."""
        statistics = asdict(result.statistics)
        summary = {
            "outcome": result.outcome.word,
            "explanation": result.outcome.explanation,
            "exit_code": result.exit_code,
            "certificate": asdict(result.basis),
            "adherence": adherence_object(result.adherence),
            "statistics": statistics,
            "record": {"dropped": self.dropped, "problem": self.problem},
        }
        self._file("summary.json", json.dumps(_plain(summary), indent=1).encode())
        trace = result.trace
        try:
            np.savez_compressed(
                self.folder / "trace.npz",
                time=trace.time,
                mission_time=trace.mission_time,
                position=trace.position,
                setpoint=trace.setpoint,
                phase=np.array(trace.phase, dtype=np.str_),
            )
        except OSError as error:
            self.problem = (error.strerror or "cannot be written").lower()
        self.close()

    def close(self) -> None:
        """Write what is waiting and close the files."""
        self._closing.set()
        self._writer.join(5.0)
        for file in (self._packets, self._events):
            file.close()

    def _file(self, name: str, data: bytes) -> None:
        try:
            (self.folder / name).write_bytes(data)
        except OSError as error:
            self.problem = (error.strerror or "cannot be written").lower()


def _plain(value: Any) -> Any:
    """Return a value that JSON can hold: NaN becomes null."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _versions() -> dict[str, Any]:
    found: dict[str, Any] = {
        "swarm": __version__,
        "python": platform.python_version(),
        "system": platform.platform(),
        "process": os.getpid(),
    }
    for name in ("numpy", "pymavlink", "pymap3d", "scipy", "mavsdk"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = None
    return found
