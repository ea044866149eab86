"""The built-in emulator as a process of its own, speaking real UDP on loopback."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from swarm.errors import VehicleError

_STOP_PATIENCE = 3.0

STARTING = 180.0
"""Seconds that it may take to start; on a new and busy machine most of them are for compiling."""
_LOOK_AGAIN = 0.02


class EmulatorProcess:
    """The emulator's process, ended with :meth:`stop` or with this process."""

    def __init__(
        self,
        world: Mapping[str, Any],
        folder: Path,
        port: int,
        speed: float,
        signing_key: str | None = None,
        patience: float = STARTING,
    ) -> None:
        """Write the world file and start; ``port`` is where the vehicles shall speak to.

        Raises :class:`VehicleError` where it does not speak within ``patience`` seconds.
        """
        path = folder / "world.json"
        self._errors = folder / "emulator.txt"
        try:
            path.write_text(json.dumps(world, indent=1))
            errors = self._errors.open("wb")
        except OSError as error:
            raise VehicleError(f"the emulator's world cannot be written: {error}") from None
        command = [sys.executable, "-m", "sitl", "--world", str(path), "--speed", f"{speed:g}"]
        command += ["--target", f"127.0.0.1:{port}"]
        if signing_key is not None:
            command += ["--signing-key", signing_key]
        with errors:
            self._process = subprocess.Popen(  # noqa: S603
                [*command, "--json", "--follow-parent", str(os.getpid())],
                stdin=subprocess.DEVNULL,
                stdout=errors,
                stderr=errors,
                start_new_session=True,
            )
        try:
            self._wait_until_ready(patience)
        except BaseException:
            self.stop()
            raise

    def _wait_until_ready(self, patience: float) -> None:
        """Wait for the vehicles to speak: flight time begins with them, and may run fast."""
        latest = time.monotonic() + patience
        while self._process.poll() is None:
            if b'"ready"' in self._errors.read_bytes():
                return
            if time.monotonic() >= latest:
                raise VehicleError(f"the emulator has not started in {patience:g} s")
            time.sleep(_LOOK_AGAIN)

    @property
    def pid(self) -> int:
        """The process id, for those who want to see what happens when it dies."""
        return self._process.pid

    def ended(self) -> str | None:
        """Return how the emulator ended, None while it runs."""
        code = self._process.poll()
        if code is None:
            return None
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        said = self._errors.read_text(errors="replace").strip().splitlines()
        return f"the emulator ended ({how})" + (f": {said[-1]}" if said and code > 0 else "")

    def stop(self) -> None:
        """End the emulator."""
        self._process.terminate()
        try:
            self._process.wait(_STOP_PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
