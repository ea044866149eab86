"""Processes of real firmware, each with fresh parameters in a folder of its own; ArduPilot's."""

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NamedTuple

from sitl.firmware import positioning as sources
from sitl.firmware.ardupilot import PORT, PORT_STEP
from sitl.firmware.positioning import Positioning
from sitl.world import Capture, Origin

_STOP_TIMEOUT = 0.5
"""Seconds in which all processes may end by themselves; then they are killed."""

_PARAMETERS: dict[str, float] = {
    "FRAME_CLASS": 1,  # quadrotor
    "FRAME_TYPE": 1,  # X
    "SIM_RATE_HZ": 400,  # the rate of `sitl.physics.rigid_bodies`
    "SCHED_LOOP_RATE": 200,  # arming requires 1.8 samples of the gyroscopes per loop
    # Tuned for the default vehicle, as every real one must be. A pull at the end of a stiff dropper
    # turns the vehicle into the pull and so drives it away from there: with ArduCopter's default
    # gains (4.5, 0.135, 0.135) nine of them turned over as soon as they lifted the cable.
    "ATC_ANG_RLL_P": 8,
    "ATC_ANG_PIT_P": 8,
    "ATC_RAT_RLL_P": 0.33,
    "ATC_RAT_PIT_P": 0.33,
    "ATC_RAT_RLL_I": 1.0,
    "ATC_RAT_PIT_I": 1.0,
    "ATC_RAT_RLL_D": 0.006,
    "ATC_RAT_PIT_D": 0.006,
    # ArduPilot takes no force as feed-forward: its integrator resists the cable. With the default
    # gains (1, 2, 1, 0.25) a pull that grows by 0.14 N/s moves one vehicle by 0.08 m, and it is
    # 0.09 m off on a circle of 1.5 m at 1 m/s; with these, 0.02 and 0.04 m.
    "PSC_POSXY_P": 2,
    "PSC_VELXY_P": 4,
    "PSC_VELXY_I": 2,
    "PSC_VELXY_D": 0.5,
    "MOT_THST_HOVER": 0.39,  # weight over full thrust of the default vehicle
    "MOT_SPIN_MIN": 0.0,  # the simulated motors have no dead band
    "MOT_SPIN_ARM": 0.0,
    "COMPASS_OFS_X": 5,  # the simulated compass's offsets: it counts as calibrated with them
    "COMPASS_OFS_Y": 13,
    "COMPASS_OFS_Z": -18,
    "COMPASS_OFS2_X": 5,
    "COMPASS_OFS2_Y": 13,
    "COMPASS_OFS2_Z": -18,
    "COMPASS_OFS3_X": 5,
    "COMPASS_OFS3_Y": 13,
    "COMPASS_OFS3_Z": -18,
    "INS_ACCOFFS_X": 0.001,  # not zero: the accelerometers count as calibrated
    "INS_ACCOFFS_Y": 0.001,
    "INS_ACCOFFS_Z": 0.001,
    "INS_ACC2OFFS_X": 0.001,
    "INS_ACC2OFFS_Y": 0.001,
    "INS_ACC2OFFS_Z": 0.001,
    "INS_ACCSCAL_X": 1.001,
    "INS_ACCSCAL_Y": 1.001,
    "INS_ACCSCAL_Z": 1.001,
    "INS_ACC2SCAL_X": 1.001,
    "INS_ACC2SCAL_Y": 1.001,
    "INS_ACC2SCAL_Z": 1.001,
    "BATT_MONITOR": 4,  # voltage and current
    "SIM_BARO_RND": 0,
}
_GROUND = "127.0.0.1:14550"
"""Where ground stations listen."""
_RADIO = 5501
"""UDP port of instance 0's radio; ArduPilot opens it on all interfaces."""
_GRIPPER: dict[str, float] = {"GRIP_ENABLE": 1, "GRIP_TYPE": 1, "SERVO9_FUNCTION": 28}
"""A gripper on output 9."""


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

    @property
    def physics(self) -> int:
        """The UDP port on loopback of an ArduPilot's physics."""
        return PORT + PORT_STEP * self.instance


def command(start: Start, origin: Origin) -> list[str]:
    """Return the command line of one autopilot; its home is the origin of the world.

    ArduPilot listens for more ground stations and for a radio on all interfaces. Here it has one
    serial port, and without ``radio`` its radio has the port of the physics, which is taken.
    """
    home = f"{origin.latitude:.7f},{origin.longitude:.7f},{origin.altitude:.2f},{start.heading:.1f}"
    return [
        str(start.binary), "--model", "JSON:127.0.0.1", f"-I{start.instance}",
        "--sysid", str(start.system), "--home", home, "--speedup", "1",
        "--serial0", f"udpclient:{start.target or _GROUND}", "--serial1", "none:",
        "--serial2", "none:", "--rc-in-port", str(_radio(start) if start.radio else start.physics),
        "--defaults", "defaults.parm",
    ]  # fmt: skip


def _radio(start: Start) -> int:
    return _RADIO + PORT_STEP * start.instance


def parameters(start: Start) -> str:
    """Return the text of the file of default parameters."""
    values = _PARAMETERS | sources.parameters("ardupilot", start.positioning, start.capture)
    values |= (_GRIPPER if start.gripper else {}) | dict(start.parameters)
    if not start.radio:
        values["FS_THR_ENABLE"] = 0  # otherwise it does not arm without a radio
    return "".join(f"{name} {value:g}\n" for name, value in values.items())


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


def launch(start: Start, origin: Origin) -> Launch:
    """Return the process of one ArduPilot."""
    needs = [Need("UDP", start.physics, "127.0.0.1")]
    if start.radio:
        needs.append(Need("UDP", _radio(start)))
    return Launch(command(start, origin), start.folder, {"defaults.parm": parameters(start)}, needs)


class Processes:
    """Running autopilots; they end with `stop`."""

    def __init__(self, launches: Sequence[Launch]) -> None:
        """Start all; raise `OSError` if a folder cannot be written or a binary not executed."""
        self._running: list[subprocess.Popen[bytes]] = []
        try:
            for one in launches:
                one.folder.mkdir(parents=True, exist_ok=True)
                for name, text in one.files.items():
                    (one.folder / name).write_text(text)
                with (one.folder / "log.txt").open("wb") as log:
                    self._running.append(
                        subprocess.Popen(  # noqa: S603
                            one.command,
                            cwd=one.folder,
                            env=os.environ | one.environment,
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
        return [i for i, one in enumerate(self._running) if one.poll() is not None]

    def stop(self) -> None:
        """End all processes."""
        for one in self._running:
            with contextlib.suppress(ProcessLookupError):
                one.send_signal(signal.SIGTERM)
        deadline = time.monotonic() + _STOP_TIMEOUT
        for one in self._running:
            with contextlib.suppress(subprocess.TimeoutExpired):
                one.wait(max(deadline - time.monotonic(), 0.0))
        for one in self._running:
            one.kill()
            one.wait()
