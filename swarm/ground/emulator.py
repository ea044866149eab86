"""The built-in emulator as a child process that uses real UDP on loopback."""

import json
import os
import signal
import subprocess
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from swarm.child_modules import module_command
from swarm.errors import VehicleError
from swarm.ground.child_process import exit_reason
from swarm.ground.world_clock import WorldClock, create_clock

_STOP_TIMEOUT = 3.0

START_TIMEOUT = 180.0
"""Seconds until it must be ready; on a new and busy machine most of them are for compiling."""
_POLL = 0.02


@dataclass(frozen=True)
class RealFirmware:
    """Vehicles with real autopilots: ``--firmware`` and ``--positioning`` of ``swarm sitl``.

    ``mocap`` is the UDP port on loopback that gets the vehicles' poses.
    """

    selection: str
    positioning: str = "rtk"
    mocap: int | None = None


class EmulatorProcess:
    """The process of the emulator; it ends with :meth:`stop` or with this process."""

    def __init__(
        self,
        world: Mapping[str, Any],
        folder: Path,
        port: int,
        speed: float,
        signing_key: str | None = None,
        timeout: float = START_TIMEOUT,
        firmware: RealFirmware | None = None,
        scenario: Mapping[str, Any] | None = None,
    ) -> None:
        """Write the world file and start; the vehicles send to UDP ``port`` on loopback.

        ``clock`` has the time of the world; with ``firmware``, the record has its ground truth.
        ``scenario`` has the faults that happen in the world.
        Raises :class:`VehicleError` if it ends, or is not ready within ``timeout`` seconds.
        """
        path, clock = folder / "world.json", folder.absolute() / "clock.bin"
        self._errors = folder / "emulator.txt"
        try:
            path.write_text(json.dumps(world, indent=1))
            if scenario is not None:
                (folder / "scenario.json").write_text(json.dumps(scenario, indent=1))
            create_clock(clock)
            self.clock = WorldClock(clock, speed)
            errors = self._errors.open("wb")
        except OSError as error:
            raise VehicleError(f"the emulator's world cannot be written: {error}") from None
        command = module_command("sitl", "--world", str(path), "--speed", f"{speed:g}")
        command += ["--target", f"127.0.0.1:{port}", "--clock", str(clock)]
        if signing_key is not None:
            command += ["--signing-key", signing_key]
        if scenario is not None:
            command += ["--scenario", str(folder / "scenario.json")]
        if firmware is not None:
            command += ["--firmware", firmware.selection, "--positioning", firmware.positioning]
            command += ["--firmware-folder", str(folder.absolute() / "firmware")]
            command += ["--truth", str(folder.absolute() / "truth.jsonl")]
            if firmware.mocap is not None:
                command += ["--mocap", f"127.0.0.1:{firmware.mocap}"]
        with errors:
            self._process = subprocess.Popen(  # noqa: S603
                [*command, "--json", "--follow-parent", str(os.getpid())],
                stdin=subprocess.DEVNULL,
                stdout=errors,
                stderr=errors,
                start_new_session=True,
            )
        try:
            self._wait_until_ready(timeout)
        except BaseException:
            self.stop()
            raise
        clock.unlink(missing_ok=True)

    def _wait_until_ready(self, timeout: float) -> None:
        """Wait until the vehicles send: flight time begins with them, and may run fast."""
        latest = time.monotonic() + timeout
        while b'"ready"' not in self._errors.read_bytes():
            ended = self.ended()
            if ended is not None:
                raise VehicleError(ended)
            if time.monotonic() >= latest:
                raise VehicleError(f"the emulator has not started in {timeout:g} s")
            time.sleep(_POLL)

    @property
    def pid(self) -> int:
        """The process id."""
        return self._process.pid

    def ended(self) -> str | None:
        """Return how the emulator ended; None while it runs."""
        code = self._process.poll()
        if code is None:
            return None
        lines = self._errors.read_text(errors="replace").strip().splitlines()
        last = f": {lines[-1]}" if lines and code > 0 else ""
        return f"the emulator ended ({exit_reason(code)}){last}"

    def stop(self) -> None:
        """End the emulator, and the autopilots that it has started: its session."""
        self._process.terminate()
        try:
            self._process.wait(_STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self.clock.close()
