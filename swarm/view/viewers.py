"""Rerun's own program: viewers and servers as processes, on loopback only.

The library's own ways of starting them bind every interface of the machine; the program can be
told not to.
"""

import importlib.util
import os
import socket
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from swarm.ground.priority import give_way

LOOPBACK = "127.0.0.1"

Process = subprocess.Popen[bytes]


def viewer_binary() -> Path:
    """Return the path of the rerun program that the installed package brings along."""
    spec = importlib.util.find_spec("rerun_cli")
    if spec is None or not spec.submodule_search_locations:
        raise FileNotFoundError("the rerun program is not installed")
    folder = Path(spec.submodule_search_locations[0])
    bundled = folder / "Rerun.app" / "Contents" / "MacOS" / "Rerun"
    if sys.platform == "darwin" and bundled.exists():
        return bundled
    return folder / ("rerun.exe" if sys.platform == "win32" else "rerun")


def free_port() -> int:
    """Return a TCP port of the loopback interface that nobody uses now."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        port: int = probe.getsockname()[1]
        return port


def proxy_url(port: int) -> str:
    """Return the address at which viewers and recordings meet on that port."""
    return f"rerun+http://{LOOPBACK}:{port}/proxy"


def web_url(web_port: int, port: int) -> str:
    """Return the address of the page that shows what the server on ``port`` is sent."""
    return f"http://{LOOPBACK}:{web_port}/?url=rerun%2Bhttp%3A%2F%2F{LOOPBACK}%3A{port}%2Fproxy"


def has_display() -> bool:
    """Return whether a window can be opened here."""
    if sys.platform in {"darwin", "win32"}:
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def run_viewer(arguments: Sequence[str], *, own_group: bool = False) -> Process:
    """Start the rerun program, quiet and bound to loopback.

    With ``own_group`` it outlives the process group that started it, as a window should.
    """
    process = subprocess.Popen(  # noqa: S603 - our own arguments to the installed program
        [str(viewer_binary()), "--bind", LOOPBACK, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=own_group,
    )
    give_way(process.pid)
    return process


def serve(port: int, web_port: int | None, *files: Path) -> Process:
    """Start a server that keeps what is logged for viewers that come and go, and given files.

    It remembers the newest 256 MiB; with ``web_port`` it also serves the viewer as a page.
    """
    kind = ["--serve-grpc"]
    if web_port is not None:
        kind = ["--serve-web", "--web-viewer-port", str(web_port)]
    sources = [str(file) for file in files]
    return run_viewer([*kind, "--port", str(port), "--server-memory-limit", "256MiB", *sources])


def open_window(*sources: str) -> Process:
    """Open a viewer's window that stays when the flight is over."""
    return run_viewer(["--port", "auto", "--hide-welcome-screen", *sources], own_group=True)
