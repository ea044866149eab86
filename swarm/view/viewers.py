"""Rerun's program: viewers and servers as processes, on loopback only.

The library starts them on every interface of the machine; the program has an option for the
address.
"""

import importlib.util
import os
import re
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from swarm.errors import SwarmError, reason
from swarm.ground.priority import lower_priority

LOOPBACK = "127.0.0.1"

DRIVER: Final = (
    "without a graphics card it needs a software Vulkan driver "
    "(Debian, Ubuntu: apt install mesa-vulkan-drivers)"
)

_EXIT_TIME: Final = 5.0
"""Seconds within which a terminated process ends by itself."""

_OUTPUT: Final = "rerun.txt"
"""The file of the program's error output."""

_WINDOW: Final = ("--port", "auto", "--hide-welcome-screen")

_COLOURS: Final = re.compile(r"\x1b\[[0-9;]*m")

Process = subprocess.Popen[bytes]


class ViewerFailed(SwarmError):  # noqa: N818 - it describes the failure
    """Rerun's program is missing, did not start or failed; the message has the reason."""


def viewer_binary() -> Path:
    """Return the path of the rerun program in the installed package.

    Raises :class:`ViewerFailed` where there is none.
    """
    spec = importlib.util.find_spec("rerun_cli")
    if spec is None or not spec.submodule_search_locations:
        raise ViewerFailed("the rerun program is not installed: pip install rerun-sdk")
    folder = Path(spec.submodule_search_locations[0])
    bundled = folder / "Rerun.app" / "Contents" / "MacOS" / "Rerun"
    if sys.platform == "darwin" and bundled.exists():
        return bundled
    return folder / ("rerun.exe" if sys.platform == "win32" else "rerun")


def free_port(preferred: int = 0) -> int:
    """Return a free TCP port of the loopback interface: the preferred one where that is free."""
    with socket.socket() as probe:
        try:
            probe.bind((LOOPBACK, preferred))
        except OSError:
            probe.bind((LOOPBACK, 0))
        port: int = probe.getsockname()[1]
        return port


def proxy_url(port: int) -> str:
    """Return the address of a server for viewers and recordings on a port."""
    return f"rerun+http://{LOOPBACK}:{port}/proxy"


def web_url(web_port: int, port: int) -> str:
    """Return the address of the page that shows the data of the server on ``port``."""
    return f"http://{LOOPBACK}:{web_port}/?url=rerun%2Bhttp%3A%2F%2F{LOOPBACK}%3A{port}%2Fproxy"


def has_display() -> bool:
    """Return whether a window can be opened on this machine."""
    if sys.platform in {"darwin", "win32"}:
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def run_viewer(
    arguments: Sequence[str], *, own_group: bool = False, folder: Path | None = None
) -> Process:
    """Start the rerun program without output, bound to loopback.

    With ``own_group`` it outlives the process group of its parent, as a window should. Its error
    output and temporary files go into ``folder``, where one is given. Raises :class:`ViewerFailed`
    where it cannot be started.
    """
    program = str(viewer_binary())
    environment = os.environ if folder is None else os.environ | {"TMPDIR": str(folder)}
    try:
        with (folder / _OUTPUT if folder else Path(os.devnull)).open("wb") as output:
            process = subprocess.Popen(  # noqa: S603 - our own arguments to the installed program
                [program, "--bind", LOOPBACK, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=output,
                start_new_session=own_group,
                env=environment,
            )
    except OSError as error:
        raise ViewerFailed(f"{program} cannot be started: {reason(error)}") from None
    lower_priority(process.pid)
    return process


@contextmanager
def ending(process: Process) -> Iterator[Process]:
    """End a process at the end of the block."""
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(_EXIT_TIME)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def exit_description(process: Process, folder: Path) -> str:
    """Return how the rerun program ended, with the last line of its output in ``folder``."""
    code = process.wait()
    how = f"signal {-code}" if code < 0 else f"exit code {code}"
    output = _COLOURS.sub("", (folder / _OUTPUT).read_text(errors="replace"))
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    worst = [line for line in lines if "panicked at" in line or " ERROR " in line]
    last = (worst or lines or ["no output"])[-1]
    return f"the rerun program ended ({how}): {last}"


def serve(port: int, web_port: int | None, *files: Path, folder: Path | None = None) -> Process:
    """Start a server that keeps logged data and files for viewers.

    It keeps the newest 256 MiB; with ``web_port`` it also serves the viewer as a page.
    """
    kind = ["--serve-grpc"]
    if web_port is not None:
        kind = ["--serve-web", "--web-viewer-port", str(web_port)]
    sources = [str(file) for file in files]
    options = ["--port", str(port), "--server-memory-limit", "256MiB"]
    return run_viewer([*kind, *options, *sources], folder=folder)


def open_window(*sources: str) -> Process:
    """Open a viewer's window that stays open after the flight."""
    return run_viewer([*_WINDOW, *sources], own_group=True)


def window(*sources: str, folder: Path) -> Process:
    """Open a viewer's window as a child of this process; see :func:`run_viewer`."""
    return run_viewer([*_WINDOW, *sources], folder=folder)
