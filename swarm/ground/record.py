"""The record of a flight: a folder that is written during the flight, without delaying it.

A thread writes packets and events a few times a second. A disk that is full or missing damages the
record, not the flight.
"""

import json
import math
import os
import platform
import struct
import threading
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from swarm.errors import InputError, Problem, reason
from swarm.flight.archive import certificate_document
from swarm.flight.flight_plan import Basis, FlightPlan
from swarm.flight.result import FlightResult, adherence_object
from swarm.flight.snapshot import Event
from swarm.flight.swinging import largest_stray, swing_object
from swarm.flight.tlog import KnownFrames, frames_document
from swarm.flight.training import training_object
from swarm.ground.priority import run_behind_main_thread
from swarm.mavlink.packets import split_packets
from swarm.mission.fleet import Fleet
from swarm.planning.archive import plan_document, plan_motion
from swarm.version import __version__

LONGEST_SOCKET_PATH = 100
"""Bytes; longer paths of sockets are refused by the operating system."""


def new_record_folder(parent: Path, name: str) -> Path:
    """Return an unused folder in ``parent``, named by the local time and ``name``."""
    stem = f"{_timestamp()}-{name}".replace("/", "-")
    for number in range(100):
        folder = parent / (f"{stem}-{number}" if number else stem)
        if not folder.exists():
            return folder
    raise InputError([Problem(str(parent), "expected a free name for the record")])


def new_check_folder(parent: Path) -> Path:
    """Return the folder of a check that starts now, named by the local time."""
    return parent / _timestamp()


def control_socket(folder: Path) -> Path | None:
    """Return the path of the control socket; None if it is longer than a socket's path may be."""
    path = folder / "control"
    return path if len(os.fsencode(path)) < LONGEST_SOCKET_PATH else None


@contextmanager
def shared_folder(folder: Path, group: int | None) -> Iterator[None]:
    """Make the folder of a record; the members of a group, if any, read what is written meanwhile.

    Whatever the umask: they may list the folder, and pass through those that are made above it.
    Raises :class:`InputError` where that is not possible.
    """
    try:
        above = [each for each in folder.parents if not each.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        if group is not None:
            for each in above:
                _give_way(each, group, 0o010)
            _give_way(folder, group, 0o2050)  # new files belong to the group of the folder
    except OSError as error:
        raise InputError([Problem(str(folder), reason(error))]) from None
    before = os.umask(0o077)
    os.umask(before if group is None else before & ~0o050)
    try:
        yield
    finally:
        os.umask(before)


def _give_way(folder: Path, group: int, mode: int) -> None:
    """Give a folder to a group with these bits, and with what all others may already."""
    os.chown(folder, -1, group)
    before = folder.stat().st_mode
    folder.chmod(before & ~0o070 | mode | (before & 0o007) << 3)


def refuse_used(folder: Path) -> None:
    """Raise :class:`InputError` for a folder that holds a record, before anything is written."""
    if (folder / "flight.tlog").exists():
        raise InputError([Problem(str(folder), "holds the record of a flight")])


def _timestamp() -> str:
    return f"{datetime.now().astimezone():%Y-%m-%dT%H-%M-%S}"


WRITE_INTERVAL = 0.25
_BATCH, _PAUSE = 40, 0.001
"""Items that are prepared for writing without interruption, and the pause in seconds after them."""
_MAX_QUEUED = 200_000
_TIMESTAMP = struct.Struct(">Q")


class Record:
    """The record of one flight.

    ``start_time`` is the wall-clock time in seconds since 1970 at which flight time is zero.
    ``problem`` is the reason why the record cannot be written, None without one; ``dropped`` counts
    packets and events that were not written.
    """

    def __init__(self, folder: Path, start_time: float) -> None:
        """Raise :class:`InputError` if the folder cannot be created or holds a flight record."""
        self.folder = folder
        self.start_time = start_time
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
        self._queue: deque[Event | tuple[str, float, bytes]] = deque()
        self._incomplete: dict[str, bytes] = {}
        self._closing = threading.Event()
        self._writer = threading.Thread(target=self._write, name="record", daemon=True)
        self._writer.start()

    def packet(self, data: bytes, now: float, stream: str = "") -> None:
        """Record sent or received bytes; on a ``stream`` they may end in the middle of a packet."""
        self._enqueue((stream, now, data))

    def event(self, event: Event) -> None:
        """Record an event."""
        self._enqueue(event)

    def _enqueue(self, item: Event | tuple[str, float, bytes]) -> None:
        if len(self._queue) < _MAX_QUEUED:
            self._queue.append(item)
        else:
            self.dropped += 1

    def _write(self) -> None:
        run_behind_main_thread()
        while not self._closing.wait(WRITE_INTERVAL):
            self._write_queue()
        self._write_queue()

    def _write_queue(self) -> None:
        packets: list[bytes] = []
        events: list[bytes] = []
        for done in range(len(self._queue)):
            if done % _BATCH == _BATCH - 1:
                # the flight loop waits while this thread holds the interpreter lock
                self._closing.wait(_PAUSE)
            item = self._queue.popleft()
            if isinstance(item, Event):
                events.append(json.dumps(asdict(item), ensure_ascii=False).encode() + b"\n")
            else:
                packets.extend(self._timestamped(*item))
        self._append(self._packets, packets)
        self._append(self._events, events)

    def _timestamped(self, stream: str, now: float, data: bytes) -> Iterator[bytes]:
        """Yield the packets with timestamps: eight bytes, microseconds since 1970, big-endian."""
        timestamp = _TIMESTAMP.pack(int((self.start_time + now) * 1e6))
        packets, rest = split_packets(self._incomplete.get(stream, b"") + data)
        if stream:
            self._incomplete[stream] = rest
        for packet in packets:
            yield timestamp + packet

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
        """Write mission, fleet, plan, certificate, software versions and other facts."""
        plan = flight_plan.plan
        self._file("mission.json", json.dumps(plan.mission.document(), indent=1).encode())
        self._file("fleet.json", fleet.model_dump_json(by_alias=True, indent=1).encode())
        self._file("plan.json", json.dumps(plan_document(plan), indent=1).encode())
        self._file("motion.npz", plan_motion(plan))
        certificate = certificate_document(basis, flight_plan.assessment)
        self._file("certificate.json", json.dumps(certificate, indent=1).encode())
        self._file("versions.json", json.dumps({**_versions(), **facts}, indent=1).encode())

    def frames(self, known: KnownFrames) -> None:
        """Write the frames of vehicles that fly already: they do not follow from this record."""
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
            "swing": swing_object(largest_stray(result.trace)),
            "statistics": statistics,
            "training": training_object(result.training, result.events),
            "skipped_steps": list(result.skipped),
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
                stray=trace.stray,
            )
        except OSError as error:
            self.problem = (error.strerror or "cannot be written").lower()
        self.close()

    def close(self) -> None:
        """Write the queue and close the files."""
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
    """Return a value for JSON: numbers that are not finite become null."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _versions() -> dict[str, Any]:
    versions: dict[str, Any] = {
        "swarm": __version__,
        "python": platform.python_version(),
        "system": platform.platform(),
        "process": os.getpid(),
    }
    for name in ("numpy", "pymavlink", "pymap3d", "scipy", "mavsdk"):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = None
    return versions
