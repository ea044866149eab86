"""What all real firmware has: the text of ``--firmware``, positioning, processes, connections.

Each process has fresh parameters in a folder of its own.
"""

import contextlib
import os
import re
import signal
import subprocess
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from sitl.physics.dynamics import Array
from sitl.physics.rigid_bodies import MOTORS
from sitl.world import Capture, Kind, World

Positioning = Literal["gps", "rtk", "mocap"]
PX4_PROGRAM = "bin/px4"
"""PX4's program in the folder of its build."""
_PART = re.compile(r"(?:(\d+)\*)?(\w+)=(.+)")
_EXPECTED = {"px4": "BUILD_FOLDER", "ardupilot": "PATH"}
"""The autopilots whose firmware the world can drive, and what names their programs."""
_KINDS: tuple[Kind, ...] = ("px4", "ardupilot")


class FirmwareError(Exception):
    """An invalid ``--firmware``; the text says what was expected."""


@dataclass(frozen=True)
class Firmware:
    """One part of ``--firmware``: the autopilot, its program, and for how many vehicles.

    ``program`` of PX4 is the folder of its build.
    """

    kind: Kind
    program: Path
    count: int | None


def parse_firmware(text: str) -> list[Firmware]:
    """Return the parts of ``KIND=PATH`` or ``COUNT*KIND=PATH,…``; raise `FirmwareError`."""
    parts = []
    for part in text.split(","):
        match = _PART.fullmatch(part.strip())
        if match is None or match[2] not in _KINDS:
            known = " or ".join(f"{kind}={what}" for kind, what in _EXPECTED.items())
            raise FirmwareError(f"--firmware: expected {known}, got {part}")
        count, name, program = match.groups()
        kind = _KINDS[_KINDS.index(name)]
        path = _program(kind, program)
        if count is not None and int(count) < 1:
            raise FirmwareError(f"--firmware: expected a count from 1, got {part}")
        parts.append(Firmware(kind, path, int(count) if count else None))
    return parts


def _program(kind: Kind, given: str) -> Path:
    """Return the program of an autopilot, or the folder of a PX4 build; raise `FirmwareError`."""
    path = Path(given).expanduser().absolute()
    file = path / PX4_PROGRAM if kind == "px4" else path
    if file.is_file() and os.access(file, os.X_OK):
        return path
    what = "the folder of a build" if kind == "px4" else "the program"
    lacks = f"no executable {PX4_PROGRAM} in it" if kind == "px4" else "no executable file"
    raise FirmwareError(
        f"--firmware: expected {what} of {kind}, built as its own pages say, got {given}: {lacks}"
    )


def check_positioning(parts: list[Firmware], positioning: Positioning) -> None:
    """Raise `FirmwareError` for firmware that cannot know its position in this way here."""
    if any(not usable(part.kind, positioning) for part in parts):
        raise FirmwareError(f"--positioning: expected rtk or mocap with px4, got {positioning}")


def assign(parts: list[Firmware], world: World) -> dict[int, Firmware]:
    """Return the firmware of each system id that flies with one.

    A part with a count takes as many vehicles of its kind, in order; without one, all that are
    left. Raises `FirmwareError` if there are fewer, or for a cable without inertia: it answers
    each motion of a grip at once, which no control loop in steps stands.
    """
    if parts and world.cable is not None and world.cable.model != "swinging":
        raise FirmwareError(
            f"--firmware: expected a world with cable.model: swinging, got {world.cable.model}"
        )
    vehicles = [(spec.id, spec.autopilot) for spec in world.vehicles]
    chosen: dict[int, Firmware] = {}
    for part in parts:
        free = [system for system, kind in vehicles if kind == part.kind and system not in chosen]
        if len(free) < (part.count or 1):
            raise FirmwareError(
                f"--firmware: expected at least {part.count or 1} vehicles with {part.kind}, "
                f"got {len(free)}"
            )
        chosen |= dict.fromkeys(free[: part.count], part)
    return chosen


_RECEIVER: dict[str, float] = {
    # The simulated receiver is late by 0.16 s; the default for its kind (0.12 s) leaves 0.05 s of
    # delay in the estimate.
    "GPS1_DELAY_MS": 160,
}
_ARDUPILOT: Mapping[Positioning, Mapping[str, float]] = {
    # ArduPilot's simulated receiver as it is: 5 Hz, and an estimator that trusts it little. With
    # it, the drift of the simulated gyroscopes makes velocities wrong by 0.025 m/s.
    "gps": _RECEIVER,
    "rtk": _RECEIVER
    | {
        "SIM_GPS_HZ": 10,
        "SIM_GPS_ACC": 0.02,
        "GPS1_RATE_MS": 100,
        "EK3_POSNE_M_NSE": 0.1,
        "EK3_VELNE_M_NSE": 0.1,
    },
    "mocap": {
        "SIM_GPS_DISABLE": 1,
        "GPS1_TYPE": 0,
        "COMPASS_ENABLE": 0,  # the heading comes from motion capture
        "EK3_SRC1_POSXY": 6,
        "EK3_SRC1_VELXY": 0,
        "EK3_SRC1_POSZ": 6,
        "EK3_SRC1_VELZ": 0,
        "EK3_SRC1_YAW": 6,
        "VISO_TYPE": 1,  # MAVLink
        "VISO_YAW_M_NSE": 0.05,
    },
}
_PX4: Mapping[Positioning, Mapping[str, float]] = {
    # PX4's defaults are those of a receiver without correction data; the simulated one has no delay
    "rtk": {"EKF2_GPS_P_NOISE": 0.02, "EKF2_GPS_V_NOISE": 0.1, "EKF2_GPS_DELAY": 0},
    "mocap": {
        "SYS_HAS_GPS": 0,
        "EKF2_GPS_CTRL": 0,
        "EKF2_BARO_CTRL": 0,  # its noise is a hundred times that of motion capture
        "EKF2_MAG_TYPE": 5,  # none: the heading comes from motion capture
        "EKF2_HGT_REF": 3,
        "EKF2_EV_CTRL": 11,  # position, height and yaw
        "EKF2_EV_NOISE_MD": 1,  # the poses have no covariance
        "EKF2_EVA_NOISE": 0.05,
    },
}

_TRUSTED: dict[Kind, float] = {"ardupilot": 0.05, "px4": 0.01}
"""Least noise of positions that an estimator is told, metres: the attitude of a pose errs too."""


def usable(kind: Kind, positioning: Positioning) -> bool:
    """Return whether vehicles with this firmware can know their position so."""
    return positioning in (_PX4 if kind == "px4" else _ARDUPILOT)


def position_parameters(kind: Kind, positioning: Positioning, capture: Capture) -> dict[str, float]:
    """Return the parameters for a source of positions; ``capture`` is the world's system."""
    if kind == "px4":
        values, delay, noise = dict(_PX4[positioning]), "EKF2_EV_DELAY", "EKF2_EVP_NOISE"
    else:
        values, delay, noise = dict(_ARDUPILOT[positioning]), "VISO_DELAY_MS", "VISO_POS_M_NSE"
    if positioning == "mocap":
        values |= {delay: round(1e3 * capture.delay), noise: max(_TRUSTED[kind], capture.noise)}
    return values


_STOP_TIMEOUT = 0.5
"""Seconds in which all processes may end by themselves; then they are killed."""


@dataclass(frozen=True)
class Start:
    """What one process is started with.

    ``target`` is the ground station's UDP address; None: that of the autopilot's own simulator.
    ``radio``: a pilot's transmitter is switched on.
    """

    binary: Path
    folder: Path
    instance: int
    system: int
    heading: float
    gripper: bool
    parameters: Mapping[str, float]
    target: str | None
    radio: bool = False
    positioning: Positioning = "rtk"
    capture: Capture = field(default_factory=Capture)


class Need(NamedTuple):
    """A port that must be free; without ``host`` the process opens it on all interfaces."""

    protocol: Literal["TCP", "UDP"]
    port: int
    host: str = ""


@dataclass(frozen=True)
class Launch:
    """One process: its command, folder, files, variables beside the present ones, and ports."""

    command: Sequence[str]
    folder: Path
    files: Mapping[str, str]
    needs: Sequence[Need]
    environment: Mapping[str, str] = field(default_factory=dict)


class Processes:
    """Running autopilots; they end with `stop`."""

    def __init__(self, launches: Sequence[Launch]) -> None:
        """Start all; raise `OSError` if a folder cannot be written or a binary not executed."""
        self._running: list[subprocess.Popen[bytes]] = []
        try:
            for launch in launches:
                launch.folder.mkdir(parents=True, exist_ok=True)
                for name, text in launch.files.items():
                    (launch.folder / name).write_text(text)
                with (launch.folder / "log.txt").open("wb") as log:
                    self._running.append(
                        subprocess.Popen(  # noqa: S603
                            launch.command,
                            cwd=launch.folder,
                            env=os.environ | launch.environment,
                            stdin=subprocess.DEVNULL,
                            stdout=log,
                            stderr=log,
                        )
                    )
        except OSError:
            self.stop()
            raise

    def ended(self) -> list[int]:
        """Return the numbers of processes that have ended."""
        return [i for i, process in enumerate(self._running) if process.poll() is not None]

    def stop(self) -> None:
        """End all processes."""
        for process in self._running:
            with contextlib.suppress(ProcessLookupError):
                process.send_signal(signal.SIGTERM)
        deadline = time.monotonic() + _STOP_TIMEOUT
        for process in self._running:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(max(deadline - time.monotonic(), 0.0))
        for process in self._running:
            process.kill()
            process.wait()


class Port(ABC):
    """One autopilot's connection and its latest outputs.

    ``row`` is that of its rigid body; ``command`` (4,) are its motors between 0 and 1; ``fresh``:
    they answer the latest sensor values; ``silent``: none came in time, because it has not booted
    or its process has ended, so the world does not wait for it; ``ended``: none will come.
    """

    def __init__(self, row: int) -> None:
        self.row = row
        self.fresh, self.silent, self.ended = False, True, False
        self.command = np.zeros(MOTORS)

    @abstractmethod
    def fileno(self) -> int:
        """Return the descriptor to wait at."""

    @abstractmethod
    def receive(self) -> None:
        """Take what has come."""

    @abstractmethod
    def answer(self, at: float, state: Array, measured: Array) -> None:
        """Send what the vehicle measures at ``at`` seconds, if it is expected."""

    def end(self) -> None:
        """Note that the process has ended: motors stop, and the gripper stays as it is."""
        self.ended = self.silent = True
        self.command = np.zeros(MOTORS)

    @abstractmethod
    def grip(self) -> bool | None:
        """Return whether the gripper shall close (True) or open (False); None: stay."""

    @abstractmethod
    def close(self) -> None:
        """Close the sockets."""
